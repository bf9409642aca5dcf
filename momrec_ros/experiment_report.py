"""The experiment's report: one page of HTML that needs nothing else."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from momrec_ros.bounds import Bound
from momrec_ros.experiment import Plan, Trial
from momrec_ros.neighbours import Neighbour
from momrec_ros.paper_table import PAPER_TABLE

__all__ = [
    "bounds_section",
    "html_page",
    "neighbours_section",
    "picture_section",
    "spread_section",
    "table_1_section",
]

STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1f2933; background: #fff; margin: 0 auto;
  max-width: 1180px; padding: 1.5rem; }
h1 { font-size: 1.7rem; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2.6rem 0 .6rem; border-bottom: 2px solid #0072B2; }
p { max-width: 75ch; }
img { width: 100%; height: auto; }
figure { margin: 1rem 0 2rem; }
figcaption, .faint { color: #52606d; font-size: .92rem; }
table { border-collapse: collapse; font-size: .92rem; font-variant-numeric: tabular-nums; }
th, td { padding: .22rem .7rem; text-align: right; white-space: nowrap;
  border-bottom: 1px solid #e4e7eb; }
th { color: #52606d; font-weight: 600; vertical-align: bottom; }
td.text, th.text { text-align: left; white-space: normal; min-width: 16ch; }
td.edge, th.edge { border-left: 2px solid #cbd2d9; }
caption { text-align: left; font-weight: 600; padding: .4rem 0; }
.held { color: #006b4e; font-weight: 600; white-space: nowrap; }
.missed { color: #b04a00; font-weight: 600; white-space: nowrap; }
.side { display: grid; gap: 1.2rem;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 500px), 1fr)); }
.wide { overflow-x: auto; }
"""

ORDER_LETTERS = {2: "(a) second", 3: "(b) third", 4: "(c) fourth", 5: "(d) fifth"}


def html_page(title: str, plan: Plan, sections: Iterable[str]) -> str:
    """Return a whole page.

    Parameters
    ----------
    title : str
        Plain text.
    plan : Plan
        How the experiment was done.
    sections : iterable of str
        HTML.

    Returns
    -------
    page : str
        HTML 5, UTF-8.
    """
    facts = (
        f"Seed {plan.seed}, {plan.splits} random splits, {plan.views} orthographic views of each "
        f"instance, {plan.slices} slices."
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f'<h1>{escape(title)}</h1>\n<p class="faint">{escape(facts)}</p>\n'
        + "\n".join(sections)
        + "\n</body>\n</html>\n"
    )


def bounds_section(bounds: Sequence[Bound]) -> str:
    """Show which figures were reached, and why others were not."""
    rows = []
    for bound in bounds:
        verdict = "held" if bound.held else "missed"
        rows.append(
            "<tr>"
            f'<td class="text">{escape(bound.what)}</td><td>{escape(bound.expected)}</td>'
            f'<td>{escape(bound.found)}</td><td class="{verdict}">{verdict}</td>'
            f'<td class="text">{escape(bound.why)}</td></tr>'
        )
    head = _head(["figure", "bound", "found", "", "why"], text=(0, 4))
    return _section("What should be seen, and what is", _table(head, rows))


def table_1_section(trials: Mapping[int, Trial]) -> str:
    """Show the first split's rates beside the paper's Table 1."""
    tables = [_table_1(trial) for trial in trials.values()]
    text = (
        "One random split: seven instances of each class for training, four for the test set. "
        "Left ours, right the paper's, on its own ten objects. Frames by A.1 to A.3 only, features "
        "chosen step by step for the largest trace of T<sub>q</sub><sup>-1</sup>B<sub>q</sub>, the "
        "nearest class mean in the metric of the total covariance T."
    )
    body = f'<p>{text}</p><div class="side">{"".join(tables)}</div>'
    return _section("Table 1: success of classification, percent", body)


