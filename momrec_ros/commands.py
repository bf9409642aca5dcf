"""What the commands of `momrec` do; each returns the exit code."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np

from momrec_core.canonical import CanonicalShape
from momrec_core.errors import MomrecError
from momrec_core.model import RecognitionModel, check_new_label, load_model
from momrec_core.recognizer import ObjectResult, Recognizer
from momrec_core.simulation import Projection, simulate_instance
from momrec_core.view import View
from momrec_ros import parameters
from momrec_ros.bag import read_bag
from momrec_ros.bag_writer import BagWriter
from momrec_ros.cameras_json import MaskedView, MaskedViews, read_cameras_json, read_mask
from momrec_ros.confusion_figures import draw_confusions
from momrec_ros.confusions import confusions
from momrec_ros.demo_folder import replaced_folder
from momrec_ros.experiment import Plan
from momrec_ros.experiment_folder import Objects, write_experiment
from momrec_ros.experiment_tables import bounds_table, table_1
from momrec_ros.figures import draw_coverage, draw_object, draw_overview
from momrec_ros.files import (
    check_mesh_output,
    expect_new,
    file_name,
    new_file,
    new_folder,
    read_mesh,
    write_mesh,
)
from momrec_ros.lessons import assess, split_sources
from momrec_ros.mask_coverage import mask_coverage
from momrec_ros.mask_messages import MaskRules
from momrec_ros.messages import StampedView
from momrec_ros.report import (
    ResultRow,
    json_line,
    lesson_table,
    lesson_warnings,
    rate_table,
    result_row,
    result_table,
)
from momrec_ros.rigs import image_size, read_rig
from momrec_ros.session import CONTRADICTS, Ended, Lost, Result, Session
from momrec_ros.shared_data import shared_path
from momrec_ros.terminal import Terminal
from momrec_ros.training import (
    Sight,
    held_back_recognitions,
    read_classes,
    recognition_rates,
    reconstructed_instances,
)
from momrec_ros.workers import FigureDrawer

__all__ = [
    "Course",
    "MaskRules",
    "Recording",
    "Scene",
    "Sources",
    "run_demo",
    "run_experiment",
    "run_learn",
    "run_reconstruct",
    "run_replay",
    "run_simulate",
    "run_train",
]

ALL_USED, SOMETHING_LOST = 0, 3
LEAST_CLASSES = 2  # that can be told apart
WORLD = "world"  # the frame of simulated views and of those of photographs
FIRST_STAMP = 1_000_000_000  # nanoseconds; zero means "no time" to many ROS tools
STEP = 100_000_000  # nanoseconds between simulated views: ten a second
SHIPPED_BAG, SHIPPED_MODEL = "bags/ten_objects", "models/ten_objects.json"


@dataclass(frozen=True)
class Recording:
    """A bag and how to read it; the fields are the parameters of the same names."""

    bag: Path
    projection: str
    world_frame: str
    slices: int
    min_views: int
    max_views: int
    max_bad_views: int
    max_objects: int
    object_timeout: float
    pose_source: str
    rules: MaskRules


@dataclass(frozen=True)
class Scene:
    """What simulated instances are seen by; the fields are the parameters of the same names.

    Attributes
    ----------
    rig : Path or None
        A camera file or a bag.
    upright : bool
    image_size : str
        Width and height with an x between, or empty.
    unit : float
    """

    rig: Path | None = None
    upright: bool = parameters.UPRIGHT.default
    image_size: str = parameters.IMAGE_SIZE.default
    unit: float = parameters.UNIT.default

    def sight(self, *, own_size: bool) -> Sight:
        """Return how simulated instances are seen.

        Raises
        ------
        MomrecError
            If the size is none, or the rig cannot be read.
        """
        size = image_size(self.image_size)
        rig = None if self.rig is None else read_rig(self.rig, size)
        return Sight(image_size=size, rig=rig, upright=self.upright, own_size=own_size)


@dataclass(frozen=True)
class Course:
    """How to train; the fields are the parameters of the same names."""

    instances: int
    views: int
    slices: int
    noise: float
    max_features: int
    order: int
    sized: bool
    with_invariants: bool
    scene: Scene
    seed: int
    workers: int


@dataclass(frozen=True)
class Sources:
    """What to learn one more class from; fields with a parameter's name are that parameter."""

    paths: Sequence[Path]
    instances: int
    views: int
    slices: int
    noise: float
    scene: Scene
    seed: int
    workers: int
    projection: str
    world_frame: str


