"""Cells around values on a grid: whether values lie on one, the edges of cells, and their hatching."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from gaitsweep.plot import style


def hatch_cells(axes: Axes, edges: tuple[np.ndarray, np.ndarray], at: tuple, marked: np.ndarray) -> None:
    """Hatch the marked cells, runs of neighbours in a row as one rectangle."""
    across, up = edges
    cells = np.zeros((len(up) - 1, len(across) - 1), bool)
    cells[at] = marked
    for row in np.flatnonzero(cells.any(axis=1)):
        turns = np.flatnonzero(np.diff(np.r_[False, cells[row], False]))
        for start, stop in zip(turns[::2], turns[1::2], strict=True):
            (left, right), (bottom, top) = across[[start, stop]], up[[row, row + 1]]
            look = {"fill": False, "hatch": style.HATCH, "linewidth": 0, "edgecolor": "#333333", "zorder": 3}
            axes.add_patch(
                Rectangle((float(left), float(bottom)), float(right - left), float(top - bottom), **look)
            )


def on_grid(values: np.ndarray) -> bool:
    """Whether sorted values lie on a grid: all steps whole multiples of the smallest, up to rounding."""
    gaps = np.diff(values)
    if not len(gaps):
        return True
    counts = gaps / gaps.min()
    return len(values) <= 4 or bool((np.abs(counts - np.round(counts)) < 0.01).all() and counts.max() < 50)


def filled(values: np.ndarray) -> np.ndarray:
    """Sorted values that lie on a grid, with those between them that are missing, so that no cell grows over
    its missing neighbour; values as they are where their steps are no multiples of the smallest."""
    gaps = np.diff(values)
    if not len(gaps):
        return values
    counts = np.round(gaps / gaps.min())
    if (np.abs(gaps / gaps.min() - counts) >= 0.01).any() or counts.max() >= 50:
        return values
    steps = zip(values[:-1], values[1:], counts.astype(int), strict=True)
    return np.r_[*(np.linspace(a, b, n, endpoint=False) for a, b, n in steps), values[-1:]]


def cell_edges(centres: np.ndarray) -> np.ndarray:
    """Edges of cells around their centres (of a grid: `filled`), half way between neighbours."""
    if len(centres) == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.r_[centres[0] - (middle[0] - centres[0]), middle, centres[-1] + (centres[-1] - middle[-1])]
