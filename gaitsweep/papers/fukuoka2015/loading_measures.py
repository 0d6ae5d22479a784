"""Measures of the rule of leg loading: loads and pitch of the planar quadruped's diagonal pairs."""

from __future__ import annotations

import numpy as np
import pandas as pd

from gaitsweep.claims import Condition, measure, records
from gaitsweep.papers.fukuoka2015.analysis.loading_rule import load_prediction, loading_rule
from gaitsweep.papers.fukuoka2015.analysis.pair_loads import pairs_in
from gaitsweep.papers.fukuoka2015.gait_measures import records_of_gait, rows_of_gait


@measure
def rule_agreement(
    table: pd.DataFrame, *, measure: str, what: str = "right", where: Condition | None = None
) -> float:
    """Agreement of a load or pitch with the rule: share of right signs, or r with the shift (1)."""
    judged = loading_rule(records(table, where)).set_index("measure")
    return float(judged.loc[measure, what])


@measure
def foretold(table: pd.DataFrame, *, measure: str) -> float:
    """Share of walks with the sign that a load or pitch of the trot without feedback foretells (1)."""
    return float(loading_rule(load_prediction(table), repeats=()).set_index("measure").loc[measure, "right"])


@measure
def pair_measure(
    table: pd.DataFrame, *, gait: str, pair: int, measure: str, where: Condition | None = None
) -> float:
    """Mean load, fore less hind (N), pitch, nose down (rad), or shift (cycles) of a pair in a gait."""
    pairs = records_of_gait(pairs_in(records(table, where)), gait)
    return float(pairs.loc[pairs["pair_number"] == pair, measure].mean())


@measure
def pairs_measure(table: pd.DataFrame, *, gait: str, measure: str) -> list[float]:
    """The `pair_measure` of each of the two pairs."""
    return [pair_measure(table, gait=gait, pair=pair, measure=measure) for pair in (1, 2)]


@measure
def late_tilt(table: pd.DataFrame, *, gait: str) -> list[float]:
    """Pitch of each pair's late stance in a gait, nose down, over the range of the pitch (1)."""
    nods = float(np.mean([np.ptp(part["pitch"].to_numpy(float)) for part in rows_of_gait(table, gait)]))
    return [tilt / nods for tilt in pairs_measure(table, gait=gait, measure="tilt_late")]


@measure
def pair_ratio(table: pd.DataFrame, *, gait: str, pair: int, to: int, measure: str) -> float:
    """Size of the `pair_measure` of one pair, over that of the other (1)."""
    own, other = (abs(pair_measure(table, gait=gait, pair=p, measure=measure)) for p in (pair, to))
    return own / other
