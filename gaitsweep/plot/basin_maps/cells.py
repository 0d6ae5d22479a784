"""Cells around values on a grid: detection of the grid, edges of cells, and hatching."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import pandas as pd
from jaxtyping import Float, Int, Real, Shaped
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from gaitsweep.kinds.columns import quantities_of
from gaitsweep.plot.columns import is_drawn, is_logarithmic, listed_values
from gaitsweep.plot.kind import PlannedTable, Refusal

_NEAR_WHOLE = 0.01  # largest distance of a step from a whole multiple of the smallest, in such steps
_MOST_STEPS = 50  # between neighbouring values of a grid
_FEW_VALUES = 4  # form a grid, whatever their steps
_LEAST_FILLED = 0.02  # share of a grid's cells that have a row; fewer rows are drawn as points


def check_cells(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Explain why a figure with x, y and panels has several rows in one cell."""
    if figure.x == figure.y or not {figure.x, figure.y} <= set(table.varied):
        return  # columns whose cells only the table shows
    if figure.panels not in (None, *table.varied):
        return
    shown = {figure.x, figure.y, figure.panels}
    others = [group for group in table.rows.groups if group.length > 1 and not shown & set(group.names)]
    if others and table.rows.is_drawn_as_cells(figure.x) and table.rows.is_drawn_as_cells(figure.y):
        name = others[0].names[0]
        field = "params" if name in [q.name for q in table.model.parameters] else "start"
        yield (
            ("panels",),
            f"leaves out {name}, which varies too, so a cell of {figure.x} and {figure.y} would have "
            f"several rows; name it as panels, or fix its value under {field}.",
        )


