"""What the command line says about finished objects: JSON lines and a table."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from momrec_ros.messages import pose_from_matrix

if TYPE_CHECKING:
    from momrec_core.recognizer import ObjectResult
    from momrec_ros.confusions import Confusions
    from momrec_ros.lessons import Lesson
    from momrec_ros.training import ClassRate

__all__ = [
    "ResultRow",
    "json_line",
    "lesson_table",
    "lesson_warnings",
    "printable",
    "rate_table",
    "result_row",
    "result_table",
]

NEAREST_CLASSES = 5  # of the others are in a table about one more class


def json_line(result: ObjectResult, cut_views: int = 0) -> str:
    """Describe a result for programs.

    Parameters
    ----------
    result : ObjectResult
        Of a finished object.
    cut_views : int
        Views used in which the border of the image cuts the object.

    Returns
    -------
    line : str
        One JSON object without a line break: object, label, known, distance, score, views,
        slices, area (m^2), volume (m^3), scale (world to canonical, 1/m), position [x, y, z]
        (m) and orientation [x, y, z, w] of the principal frame in the world, unique_frame,
        rejected_views, contradicting_views (of these), cut_views, coverage_mean, coverage_worst
        (share of the used silhouettes that the mesh covers again). Without a model label is
        "unknown", distance and score are null.
    """
    recognition, canonical = result.recognition, result.canonical
    pose = pose_from_matrix(canonical.principal_frame)
    return json.dumps(
        {
            "object": result.object_id,
            "label": recognition.label if recognition else "unknown",
            "known": bool(recognition and recognition.known),
            "distance": _finite(recognition.distance) if recognition else None,
            "score": _finite(recognition.score) if recognition else None,
            "views": result.views,
            "slices": result.slices,
            "area": result.area,
            "volume": result.volume,
            "scale": float(canonical.scale),
            "position": list(pose.position),
            "orientation": list(pose.orientation),
            "unique_frame": bool(canonical.is_unique),
            "rejected_views": result.rejected_views,
            "contradicting_views": len(result.left_out),
            "cut_views": cut_views,
            "coverage_mean": float(result.coverage.mean()),
            "coverage_worst": float(result.coverage.min()),
        },
        allow_nan=False,
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def printable(text: str) -> str:
    """Return text from outside without what a terminal would obey.

    Parameters
    ----------
    text : str
        Untrusted.

    Returns
    -------
    text : str
        In one line; control characters are escaped.
    """
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


ResultRow = tuple[Text, ...]


def result_row(result: ObjectResult) -> ResultRow:
    """Return the cells that describe a result in `result_table`."""
    position = result.canonical.principal_frame[:3, 3]
    unique = result.canonical.is_unique
    return (
        Text(printable(result.object_id), style="bold"),
        _label(result),
        Text(f"{result.recognition.score:.3f}" if result.recognition else ""),
        Text(str(result.views)),
        Text(f"{result.area:.4g}"),
        Text(f"{result.volume:.4g}"),
        Text(" ".join(f"{coordinate:.3g}" for coordinate in position)),
        Text("yes", style="green") if unique else Text("no", style="yellow"),
        Text(f"{100 * result.coverage.min():.1f}"),
        Text(str(result.rejected_views), style="red" if result.rejected_views else ""),
    )


def result_table(rows: Sequence[ResultRow]) -> Table:
    """Describe results for people.

    Parameters
    ----------
    rows : sequence of ResultRow
        Of `result_row`.

    Returns
    -------
    table : rich Table
    """
    table = Table(title=f"{len(rows)} object{'s' * (len(rows) != 1)}")
    for heading in ("object", "label"):
        table.add_column(heading, overflow="fold")
    for heading in ("score", "views", "area m²", "volume m³", "position m"):
        table.add_column(heading, justify="right")
    table.add_column("unique frame", justify="center")
    table.add_column("worst covered %", justify="right")
    table.add_column("rejected", justify="right")
    for row in rows:
        table.add_row(*row)
    return table


def rate_table(rates: Sequence[ClassRate], found: Confusions) -> Table:
    """Describe how well a new model names the instances of each class, and of all.

    Parameters
    ----------
    rates : sequence of ClassRate
        One per class.
    found : Confusions
        What held-back instances of the same classes are taken for.

    Returns
    -------
    table : rich Table
    """
    total = sum(rate.instances for rate in rates)
    table = Table(title="rightly named", show_footer=True)
    table.add_column("class", "all", overflow="fold")
    table.add_column("instances", str(total), justify="right")
    for heading, shares in (
        ("training %", [rate.training for rate in rates]),
        ("cross-validated %", [rate.cross_validated for rate in rates]),
    ):
        right = sum(share * rate.instances for share, rate in zip(shares, rates, strict=True))
        table.add_column(heading, f"{100 * right / total:.1f}", justify="right")
    table.add_column("most like", overflow="fold")
    table.add_column("its share %", justify="right")
    for rate in rates:
        other = found.taken_for(rate.label)
        table.add_row(
            Text(printable(rate.label), style="bold"),
            str(rate.instances),
            f"{100 * rate.training:.1f}",
            f"{100 * rate.cross_validated:.1f}",
            Text(printable(other[0]) if other else ""),
            f"{100 * other[1]:.1f}" if other else "",
        )
    return table


def lesson_table(lesson: Lesson) -> Table:
    """Describe how well a new class is told from the classes nearest to it.

    Parameters
    ----------
    lesson : Lesson
        Of `momrec_ros.lessons.assess`.

    Returns
    -------
    table : rich Table
        The new class first, then the others with the distances of its instances from them.
    """
    held_back = "too few" if lesson.held_back is None else str(lesson.held_back)
    table = Table(title=f"one more class, threshold {lesson.threshold:.2f} spreads")
    table.add_column("class", overflow="fold")
    for heading in (
        "instances",
        "rightly named",
        "held back, rightly named",
        "nearest, spreads",
        "median, spreads",
        "inside threshold",
    ):
        table.add_column(heading, justify="right")
    table.add_row(
        Text(printable(lesson.label), style="bold"),
        *(str(lesson.instances), str(lesson.right), held_back, "", "", ""),
        end_section=True,
    )
    for other in lesson.others[:NEAREST_CLASSES]:
        table.add_row(
            Text(printable(other.label)),
            *("", "", "", f"{other.nearest:.2f}", f"{other.median:.2f}"),
            Text(str(other.within), style="yellow" if other.within else ""),
        )
    return table


def lesson_warnings(lesson: Lesson) -> list[str]:
    """Tell, a line each, which classes a new class is likely to be confused with.

    Parameters
    ----------
    lesson : Lesson
        Of `momrec_ros.lessons.assess`.

    Returns
    -------
    lines : list of str
        Empty where no instance is inside the threshold of another class.
    """
    return [
        f"warning: {lesson.label} may be confused with {other.label}: {other.within} of "
        f"{lesson.instances} instances are inside the threshold of {lesson.threshold:.2f} spreads, "
        f"the nearest at {other.nearest:.2f}"
        for other in lesson.others
        if other.within
    ]


def _label(result: ObjectResult) -> Text:
    if result.recognition is None:
        return Text("-", style="dim")
    style = "green" if result.recognition.known else "yellow"
    return Text(printable(result.recognition.label), style=style)
