"""Regions of stable gaits in a plane of two parameters, bounded by bifurcations of their branches."""

from __future__ import annotations

import itertools
from typing import Annotated, Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gaitsweep.analysis.continuation.stable_ranges import range_of_gait
from gaitsweep.analysis.continuation.stable_ranges import stable_ranges as ranges_of
from gaitsweep.plot import theme
from gaitsweep.plot.arguments import AlongAxis, GaitColumn, Title
from gaitsweep.plot.bifurcations.branch_lines import MARKERS, WORDS
from gaitsweep.plot.column_labels import described
from gaitsweep.plot.columns import PlotError, branch_parameter, log_axes, require_columns
from gaitsweep.plot.kind import figure_kind

_STRIPES = {"hatch": "\\\\\\", "facecolor": "none", "lw": 0.0}  # of the second gait over the first


@figure_kind("continuation")
def stable_ranges(
    table: pd.DataFrame,
    *,
    y: Annotated[AlongAxis, "column of the parameter that differs between branches"],
    x: str | None = None,
    hue: GaitColumn = "gait",
    title: Title = None,
) -> Figure:
    """The range of a parameter in which each gait is stable, over another that differs between branches.

    Each gait has an area, striped in the colour of another that is stable too; edges are marked by the
    bifurcation there. At an edge without a mark the branch ended, or stability changes at a corner or jump of
    the map; at an edge without a line branches begin or leave their range.

    Args:
        table: a continuation's table. If several branches have the same gait at one value of y, their stable
            ranges must touch, and are joined.
        x: the column of the continuation parameter; by default that of the job.

    Raises:
        PlotError: a column is missing, y is not numeric, or a gait's ranges at one value of y are disjoint.
    """
    x = x or branch_parameter(table)
    require_columns(table, x, y, hue, "row", "point", "stable", "special", "end")
    with theme.canvas(theme.COLUMN + 1.2, 3.5, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel(described(table, x))
        axes.set_ylabel(described(table, y, 36))
        log_axes(axes, table, y=y)
        areas = _areas(table.assign(gait=table[hue]), x, y)
        if not areas:
            theme.message(axes, "no stable gait was found" if len(table) else "no rows yet")
            return figure
        _draw(axes, areas)
        theme.legend(figure, *_key(areas), ncols=2)
    return figure


def _areas(table: pd.DataFrame, x: str, y: str) -> dict[str, pd.DataFrame]:
    """The ranges of each named gait, with the value `up` of y, in the order of y."""
    up_of_row = dict(zip(table["row"], table[y], strict=True))
    values = pd.DataFrame({"up": np.unique(table[y].dropna().to_numpy(float))})
    areas = {}
    for gait in dict.fromkeys(ranges_of(table, x)["gait"]):
        if gait == "none":
            continue
        ranges = range_of_gait(table, x, gait)
        ranges = ranges.assign(up=[up_of_row[row] for row in ranges["row"]])
        unions = [
            _union(at_value, f"{gait} at {y} = {value:g}", x)
            for value, at_value in ranges.groupby("up", sort=True)
        ]
        # no area crosses a value of y at which the gait is not stable
        area = values.merge(pd.DataFrame(unions), on="up", how="left")
        areas[gait] = area.fillna({"low_by": "", "high_by": ""})
    return areas


def _union(ranges: pd.DataFrame, place: str, x: str) -> pd.Series:
    """The union of the ranges of branches at one value of y, which `place` names in messages.

    Raises:
        PlotError: the ranges are disjoint.
    """
    ranges = ranges.sort_values("low", kind="stable")
    low, high = ranges["low"].to_numpy(float), ranges["high"].to_numpy(float)
    reach = np.maximum.accumulate(high)
    if np.any(low[1:] > reach[:-1]):
        raise PlotError(
            f"{place}: stable in separate ranges of {x}, which do not form one area. Draw fewer branches, or "
            "the branches themselves (figures: continuation)."
        )
    last = ranges.iloc[int(np.argmax(high))]
    return pd.Series({**ranges.iloc[0], "high": last["high"], "high_by": last["high_by"]})


def _draw(axes: Axes, areas: dict[str, pd.DataFrame]) -> None:
    """Draw the areas, their overlaps and their edges."""
    colour, hatch = theme.colours(areas), theme.hatches(areas)
    for name, area in areas.items():
        low, high, up = (area[key].to_numpy(float) for key in ("low", "high", "up"))
        axes.fill_betweenx(up, low, high, **theme.hatched(colour[name], hatch[name]))
    for (one, other), (low, high, up) in _overlaps(areas).items():
        axes.fill_betweenx(up, low, high, color=colour[one], lw=0.0)
        axes.fill_betweenx(up, low, high, edgecolor=colour[other], **_STRIPES)
    for area in areas.values():
        for side in ("low", "high"):
            at, up = area[side].to_numpy(float), area["up"].to_numpy(float)
            cause = area[f"{side}_by"].to_numpy(str)
            is_lost = ~np.isin(cause, ["start", "range"])
            edge_colour = mpl.rcParams["axes.edgecolor"]
            axes.plot(np.where(is_lost, at, np.nan), up, color=edge_colour, lw=1.0, zorder=3)
            for bifurcation, marker in MARKERS.items():
                marked = cause == bifurcation
                look: dict[str, Any] = {"ms": 4.5, "color": "black", "mfc": "white", "zorder": 4}
                axes.plot(at[marked], up[marked], marker, **look)


def _overlaps(
    areas: dict[str, pd.DataFrame],
) -> dict[tuple[str, str], tuple[Float[np.ndarray, " points"], ...]]:
    """For each pair of gaits: low, high and up of the range where both are stable, NaN where not."""
    overlaps = {}
    for one, other in itertools.combinations(areas, 2):
        both = areas[one].merge(areas[other], on="up", suffixes=("", "_2"))
        low = both[["low", "low_2"]].to_numpy(float).max(axis=1)
        high = both[["high", "high_2"]].to_numpy(float).min(axis=1)
        disjoint = high <= low
        if not disjoint.all():
            up = both["up"].to_numpy(float)
            overlaps[one, other] = np.where(disjoint, np.nan, low), np.where(disjoint, np.nan, high), up
    return overlaps


def _key(areas: dict[str, pd.DataFrame]) -> tuple[list[Any], list[str]]:
    """The handles and texts of the legend."""
    colour, hatch = theme.colours(areas), theme.hatches(areas)
    handles: list[Any] = [Patch(**theme.hatched(colour[name], hatch[name])) for name in areas]
    labels = [f"{theme.named(name)} stable" for name in areas]
    for one, other in _overlaps(areas):
        handles.append((Patch(color=colour[one], lw=0.0), Patch(edgecolor=colour[other], **_STRIPES)))
        labels.append(f"{theme.named(one)} and {theme.named(other)} stable")
    causes = {cause for area in areas.values() for cause in (*area["low_by"], *area["high_by"])}
    kinds = [kind for kind in MARKERS if kind in causes]
    look: dict[str, Any] = {"ls": "", "ms": 4.5, "color": "black", "mfc": "white"}
    handles += [Line2D([], [], marker=MARKERS[kind], **look) for kind in kinds]
    return handles, [*labels, *(WORDS.get(kind, kind) for kind in kinds)]