def check_hue(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refuse outcomes by a column that inferred rows do not have."""
    if table.run.refined(table.rows) is None or figure.hue in ("gait", "outcome", *table.varied):
        return
    if figure.hue in quantities_of(table.model, table.run.all_columns(table.model)):
        text = "but run.refine infers rows, of which the gait alone is known"
        yield ("hue",), f"is {figure.hue}, {text}: use gait, or leave run.refine out."


class CellGrid(NamedTuple):
    """Cells around the values of two columns: names, values (nx,), (ny,) and edges (nx + 1,), (ny + 1,)."""

    names: tuple[str, str]
    values: tuple[Real[np.ndarray, " across"], Real[np.ndarray, " up"]]
    edges: tuple[Float[np.ndarray, " edges_across"], Float[np.ndarray, " edges_up"]]

    def placed(
        self, rows: pd.DataFrame, values: Any, empty: Any = np.nan
    ) -> Shaped[np.ndarray, "up across ..."]:
        """The values of rows in their cells, (ny, nx, ...), `empty` in cells without a row."""
        of_rows = np.asarray(values)
        (x, y), (across, up) = self.names, self.values
        cells = np.full((len(up), len(across), *of_rows.shape[1:]), empty, np.result_type(of_rows, empty))
        cells[np.searchsorted(up, rows[y]), np.searchsorted(across, rows[x])] = of_rows
        return cells


def cell_grid(rows: pd.DataFrame, x: str, y: str, table: pd.DataFrame) -> CellGrid | None:
    """The grid of the cells of rows, or None if their values are drawn at random or form no grid.

    Args:
        rows: one panel's rows.
        x, y: columns along the axes.
        table: the rows of all panels, of which one panel may lack cells, with the job in `.attrs`.
    """
    values, edges = [], []
    for name in (x, y):
        log = is_logarithmic(table, name)
        of_rows, of_table = (np.unique(part[name].dropna().to_numpy(float)) for part in (rows, table))
        if is_drawn(table, name) or not _on_grid(of_rows, log=log):
            return None
        centres = of_table if _on_grid(of_table, log=log) else of_rows
        listed = listed_values(table, name)
        # between the values of a list, which may be uneven, none is missing
        centres = np.union1d(centres, listed) if listed else _filled(centres, log=log)
        values.append(centres)
        edges.append(cell_edges(centres, log=log))
    few = len(rows) < _LEAST_FILLED * len(np.unique(rows[x])) * len(np.unique(rows[y]))
    return None if few else CellGrid((x, y), (values[0], values[1]), (edges[0], edges[1]))


def colour_cells(axes: Axes, grid: CellGrid, rows: pd.DataFrame, colours: Iterable[str]) -> None:
    """Draw cells in the colours of their rows; cells without a row stay empty."""
    cells = grid.placed(rows, [to_rgba(colour) for colour in colours], 0.0)
    axes.pcolormesh(*grid.edges, cells, rasterized=True)


@contextlib.contextmanager
def hatch_look(hatch: str, colour: str, width: float) -> Iterator[dict[str, Any]]:
    """A context in which a patch takes the width of its hatch, with the look of a hatch alone."""
    with mpl.rc_context({"hatch.linewidth": width}):
        yield {"fill": False, "hatch": hatch, "linewidth": 0.0, "edgecolor": colour}


def hatch_cells(
    axes: Axes, grid: CellGrid, rows: pd.DataFrame, marked: Any, hatch: str, colour: str, width: float = 0.5
) -> None:
    """Hatch the cells of marked rows; neighbours in a row of cells become one rectangle."""
    across, up = grid.edges
    cells = grid.placed(rows, marked, False)
    rectangles = []
    for row in np.flatnonzero(cells.any(axis=1)):
        low, high = up[row], up[row + 1]
        sides = across[np.flatnonzero(np.diff(np.r_[False, cells[row], False]))]
        for left, right in zip(sides[::2], sides[1::2], strict=True):
            corners = [(left, low), (right, low), (right, high), (left, high), (left, low)]
            rectangles.append(Path(corners, closed=True))
    if rectangles:
        shape = Path.make_compound_path(*rectangles)
        with hatch_look(hatch, colour, width) as look:
            axes.add_patch(PathPatch(shape, zorder=3, **look))


def _steps(values: Real[np.ndarray, " values"], *, log: bool) -> Int[np.ndarray, " steps"] | None:
    """The steps between sorted values as multiples of the smallest; None if they form no grid.

    On a grid they are whole, up to rounding, and shorter than `_MOST_STEPS`. Steps are ratios with `log`.
    """
    gaps = np.diff(np.log(values) if log else values)
    steps = gaps / gaps.min(initial=np.inf)
    if steps.max(initial=0.0) >= _MOST_STEPS or (np.abs(steps - np.round(steps)) >= _NEAR_WHOLE).any():
        return None
    return np.round(steps).astype(int)


def _on_grid(values: Real[np.ndarray, " values"], *, log: bool) -> bool:
    """Whether sorted values form a grid, as few values always do."""
    return len(values) <= _FEW_VALUES or _steps(values, log=log) is not None


def _filled(values: Real[np.ndarray, " values"], *, log: bool) -> Real[np.ndarray, " cells"]:
    """Sorted values of a grid with missing values filled in, so that no cell covers a missing neighbour.

    Values that do not form a grid are returned unchanged.
    """
    steps = _steps(values, log=log)
    if steps is None:
        return values
    positions = np.log(values) if log else values
    filled = []
    for number, count in enumerate(steps):
        missing = np.linspace(positions[number], positions[number + 1], count, endpoint=False)[1:]
        # the value itself exactly, by which rows find their cells
        filled += [values[number : number + 1], np.exp(missing) if log else missing]
    return np.concatenate([*filled, values[-1:]])


def cell_edges(centres: Real[np.ndarray, " cells"], *, log: bool = False) -> Float[np.ndarray, " edges"]:
    """The edges of cells, half way between neighbouring centres.

    Half way is the geometric mean with `log`.
    """
    if log:
        return np.exp(cell_edges(np.log(centres)))
    if len(centres) == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.r_[centres[0] - (middle[0] - centres[0]), middle, centres[-1] + (centres[-1] - middle[-1])]
