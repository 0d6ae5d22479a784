"""Measures of the gaits in which starts end, and of their distance from the analytic solutions."""

from __future__ import annotations

import numpy as np
import pandas as pd

from gaitsweep.claims import Condition, masked, measure, numbers, records, value
from gaitsweep.papers.ambe2021.analysis.gait_shares import gait_shares
from gaitsweep.papers.ambe2021.theory.gaits import GAITS, WAVES


@measure
def three_gaits(table: pd.DataFrame, *, where: Condition | None = None) -> float:
    """Share of the sets of parameters at which all three gaits occur, among those of a condition (1).

    Args:
        where: a condition over the columns of `gait_shares`, such as `conditions`.
    """
    chosen = records(gait_shares(table), where)
    return float(np.mean((np.asarray(chosen[list(WAVES)]) > 0.0).all(axis=1)))


@measure
def no_gaits(table: pd.DataFrame, *, where: Condition, less: Condition) -> float:
    """Share of sets of parameters without any of the three gaits: of one condition minus of another (1)."""
    shares = gait_shares(table)
    one, other = (
        float(np.mean((np.asarray(records(shares, condition)[list(WAVES)]) == 0.0).all(axis=1)))
        for condition in (where, less)
    )
    return one - other


@measure
def gaits_left(table: pd.DataFrame, *, where: Condition) -> list[str]:
    """The gaits in which the settled rows of a condition end, in the order of the gaits."""
    ends = set(records(records(table, where), "status == 'settled'")["gait"].astype(str))
    return [gait for gait in GAITS if gait in ends]


@measure
def distance_share(table: pd.DataFrame) -> float:
    """Largest distance from the analytic solutions as a share of 2 pi (%)."""
    return float(100.0 * numbers(table, "distance").max() / (2 * np.pi))


@measure
def distance_over_lag(table: pd.DataFrame, *, low: float, high: float) -> float:
    """Largest distance from the analytic solutions at one tau over that at another (1)."""
    at_low, at_high = (
        value(masked(table, table["tau"] == tau), column="distance", where="status == 'settled'", take="max")
        for tau in (low, high)
    )
    return at_low / at_high
