"""The minimal fatal shock of each start: the distance to the nearest start with another outcome."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from gaitsweep.analysis.basins.measures import basins
from gaitsweep.plot.arguments import TEXT_COLUMNS, AlongAxis, Column, Horizontal, Panels, Title
from gaitsweep.plot.basins.basin import basin
from gaitsweep.plot.basins.cells import check_cells
from gaitsweep.plot.column_labels import unit_of
from gaitsweep.plot.columns import require_columns
from gaitsweep.plot.kind import PlannedTable, Refusal, figure_kind
from gaitsweep.status import Status


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
    if not len(table):
        return basin(table.assign(shock=np.nan), x=x, y=y, hue="shock", panels=panels, title=title)
    measured = basins(table, [x, y], label=hue, by=panels or ()).rows
    measured.loc[~np.isfinite(measured["shock"].to_numpy(float)), "shock"] = np.nan
    quantity = {"unit": unit_of(table, x), "symbol": r"\mathrm{smallest\ shock}", "circular": False}
    measured.attrs = {**table.attrs, "quantities": {**table.attrs.get("quantities", {}), "shock": quantity}}
    # failed starts have a shock too: the distance to one that does not fail
    measured["status"] = Status.settled.name
    return basin(measured, x=x, y=y, hue="shock", panels=panels, title=title)
