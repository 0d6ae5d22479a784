"""Branches of fixed points over a parameter, stable and unstable, with their bifurcations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any

import matplotlib as mpl
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pydantic import Field

from gaitsweep.near_miss import allowing
from gaitsweep.plot import theme
from gaitsweep.plot.arguments import Column, Observable, Title
from gaitsweep.plot.bifurcations.branch_lines import draw_branch, key, style_of_range
from gaitsweep.plot.columns import PlotError, column, described, moved_parameter, origin_of, require_columns
from gaitsweep.plot.kind import figure_kind
from gaitsweep.schema.numbers import Real, Text


@figure_kind("continuation")
def continuation(
    table: pd.DataFrame,
    *,
    y: Annotated[
        Observable | None, "observable of the model; by default the first coordinate of the map that is one"
    ] = None,
    x: str | None = None,
    hue: Annotated[
        Column | None, "column of another parameter that differs between branches, or of the gait"
    ] = None,
    intervals: Annotated[
        Mapping[Text, Annotated[Sequence[Real], Field(min_length=2, max_length=2)]],
        "ranges of the parameter to show beside the branches, [low, high] by name",
    ] = MappingProxyType({}),
    title: Title = None,
) -> Figure:
    """Branches over a parameter, solid where stable and dashed where unstable, with marked bifurcations.

    A thin dotted line crosses a corner or a jump of the map.

    Args:
        table: a continuation's table: of a job, or of `return_map(...).continue_`.
        y: the observable; by default the first coordinate of the map that is one, or the first of the table.
        x: the column of the parameter; by default that of the table's job.

    Raises:
        PlotError: the table lacks a column.
    """
    observables = [*table.attrs.get("recorded", ()), *(name for name in table if str(name).endswith("_n"))]
    if y is None and not observables:
        raise PlotError(f"The table names no observable: give y. {allowing(map(str, table.columns))}")
    name = column(table, y or observables[0], ("_n", ""))
    x = x or moved_parameter(table) or "parameter"
    require_columns(table, x, "row", "point", "stable", "special", hue)
    # the two directions in which a map follows a branch begin at one point
    of_branch = [key for key in ("row", "direction") if key in table]
    table = table.dropna(subset=[name]).sort_values([*of_branch, "point"], kind="stable")
    with theme.canvas(theme.COLUMN + 1.6, 3.4, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel(described(table, x))
        axes.set_ylabel(described(table, name, 36))
        if not len(table):
            theme.message(axes, "No row has a fixed point on a branch.")
            return figure
        colours = _colours(table, hue)
        origin = origin_of(table, name, table[name].to_numpy(float))
        for number, (low, high) in enumerate(intervals.values()):
            axes.axvspan(low, high, zorder=0, **style_of_range(number))
        for _, branch in table.groupby(of_branch, sort=True):
            draw_branch(axes, branch, x, name, colours.get(branch["row"].iloc[0]), origin=origin)
        theme.value_axis(axes, angle=origin is not None)
        gaits: list[Line2D] = []
        if hue is not None and _numbers(table, hue):
            shades = ScalarMappable(_span(table, hue), "viridis")
            figure.colorbar(shades, ax=axes, label=described(table, hue), shrink=0.85)
        elif hue is not None:
            gaits = _gait_key(table, hue)
        theme.legend(figure, [*gaits, *key(table, intervals, coloured=hue is not None)], ncols=2)
    return figure


def _gait_key(table: pd.DataFrame, hue: str) -> list[Line2D]:
    """The legend of the gaits of branches."""
    colours = theme.colours(theme.ordered(dict.fromkeys(_names(table, hue).values())))
    return [Line2D([], [], color=colour, lw=1.4, label=theme.named(gait)) for gait, colour in colours.items()]


def _numbers(table: pd.DataFrame, hue: str) -> bool:
    """Whether colours show numbers."""
    return bool(pd.api.types.is_numeric_dtype(table[hue]))


def _names(table: pd.DataFrame, hue: str) -> dict[Any, str]:
    """The most frequent value of `hue` among the records of each row."""
    return {row: str(branch[hue].astype(str).mode().iloc[0]) for row, branch in table.groupby("row")}


def _span(table: pd.DataFrame, hue: str) -> Normalize:
    """The range of the numbers that colours show."""
    values = table[hue].to_numpy(float)
    low, high = float(values.min()), float(values.max())
    return Normalize(low, high if high > low else low + 1.0)


def _colours(table: pd.DataFrame, hue: str | None) -> dict[Any, Any]:
    """A colour for each row, if colours show another parameter or the gait."""
    if hue is None:
        return {}
    if not _numbers(table, hue):
        names = _names(table, hue)
        colours = theme.colours(list(dict.fromkeys(names.values())))
        return {row: colours[name] for row, name in names.items()}
    shades = mpl.colormaps["viridis"]
    span = _span(table, hue)
    return {row: shades(span(float(branch[hue].iloc[0]))) for row, branch in table.groupby("row")}