class _Sinks:
    """All that a finished object is written to."""

    def __init__(
        self,
        terminal: Terminal,
        drawer: FigureDrawer,
        writer: BagWriter | None = None,
        figures: Path | None = None,
        on_result: Callable[[ObjectResult], object] | None = None,
    ) -> None:
        self._terminal = terminal
        self._drawer = drawer
        self._writer = writer
        self._figures = figures
        self._on_result = on_result
        self._names: set[str] = set()
        self.rows: list[ResultRow] = []

    def take(self, finished: Result) -> None:
        result = finished.result
        self.rows.append(result_row(result))
        self._terminal.json(json_line(result, finished.cut_views))
        if self._writer is not None:
            self._writer.write_result(
                result, finished.stamp, finished.frame_id, cut_views=finished.cut_views
            )
        if self._figures is not None:
            name = self._new_name(result.object_id)
            self._drawer.draw(result, self._figures / f"{name}.png")
        if self._on_result is not None:
            self._on_result(result)

    def _new_name(self, object_id: str) -> str:
        name = file_name(object_id)
        if name in self._names:
            name = f"{name}-{len(self._names)}"
        self._names.add(name)
        return name


def run_replay(
    recording: Recording,
    model: Path | None,
    output: Path | None,
    figures: Path | None,
    *,
    json: bool = False,
) -> int:
    """Replay a bag; see `momrec replay --help`."""
    expect_new(output, figures)
    terminal = Terminal(json=json)
    if model is None:
        terminal.say("no --model given: objects are not named")
    with ExitStack() as stack:
        writer = stack.enter_context(BagWriter(output)) if output else None
        folder = stack.enter_context(new_folder(figures)) if figures else None
        drawer = stack.enter_context(FigureDrawer())
        sinks = _Sinks(terminal, drawer, writer, folder)
        known = None if model is None else load_model(model)
        losses = _replay(recording, known, writer, sinks, terminal)
    terminal.table(result_table(sinks.rows))
    terminal.wrote(output, figures)
    return SOMETHING_LOST if losses else ALL_USED


def _replay(
    recording: Recording,
    model: RecognitionModel | None,
    writer: BagWriter | None,
    sinks: _Sinks,
    terminal: Terminal,
) -> int:
    """Replay a bag into the sinks; return how many things were lost."""
    losses = 0
    for outcome in _outcomes(recording, model, writer, terminal):
        if isinstance(outcome, Lost):
            terminal.lost(outcome.text)
            losses += 1
        elif isinstance(outcome, Result):
            sinks.take(outcome)
    if not sinks.rows:
        raise MomrecError(f"Expected views of an object in {recording.bag}, got no result")
    return losses


def _outcomes(
    recording: Recording,
    model: RecognitionModel | None,
    writer: BagWriter | None,
    terminal: Terminal,
) -> Iterator[Result | Ended | Lost]:
    session = Session(
        model,
        slices=recording.slices,
        min_views=recording.min_views,
        max_objects=recording.max_objects,
        max_views=recording.max_views,
        max_bad_views=recording.max_bad_views,
    )
    reader = read_bag(
        recording.bag,
        projection=recording.projection,
        world_frame=recording.world_frame,
        rules=recording.rules,
        pose_source=recording.pose_source,
    )
    events = terminal.progress(reader, "replaying", reader.size, lambda: reader.position)
    now = 0
    for event in events:
        if isinstance(event, StampedView):
            now = event.stamp
            if writer is not None:
                writer.write_view(event)
        yield from session.end_overdue(now, recording.object_timeout)
        yield from session.feed(event, now)
    yield from session.finish()
    for note in reader.report.notes:
        terminal.say(note)
    for loss in reader.report.losses:
        yield Lost(f"{loss.size} bytes of the bag: {loss.reason}")


