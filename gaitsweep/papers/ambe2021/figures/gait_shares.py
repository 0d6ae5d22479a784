"""Fractions of the multi-legged chain's gaits over parameters, with the limits of the paper's conditions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from gaitsweep import near_miss
from gaitsweep.papers.ambe2021.analysis.gait_shares import existence, printed_margins
from gaitsweep.papers.ambe2021.analysis.gait_shares import gait_shares as shares_of
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import profile_of, set_columns, without_phases
from gaitsweep.papers.ambe2021.multilegged.parameters import PARAMETERS
from gaitsweep.papers.ambe2021.theory.gaits import WAVES
from gaitsweep.plot import (
    TEXT_COLUMNS,
    AlongAxis,
    Horizontal,
    PlannedTable,
    PlotError,
    Refusal,
    Title,
    axis_label,
    cell_grid,
    described,
    figure_kind,
    log_axes,
    require_columns,
    theme,
)

_SHARES = (*WAVES, "elsewhere")
_BINNED_FROM, _SETS_PER_BIN = 1000, 4  # sets from which a map has bins, and their mean number in one
_EDGE: dict[str, Any] = {"color": "black", "lw": 0.9, "ls": "--"}
_EXACT: dict[str, Any] = {"color": "#D55E00", "lw": 1.1, "ls": "-"}
_LINES = {
    "m/2 < m$_B$ < m, m g/κ < a < L": _EDGE,
    "edge of where the wave is a motion of the chain": _EXACT,
}


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    if table.missing(["psi_1_end"]):
        yield figure.needs(table, "the multi-legged chain's psi_1")
        return
    sets = without_phases(table.varied)
    for field in ("x", "y"):
        column = getattr(figure, field)
        if column is not None and column not in sets and column not in TEXT_COLUMNS:
            allowed = near_miss.allowing(sets)
            yield (field,), f"is {column}, which is not a varying parameter of this job. {allowed}"


@figure_kind("settle", check=_check)
def gait_shares(
    table: pd.DataFrame,
    *,
    x: Horizontal,
    y: Annotated[
        AlongAxis | None, "column along the vertical axis; by default curves over x are drawn"
    ] = None,
    title: Title = None,
) -> Figure:
    """The fraction of starts with each gait: curves over x, or a map over x and y for each gait.

    Curves have their 95 % intervals. Dashed lines are the limits of m/2 < m_B < m and of m g/kappa < a < L,
    solid ones those of the exact conditions (`existence`); parameters that are not on the axes are those of
    the job, or of Table 1 if they vary. With a profile the limits are those of all inner legs. If the sets
    form no grid, a map has a point for each, or, of many, the means of bins.

    Args:
        table: a settle table of the multi-legged chain, several starts for each set of parameters.

    Raises:
        PlotError: the table does not have a column, or a column along an axis of a map is no swept parameter.
    """
    require_columns(table, x, y)
    if y is None:
        return _curves(table, x, title)
    require_swept(table, x=x, y=y)
    down, across = theme.shape(len(_SHARES), theme.PAGE, 1.4)
    with theme.canvas(theme.PAGE, 1.9 * down + 0.8, title) as figure:
        panels = theme.panels(figure, (down, across), len(_SHARES), sharex=True, sharey=True)
        if not len(table):
            for axes in panels:
                theme.message(axes, "no rows yet")
            return figure
        shares = shares_of(table)
        meshes = []
        for axes, gait in zip(panels, _SHARES, strict=True):
            log_axes(axes, table, x=x, y=y)
            meshes.append(_map(axes, shares, table, x, y, gait))
            axes.set(xlim=axes.get_xlim(), ylim=axes.get_ylim())  # lines leave them as they are
            axes.set_title(_label(gait))
            axes.set_xlabel(axis_label(table, x))
            _contours(axes, table, x, y, gait)
        for axes in panels[::across]:
            axes.set_ylabel(described(table, y, 24))
        for axes in panels[:-across]:
            axes.set_xlabel("")
        figure.colorbar(meshes[0], ax=panels, label="share of starts", shrink=0.9)
        handles = [Line2D([], [], **line) for line in _LINES.values()]
        theme.legend(figure, handles, list(_LINES), ncols=2)
    return figure


def require_swept(table: pd.DataFrame, **columns: str) -> None:
    """Refuse columns, by the names of their fields, that are no swept parameters of the chain.

    Raises:
        PlotError: a column is a phase of the start, or does not vary in the table's job.
    """
    swept = set_columns(table)
    for field, name in columns.items():
        if name not in swept:
            text = f"{field} is {name}, which is not a swept parameter of this table."
            raise PlotError(f"{text} {near_miss.allowing(swept)}")


def _label(gait: str) -> str:
    """The name of a gait in figures, or of starts without one of the three."""
    return theme.named(gait) if gait in WAVES else "none of these"


def _map(axes: Axes, shares: pd.DataFrame, table: pd.DataFrame, x: str, y: str, gait: str) -> Any:
    """Cells with the means of their sets if these form a grid; else a point for each set, or bins of many."""
    style = {"cmap": "viridis", "vmin": 0.0, "vmax": 1.0, "rasterized": True}
    cells = pd.DataFrame(shares.groupby([x, y])[gait].mean()).reset_index()
    grid = cell_grid(cells, x, y, table)
    if grid is not None:
        return axes.pcolormesh(*grid.edges, grid.placed(cells, cells[gait]), **style)
    at = cells[[x, y]].to_numpy(float)
    if len(cells) >= _BINNED_FROM:
        number = int(np.sqrt(len(cells) / _SETS_PER_BIN))
        scales = (axes.get_xscale(), axes.get_yscale())
        edges = [
            _along((low, high), number + 1, scale)
            for low, high, scale in zip(at.min(axis=0), at.max(axis=0), scales, strict=True)
        ]
        sums = np.histogram2d(at[:, 0], at[:, 1], edges, weights=cells[gait].to_numpy(float))[0]
        sets = np.ma.masked_equal(np.histogram2d(at[:, 0], at[:, 1], edges)[0], 0.0)
        return axes.pcolormesh(*edges, (sums / sets).T, **style)
    size = float(np.clip(2e3 / len(cells), 3.0, 30.0))
    return axes.scatter(cells[x], cells[y], c=cells[gait], s=size, linewidths=0.0, **style)


def _curves(table: pd.DataFrame, x: str, title: str | None) -> Figure:
    """The curves over x, with intervals and limits."""
    with theme.canvas(theme.COLUMN + 0.9, 3.1, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel(described(table, x))
        axes.set_ylabel("share of starts")
        log_axes(axes, table, x=x)
        if not len(table):
            theme.message(axes, "no rows yet")
            return figure
        shares = shares_of(table, x).sort_values(x)  # starts at all values of other parameters together
        colour = {**theme.colours(WAVES), "elsewhere": theme.COLOURS["none"]}
        marker = {**theme.markers(WAVES), "elsewhere": "x"}
        for gait in _SHARES:
            style = {"color": colour[gait], "marker": marker[gait], "ms": 3.5}
            axes.plot(shares[x], shares[gait], label=_label(gait), **style)
            if gait in WAVES:
                band = (shares[x], shares[f"{gait}_low"], shares[f"{gait}_high"])
                axes.fill_between(*band, color=colour[gait], alpha=0.18, lw=0)
        axes.set(xlim=axes.get_xlim(), ylim=(-0.02, 1.02))
        _mark_limits(axes, table, x)
        theme.legend(figure, ncols=4)
    return figure


def _cased() -> dict[str, Any]:
    """The style of a limit over cells: white around black shows on dark ones and on light ones."""
    return {**_EDGE, "path_effects": [withStroke(linewidth=2.0, foreground="white")]}


def _along(limits: tuple[float, float], number: int, scale: str) -> Float[np.ndarray, " places"]:
    """Places of an axis, evenly spread on the page."""
    if scale == "log":
        return np.geomspace(*limits, number)
    return np.linspace(*limits, number)


def _inside(table: pd.DataFrame, name: str, limits: tuple[float, float]) -> tuple[float, float]:
    """The limits of an axis without the figure's margin below zero, if the parameter is above it."""
    parameters = (*PARAMETERS, *profile_of(table).values())
    positive = {quantity.name for quantity in parameters if quantity.low == 0.0}
    return (max(limits[0], 1e-3 * limits[1]), limits[1]) if name in positive else limits


