"""The command line `momrec`: options and exit codes. What the commands do is in `commands`.

That module, and the geometry with it, is imported by the commands only, so that help is instant.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Any

import typer

from momrec_ros import parameters
from momrec_ros.parameters import Parameter, PoseSource, Projection, SimulatedProjection

__all__ = ["app", "main"]

FAILED = 1

EXIT_CODES = (
    "Exit codes: 0 all was read and used; 1 nothing could be recognised, or an error; "
    "2 wrong usage; 3 results given, but something was lost on the way."
)

app = typer.Typer(
    help="Turn silhouettes into closed meshes, principal frames and class labels.\n\n" + EXIT_CODES,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain help: rich would take longer to load than all else
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def _option(parameter: Parameter[Any]) -> Any:
    return typer.Option(
        "--" + parameter.name.replace("_", "-"),
        min=parameter.minimum,
        max=parameter.maximum,
        help=parameter.description,
    )


BagPath = Annotated[
    Path, typer.Argument(exists=True, help="A rosbag2 folder or an .mcap file.", metavar="BAG")
]
ModelPath = Annotated[
    Path | None,
    typer.Option(exists=True, dir_okay=False, help="Model that names the objects, from train."),
]
BagOutput = Annotated[Path | None, typer.Option(help="New bag folder for views and results.")]
FiguresOutput = Annotated[Path | None, typer.Option(help="New folder for a picture per object.")]
Slices = Annotated[int, _option(parameters.SLICES)]
MinViews = Annotated[int, _option(parameters.MIN_VIEWS)]
MaxViews = Annotated[int, _option(parameters.MAX_VIEWS)]
MaxBadViews = Annotated[int, _option(parameters.MAX_BAD_VIEWS)]
MaxObjects = Annotated[int, _option(parameters.MAX_OBJECTS)]
ObjectTimeout = Annotated[float, _option(parameters.OBJECT_TIMEOUT)]
ProjectionRule = Annotated[Projection, _option(parameters.PROJECTION)]
SimulatedCameras = Annotated[SimulatedProjection, _option(parameters.SIMULATED_PROJECTION)]
WorldFrame = Annotated[str, _option(parameters.WORLD_FRAME)]
Views = Annotated[int, _option(parameters.VIEWS)]
Instances = Annotated[int, _option(parameters.INSTANCES)]
Noise = Annotated[float, _option(parameters.NOISE)]
Distance = Annotated[float, _option(parameters.DISTANCE)]
Seed = Annotated[int, _option(parameters.SEED)]
Tolerance = Annotated[float, _option(parameters.TOLERANCE)]
Margin = Annotated[float, _option(parameters.MARGIN)]
PoseSourceRule = Annotated[PoseSource, _option(parameters.POSE_SOURCE)]
Rectified = Annotated[
    bool, typer.Option("--rectified", help=parameters.RECTIFIED.description, show_default=False)
]
MaxFeatures = Annotated[int, _option(parameters.MAX_FEATURES)]
Order = Annotated[int, _option(parameters.ORDER)]
Workers = Annotated[int, _option(parameters.WORKERS)]
RigPath = Annotated[
    Path | None,
    typer.Option(
        exists=True, help="Camera file, or bag, whose cameras are simulated instead of any."
    ),
]
ImageSize = Annotated[str, _option(parameters.IMAGE_SIZE)]
Upright = Annotated[bool, _option(parameters.UPRIGHT)]
Sized = Annotated[bool, _option(parameters.SIZED)]
Invariants = Annotated[bool, _option(parameters.INVARIANTS)]
Unit = Annotated[float, _option(parameters.UNIT)]
Splits = Annotated[int, _option(parameters.SPLITS)]


def _show_version(*, wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # noqa: PLC0415

        typer.echo(f"momrec {version('momrec_ros')}")
        raise typer.Exit


@app.callback()
def momrec(
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Turn silhouettes into closed meshes, principal frames and class labels."""


@app.command()
def demo(
    output: Annotated[
        Path, typer.Option(help="Folder for figures and bag; replaced if a demo made it.")
    ] = Path("demo"),
) -> None:
    """Replay the shipped bag with the shipped model: table, figures, output bag."""
    with _plain_interrupts():
        from momrec_ros.commands import run_demo  # noqa: PLC0415

    raise typer.Exit(run_demo(output))


