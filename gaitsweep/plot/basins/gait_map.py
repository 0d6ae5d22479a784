"""Gait maps: the gaits reached from several starts at each point of a plane of two parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from gaitsweep.contract import Outcome
from gaitsweep.plot import theme
from gaitsweep.plot.basins.cells import cell_edges, filled, hatch_cells, on_grid
from gaitsweep.plot.columns import column, described, is_angle, is_logarithmic, log_axes, outcome, rows_where
from gaitsweep.plot.kind import GaitColumn, Horizontal, Title, Vertical, figure_kind

OTHER = "another gait"  # settled, but in no gait of the model
_HATCHED = (Outcome.NOT_SETTLED, Outcome.FAILED)


@figure_kind("settle", "fixed_time")
def gait_map(
    table: pd.DataFrame, *, x: Horizontal, y: Vertical, hue: GaitColumn = "gait", title: Title = None
) -> Figure:
    """Cells coloured by the set of gaits in which their starts settle: one colour for each set.

    A gait belongs to a cell's set if any start of the cell settles in it. Cells in which another start failed
    have a darker colour of their own, those in which another did not settle a lighter one: they may have more
    gaits. A cell without a named gait is `another gait`, `not settled` or `failed`, the first of these that
    occurs among its starts. The legend gives each set's share of the cells.

    Args:
        table: a settle table, complete or partial, with several starts for each pair of x and y. `none` is
            not a gait.

    Raises:
        PlotError: the table lacks a column.
    """
    for name in (x, y, hue):
        column(table, name)
    with theme.canvas(theme.COLUMN + 1.8, 3.9, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel(described(table, x))
        axes.set_ylabel(described(table, y, 36))
        table = rows_where(table, table[x].notna() & table[y].notna())
        if not len(table):
            theme.message(axes, "no rows yet")
            return figure
        sets = _sets(table, x, y, hue)
        colour = _colours(_ordered(sets["set"].tolist()))
        log_axes(axes, table, x=x, y=y)
        _draw(axes, sets, x, y, colour, (is_logarithmic(table, x), is_logarithmic(table, y)))
        for which, name in (("x", x), ("y", y)):
            if is_angle(table, name) and not is_logarithmic(table, name):
                theme.angle_ticks(axes, which)
        heading = "gaits that starts settle in, share of cells"
        theme.legend(figure, _key(sets, colour), ncols=2, title=heading)
    return figure


def _sets(table: pd.DataFrame, x: str, y: str, hue: str) -> pd.DataFrame:
    """The set of each cell, a tuple of names in the hue's own order: columns x, y, set."""
    shown = outcome(table, hue).replace({"none": OTHER})
    kind = table[hue].dtype
    order = [str(each) for each in kind.categories] if isinstance(kind, pd.CategoricalDtype) else []
    order = [name for name in order if name != "none"] or sorted(set(shown) - {OTHER, *_HATCHED})
    order = theme.ordered(order)

    def reached(names: pd.Series) -> tuple[str, ...]:
        here = set(names)
        gaits = tuple(name for name in order if name in here)
        if not gaits:
            return tuple(name for name in (OTHER, *_HATCHED) if name in here)[:1]
        return gaits + tuple(name for name in (Outcome.FAILED, Outcome.NOT_SETTLED) if name in here)[:1]

    cells = pd.DataFrame({x: table[x], y: table[y], "set": shown})
    return cells.groupby([x, y], sort=True)["set"].agg(reached).reset_index()