def _recording(
    bag: Path,
    *,
    slices: int = parameters.SLICES.default,
    projection: str = parameters.PROJECTION.default,
    world_frame: str = parameters.WORLD_FRAME.default,
) -> Recording:
    """Return a bag that is read with the defaults of all other parameters."""
    return Recording(
        bag=bag,
        projection=projection,
        world_frame=world_frame,
        slices=slices,
        min_views=parameters.MIN_VIEWS.default,
        max_views=parameters.MAX_VIEWS.default,
        max_bad_views=parameters.MAX_BAD_VIEWS.default,
        max_objects=parameters.MAX_OBJECTS.default,
        object_timeout=parameters.OBJECT_TIMEOUT.default,
        pose_source=parameters.POSE_SOURCE.default,
        rules=MaskRules(),
    )


def run_demo(output: Path) -> int:
    """Replay the shipped bag with the shipped model; see `momrec demo --help`."""
    recording = _recording(shared_path(SHIPPED_BAG))
    model = load_model(shared_path(SHIPPED_MODEL))
    terminal = Terminal()
    results: list[ObjectResult] = []
    with replaced_folder(output) as folder:
        figures = folder / "figures"
        figures.mkdir()
        with BagWriter(folder / "results") as writer, FigureDrawer() as drawer:
            sinks = _Sinks(terminal, drawer, writer, figures, results.append)
            losses = _replay(recording, model, writer, sinks, terminal)
            draw_overview(results, folder / "overview.png")
    terminal.table(result_table(sinks.rows))
    terminal.wrote(output / "overview.png", output / "figures", output / "results")
    return SOMETHING_LOST if losses else ALL_USED


def run_simulate(
    meshes: Sequence[Path],
    output: Path,
    *,
    views: int,
    projection: Projection,
    distance: float,
    noise: float,
    seed: int,
) -> int:
    """Write views of meshes as a bag; see `momrec simulate --help`."""
    expect_new(output)
    stems = [path.stem for path in meshes]
    repeated = sorted({stem for stem in stems if stems.count(stem) > 1})
    if repeated:
        raise MomrecError(f"Expected meshes with different stems, got several of {repeated}")
    terminal = Terminal()
    rng = np.random.default_rng(seed)
    stamps = count(FIRST_STAMP, STEP)
    with BagWriter(output) as writer:
        for path in terminal.progress(meshes, "simulating", len(meshes)):
            instance = simulate_instance(
                read_mesh(path), views, rng, projection=projection, distance=distance, noise=noise
            )
            for stamped in _stamped(path.stem, instance.views, stamps):
                writer.write_view(stamped)
    terminal.wrote(output)
    return ALL_USED


def _stamped(object_id: str, views: Iterable[View], stamps: Iterator[int]) -> Iterator[StampedView]:
    for view in views:
        yield StampedView(object_id, next(stamps), WORLD, view)


