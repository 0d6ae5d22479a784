"""Basins of attraction: the gait reached from each start, over two swept quantities."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from gaitsweep.analysis.records import in_order
from gaitsweep.contract import Outcome
from gaitsweep.plot import theme
from gaitsweep.plot.basins.cells import cell_edges, check_cells, filled, hatch_cells, on_grid
from gaitsweep.plot.columns import (
    PlotError,
    axis_label,
    column,
    is_angle,
    is_logarithmic,
    log_axes,
    outcome,
    rows_where,
    symbol,
    written,
)
from gaitsweep.plot.kind import Horizontal, Hue, Panels, Title, Vertical, figure_kind

_PANELS_A_ROW = 4
_MOST_PANELS = 40

_Looks = tuple[dict[str, str], dict[str, str]]  # colour and marker of each outcome, the same in all panels


@figure_kind("settle", "fixed_time", check=check_cells)
def basin(
    table: pd.DataFrame,
    *,
    x: Horizontal,
    y: Vertical,
    hue: Hue = "gait",
    panels: Panels = None,
    title: Title = None,
) -> Figure:
    """Cells coloured by the outcome of each start, with the share of each outcome in the legend.

    Starts on a grid are drawn as cells; others as points. A numeric `hue` is drawn on a colour scale. Rows
    that failed or did not settle are hatched grey; cells without a row yet are left white.

    Args:
        table: a settle table, complete or partial.

    Raises:
        PlotError: the table lacks a column, or a cell has several rows.
    """
    for name in (x, y, hue, *([panels] if panels else [])):
        column(table, name)
    values = sorted(table[panels].dropna().unique()) if panels else [None]
    if len(values) > _MOST_PANELS:
        title = f"{title or ''} (the first {_MOST_PANELS} of {len(values)} panels)".strip()
        values = values[:_MOST_PANELS]
    rows, columns = theme.shape(len(values), theme.PAGE, 1.6, _PANELS_A_ROW)
    numeric = pd.api.types.is_numeric_dtype(table[hue])
    width = theme.width_of(theme.COLUMN + 0.4 if columns == 1 else min(theme.PAGE, 2.4 * columns))
    side = (width - (1.3 if numeric else 0.6)) / columns
    with theme.canvas(width, rows * (side + 0.35) + (0.35 if numeric else 0.75), title) as figure:
        if not len(table):
            theme.message(figure.add_subplot(), "no rows yet")
            return figure
        grid = np.atleast_1d(figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)).ravel()
        parts = [table if value is None else rows_where(table, table[panels] == value) for value in values]
        shown = outcome(table, hue)
        names = theme.ordered(in_order(table, hue, shown))
        looks = theme.colours(names), theme.markers(names)
        limits = (table[hue].min(), table[hue].max()) if numeric else None
        image = None
        # the grid of all panels shows which cells one panel lacks
        whole = tuple(np.unique(table[name].dropna().to_numpy(float)) for name in (x, y))
        for axes, value, part in zip(grid, values, parts, strict=False):
            drawn = _cells(axes, part, x, y, hue, shown.loc[part.index], limits, looks, whole)
            image = drawn or image
            if panels:
                axes.set_title(written(table, panels, value))
        for axes in grid[len(values) :]:
            axes.set_visible(False)
        _axes_of(table, list(grid[: len(values)]), x, y, columns)
        if numeric and image is not None:
            figure.colorbar(image, ax=list(grid), label=axis_label(table, hue), shrink=0.8)
            names = [str(name) for name in names if name in (Outcome.NOT_SETTLED, Outcome.FAILED)]
        if names:
            status = table["status"].astype(str) if "status" in table.columns else pd.Series(dtype=str)
            inferred = float(np.mean(status.to_numpy(str) == "inferred")) if len(status) else 0.0
            each = [shown.loc[part.index] for part in parts]
            _legend(figure, each, names, looks, symbol(table, panels or hue), inferred)
    return figure


def _axes_of(table: pd.DataFrame, grid: Sequence[Axes], x: str, y: str, columns: int) -> None:
    """Labels along the outer edges, ticks of angles in multiples of pi."""
    for number, axes in enumerate(grid):
        below = number + columns >= len(grid)
        axes.set_xlabel(axis_label(table, x) if below else "")
        axes.tick_params(labelbottom=below)
        axes.set_ylabel(axis_label(table, y) if number % columns == 0 else "")
        for which, name in (("x", x), ("y", y)):
            if is_angle(table, name) and not is_logarithmic(table, name):
                theme.angle_axis(axes, which)
        if all(is_angle(table, name) and not is_logarithmic(table, name) for name in (x, y)):
            axes.set_aspect("equal")


def _cells(
    axes: Axes,
    part: pd.DataFrame,
    x: str,
    y: str,
    hue: str,
    shown: pd.Series,
    limits: tuple | None,
    looks: _Looks,
    whole: tuple[np.ndarray, ...],
) -> ScalarMappable | None:
    """Draw one panel; returns the artist of the colour scale for a numeric hue."""
    part = rows_where(part, part[x].notna() & part[y].notna())
    if not len(part):
        theme.message(axes, "no rows yet")
        return None
    log_axes(axes, part, x=x, y=y)
    logs = is_logarithmic(part, x), is_logarithmic(part, y)
    across, up = np.unique(part[x]), np.unique(part[y])
    regular = on_grid(across, log=logs[0]) and on_grid(up, log=logs[1])
    regular = regular and len(part) >= 0.02 * len(across) * len(up)
    shown = shown.loc[part.index]
    palette, marker = looks
    if not regular:
        size = float(np.clip(4e3 / len(part), 2.0, 30.0))
        if limits is not None:
            low, high = limits
            return axes.scatter(part[x], part[y], c=part[hue], s=size, cmap="viridis", vmin=low, vmax=high)
        for name in shown.unique():
            mine = rows_where(part, shown == name)
            axes.scatter(mine[x], mine[y], c=palette[name], marker=marker[name], s=size, linewidths=0.6)
        return None
    if part.duplicated([x, y]).any():
        raise PlotError(
            f"Several rows have the same {x} and {y}, since another quantity varies too. Name it as "
            "`panels`, or keep one of its values in the table."
        )
    across, up = (
        filled(all_ if on_grid(all_, log=log) else mine, log=log)
        for all_, mine, log in zip(whole, (across, up), logs, strict=True)
    )
    at = np.searchsorted(up, part[y]), np.searchsorted(across, part[x])
    edges = cell_edges(across, log=logs[0]), cell_edges(up, log=logs[1])
    hatch_cells(axes, edges, at, shown.isin([Outcome.NOT_SETTLED, Outcome.FAILED]).to_numpy())
    if limits is not None:
        cells = np.full((len(up), len(across)), np.nan)
        cells[at] = part[hue].where(~shown.isin([Outcome.FAILED]))
        return axes.pcolormesh(*edges, cells, cmap="viridis", vmin=limits[0], vmax=limits[1], rasterized=True)
    cells = np.zeros((len(up), len(across), 4))
    cells[at] = np.array([to_rgba(palette[name]) for name in shown])
    axes.pcolormesh(*edges, cells, rasterized=True)
    return None


def _legend(
    figure: Figure, parts: list[pd.Series], names: list[str], looks: _Looks, panels: str, inferred: float
) -> None:
    """The legend below the panels: each outcome with its share, for each panel if there are few."""
    colour, _ = looks
    apart = parts if 1 < len(parts) <= _PANELS_A_ROW else [pd.concat(parts)]
    handles = []
    for name in names:
        shares = " / ".join(
            theme.percent(float((part == name).mean()) if len(part) else 0.0) for part in apart
        )
        hatch = theme.HATCH if name in (Outcome.NOT_SETTLED, Outcome.FAILED) else None
        face = {"facecolor": colour[name], "edgecolor": "#333333", "hatch": hatch, "linewidth": 0.4}
        handles.append(Patch(label=f"{theme.named(name)}  {shares} %", **face))
    guessed = f" ({theme.percent(inferred)} % of cells inferred from their neighbours)" if inferred else ""
    heading = (
        f"share of starts{guessed}"
        if len(apart) == 1
        else f"share of starts{guessed}, by {panels}, left to right"
    )
    columns = min(len(handles), 3 if len(parts) > 1 else 2)
    theme.legend(figure, handles, ncols=columns, title=heading)
