"""The repertoire of gaits of each parameter set in a table with many starts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.analyses import require
from gaitsweep.contract import Status
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART

# The gaits and mirror images of each kind; slow kinds first.
KINDS = {
    "walk": ("L-walk", "D-walk"),
    "trot": ("trot",),
    "canter": ("R-canter", "L-canter"),
    "unusual": ("uR-canter", "uL-canter"),
    "gallop": ("RT-gallop", "LT-gallop"),
}


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
    found = pd.DataFrame(table.drop_duplicates(keys)[keys]).reset_index(drop=True)
    found["rows"] = np.bincount(number, minlength=count)
    found["fell"] = np.bincount(number[fell], minlength=count)
    for each in ("unsteady", *CHART):
        found[each] = np.bincount(number[name == each], minlength=count)
    found["gaits"] = (found[list(CHART)] > 0).sum(axis=1)
    for kind, members in KINDS.items():
        shown = np.isin(name, members)
        medians = table.loc[shown, speed].groupby(number[shown]).median()
        found[f"speed_{kind}"] = medians.reindex(range(count)).to_numpy()
    speeds = np.stack([found[f"speed_{kind}"] for kind in ("walk", "trot", "canter", "gallop")], axis=1)
    return found.assign(in_order=np.all(np.diff(speeds, axis=1) > 0.0, axis=1))
