"""Values of a parameter at which gaits are lost, from settled rows that start in each gait."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Shaped
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gaitsweep.analysis.records import in_order
from gaitsweep.analysis.transitions.hysteresis import transition_points_by_gait
from gaitsweep.angles import unwrap_from
from gaitsweep.plot import theme
from gaitsweep.plot.arguments import AlongAxis, Column, GaitColumn, Observed, Title
from gaitsweep.plot.column_labels import symbol, unit_of
from gaitsweep.plot.columns import (
    column,
    is_angle,
    origin_of,
    outcome,
    require_columns,
    require_one_system,
    rows_where,
)
from gaitsweep.plot.kind import PlannedTable, Refusal, check_one_system, figure_kind
from gaitsweep.status import Outcome

_OPEN = "#777777"  # of outcomes that are no gait
_Looks = tuple[dict[str, str], dict[str, str]]  # colours and markers of gaits


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    if figure.start == figure.x:
        yield ("start",), f"is {figure.start}, like x: name the column of a start."
    yield from check_one_system(figure, table)


@figure_kind("settle", check=_check)
def gait_transitions(
    table: pd.DataFrame,
    *,
    x: Annotated[AlongAxis, "column of the varying parameter"],
    y: Observed,
    start: Annotated[Column, "column of the start that selects the branch"],
    hue: GaitColumn = "gait",
    title: Title = None,
) -> Figure:
    """An observable of settled rows over a parameter, and the intervals in which each gait is lost.

    Points are coloured by gait; rows that did not settle are open, and those that fell are marked below. A
    gait is lost between the last value at which a row settles in it and the first value at which none of its
    starts settles in it; the legend gives these intervals.

    Args:
        table: a settle table with starts in each gait at each value of x.

    Raises:
        PlotError: the table lacks a column, or `start` is `x`.
    """
    name = column(table, y, ("_end", ""))
    require_columns(table, x, start, hue, "status")
    require_one_system(table, x)
    with theme.diagram(table, x, name, title, height=3.6) as (figure, axes):
        table = rows_where(table, table[x].notna())
        if not len(table):
            theme.message(axes, "no rows yet")
            return figure
        values = table[name].to_numpy(float)
        values = unwrap_from(values, origin_of(table, name, values))
        outcomes = outcome(table, hue)
        names = theme.ordered(in_order(table, hue, outcomes))
        colours = theme.colours([gait for gait in names if gait not in (Outcome.NOT_SETTLED, Outcome.FAILED)])
        looks = colours, theme.markers(colours)
        handles = _draw_rows(axes, table[x].to_numpy(float), values, outcomes.to_numpy(), names, looks)
        labels = [theme.named(name) for name in names]
        if not np.isfinite(values[(outcomes != Outcome.FAILED).to_numpy()]).any():
            theme.message(axes, f"No row that did not fail has a value of {symbol(table, name)}.")
        lost = transition_points_by_gait(table, x, start, hue)
        for edge in rows_where(lost, lost["gait"].isin(list(colours))).to_dict("records"):
            handles.append(_draw_edge(axes, edge, looks))
            labels.append(_words(table, x, edge))
        theme.value_axis(axes, angle=is_angle(table, name))
        theme.legend(figure, handles, labels, ncols=2)
    return figure


def _draw_edge(axes: Axes, edge: Mapping[Any, Any], looks: _Looks) -> tuple[Patch, Line2D]:
    """Draw the interval in which a gait is lost; returns its handle in the legend."""
    colours, markers = looks
    gait = str(edge["gait"])
    axes.axvspan(edge["low"], edge["high"], color=colours[gait], alpha=0.3, lw=0)
    middle = 0.5 * (edge["low"] + edge["high"])
    axes.axvline(middle, color=colours[gait], lw=0.8, ls=":")
    # by the marker of the gait grey print tells the intervals apart
    look: dict[str, Any] = {"marker": markers[gait], "mfc": colours[gait], "color": "#333333", "ls": ""}
    axes.plot([middle], [0.96], transform=axes.get_xaxis_transform(), ms=5.0, **look)
    return Patch(facecolor=colours[gait], alpha=0.3), Line2D([], [], ms=4.0, **look)


def _draw_rows(
    axes: Axes,
    at: Float[np.ndarray, " rows"],
    values: Float[np.ndarray, " rows"],
    outcomes: Shaped[np.ndarray, " rows"],
    names: list[str],
    looks: _Looks,
) -> list[Any]:
    """Draw the rows as points; returns the handle of each outcome in the legend."""
    handles: list[Any] = []
    colours, markers = looks
    for name in names:
        rows = outcomes == name
        look: dict[str, Any] = {"ls": "", "ms": 3.5}
        if name == Outcome.FAILED:
            look |= {"marker": "x", "color": "black", "clip_on": False}
            axes.plot(at[rows], np.zeros(rows.sum()), transform=axes.get_xaxis_transform(), **look)
        else:
            colour = colours.get(name, _OPEN)
            face = "white" if name == Outcome.NOT_SETTLED else colour
            look |= {"marker": markers.get(name, "o"), "color": colour, "mfc": face}
            axes.plot(at[rows], values[rows], **look)
        handles.append(Line2D([], [], **look))
    return handles


def _words(table: pd.DataFrame, x: str, edge: Mapping[Any, Any]) -> str:
    """Name the gait that is lost, the direction of the parameter, and the interval."""
    verb = "rises" if edge["direction"] == "rising" else "falls"
    interval = f"{edge['low']:.6g} to {edge['high']:.6g} {unit_of(table, x)}".rstrip()
    return f"{theme.named(edge['gait'])} lost as {symbol(table, x)} {verb}: {interval}"