def _mark_limits(axes: Axes, table: pd.DataFrame, x: str) -> None:
    """Upright lines along x: at the limits of conditions, and where a gait begins or ends to exist.

    The latter are left out where another line is. Other parameters are those of the
    job, or of Table 1 if they vary.
    """
    along = _along(_inside(table, x, axes.get_xlim()), 241, axes.get_xscale())
    sets = pd.DataFrame({x: along})
    for margin in printed_margins(table, sets):
        for turn in np.flatnonzero(np.diff(margin > 0.0)):
            low, high = margin[turn : turn + 2]
            axes.axvline(along[turn] + (along[turn + 1] - along[turn]) * low / (low - high), **_cased())
    for exists in existence(table, sets).values():
        others = [float(np.asarray(line.get_xdata(), float)[0]) for line in axes.get_lines()]
        for turn in np.flatnonzero(np.diff(exists)):
            at, step = 0.5 * (along[turn] + along[turn + 1]), along[turn + 1] - along[turn]
            if min(abs(at - other) for other in others) > step:
                axes.axvline(at, zorder=0, **_EXACT)


def _contours(axes: Axes, table: pd.DataFrame, x: str, y: str, gait: str) -> None:
    """The limits of conditions over x and y, and the edge of the region in which a gait exists."""
    along = _along(_inside(table, x, axes.get_xlim()), 161, axes.get_xscale())
    up = _along(_inside(table, y, axes.get_ylim()), 161, axes.get_yscale())
    across, upwards = np.meshgrid(along, up)
    sets = pd.DataFrame({x: across.ravel(), y: upwards.ravel()})
    drawn = [(margin, _cased()) for margin in printed_margins(table, sets)]
    if gait in WAVES:
        drawn.append((existence(table, sets)[gait] - 0.5, _EXACT))
    for values, style in drawn:
        if values.min() < 0.0 < values.max():
            lines = {"colors": style["color"], "linewidths": style["lw"], "linestyles": style["ls"]}
            contour = axes.contour(along, up, values.reshape(across.shape), [0.0], **lines)
            contour.set(path_effects=style.get("path_effects"))
