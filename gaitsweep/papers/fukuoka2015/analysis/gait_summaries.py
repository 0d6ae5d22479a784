"""Summaries of the gaits in a table: measures, repertoires of parameter sets, effect of the threshold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.analyses import AnalysisError, axes_of, require
from gaitsweep.contract import Status
from gaitsweep.papers.fukuoka2015.analysis.loading_rule import REPEATS
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART

MEASURES = (
    "speed", "period", "flight", "pitch_range", "pitch_mean", "power_hip", "power_knee", "cost_of_transport",
    "delta_1_mean", "delta_2_mean", "delta_1_touchdown", "delta_2_touchdown", "margin",
)  # fmt: skip

# The gaits and mirror images of each kind; slow kinds first.
KINDS = {
    "walk": ("L-walk", "D-walk"),
    "trot": ("trot",),
    "canter": ("R-canter", "L-canter"),
    "unusual": ("uR-canter", "uL-canter"),
    "gallop": ("RT-gallop", "LT-gallop"),
}


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
    columns = {name: name if name in table.columns else f"{name}_end" for name in MEASURES}
    names = {column: name for name, column in columns.items() if column in table.columns}
    if not names:
        raise AnalysisError(f"The table has none of {', '.join(MEASURES)} where its rows end.")
    stood = table.loc[table["status"].astype(str) != "fell"]
    groups = stood.assign(gait=stood["gait"].astype(str)).groupby([*axes, "gait"], dropna=False)
    medians = groups[list(names)].median().rename(columns=names)
    medians.insert(0, "rows", groups.size())
    return medians.reset_index()


def repertoire(
    table: pd.DataFrame, sets: Sequence[str], *, gait: str = "gait", speed: str = "speed_end"
) -> pd.DataFrame:
    """Count the gaits of each parameter set: one record for each set, in the order of the table.

    Columns: the `sets` themselves; `rows`; `fell`; `unsteady`; a count for each of the nine gaits; `gaits`,
    how many of the nine there are; `speed_walk` and so on, the median speed (m/s) of each of `KINDS`;
    `in_order`: walk, trot, canter and gallop are all there and their median speeds rise.

    Args:
        table: a hold or settle table.
        sets: the columns that define a parameter set.
        gait: the column of gaits.
        speed: the column of speeds, m/s.

    Raises:
        AnalysisError: the table does not have a column.
    """
    require(table, *sets, gait, speed, "status")
    keys = list(sets)
    fell = Status.FAILED.among(table["status"])
    name = np.where(fell, "", table[gait].astype(str))
    number = table.groupby(keys, sort=False, observed=True).ngroup().to_numpy()
    count = int(number.max(initial=-1)) + 1
    counts = pd.DataFrame(table.drop_duplicates(keys)[keys]).reset_index(drop=True)
    counts["rows"] = np.bincount(number, minlength=count)
    counts["fell"] = np.bincount(number[fell], minlength=count)
    for gait_name in ("unsteady", *CHART):
        counts[gait_name] = np.bincount(number[name == gait_name], minlength=count)
    counts["gaits"] = (counts[list(CHART)] > 0).sum(axis=1)
    for kind, members in KINDS.items():
        shown = np.isin(name, members)
        medians = table.loc[shown, speed].groupby(number[shown]).median()
        counts[f"speed_{kind}"] = medians.reindex(range(count)).to_numpy()
    speeds = counts[[f"speed_{kind}" for kind in ("walk", "trot", "canter", "gallop")]].to_numpy()
    return counts.assign(in_order=np.all(np.diff(speeds, axis=1) > 0.0, axis=1))