@app.command()
def replay(
    bag: BagPath,
    *,
    model: ModelPath = None,
    output: BagOutput = None,
    figures: FiguresOutput = None,
    json: Annotated[
        bool, typer.Option("--json", help="A JSON object a line on stdout for each object.")
    ] = False,
    slices: Slices = parameters.SLICES.default,
    projection: ProjectionRule = Projection.AUTO,
    min_views: MinViews = parameters.MIN_VIEWS.default,
    max_views: MaxViews = parameters.MAX_VIEWS.default,
    max_bad_views: MaxBadViews = parameters.MAX_BAD_VIEWS.default,
    max_objects: MaxObjects = parameters.MAX_OBJECTS.default,
    object_timeout: ObjectTimeout = parameters.OBJECT_TIMEOUT.default,
    world_frame: WorldFrame = parameters.WORLD_FRAME.default,
    pose_source: PoseSourceRule = PoseSource.TOPIC,
    rectified: Rectified = parameters.RECTIFIED.default,
    tolerance: Tolerance = parameters.TOLERANCE.default,
    margin: Margin = parameters.MARGIN.default,
) -> None:
    """Turn the contours or masks of a recorded bag into meshes, canonical shapes and names.

    Without a model the objects are reconstructed and normalised, but not named.
    """
    with _plain_interrupts():
        from momrec_ros.commands import MaskRules, Recording, run_replay  # noqa: PLC0415

    recording = Recording(
        bag=bag,
        projection=projection,
        world_frame=world_frame,
        slices=slices,
        min_views=min_views,
        max_views=max_views,
        max_bad_views=max_bad_views,
        max_objects=max_objects,
        object_timeout=object_timeout,
        pose_source=pose_source,
        rules=MaskRules(tolerance, margin, rectified),
    )
    raise typer.Exit(run_replay(recording, model, output, figures, json=json))


@app.command()
def simulate(
    meshes: Annotated[
        list[Path],
        typer.Argument(exists=True, dir_okay=False, help="Each an object, named by its stem."),
    ],
    *,
    output: Annotated[Path, typer.Option(help="New bag folder.")],
    views: Views = parameters.VIEWS.default,
    projection: SimulatedCameras = SimulatedProjection.ORTHOGRAPHIC,
    distance: Distance = parameters.DISTANCE.default,
    noise: Noise = parameters.NOISE.default,
    seed: Seed = parameters.SEED.default,
) -> None:
    """Write views of meshes as a bag that `ros2 bag play` can play.

    Each mesh comes to its own random position, orientation and size.
    """
    with _plain_interrupts():
        from momrec_ros.commands import run_simulate  # noqa: PLC0415

    raise typer.Exit(
        run_simulate(
            meshes,
            output,
            views=views,
            projection="central" if projection is SimulatedProjection.CENTRAL else "orthographic",
            distance=distance,
            noise=noise,
            seed=seed,
        )
    )


@app.command()
def train(
    meshes: Annotated[
        list[Path],
        typer.Argument(exists=True, help="Files, and folders: a class per subfolder or per file."),
    ],
    *,
    output: Annotated[Path, typer.Option(help="New model file (JSON).")],
    instances: Instances = parameters.INSTANCES.default,
    views: Views = parameters.VIEWS.default,
    slices: Slices = parameters.SLICES.default,
    noise: Noise = parameters.NOISE.default,
    max_features: MaxFeatures = parameters.MAX_FEATURES.default,
    order: Order = parameters.ORDER.default,
    rig: RigPath = None,
    upright: Upright = parameters.UPRIGHT.default,
    image_size: ImageSize = parameters.IMAGE_SIZE.default,
    size: Sized = parameters.SIZED.default,
    invariants: Invariants = parameters.INVARIANTS.default,
    unit: Unit = parameters.UNIT.default,
    figures: Annotated[
        Path | None, typer.Option(help="New folder for a picture of classes that are alike.")
    ] = None,
    seed: Seed = parameters.SEED.default,
    workers: Workers = parameters.WORKERS.default,
) -> None:
    """Learn to name the classes of meshes from simulated, reconstructed instances.

    Each of them is seen from its own random directions, or by all cameras of a rig: the cameras of
    a cameras.json as of reconstruct, or those that saw the first object of a bag.
    """
    with _plain_interrupts():
        from momrec_ros.commands import Course, Scene, run_train  # noqa: PLC0415

    course = Course(
        instances=instances,
        views=views,
        slices=slices,
        noise=noise,
        max_features=max_features,
        order=order,
        sized=size,
        with_invariants=invariants,
        scene=Scene(rig, upright, image_size, unit),
        seed=seed,
        workers=workers,
    )
    raise typer.Exit(run_train(meshes, output, figures, course))


