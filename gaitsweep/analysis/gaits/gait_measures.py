"""Speed, period, flight, pitch and mechanical cost of transport of each gait, from where rows end."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from gaitsweep.analysis.gaits.loading_rule import REPEATS
from gaitsweep.analysis.records import AnalysisError, axes_of, require

MEASURES = (
    "speed",
    "period",
    "flight",
    "pitch_range",
    "pitch_mean",
    "power_hip",
    "power_knee",
    "cost_of_transport",
)


def gait_measures(table: pd.DataFrame, by: Sequence[str] | None = None) -> pd.DataFrame:
    """The median measures of each gait at each set of the swept axes.

    Args:
        table: a fixed_time or settle table of a model with gaits.
        by: the columns whose values are kept apart, besides the gait; by default the swept axes but
            repetitions (seed, pair, scatter).

    Returns:
        One record for each set and gait: by, gait, rows, and the medians of those of `MEASURES` that the
        table has: speed (m/s), period (s), flight (share of a cycle), pitch_range and pitch_mean (rad),
        power_hip and power_knee (W), cost_of_transport (1). Rows that fell are left out.

    Raises:
        AnalysisError: the table does not have a column, or none of the measures.
    """
    require(table, "gait", "status")
    axes = [name for name in axes_of(table) if name not in REPEATS] if by is None else list(by)
    require(table, *axes)
    names = {f"{name}_end": name for name in MEASURES if f"{name}_end" in table.columns}
    if not names:
        raise AnalysisError(f"The table has none of {', '.join(MEASURES)} where its rows end.")
    stood = table.loc[table["status"].astype(str) != "fell"]
    groups = stood.assign(gait=stood["gait"].astype(str)).groupby([*axes, "gait"], dropna=False)
    found = groups[list(names)].median().rename(columns=names)
    found.insert(0, "rows", groups.size())
    return found.reset_index()