def _ordered(sets: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The sets that occur: single gaits first, then sets of several; cells without a gait last."""
    present = list(dict.fromkeys(sets))
    without = [(OTHER,), *((name,) for name in _HATCHED)]
    gaits = (each for each in present if each not in without)
    ordered = sorted(gaits, key=lambda each: (each[-1] in _HATCHED, len(each), each))
    return [*ordered, *(each for each in without if each in present)]


def _whole(names: tuple[str, ...]) -> tuple[str, ...]:
    """A set of gaits without the mark of a start that failed or did not settle."""
    return names[:-1] if len(names) > 1 and names[-1] in _HATCHED else names


def _colours(sets: list[tuple[str, ...]]) -> dict[tuple[str, ...], str]:
    """The colour of each set: that of a single gait, other colours for several gaits, greys for no gait."""
    whole = list(dict.fromkeys(map(_whole, sets)))
    alone = theme.colours(dict.fromkeys(name for each in whole for name in each if name != OTHER))
    colour: dict[tuple[str, ...], str] = {
        each: theme.COLOURS["none"] if each == (OTHER,) else alone[each[0]]
        for each in whole
        if len(each) == 1
    }
    free = [each for each in ("#009E73", *theme.SPARE_COLOURS) if each not in alone.values()]
    free = free or list(theme.SPARE_COLOURS)  # with many gaits no colour is free
    several = [each for each in whole if len(each) > 1]
    colour |= {each: free[number % len(free)] for number, each in enumerate(several)}
    for each in sets:
        if each not in colour:
            colour[each] = _mixed(colour[_whole(each)], "black" if each[-1] == Outcome.FAILED else "white")
    return colour


def _mixed(colour: str, other: str) -> str:
    """The mean of two colours."""
    red, green, blue = 0.5 * (np.array(to_rgb(colour)) + np.array(to_rgb(other)))
    return to_hex((float(red), float(green), float(blue)))


def _key(sets: pd.DataFrame, colour: dict[tuple[str, ...], str]) -> list[Patch]:
    """Each set in words, with its share of the cells."""
    every = sets["set"].tolist()
    handles = []
    for names in _ordered(every):
        hatch = theme.HATCH if names[0] in _HATCHED else None
        face: dict[str, Any] = {"facecolor": colour[names], "edgecolor": "#333333", "linewidth": 0.4}
        label = f"{_words(names)}  {theme.percent(every.count(names) / len(every))} %"
        handles.append(Patch(label=label, hatch=hatch, **face))
    return handles


def _words(names: tuple[str, ...]) -> str:
    """A set in words: `trot only`, `trot and walk`, `trot; another start failed`, `failed`."""
    names = tuple(map(theme.named, names))
    if _whole(names) != names:
        return f"{' and '.join(_whole(names))}; another start {names[-1]}"
    if len(names) == 1:
        return names[0] if names[0] in (OTHER, *_HATCHED) else f"{names[0]} only"
    return f"{', '.join(names[:-1])} and {names[-1]}"


def _draw(
    axes: Axes,
    sets: pd.DataFrame,
    x: str,
    y: str,
    colour: dict[tuple[str, ...], str],
    logs: tuple[bool, bool],
) -> None:
    """Cells if the parameter sets form a grid, else one point for each set."""
    across, up = np.unique(sets[x]), np.unique(sets[y])
    colours = np.array([to_rgba(colour[each]) for each in sets["set"]])
    regular = on_grid(across, log=logs[0]) and on_grid(up, log=logs[1])
    if not (regular and len(sets) >= 0.02 * len(across) * len(up)):
        size = float(np.clip(4e3 / len(sets), 4.0, 36.0))
        axes.scatter(sets[x], sets[y], c=colours, s=size, edgecolors="#333333", linewidths=0.3)
        return
    across, up = filled(across, log=logs[0]), filled(up, log=logs[1])
    at = np.searchsorted(up, sets[y]), np.searchsorted(across, sets[x])
    edges = cell_edges(across, log=logs[0]), cell_edges(up, log=logs[1])
    cells = np.zeros((len(up), len(across), 4))
    cells[at] = colours
    axes.pcolormesh(*edges, cells, rasterized=True)
    hatch_cells(axes, edges, at, sets["set"].isin([(name,) for name in _HATCHED]).to_numpy())