def run_train(paths: Sequence[Path], output: Path, figures: Path | None, course: Course) -> int:
    """Learn classes from meshes; see `momrec train --help`."""
    expect_new(output, figures)
    terminal = Terminal()
    sight = course.scene.sight(own_size=course.sized)
    classes = read_classes(paths, course.scene.unit)
    for loss in classes.losses:
        terminal.lost(loss)
    if len(classes.meshes) < LEAST_CLASSES:
        raise MomrecError(
            f"Expected meshes of {LEAST_CLASSES} classes or more, got those of "
            f"{', '.join(map(repr, classes.meshes)) or 'none'}"
        )
    rebuilt = reconstructed_instances(
        classes.meshes,
        instances=course.instances,
        views=course.views,
        slices=course.slices,
        noise=course.noise,
        seed=course.seed,
        workers=course.workers,
        sight=sight,
    )
    total = len(classes.meshes) * course.instances
    pairs = list(terminal.progress(rebuilt, "reconstructing", total))
    labels = [label for label, _ in pairs]
    shapes = [shape for _, shape in pairs]
    fit = partial(
        RecognitionModel.fit,
        max_features=course.max_features,
        order=course.order,
        sized=course.sized,
        with_invariants=course.with_invariants,
    )
    model = fit(shapes, labels)
    held_back = held_back_recognitions(fit, shapes, labels)
    found = confusions(labels, held_back)
    with ExitStack() as stack:
        if figures is not None:
            folder = stack.enter_context(new_folder(figures))
            meshes = {label: shape.mesh for label, shape in reversed(pairs)}
            draw_confusions(found, meshes, folder / "confusions.png")
        model.save(stack.enter_context(new_file(output)))
    terminal.table(rate_table(recognition_rates(model, held_back, shapes, labels), found))
    terminal.wrote(output, figures)
    return SOMETHING_LOST if classes.losses else ALL_USED


def run_learn(model: Path, label: str, output: Path, sources: Sources) -> int:
    """Learn one more class from meshes and bags; see `momrec learn --help`."""
    expect_new(output)
    terminal = Terminal()
    known = load_model(model)
    check_new_label(label, known.classes)
    meshes, bags = split_sources(sources.paths)
    shapes = _simulated(meshes, sources, known.sized, terminal)
    losses = sum(_gather(bag, sources, shapes, terminal) for bag in bags)
    learned = known.with_class(label, shapes)
    lesson = assess(known, learned, shapes)
    with new_file(output) as temporary:
        learned.save(temporary)
    terminal.table(lesson_table(lesson))
    for line in lesson_warnings(lesson):
        terminal.say(line)
    terminal.wrote(output)
    return SOMETHING_LOST if losses else ALL_USED


def _simulated(
    meshes: Sequence[Path], sources: Sources, own_size: bool, terminal: Terminal
) -> list[CanonicalShape]:
    """Return instances of one class, which take turns with the meshes; none without meshes."""
    if not meshes:
        return []
    rebuilt = reconstructed_instances(
        {"": [read_mesh(path, sources.scene.unit) for path in meshes]},
        instances=sources.instances,
        views=sources.views,
        slices=sources.slices,
        noise=sources.noise,
        seed=sources.seed,
        workers=sources.workers,
        sight=sources.scene.sight(own_size=own_size),
    )
    return [shape for _, shape in terminal.progress(rebuilt, "reconstructing", sources.instances)]


def _gather(bag: Path, sources: Sources, shapes: list[CanonicalShape], terminal: Terminal) -> int:
    """Add the shape of every object in a bag; return how many things were lost."""
    recording = _recording(
        bag,
        slices=sources.slices,
        projection=sources.projection,
        world_frame=sources.world_frame,
    )
    losses = 0
    for outcome in _outcomes(recording, None, None, terminal):
        if isinstance(outcome, Lost):
            terminal.lost(outcome.text)
            losses += 1
        elif isinstance(outcome, Result):
            shapes.append(outcome.result.canonical)
    return losses