def _table_1(trial: Trial) -> str:
    ours = zip(trial.names[0].selected, trial.train_rates()[0], trial.test_rates()[0], strict=False)
    cells = [
        (_moment(moment), f"{100 * train:.1f}", f"{100 * test:.1f}") for moment, train, test in ours
    ]
    paper = [
        (_moment(row.moment), f"{row.train:.1f}", f"{row.test:.1f}")
        for row in PAPER_TABLE[trial.order]
    ]
    rows = []
    for step, (left, right) in enumerate(zip_longest(cells, paper, fillvalue=("",) * 3), start=1):
        moment, *rates = (f"<td>{cell}</td>" for cell in right)
        edge = moment.replace("<td>", '<td class="edge">')
        rows.append(
            f"<tr><td>{step}</td>{''.join(f'<td>{cell}</td>' for cell in left)}{edge}"
            f"{''.join(rates)}</tr>"
        )
    head = _head(["step", "moment", "training", "test", "paper's", "training", "test"], edge=(4,))
    return _table(head, rows, caption=f"{ORDER_LETTERS[trial.order]} order")


def spread_section(
    title: str,
    text: str,
    ruled: Mapping[int, Trial],
    free: Mapping[int, Trial],
    picture: Path | None,
) -> str:
    """Show means and spreads over all splits, with and without alternatives.

    Parameters
    ----------
    title, text : str
        Plain text.
    ruled, free : mapping
        Order to trial, by A.1 to A.3 only and in all admissible frames.
    picture : Path or None
        A PNG to show above.

    Returns
    -------
    section : str
        HTML.
    """
    tables = [_spread(trial, free[order]) for order, trial in ruled.items()]
    shown = "" if picture is None else _picture(picture, title)
    return _section(title, f'<p>{escape(text)}</p>{shown}<div class="side">{"".join(tables)}</div>')


def _spread(ruled: Trial, free: Trial) -> str:
    found, better = ruled.spread(), free.spread()
    columns = (
        _means(found.train_mean, found.train_std),
        _means(found.test_mean, found.test_std),
        _means(better.test_mean, better.test_std),
    )
    rows = [
        f"<tr><td>{step}</td>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
        for step, cells in enumerate(zip_longest(*columns, fillvalue=""), start=1)
    ]
    head = _head(["step", "training", "test", "test, with alternatives"])
    return _table(head, rows, caption=f"{ORDER_LETTERS[ruled.order]} order")


def _means(means: NDArray[np.float64], deviations: NDArray[np.float64]) -> list[str]:
    pairs = zip(means, deviations, strict=True)
    return [f"{100 * mean:.1f} ± {100 * deviation:.1f}" for mean, deviation in pairs]


def neighbours_section(title: str, text: str, found: Sequence[Neighbour], picture: Path) -> str:
    """Show how near each class is to the next, and a picture of it."""
    rows = [
        f'<tr><td class="text">{escape(one.label)}</td><td class="text">{escape(one.nearest)}</td>'
        f"<td>{one.apart:.2f}</td><td>{one.apart_as_modelled:.2f}</td><td>{one.stray:.2f}</td>"
        f"<td>{one.offset:.2f}</td></tr>"
        for one in found
    ]
    headings = [
        "class",
        "nearest class",
        "means apart",
        "as modelled apart",
        "instances stray",
        "mean off the model",
    ]
    table = _table(_head(headings, text=(0, 1)), rows)
    return _section(title, f"<p>{escape(text)}</p>{_picture(picture, title)}{table}")


def picture_section(title: str, text: str, picture: Path) -> str:
    """Show a picture with a caption; all text is plain."""
    return _section(title, _picture(picture, title, text))


def _picture(path: Path, alternative: str, caption: str = "") -> str:
    data = b64encode(path.read_bytes()).decode("ascii")
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return (
        f'<figure><img alt="{escape(alternative, quote=True)}" '
        f'src="data:image/png;base64,{data}">{below}</figure>'
    )


def _section(title: str, body: str) -> str:
    return f"<section>\n<h2>{escape(title)}</h2>\n{body}\n</section>"


def _head(headings: Sequence[str], text: Sequence[int] = (), edge: Sequence[int] = ()) -> str:
    kinds = {**dict.fromkeys(text, "text"), **dict.fromkeys(edge, "edge")}
    cells = (
        f'<th class="{kinds.get(place, "")}">{escape(heading)}</th>'
        for place, heading in enumerate(headings)
    )
    return f"<tr>{''.join(cells)}</tr>"


def _table(head: str, rows: Iterable[str], caption: str = "") -> str:
    named = f"<caption>{escape(caption)}</caption>" if caption else ""
    return (
        f'<div class="wide"><table>{named}<thead>{head}</thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _moment(index: tuple[int, int, int]) -> str:
    return f"η<sub>{''.join(map(str, index))}</sub>"
