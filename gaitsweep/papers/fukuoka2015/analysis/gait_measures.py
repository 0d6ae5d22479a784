"""Speed, period, flight, pitch, cost of transport and shifts of each gait, from where rows end."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from gaitsweep.analyses import AnalysisError, axes_of, require
from gaitsweep.papers.fukuoka2015.analysis.loading_rule import REPEATS

MEASURES = (
    "speed", "period", "flight", "pitch_range", "pitch_mean", "power_hip", "power_knee", "cost_of_transport",
    "delta_1_mean", "delta_2_mean", "delta_1_touchdown", "delta_2_touchdown", "margin",
)  # fmt: skip


def gait_measures(table: pd.DataFrame, by: Sequence[str] | None = None) -> pd.DataFrame:
    """The median measures of each gait at each set of the swept axes.

    Args:
        table: a fixed_time or settle table of a model with gaits.
        by: the columns to group by, besides the gait; by default the swept axes but
            repetitions (seed, pair, scatter).

    Returns:
        One record for each set and gait: by, gait, rows, and the medians of those of `MEASURES` that the
        table has: speed (m/s), period (s), flight (share of a cycle), pitch_range and pitch_mean (rad),
        power_hip and power_knee (W), cost_of_transport (1), the pairs' shifts delta_1_mean, delta_2_mean and
        those by touchdowns, and the margin to the next label (cycles). Rows that fell are left out.

    Raises:
        AnalysisError: the table does not have a column, or none of the measures.
    """
    require(table, "gait", "status")
    axes = [name for name in axes_of(table) if name not in REPEATS] if by is None else list(by)
    axes = [name for name in axes if name != "gait"]
    require(table, *axes)
    # a label's field has no suffix
    read = {name: name if name in table.columns else f"{name}_end" for name in MEASURES}
    names = {column: name for name, column in read.items() if column in table.columns}
    if not names:
        raise AnalysisError(f"The table has none of {', '.join(MEASURES)} where its rows end.")
    stood = table.loc[table["status"].astype(str) != "fell"]
    groups = stood.assign(gait=stood["gait"].astype(str)).groupby([*axes, "gait"], dropna=False)
    found = groups[list(names)].median().rename(columns=names)
    found.insert(0, "rows", groups.size())
    return found.reset_index()
