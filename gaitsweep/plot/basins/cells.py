"""Cells around values on a grid: detection of the grid, edges of cells, and hatching."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Real
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from gaitsweep.plot import theme
from gaitsweep.plot.kind import PlannedTable, Refusal


def check_cells(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Explain why a figure with x, y and panels has several rows in one cell."""
    if figure.x == figure.y or not {figure.x, figure.y} <= set(table.varied):
        return  # cells that only the table has
    if figure.panels not in (None, *table.varied):
        return
    shown = {figure.x, figure.y, figure.panels}
    others = [group for group in table.rows.groups if group.length > 1 and not shown & set(group.names)]
    if others and table.rows.in_cells(figure.x) and table.rows.in_cells(figure.y):
        name = others[0].names[0]
        field = "params" if name in [q.name for q in table.model.parameters] else "start"
        near = f"name it as panels, or fix its value under {field}"
        yield (
            ("panels",),
            f"leaves out {name}, which varies too, so a cell of {figure.x} and {figure.y} would have "
            f"several rows; {near}.",
        )


def hatch_cells(axes: Axes, edges: tuple[np.ndarray, np.ndarray], at: tuple, marked: np.ndarray) -> None:
    """Hatch the marked cells; neighbours in a row become one rectangle."""
    across, up = edges
    cells = np.zeros((len(up) - 1, len(across) - 1), bool)
    cells[at] = marked
    for row in np.flatnonzero(cells.any(axis=1)):
        turns = np.flatnonzero(np.diff(np.r_[False, cells[row], False]))
        for start, stop in zip(turns[::2], turns[1::2], strict=True):
            (left, right), (bottom, top) = across[[start, stop]], up[[row, row + 1]]
            look = {"fill": False, "hatch": theme.HATCH, "linewidth": 0, "edgecolor": "#333333", "zorder": 3}
            axes.add_patch(
                Rectangle((float(left), float(bottom)), float(right - left), float(top - bottom), **look)
            )


def on_grid(values: Real[np.ndarray, " values"], *, log: bool = False) -> bool:
    """Whether sorted values form a grid: all steps are whole multiples of the smallest, up to rounding.

    Steps are ratios with `log`.
    """
    gaps = np.diff(np.log(values) if log else values)
    if not len(gaps):
        return True
    counts = gaps / gaps.min()
    return len(values) <= 4 or bool((np.abs(counts - np.round(counts)) < 0.01).all() and counts.max() < 50)


def filled(values: Real[np.ndarray, " values"], *, log: bool = False) -> Real[np.ndarray, " cells"]:
    """Sorted values of a grid with missing values filled in, so that no cell covers a missing neighbour.

    Values that do not form a grid are returned unchanged. Steps are ratios with `log`.
    """
    places = np.log(values) if log else values
    gaps = np.diff(places)
    if not len(gaps):
        return values
    counts = np.round(gaps / gaps.min())
    if (np.abs(gaps / gaps.min() - counts) >= 0.01).any() or counts.max() >= 50:
        return values
    steps = zip(places[:-1], places[1:], counts.astype(int), strict=True)
    between = [np.linspace(a, b, n, endpoint=False)[1:] for a, b, n in steps]
    between = [np.exp(each) for each in between] if log else between
    # the values themselves exactly, by which rows find their cells
    pairs = zip(values[:-1], between, strict=True)
    return np.r_[*(part for a, inner in pairs for part in ([a], inner)), values[-1:]]


def cell_edges(centres: Real[np.ndarray, " cells"], *, log: bool = False) -> Float[np.ndarray, " edges"]:
    """The edges of cells, half way between neighbouring centres (for a grid: `filled`).

    Half way is the geometric mean with `log`.
    """
    if log:
        return np.exp(cell_edges(np.log(centres)))
    if len(centres) == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.r_[centres[0] - (middle[0] - centres[0]), middle, centres[-1] + (centres[-1] - middle[-1])]
