"""What a shape is: classes learned from instances, kept in a file that people can read."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, cast

import numpy as np

from momrec_core.canonical import CanonicalShape, normalize
from momrec_core.covariance import (
    correlation,
    distances_from_means,
    distances_in_own_metrics,
    whitening,
)
from momrec_core.errors import ModelFormatError, MomrecError
from momrec_core.features import (
    INVARIANTS,
    feature_vectors,
    invariants,
    log_size,
    moment_indices,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import trimesh
    from numpy.typing import NDArray

__all__ = ["UNKNOWN", "Recognition", "RecognitionModel", "check_new_label", "load_model"]

UNKNOWN = "unknown"  # the label of what is far from every class; no class may have it
FORMAT, VERSION = "momrec recognition model", 3
MOMENTS_ONLY = 2  # the version before: its models know moments alone
MAX_FILE_BYTES = 16 * 2**20  # a model of a thousand classes has two to seven megabytes
MAX_ORDER = 5  # canonical shapes carry their moments up to it
LARGEST = 1e100  # of a number in a model file: its square is one
SMALLEST = 1e-50  # of a variance or threshold in a model file, likewise
ROUNDING = 1e-9  # of what decimal digits may leave of a covariance's symmetry
MOST_ODDS = 700.0  # logarithm: beyond it, their exponential is none


@dataclass(frozen=True, eq=False)
class Recognition:
    """What a model says of a shape.

    Attributes
    ----------
    label : str
        The nearest class, or ``unknown`` where that is too far.
    known : bool
        Whether the nearest class is near enough.
    distance : float
        To the nearest class's mean, in the metric of the covariance within classes, or in the
        class's own.
    score : float
        How sure the label is, 0 to 1: the nearest class's share among all, by the spread of
        held-back instances, times the probability that the shape is of a known class at all, as
        learned from instances and classes that were held back. For ``unknown``, what that
        probability leaves.
    ranking : tuple of (label, distance, score)
        All classes, nearest first.
    canonical : CanonicalShape
        The shape that was recognised.
    """

    label: str
    known: bool
    distance: float
    score: float
    ranking: tuple[tuple[str, float, float], ...]
    canonical: CanonicalShape


@dataclass(frozen=True, eq=False)
class RecognitionModel:
    """Classes of shapes, by the means of a few normalised moments; made with `fit`.

    Attributes
    ----------
    classes : tuple of str
        Labels.
    indices : tuple of (int, int, int)
        The moments eta_ijk in use, in the order of their selection.
    means : array, shape (classes, features)
        Of each class: the moments in use, then the invariants and the logarithm of the size, if
        these are.
    covariance : array, shape (features, features)
        Of the metric, from the training instances about their class's mean.
    threshold : float
        Distance from the nearest class, in its spreads, beyond which a shape is unknown.
    spreads : array, shape (classes,)
        How far held-back instances of each class are from its mean.
    blur : float
        Width, in distances, by which the classes share what lies between them.
    certainty : float
        How fast the log odds that a shape is of a known class rise inside the threshold, over the
        distance in thresholds.
    sized : bool
        Whether the size counts as well, so that shapes must come in metres.
    with_invariants : bool
        Whether what is the same in every frame counts beside the moments.
    covariances : array, shape (classes, features, features), or None
        Of the classes' own metrics, where they have them: with size or invariants. The common one
        is what that of a further class is drawn towards.
    """

    classes: tuple[str, ...]
    indices: tuple[tuple[int, int, int], ...]
    means: NDArray[np.float64]
    covariance: NDArray[np.float64]
    threshold: float
    spreads: NDArray[np.float64]
    blur: float
    certainty: float
    sized: bool = False
    with_invariants: bool = False
    covariances: NDArray[np.float64] | None = None
    _metrics: tuple[NDArray[np.float64], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        covariances = [self.covariance] if self.covariances is None else self.covariances
        object.__setattr__(self, "_metrics", tuple(whitening(each)[0] for each in covariances))

    @classmethod
    def fit(
        cls,
        shapes: Sequence[CanonicalShape | trimesh.Trimesh],
        labels: Sequence[str],
        *,
        max_features: int = 10,
        order: int = 5,
        sized: bool = False,
        with_invariants: bool = False,
    ) -> Self:
        """Learn classes from instances.

        Parameters
        ----------
        shapes : sequence of CanonicalShape or Trimesh
            Instances, each as it would be reconstructed.
        labels : sequence of str
            The class of each; at least two classes with two instances each.
        max_features : int
            Number of moments at the most.
        order : int
            Highest order of the moments to choose from, 2 to 5.
        sized : bool
            Whether size tells classes apart as well. Instances must then have the sizes that
            their classes have in the world, in metres.
        with_invariants : bool
            Whether the lengths of the moment tensors, which are the same in every frame, tell
            classes apart as well: for many classes, and round ones.

        Returns
        -------
        model : RecognitionModel

        Raises
        ------
        DegenerateShapeError
            If a mesh has no area.
        ValueError
            If classes or instances are too few, or a parameter is out of its range.

        Notes
        -----
        Instances whose frame is ambiguous take, of their admissible frames, the one nearest to
        their class's mean. The threshold is learned from the distances of instances that were
        held back, in turn, from selection, means and metric.
        """
        from momrec_core.learning import learn  # noqa: PLC0415  # scikit-learn takes a second

        names = [str(label) for label in labels]
        _check_training(len(shapes), names, max_features, order)
        indices = moment_indices(order)
        canonical = [_canonical(shape) for shape in shapes]
        candidates = [feature_vectors(shape, indices) for shape in canonical]
        common = np.array(
            [_common(shape, sized=sized, with_invariants=with_invariants) for shape in canonical]
        )
        learned = learn(candidates, names, indices, max_features, common)
        return cls(
            classes=learned.classes,
            indices=tuple(indices[index] for index in learned.selected),
            means=learned.means,
            covariance=learned.covariance,
            threshold=learned.threshold,
            spreads=learned.spreads,
            blur=learned.blur,
            certainty=learned.certainty,
            sized=sized,
            with_invariants=with_invariants,
            covariances=learned.covariances,
        )

    def with_class(self, label: str, shapes: Sequence[CanonicalShape | trimesh.Trimesh]) -> Self:
        """Learn one more class, without the instances that the others were learned from.

        Parameters
        ----------
        label : str
            Of the new class.
        shapes : sequence of CanonicalShape or Trimesh
            Two instances of it or more, each as it would be reconstructed.

        Returns
        -------
        model : RecognitionModel
            Another one, with the new class as its last; this one stays as it is.

        Raises
        ------
        DegenerateShapeError
            If a mesh has no area.
        MomrecError
            If there is a class of that label, no class may have it, or instances are too few.

        Notes
        -----
        Moments, metric, threshold, blur and certainty stay what they are. So a class that differs
        from another by other moments only cannot be told from it: that takes `fit`.
        """
        from momrec_core.learning import learn_class  # noqa: PLC0415  # as in `fit`

        check_new_label(label, self.classes)
        if len(shapes) < 2:
            raise MomrecError(f"Expected two instances or more of {label!r}, got {len(shapes)}")
        candidates = [self._features(_canonical(shape)) for shape in shapes]
        own = self.covariances
        mean, covariance, spread = learn_class(
            candidates, self.covariance, float(np.median(self.spreads)), own=own is not None
        )
        return replace(
            self,
            classes=(*self.classes, label),
            means=np.vstack([self.means, mean]),
            spreads=np.append(self.spreads, spread),
            covariances=None if own is None else np.concatenate([own, covariance[None]]),
        )

    def recognize(self, mesh_or_canonical: CanonicalShape | trimesh.Trimesh) -> Recognition:
        """Name a shape.

        Parameters
        ----------
        mesh_or_canonical : Trimesh or CanonicalShape
            A mesh in the world (metres), or one already normalised. An ambiguous frame is tried
            in each of its admissible orientations.

        Returns
        -------
        recognition : Recognition

        Raises
        ------
        DegenerateShapeError
            If a mesh has no area.
        """
        canonical = _canonical(mesh_or_canonical)
        distances = self._distances(self._features(canonical)).min(axis=0)
        nearest = int(np.argmin(distances))
        strayed = float(distances[nearest] / (self.threshold * self.spreads[nearest]))
        familiarity = self._familiarity_at(strayed)
        scores = familiarity * self._shares(distances)
        ranking = tuple(
            (self.classes[index], float(distances[index]), float(scores[index]))
            for index in np.argsort(distances, kind="stable")
        )
        label, distance, score = ranking[0]
        known = strayed <= 1.0
        return Recognition(
            label=label if known else UNKNOWN,
            known=known,
            distance=distance,
            score=score if known else 1.0 - familiarity,
            ranking=ranking,
            canonical=canonical,
        )

    def _features(self, canonical: CanonicalShape) -> NDArray[np.float64]:
        """Return what the model looks at, in each admissible frame; shape (frames, features)."""
        vectors = feature_vectors(canonical, list(self.indices))
        common = _common(canonical, sized=self.sized, with_invariants=self.with_invariants)
        return np.column_stack([vectors, np.tile(common, (len(vectors), 1))])

    def _distances(self, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances of vectors, shape (frames, features), from each class's mean."""
        if self.covariances is None:
            return distances_from_means(vectors, self.means, self._metrics[0])
        return distances_in_own_metrics(vectors, self.means, self._metrics)

    def _familiarity_at(self, strayed: float) -> float:
        return float(1.0 / (1.0 + np.exp(min(self.certainty * (strayed - 1.0), MOST_ODDS))))

    def _shares(self, distances: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the classes' shares, the nearer the larger; all classes are equally wide."""
        exponents = (distances**2 - distances.min() ** 2) / (2 * self.blur**2)
        shares = np.exp(-exponents)
        return np.asarray(shares / shares.sum())

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model as JSON, whole or not at all.

        Parameters
        ----------
        path : path
            Written over if it is there.
        """
        content = {
            "format": FORMAT,
            "version": VERSION,
            "classes": list(self.classes),
            "moments": [list(index) for index in self.indices],
            "means": self.means.tolist(),
            "covariance": self.covariance.tolist(),
            "threshold": self.threshold,
            "spreads": self.spreads.tolist(),
            "blur": self.blur,
            "certainty": self.certainty,
            "sized": self.sized,
            "invariants": self.with_invariants,
            "covariances": [] if self.covariances is None else _triangles(self.covariances),
        }
        target = Path(path)
        temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
        try:
            temporary.write_text(_readable(content), encoding="utf-8")
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)


def check_new_label(label: str, classes: Sequence[str]) -> None:
    """Make sure that a class may get a label.

    Parameters
    ----------
    label : str
        To be.
    classes : sequence of str
        Labels that there are.

    Raises
    ------
    MomrecError
        If it is one of these, ``unknown``, empty or not printable.
    """
    if label in classes:
        raise MomrecError(f"Expected a label other than those of the model, got {label!r}")
    if not _is_label(label):
        raise MomrecError(f'Expected a printable label other than "{UNKNOWN}", got {label!r}')


def load_model(path: str | os.PathLike[str]) -> RecognitionModel:
    """Read a model that `RecognitionModel.save` wrote.

    Parameters
    ----------
    path : path
        A JSON file.

    Returns
    -------
    model : RecognitionModel

    Raises
    ------
    ModelFormatError
        If the file cannot be read, is no model, is damaged, or is of another version.
    """
    source = Path(path)
    try:
        with source.open("rb") as stream:
            data = stream.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise ModelFormatError(
            f"Expected a model file, cannot read {source}: {error.strerror}"
        ) from error
    if len(data) > MAX_FILE_BYTES:
        raise ModelFormatError(
            f"Expected a model of at most {MAX_FILE_BYTES} bytes, {source} has more"
        )
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ModelFormatError(f"Expected JSON in {source}: {error}") from error
    try:
        return _from_content(content)
    except ModelFormatError as error:
        raise ModelFormatError(f"{source}: {error}") from None


def _readable(content: Mapping[str, Any]) -> str:
    """Write one field, and one row of a table, a line."""
    lines = []
    for name, value in content.items():
        if isinstance(value, list) and value and isinstance(value[0], list):
            rows = ",\n  ".join(json.dumps(row) for row in value)
            lines.append(f" {json.dumps(name)}: [\n  {rows}\n ]")
        else:
            lines.append(f" {json.dumps(name)}: {json.dumps(value)}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _from_content(content: object) -> RecognitionModel:
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        came = content.get("format") if isinstance(content, dict) else content
        raise ModelFormatError(
            f'Expected an object with "format": "{FORMAT}", got {_described(came)}'
        )
    version = content.get("version")
    if type(version) is not int or version not in (MOMENTS_ONLY, VERSION):
        raise ModelFormatError(
            f'Expected "version": {MOMENTS_ONLY} or {VERSION}, got {_described(version)}'
        )
    sized, with_invariants = (False, False) if version == MOMENTS_ONLY else _switches(content)
    own = content.get("covariances", []) if version == VERSION else []
    classes = _labels(content.get("classes"))
    indices = _indices(content.get("moments"))
    features = len(indices) + INVARIANTS * with_invariants + sized
    means = _numbers(content, "means", (len(classes), features))
    covariance = _numbers(content, "covariance", (features, features))
    _check_covariance(covariance)
    threshold = float(_numbers(content, "threshold", ()))
    (spreads,) = _numbers({"spreads": [content.get("spreads")]}, "spreads", (1, len(classes)))
    if min(threshold, spreads.min()) < SMALLEST:
        raise ModelFormatError(
            f'Expected positive "threshold" and "spreads", got {threshold} and {spreads.min()}'
        )
    blur, certainty = (float(_numbers(content, name, ())) for name in ("blur", "certainty"))
    if min(blur, certainty) < SMALLEST:
        raise ModelFormatError(
            f'Expected positive "blur" and "certainty", got {blur} and {certainty}'
        )
    return RecognitionModel(
        classes,
        indices,
        means,
        covariance,
        threshold,
        spreads,
        blur,
        certainty,
        sized=sized,
        with_invariants=with_invariants,
        covariances=None if own == [] else _own_covariances(content, len(classes), features),
    )


def _triangles(covariances: NDArray[np.float64]) -> list[list[float]]:
    """Return the upper triangle of each matrix, row by row."""
    rows, columns = np.triu_indices(covariances.shape[-1])
    triangles: list[list[float]] = covariances[:, rows, columns].tolist()
    return triangles


def _own_covariances(
    content: Mapping[str, object], classes: int, features: int
) -> NDArray[np.float64]:
    rows, columns = np.triu_indices(features)
    triangles = _numbers(content, "covariances", (classes, len(rows)))
    covariances = np.empty((classes, features, features))
    covariances[:, rows, columns] = covariances[:, columns, rows] = triangles
    for covariance in covariances:
        _check_covariance(covariance)
    return covariances


def _switches(content: Mapping[str, object]) -> tuple[bool, bool]:
    sized, with_invariants = content.get("sized"), content.get("invariants")
    if not (isinstance(sized, bool) and isinstance(with_invariants, bool)):
        raise ModelFormatError(
            f'Expected true or false in "sized" and "invariants", got {_described(sized)} and '
            f"{_described(with_invariants)}"
        )
    return sized, with_invariants


def _labels(value: object) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(label, str) for label in value):
        raise ModelFormatError(f'Expected a list of labels in "classes", got {_described(value)}')
    labels: list[str] = value
    wrong = [label for label in labels if not _is_label(label)]
    if wrong:
        raise ModelFormatError(
            f'Expected printable labels other than "{UNKNOWN}" in "classes", '
            f"got {_described(wrong[0])}"
        )
    if len(set(labels)) != len(labels) or len(labels) < 2:
        raise ModelFormatError(
            f'Expected two or more different labels in "classes", got {len(labels)} of which '
            f"{len(set(labels))} differ"
        )
    return tuple(labels)


def _is_label(text: str) -> bool:
    return text != UNKNOWN and bool(text) and text.isprintable()


def _indices(value: object) -> tuple[tuple[int, int, int], ...]:
    expected = f'Expected different triples i, j, k of orders up to {MAX_ORDER} in "moments"'
    if not isinstance(value, list) or not value:
        raise ModelFormatError(f"{expected}, got {_described(value)}")
    named = {json.dumps(index): index for index in moment_indices(MAX_ORDER)}  # 2.0 is not 2
    indices = []
    for row in value:
        index = named.pop(_described(row), None)
        if index is None:
            raise ModelFormatError(
                f"{expected}, got {_described(row)}, which is none, is constant or is there twice"
            )
        indices.append(index)
    return tuple(indices)


def _numbers(
    content: Mapping[str, object], name: str, shape: tuple[int, int] | tuple[()]
) -> NDArray[np.float64]:
    value = content.get(name)
    table = value if shape else [[value]]
    rows, columns = shape or (1, 1)
    count = f"{rows} x {columns} numbers" if shape else "a number"
    expected = f'Expected {count} up to {LARGEST:g} in "{name}"'
    if not isinstance(table, list) or len(table) != rows:
        raise ModelFormatError(f"{expected}, got {_described(table)}")
    for row in table:
        if not isinstance(row, list) or len(row) != columns:
            raise ModelFormatError(f"{expected}, got {_described(row)} in a row")
        wrong = [entry for entry in row if not _is_number(entry)]
        if wrong:
            raise ModelFormatError(f"{expected}, got {_described(wrong[0])}")
    return np.array(table, dtype=np.float64).reshape(shape)


def _is_number(value: object) -> bool:
    return type(value) in (int, float) and abs(cast("float", value)) <= LARGEST  # not NaN, not true


def _described(value: object) -> str:
    """Say what came instead of something expected, in a few words whatever it is."""
    if isinstance(value, list) and (len(value) > 3 or any(map(_is_nested, value))):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return "an object"
    return f"{json.dumps(value):.40}"


def _is_nested(value: object) -> bool:
    return isinstance(value, list | dict)


def _check_covariance(covariance: NDArray[np.float64]) -> None:
    variances = np.diag(covariance)
    if ((variances != 0) & (variances < SMALLEST)).any():
        raise ModelFormatError(
            f'Expected variances of 0 or at least {SMALLEST:g} on the diagonal of "covariance", '
            f"got {variances.min():g}"
        )
    correlations, _ = correlation(covariance)
    asymmetry = np.abs(correlations - correlations.T).max()
    least = np.linalg.eigvalsh(correlations)[0]
    if asymmetry > ROUNDING or least < -ROUNDING:
        raise ModelFormatError(
            'Expected a symmetric matrix without negative eigenvalues in "covariance", got an '
            f"asymmetry of {asymmetry:.3g} and an eigenvalue of {least:.3g} of the variances"
        )


def _check_training(count: int, names: Sequence[str], max_features: int, order: int) -> None:
    if count != len(names):
        raise ValueError(f"Expected a label for each of {count} shapes, got {len(names)}")
    if not 2 <= order <= MAX_ORDER:
        raise ValueError(f"Expected an order from 2 to {MAX_ORDER}, got {order}")
    if max_features < 1:
        raise ValueError(f"Expected at least one feature, got {max_features}")
    wrong = [name for name in names if not _is_label(name)]
    if wrong:
        raise ValueError(f'Expected printable labels other than "{UNKNOWN}", got {wrong[0]!r}')
    labels, counts = np.unique(names, return_counts=True)
    if len(labels) < 2 or counts.min() < 2:
        found = dict(zip(labels.tolist(), counts.tolist(), strict=True))
        raise ValueError(f"Expected two classes or more with two instances or more, got {found}")


def _common(shape: CanonicalShape, *, sized: bool, with_invariants: bool) -> NDArray[np.float64]:
    """Return the features of a shape that are the same in all its frames."""
    numbers = invariants(shape) if with_invariants else np.empty(0)
    return np.append(numbers, log_size(shape)) if sized else numbers


def _canonical(shape: CanonicalShape | trimesh.Trimesh) -> CanonicalShape:
    return shape if isinstance(shape, CanonicalShape) else normalize(shape)