def run_reconstruct(
    folder: Path,
    output: Path,
    bag: Path | None,
    figures: Path | None,
    *,
    mask_bag: Path | None = None,
    slices: int,
    tolerance: float,
    margin: float,
    max_bad_views: int,
) -> int:
    """Turn masks into a mesh; see `momrec reconstruct --help`."""
    expect_new(output, bag, mask_bag, figures)
    check_mesh_output(output)
    terminal = Terminal()
    masked = read_cameras_json(folder, tolerance=tolerance, margin=margin)
    _tell_borders(masked.views, terminal)
    recognizer = Recognizer(
        slices=slices, max_views=max(2, len(masked.views)), max_bad_views=max_bad_views
    )
    result, used, losses = _intersected(masked, folder.resolve().name, recognizer, terminal)
    for text in losses:
        terminal.lost(text)
    _tell_coverage(used, result, terminal)
    with ExitStack() as stack:
        if bag is not None:
            writer = stack.enter_context(BagWriter(bag))
            views = [view.view for view in masked.views]
            for stamped in _stamped(result.object_id, views, count(FIRST_STAMP, STEP)):
                writer.write_view(stamped)
        if mask_bag is not None:
            _write_masks(masked.views, stack.enter_context(BagWriter(mask_bag)))
        if figures is not None:
            temporary = stack.enter_context(new_folder(figures))
            draw_object(result, temporary / f"{file_name(result.object_id)}.png")
            draw_coverage(used, result.mesh, temporary / "coverage.png")
        write_mesh(result.mesh, output)
    terminal.table(result_table([result_row(result)]))
    terminal.wrote(output, bag, mask_bag, figures)
    return SOMETHING_LOST if losses else ALL_USED


def _write_masks(views: Sequence[MaskedView], writer: BagWriter) -> None:
    for masked, stamp in zip(views, count(FIRST_STAMP, STEP), strict=False):
        writer.write_mask(read_mask(masked), masked.view.camera, stamp, WORLD)


def _intersected(
    masked: MaskedViews, object_id: str, recognizer: Recognizer, terminal: Terminal
) -> tuple[ObjectResult, list[MaskedView], list[str]]:
    """Return what the masks say together, which were used, and what could not be used."""
    rejected = [f"{mask.name}: {mask.reason}" for mask in masked.rejected]
    refused: dict[View, str] = {}
    for seen in terminal.progress(masked.views, "intersecting", len(masked.views)):
        try:
            recognizer.add_view(object_id, seen.view)
        except MomrecError as error:
            refused[seen.view] = str(error)
    if not recognizer.objects:
        raise MomrecError(f"Expected masks that show an object, got none: {rejected[0]}")
    terminal.say("joining the slices to a mesh")
    result = recognizer.result(object_id)
    in_use = set(result.hull.views)
    used = [seen for seen in masked.views if seen.view in in_use]
    losses = [
        f"{seen.name}: {refused.get(seen.view, CONTRADICTS)}"
        for seen in masked.views
        if seen.view not in in_use
    ]
    return result, used, rejected + losses


def _tell_borders(views: Sequence[MaskedView], terminal: Terminal) -> None:
    names = [masked.name for masked in views if masked.touches_border]
    if names:
        terminal.say(
            f"the border of the image cuts the object in {len(names)} of {len(views)} masks, which "
            f"are open there: {', '.join(names)}"
        )


def _tell_coverage(used: Sequence[MaskedView], result: ObjectResult, terminal: Terminal) -> None:
    shares = [mask_coverage(masked, result.mesh) for masked in used]
    covered = [share.covered for share in shares]
    terminal.say(
        f"the mesh covers {100 * np.mean(covered):.1f} % of the silhouettes, "
        f"{100 * min(covered):.1f} % of the worst; intersection over union "
        f"{100 * np.mean([share.iou for share in shares]):.1f} %"
    )


def run_experiment(meshes: Sequence[Path], output: Path, plan: Plan) -> int:
    """Repeat the paper's experiment; see `momrec experiment --help`."""
    expect_new(output)
    terminal = Terminal()
    objects = Objects.given(meshes) if meshes else Objects.shipped()
    with new_folder(output) as folder:
        study, bounds = write_experiment(folder, objects, plan, terminal)
    terminal.table(table_1(study.ruled, study.free))
    terminal.table(bounds_table(bounds))
    terminal.wrote(*sorted(output.iterdir()))
    return ALL_USED
