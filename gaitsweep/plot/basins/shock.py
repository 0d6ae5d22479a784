"""The minimal fatal shock of each start: the distance to the nearest start with another outcome."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from gaitsweep.analysis.basins.measures import basins
from gaitsweep.contract import Status
from gaitsweep.plot.basins.basin import basin
from gaitsweep.plot.columns import column, unit_of
from gaitsweep.plot.provenance_marks import marked


@marked
def shock(
    table: pd.DataFrame,
    *,
    x: str,
    y: str,
    hue: str = "gait",
    panels: str | None = None,
    title: str | None = None,
) -> Figure:
    """Cells coloured by their distance, along x and y, to the nearest start with another outcome.

    Args:
        table: a settle table, refined or not; a partial table is drawn as far as it goes.
        x, y: columns of the starts along the axes, in one unit.
        hue: column of the outcomes.
        panels: column; each of its values has a panel, measured separately.
        title: text above the figure.

    Raises:
        PlotError: the table does not have a column, or a cell has several rows.
        AnalysisError: x and y have different units.
    """
    for name in (x, y, hue, *([panels] if panels else [])):
        column(table, name)
    measured = basins(table, [x, y], label=hue, by=panels or ()).rows
    far = ~np.isfinite(measured["shock"].to_numpy(float))
    measured.loc[far, "shock"] = np.nan
    known = {"unit": unit_of(table, x), "symbol": r"\mathrm{smallest\ shock}", "circular": False}
    measured.attrs = {**table.attrs, "quantities": {**table.attrs.get("quantities", {}), "shock": known}}
    # failed starts have a shock too: the distance to one that does not fail
    measured["status"] = Status.settled.name
    return basin(measured, x=x, y=y, hue="shock", panels=panels, title=title)
