"""Branches of fixed points over a parameter, stable and unstable, with their bifurcations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pydantic import Field

from gaitsweep.plot import theme
from gaitsweep.plot.arguments import Column, Observable, Title
from gaitsweep.plot.bifurcations import branch_lines
from gaitsweep.plot.bifurcations.branch_lines import draw_branch, style_of_range
from gaitsweep.plot.column_labels import described, symbol
from gaitsweep.plot.columns import PlotError, branch_parameter, origin_of, recorded_column, require_columns
from gaitsweep.plot.kind import figure_kind
from gaitsweep.schema.numbers import Real, Text


@figure_kind("continuation")
def continuation(
    table: pd.DataFrame,
    *,
    y: Annotated[
        Observable | None, "observable of the model; by default the first coordinate of the map that is one"
    ] = None,
    x: str | None = None,  # no field of a job, whose run moves one parameter
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
        PlotError: the table lacks a column, or a range is not two numbers.
    """
    for label, ends in intervals.items():
        if len(ends) != 2:
            raise PlotError(f"intervals.{label} has {len(ends)} numbers, but must be [low, high].")
    name = recorded_column(table, y)
    x = x or branch_parameter(table)
    require_columns(table, x, "row", "point", "stable", "special", hue)
    # the two directions in which a map follows a branch begin at one point
    of_branch = [name_of_part for name_of_part in ("row", "direction") if name_of_part in table]
    table = table.dropna(subset=[name]).sort_values([*of_branch, "point"], kind="stable")
    with theme.canvas(theme.COLUMN + 1.6, 3.4, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel(described(table, x))
        axes.set_ylabel(described(table, name, 36))
        if not len(table):
            theme.message(axes, "No row has a fixed point on a branch.")
            return figure
        colours, hue_key = _colours_of_rows(figure, axes, table, hue)
        origin = origin_of(table, name, table[name].to_numpy(float))
        for number, (low, high) in enumerate(intervals.values()):
            axes.axvspan(low, high, zorder=0, **style_of_range(number))
        for _, branch in table.groupby(of_branch, sort=True):
            draw_branch(axes, branch, x, name, colours.get(branch["row"].iloc[0]), origin=origin)
        theme.value_axis(axes, angle=origin is not None)
        of_branches = branch_lines.key(table, intervals, coloured=hue is not None)
        theme.legend(figure, [*hue_key, *of_branches], ncols=2)
    return figure


def _colours_of_rows(
    figure: Figure, axes: Axes, table: pd.DataFrame, hue: str | None
) -> tuple[dict[Any, Any], list[Line2D]]:
    """A colour for each row by the column `hue`, and the handles of the legend that name these colours.

    Numbers have a colour bar, which is drawn here, and names are the most frequent of a row. A row without a
    number or a name is grey.
    """
    if hue is None:
        return {}, []
    grey = theme.COLOURS["none"]
    without_hue = Line2D([], [], color=grey, lw=1.4, label=f"no {symbol(table, hue)}")
    rows = table.groupby("row")[hue]
    if not pd.api.types.is_numeric_dtype(table[hue]):
        modes = {row: names.dropna().astype(str).mode() for row, names in rows}
        name_of_row = {row: mode.iloc[0] for row, mode in modes.items() if len(mode)}
        colours = theme.colours(theme.ordered(dict.fromkeys(name_of_row.values())))
        handles = [
            Line2D([], [], color=colour, lw=1.4, label=theme.named(name)) for name, colour in colours.items()
        ]
        if len(name_of_row) < len(modes):
            handles.append(without_hue)
        named = {row: colours[name] for row, name in name_of_row.items()}
        return dict.fromkeys(modes, grey) | named, handles
    numbers = rows.first()  # the first of a row that is not NaN
    values = numbers.to_numpy(float)
    has_number = ~np.isnan(values)
    colours_of_rows: dict[Any, Any] = dict.fromkeys(numbers.index, grey)
    if has_number.any():
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        shades = ScalarMappable(Normalize(low, high if high > low else low + 1.0), "viridis")
        figure.colorbar(shades, ax=axes, label=described(table, hue), shrink=0.85)
        of_numbers = map(tuple, shades.to_rgba(values[has_number]))
        colours_of_rows |= dict(zip(numbers.index[has_number], of_numbers, strict=True))
    if has_number.all():
        return colours_of_rows, []
    return colours_of_rows, [without_hue]