@app.command()
def learn(
    model: Annotated[
        Path, typer.Argument(exists=True, dir_okay=False, help="Model file, from train or learn.")
    ],
    sources: Annotated[
        list[Path],
        typer.Argument(exists=True, help="Mesh files, rosbag2 folders and .mcap files."),
    ],
    *,
    label: Annotated[str, typer.Option(help="Name of the new class.")],
    output: Annotated[Path, typer.Option(help="New model file (JSON).", metavar="NEW_MODEL")],
    instances: Instances = parameters.INSTANCES.default,
    views: Views = parameters.VIEWS.default,
    slices: Slices = parameters.SLICES.default,
    noise: Noise = parameters.NOISE.default,
    rig: RigPath = None,
    upright: Upright = parameters.UPRIGHT.default,
    image_size: ImageSize = parameters.IMAGE_SIZE.default,
    unit: Unit = parameters.UNIT.default,
    seed: Seed = parameters.SEED.default,
    workers: Workers = parameters.WORKERS.default,
    projection: ProjectionRule = Projection.AUTO,
    world_frame: WorldFrame = parameters.WORLD_FRAME.default,
) -> None:
    """Let a model know one more class, from meshes or from a few recorded sessions.

    Of meshes instances are simulated and reconstructed, as train does. Every object of a bag is
    an instance of the class, whatever its id. Two instances are enough, more are better.
    """
    with _plain_interrupts():
        from momrec_ros.commands import Scene, Sources, run_learn  # noqa: PLC0415

    given = Sources(
        paths=sources,
        instances=instances,
        views=views,
        slices=slices,
        noise=noise,
        scene=Scene(rig, upright, image_size, unit),
        seed=seed,
        workers=workers,
        projection=projection,
        world_frame=world_frame,
    )
    raise typer.Exit(run_learn(model, label, output, given))


@app.command()
def reconstruct(
    folder: Annotated[
        Path, typer.Argument(exists=True, file_okay=False, help="Masks and cameras.json.")
    ],
    *,
    output: Annotated[Path, typer.Option(help="New mesh file: .ply, .stl or .glb.")],
    bag: Annotated[Path | None, typer.Option(help="New bag folder for the same views.")] = None,
    mask_bag: Annotated[
        Path | None,
        typer.Option(help="New bag folder for the masks, with camera_info and camera_pose."),
    ] = None,
    figures: FiguresOutput = None,
    slices: Slices = parameters.SLICES.default,
    tolerance: Tolerance = parameters.TOLERANCE.default,
    margin: Margin = parameters.MARGIN.default,
    max_bad_views: MaxBadViews = parameters.MAX_BAD_VIEWS.default,
) -> None:
    """Turn binary masks with projection matrices into a mesh."""
    with _plain_interrupts():
        from momrec_ros.commands import run_reconstruct  # noqa: PLC0415

    raise typer.Exit(
        run_reconstruct(
            folder,
            output,
            bag,
            figures,
            mask_bag=mask_bag,
            slices=slices,
            tolerance=tolerance,
            margin=margin,
            max_bad_views=max_bad_views,
        )
    )


@app.command()
def experiment(
    meshes: Annotated[
        list[Path] | None,
        typer.Argument(
            exists=True,
            help="Other objects than the ten shipped: a class per subfolder or per file.",
        ),
    ] = None,
    *,
    output: Annotated[Path, typer.Option(help="New folder for tables, figures and report.html.")],
    seed: Seed = parameters.SEED.default,
    splits: Splits = parameters.SPLITS.default,
    views: Views = parameters.VIEWS.default,
    slices: Slices = parameters.SLICES.default,
    workers: Workers = parameters.WORKERS.default,
) -> None:
    """Repeat the paper's experiment: Table 1 and figures 5, 6, 9, 10, 11 beside its own.

    Then the same with objects whose frames are ambiguous, and with classes left out.
    """
    with _plain_interrupts():
        from momrec_ros.commands import run_experiment  # noqa: PLC0415
        from momrec_ros.experiment import Plan  # noqa: PLC0415

    plan = Plan(seed=seed, splits=splits, views=views, slices=slices, workers=workers)
    raise typer.Exit(run_experiment(meshes or [], output, plan))


@contextmanager
def _plain_interrupts() -> Iterator[None]:
    """Let Ctrl-C end the process at once: libraries that are being imported may swallow it."""
    handler = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def main() -> None:
    """Run `momrec`; every expected error is one line on stderr and exit code 1."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a terminal that lacks a letter shows its number
            stream.reconfigure(errors="backslashreplace")
    try:
        app()
    except (ValueError, OSError) as error:
        from momrec_core.errors import MomrecError  # noqa: PLC0415

        if not isinstance(error, (MomrecError, OSError)):
            raise
        typer.echo(f"momrec: {' '.join(str(error).split())}", err=True)
        sys.exit(FAILED)
