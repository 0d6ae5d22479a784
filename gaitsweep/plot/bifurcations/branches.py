"""Branch diagrams: the fixed points of return maps over a parameter."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitsweep.analysis.transitions.return_map import branches as find_branches
from gaitsweep.angles import unwrap_from
from gaitsweep.plot import theme
from gaitsweep.plot.arguments import AlongAxis, Bandwidth, Observed, Title
from gaitsweep.plot.bifurcations.continuation import STABLE, UNSTABLE
from gaitsweep.plot.columns import column, origin_of, require_columns, require_one_system
from gaitsweep.plot.kind import check_one_parameter, figure_kind

_COLOUR = {True: STABLE, False: UNSTABLE}
_WORDS = {True: "stable: starts nearby come to it", False: "unstable: starts nearby leave it"}


@figure_kind("return_map", check=check_one_parameter, coloured="none")
def branches(
    table: pd.DataFrame,
    *,
    x: Annotated[AlongAxis, "column of the varying parameter"],
    y: Observed,
    bandwidth: Bandwidth = None,
    title: Title = None,
) -> Figure:
    """The fixed points of the return map over a parameter: stable ones filled, unstable ones open.

    Neighbours of the same stability are joined, by a solid line if stable and a dashed one if not; bars are
    two standard errors. Parameter values without a fixed point are marked below.

    Args:
        table: a return map's table over several values of x.

    Raises:
        PlotError: the table lacks a column, or the bandwidth is not above 0.
    """
    name = column(table, y, ("_n", ""))
    require_columns(table, x, "row", "crossing")
    require_one_system(table, x)
    points = find_branches(table, name, x, bandwidth)
    with theme.diagram(table, x, name, title) as (figure, axes):
        if not len(points):
            theme.message(axes, "No map crosses the line of no change: none has a fixed point.")
            return figure
        value = points["value"].to_numpy(float)
        origin = origin_of(table, name, value)
        _draw(axes, points.assign(place=unwrap_from(value, origin)), x, angle=origin is not None)
        parameters = np.unique(table[x].dropna().to_numpy(float))
        without = parameters[~np.isin(parameters, points[x].to_numpy(float))]
        if len(without):
            look: dict[str, Any] = {"color": "#555555", "ms": 7, "clip_on": False}
            axes.plot(without, 0.0 * without, "|", transform=axes.get_xaxis_transform(), **look)
        theme.value_axis(axes, angle=origin is not None)
        theme.legend(figure, _key(points, without=len(without) > 0), ncols=2)
    return figure


def _draw(axes: Axes, points: pd.DataFrame, x: str, *, angle: bool) -> None:
    """Draw the line of each branch, interrupted where an `angle` wraps, and its points with their errors."""
    for _, branch in points.groupby("branch", sort=True):
        stable = bool(branch["stable"].iloc[0])
        colour = _COLOUR[stable]
        branch = branch.sort_values(x, kind="stable")
        at, place = branch[x].to_numpy(float), branch["place"].to_numpy(float)
        line: dict[str, Any] = {"color": colour, "lw": 1.2, "ls": "-" if stable else (0, (4, 2)), "zorder": 2}
        over_the_cut = (np.abs(np.diff(place)) > np.pi) & angle
        axes.plot(*theme.interrupted(over_the_cut, at, place), **line)
        error = 2.0 * branch["value_error"].to_numpy(float)
        face = colour if stable else "white"
        marks: dict[str, Any] = {"fmt": "o", "ms": 4.5, "mew": 1.1, "mfc": face, "zorder": 3}
        axes.errorbar(at, place, yerr=error, color=colour, elinewidth=0.8, **marks)


def _key(points: pd.DataFrame, *, without: bool) -> list[Line2D]:
    """The legend of the points that occur, and of parameter values `without` a fixed point."""
    handles = []
    for stable, label in _WORDS.items():
        if stable in set(points["stable"].astype(bool)):
            look: dict[str, Any] = {"color": _COLOUR[stable], "marker": "o", "ms": 4.5, "lw": 1.2}
            look |= {"ls": "-" if stable else "--", "mfc": _COLOUR[stable] if stable else "white"}
            handles.append(Line2D([], [], label=label, **look))
    if without:
        handles.append(Line2D([], [], ls="", marker="|", color="#555555", ms=7, label="none found"))
    return handles
