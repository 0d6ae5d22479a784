"""Gait maps: the gaits reached from several starts at each point of a plane of two parameters."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gaitsweep.plot import theme
from gaitsweep.plot.arguments import GaitColumn, Horizontal, Title, Vertical
from gaitsweep.plot.basin_maps.cells import CellGrid, cell_grid, colour_cells, hatch_cells, hatch_look
from gaitsweep.plot.columns import HATCHED, OTHER, is_turn, outcome, require_columns, rows_where
from gaitsweep.plot.kind import figure_kind
from gaitsweep.status import Outcome

_STRIPES = ("\\\\\\", "---", "|||")  # of the second gait of a set, the third, ...
_DOUBTFUL = "++++"  # of a set that may have more gaits


@figure_kind("settle", "fixed_time")
def gait_map(
    table: pd.DataFrame, *, x: Horizontal, y: Vertical, hue: GaitColumn = "gait", title: Title = None
) -> Figure:
    """Cells coloured by the set of gaits in which their starts settle, those of several gaits striped.

    A gait belongs to a cell's set if any start of the cell settles in it. Cells in which another start failed
    have darker colours, those in which another did not settle lighter ones: they may have more gaits. A cell
    without a named gait is `another gait`, `not settled` or `failed`, the first of these that occurs among
    its starts. The legend gives each set's share of the cells.

    Args:
        table: a settle table, complete or partial, with several starts for each pair of x and y. `none` is
            not a gait.

    Raises:
        PlotError: the table lacks a column.
    """
    require_columns(table, x, y, hue)
    with theme.diagram(table, x, y, title, width=theme.COLUMN + 1.8, height=3.9) as (figure, axes):
        table = rows_where(table, table[x].notna() & table[y].notna())
        if not len(table):
            theme.message(axes, "no rows yet")
            return figure
        sets = _sets(table, x, y, hue)
        looks = _looks(_ordered(sets["set"].tolist()))
        grid = cell_grid(sets, x, y, table)
        handles = _points(axes, sets, x, y, looks) if grid is None else _cells(axes, sets, grid, looks)
        if is_turn(table, x):
            theme.angle_ticks(axes, "x")
        if is_turn(table, y):
            theme.angle_ticks(axes, "y")
        cells = sets["set"].tolist()
        labels = [f"{_words(names)}  {theme.percent(cells.count(names) / len(cells))} %" for names in looks]
        heading = "gaits that starts settle in, share of cells"
        theme.legend(figure, handles, labels, ncols=2, title=heading)
    return figure


def _sets(table: pd.DataFrame, x: str, y: str, hue: str) -> pd.DataFrame:
    """The set of each cell, a tuple of names in the hue's own order: columns x, y, set."""
    shown = outcome(table, hue).replace({"none": OTHER})
    dtype = table[hue].dtype
    categories = map(str, dtype.categories) if isinstance(dtype, pd.CategoricalDtype) else ()
    named = [name for name in categories if name != "none"]
    order = theme.ordered(dict.fromkeys([*named, *sorted(set(shown) - {OTHER, *HATCHED})]))

    def reached(outcomes: pd.Series) -> tuple[str, ...]:
        """The gaits among the outcomes of a cell's starts, and the first of the other outcomes."""
        present = set(outcomes)
        gaits = tuple(name for name in order if name in present)
        others = (Outcome.FAILED, Outcome.NOT_SETTLED) if gaits else (OTHER, *HATCHED)
        return gaits + tuple(name for name in others if name in present)[:1]

    cells = pd.DataFrame({x: table[x], y: table[y], "set": shown})
    return cells.groupby([x, y], sort=True)["set"].agg(reached).reset_index()


