"""Figures of shocks: recovery from pushes, and the smallest shock after which a start has another outcome."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from gaitsweep.analysis.basins.measures import basins, least_fatal_push, require_one_unit
from gaitsweep.engine.pushed_model import PREFIX
from gaitsweep.plot.arguments import (
    TEXT_COLUMNS,
    AlongAxis,
    Column,
    Horizontal,
    Panels,
    Shares,
    Title,
    Vertical,
)
from gaitsweep.plot.basins.basin import basin
from gaitsweep.plot.basins.cells import check_cells
from gaitsweep.plot.column_labels import unit_of
from gaitsweep.plot.columns import require_columns, rows_where
from gaitsweep.plot.kind import PlannedTable, Refusal, figure_kind
from gaitsweep.status import Outcome, Status


@figure_kind("perturb", check=check_cells)
def recovery(
    table: pd.DataFrame,
    *,
    x: Horizontal,
    y: Vertical,
    panels: Panels = None,
    shares: Shares = True,
    title: Title = None,
) -> Figure:
    """Cells coloured by whether a row recovers from its push, with the share of each outcome.

    A row that settles in another gait has the colour of that gait, if the gait has a name. Where both axes
    are amounts of one unit, a star marks the least push after which the gait is lost.

    Args:
        table: a table of pushed rows, complete or partial.

    Raises:
        PlotError: the table lacks a column, or a cell has several rows.
    """
    require_columns(table, x, y, panels, "recovery")
    dtype = table["recovery"].dtype
    names = table["recovery"].astype(object)
    if {"gait", "gait_before"} <= set(table.columns):
        gait, before = (table[name].astype(object) for name in ("gait", "gait_before"))
        in_other_gait = (names == "elsewhere") & gait.notna() & (gait != before) & (gait != Outcome.NO_GAIT)
        names = names.where(~in_other_gait, gait)
    categories = list(map(str, dtype.categories)) if isinstance(dtype, pd.CategoricalDtype) else []
    order = [*categories, *sorted(set(names.dropna()) - set(categories))]
    shown = table.assign(recovery=pd.Categorical(names, order), outcome=np.asarray(names, object))
    # the statuses of the rows are in the names already
    shown.attrs = {**table.attrs, "outcome_of": "recovery"}
    figure = basin(shown, x=x, y=y, hue="recovery", panels=panels, shares=shares, title=title)
    if x.startswith(PREFIX) and y.startswith(PREFIX) and unit_of(table, x) == unit_of(table, y) != "":
        _mark_least(figure, table, x, y, panels)
    return figure


def _mark_least(figure: Figure, table: pd.DataFrame, x: str, y: str, panels: str | None) -> None:
    """Draw a star at the least fatal push of each panel, and a line to it from no push."""
    least = least_fatal_push(table, [x, y], panels or ())
    values = sorted(table[panels].dropna().unique()) if panels else [None]
    for axes, value in zip(figure.axes, values, strict=False):
        of_panel = least if value is None else rows_where(least, least[panels] == value)
        for across, up in of_panel[[x, y]].to_numpy(float):
            axes.plot([0.0, across], [0.0, up], color="black", lw=0.8, zorder=4)
            look: dict[str, Any] = {"marker": "*", "color": "white", "mec": "black", "ms": 9.0, "zorder": 5}
            axes.plot([across], [up], **look)


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refuse axes of different units, between which there is no distance."""
    units = {column: table.unit(column) for column in (figure.x, figure.y)}
    if not TEXT_COLUMNS & set(units) and len(set(units.values())) > 1:
        named = " and ".join(f"{column} in {unit or '1'}" for column, unit in units.items())
        yield ("y",), f"is {figure.y}, but a shock is a distance and needs equal units: {named}."
    else:
        yield from check_cells(figure, table)


@figure_kind("settle", "fixed_time", check=_check, coloured="none")
def shock(
    table: pd.DataFrame,
    *,
    x: Horizontal,
    y: Annotated[AlongAxis, "column along the vertical axis, in the unit of x"],
    hue: Annotated[Column, "column of the outcomes of starts"] = "gait",
    panels: Panels = None,
    title: Title = None,
) -> Figure:
    """Cells coloured by their distance, along x and y, to the nearest start with another outcome.

    Args:
        table: a settle table, refined or not, complete or partial.

    Raises:
        PlotError: the table lacks a column, or a cell has several rows.
        AnalysisError: x and y have different units.
    """
    require_columns(table, x, y, hue, panels)
    require_one_unit(table, [x, y])
    if not len(table):
        return basin(table.assign(shock=np.nan), x=x, y=y, hue="shock", panels=panels, title=title)
    measured = basins(table, [x, y], label=hue, by=panels or ()).rows
    measured.loc[~np.isfinite(measured["shock"].to_numpy(float)), "shock"] = np.nan
    quantity = {"unit": unit_of(table, x), "symbol": r"\mathrm{smallest\ shock}", "circular": False}
    measured.attrs = {**table.attrs, "quantities": {**table.attrs.get("quantities", {}), "shock": quantity}}
    # failed starts have a shock too: the distance to one that does not fail
    measured["status"] = Status.settled.name
    return basin(measured, x=x, y=y, hue="shock", panels=panels, title=title)
