"""Table 1 of the paper: its rates on its own ten objects, one split."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PAPER_TABLE", "PaperRow"]


@dataclass(frozen=True)
class PaperRow:
    """One step of the selection.

    Attributes
    ----------
    moment : (int, int, int)
        The moment eta_ijk that the step added.
    train, test : float
        Success on the training and the test set, percent.
    """

    moment: tuple[int, int, int]
    train: float
    test: float


# By the highest order of the moments; the step is a row's place, from 1.
PAPER_TABLE: dict[int, tuple[PaperRow, ...]] = {
    2: (
        PaperRow((0, 0, 2), 55.7, 72.5),
        PaperRow((0, 2, 0), 74.3, 95.0),
        PaperRow((2, 0, 0), 85.7, 92.5),
    ),
    3: (
        PaperRow((0, 2, 1), 62.9, 67.5),
        PaperRow((0, 0, 2), 94.3, 100.0),
        PaperRow((2, 0, 1), 98.6, 100.0),
        PaperRow((1, 2, 0), 95.7, 87.5),
        PaperRow((2, 0, 0), 94.3, 90.0),
        PaperRow((0, 2, 0), 95.7, 92.5),
        PaperRow((2, 1, 0), 98.6, 92.5),
        PaperRow((3, 0, 0), 98.6, 92.5),
        PaperRow((0, 3, 0), 100.0, 92.5),
    ),
    4: (
        PaperRow((0, 2, 1), 62.9, 67.5),
        PaperRow((0, 0, 2), 94.3, 100.0),
        PaperRow((2, 0, 1), 98.6, 100.0),
        PaperRow((0, 2, 2), 94.3, 100.0),
        PaperRow((1, 2, 1), 94.3, 95.0),
        PaperRow((2, 0, 0), 95.7, 95.0),
        PaperRow((2, 2, 0), 98.6, 95.0),
        PaperRow((0, 4, 0), 98.6, 95.0),
        PaperRow((1, 2, 0), 98.6, 95.0),
        PaperRow((1, 3, 0), 97.1, 95.0),
    ),
    5: (
        PaperRow((0, 2, 1), 62.9, 67.5),
        PaperRow((0, 0, 2), 94.3, 100.0),
        PaperRow((2, 0, 1), 98.6, 100.0),
        PaperRow((0, 2, 2), 94.3, 100.0),
        PaperRow((1, 2, 1), 94.3, 95.0),
        PaperRow((2, 0, 0), 95.7, 95.0),
        PaperRow((2, 2, 0), 98.6, 95.0),
        PaperRow((0, 4, 1), 98.6, 95.0),
        PaperRow((1, 4, 0), 98.6, 95.0),
        PaperRow((1, 2, 2), 98.6, 95.0),
    ),
}