def _ordered(sets: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The sets that occur: single gaits first, then sets of several; cells without a gait last."""
    present = list(dict.fromkeys(sets))
    without = [(OTHER,), *((name,) for name in HATCHED)]
    gaits = (names for names in present if names not in without)
    ordered = sorted(gaits, key=lambda names: (names[-1] in HATCHED, len(names), names))
    return [*ordered, *(names for names in without if names in present)]


def _gaits_of(names: tuple[str, ...]) -> tuple[str, ...]:
    """A set of gaits without the mark of a start that failed or did not settle."""
    return names[:-1] if len(names) > 1 and names[-1] in HATCHED else names


class _Look(NamedTuple):
    """The colours of a set's gaits, and of its cells the hatches over each other: pattern, colour, width."""

    colours: list[str]
    hatches: list[tuple[str, str, float]]


def _looks(sets: list[tuple[str, ...]]) -> dict[tuple[str, ...], _Look]:
    """The look of each set: that of its first gait, with stripes in the colour of each other one.

    With a start that failed the colours are darker, with one that did not settle lighter, and both hatched.
    """
    styled = dict.fromkeys("none" if name == OTHER else name for names in sets for name in names)
    colour, hatch = theme.colours(styled), theme.hatches(styled)
    looks = {}
    for names in sets:
        gaits = ["none" if name == OTHER else name for name in _gaits_of(names)]
        tints = [colour[name] for name in gaits]
        fine = hatch[gaits[0]] if len(gaits) == 1 else ""
        if len(gaits) < len(names):
            mixed_with = "black" if names[-1] == Outcome.FAILED else "white"
            tints = [theme.mixed(tint, mixed_with) for tint in tints]
            fine = _DOUBTFUL
        hatches = [(pattern, tint, 1.3) for pattern, tint in zip(itertools.cycle(_STRIPES), tints[1:])]
        if fine:
            hatches.append((fine, theme.line_on(tints[0]), 0.5))
        looks[names] = _Look(tints, hatches)
    return looks


def _cells(axes: Axes, sets: pd.DataFrame, grid: CellGrid, looks: dict[tuple[str, ...], _Look]) -> list[Any]:
    """Draw the sets as cells; returns the handle of each set."""
    colour_cells(axes, grid, sets, [looks[names].colours[0] for names in sets["set"]])
    handles = []
    for names, look in looks.items():
        marked = np.array([of_cell == names for of_cell in sets["set"]])
        handle = [Patch(facecolor=look.colours[0], linewidth=0.0)]
        for hatch in look.hatches:
            hatch_cells(axes, grid, sets, marked, *hatch)
            with hatch_look(*hatch) as lines:
                handle.append(Patch(**lines))
        handles.append(tuple(handle))
    return handles


def _points(axes: Axes, sets: pd.DataFrame, x: str, y: str, looks: dict[tuple[str, ...], _Look]) -> list[Any]:
    """Draw the sets as points, of two gaits half and half; returns the handle of each set."""
    size = float(np.clip(63.0 / np.sqrt(len(sets)), 2.0, 6.0))
    markers = theme.markers(dict.fromkeys(name for names in looks for name in names))
    handles = []
    for names, look in looks.items():
        points = rows_where(sets, [of_cell == names for of_cell in sets["set"]])
        style: dict[str, Any] = {"ls": "", "ms": size, "mfc": look.colours[0], "mew": 0.3, "mec": "#333333"}
        style["marker"] = markers[names[0]]
        if len(look.colours) > 1:
            style |= {"marker": "o", "fillstyle": "left", "mfcalt": look.colours[1]}
        if len(look.colours) > 2:
            style |= {"mew": 1.0, "mec": look.colours[2]}
        axes.plot(points[x], points[y], **style)
        handles.append(Line2D([], [], **style))
    return handles


def _words(names: tuple[str, ...]) -> str:
    """A set in words: `trot only`, `trot and walk`, `trot; another start failed`, `failed`."""
    gaits = [theme.named(name) for name in _gaits_of(names)]
    if len(gaits) < len(names):
        return f"{' and '.join(gaits)}; another start {theme.named(names[-1])}"
    if len(names) == 1:
        return gaits[0] if names[0] in (OTHER, *HATCHED) else f"{gaits[0]} only"
    return f"{', '.join(gaits[:-1])} and {gaits[-1]}"
