"""Measures of the planar quadruped's legs: their order, stances and flights, and their loads by the rule."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import pandas as pd

from gaitsweep.analyses import TURN, mean_direction
from gaitsweep.claims import Condition, MeasureError, masked, measure, numbers, records, stances, value
from gaitsweep.near_miss import suggestion
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import gaits_in
from gaitsweep.papers.fukuoka2015.analysis.loading_rule import load_prediction, loading_rule
from gaitsweep.papers.fukuoka2015.analysis.pair_loads import pairs_in
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import FLEXORS
from gaitsweep.papers.fukuoka2015.gait_measures import records_of_gait, rows_of_gait
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS, PAIRS, THRESHOLD, signs


@measure
def swing_order(table: pd.DataFrame, *, gait: str) -> str:
    """Order in which the legs of a gait begin to swing, from LF; legs within the threshold joined by +."""
    phases = records_of_gait(gaits_in(table), gait)[[f"phase_{leg}" for leg in LEGS]].to_numpy(float)
    return _most_frequent([_order(dict(zip(LEGS, of_row, strict=True))) for of_row in phases.tolist()])


@measure
def footfall_order(table: pd.DataFrame, *, gait: str) -> str:
    """Order in which the feet touch down in a gait, named by its swings; as `swing_order`."""
    return _most_frequent([_order(_footfalls(part)) for part in rows_of_gait(table, gait)])


@measure
def flight_between(table: pd.DataFrame, *, gait: str, legs: Sequence[str]) -> float:
    """Share of the time in a gait with no foot on the ground, between the stances of two legs (1).

    Args:
        table: a trace.
        gait: one of the nine.
        legs: names of the two legs; either may stand first.
    """
    one, other = (LEGS.index(leg) for leg in legs)
    shares = []
    for part in rows_of_gait(table, gait):
        down = part[[f"F_{leg}" for leg in LEGS]].to_numpy(float) > 0.0
        turns = np.diff(down.any(axis=1).astype(int))
        lifts, lands = np.flatnonzero(turns < 0), np.flatnonzero(turns > 0)
        samples = 0  # without a foot on the ground, between the two legs
        for lift in lifts:
            if not (lands > lift).any():
                continue
            land = lands[lands > lift][0]
            before, after = down[lift], down[land + 1]
            if (before[one] and after[other]) or (before[other] and after[one]):
                samples += land - lift
        shares.append(samples / len(part))
    return float(np.mean(shares))


@measure
def loaded_longer(table: pd.DataFrame, *, gait: str) -> list[float]:
    """Share of the cycle by which each pair's hind foot is loaded longer than its fore foot in a gait (1)."""
    trace = pd.concat(rows_of_gait(table, gait))
    return [
        float(np.mean(numbers(trace, f"F_{hind}") > 0.0) - np.mean(numbers(trace, f"F_{fore}") > 0.0))
        for fore, hind in PAIRS
    ]


@measure
def stance_ratio(table: pd.DataFrame, *, where: Condition, to: Condition) -> float:
    """Mean duration of stance in the rows of one condition, over that in the rows of another (1).

    Args:
        table: a trace.
        where, to: the two conditions.
    """
    return _stance_time(records(table, where)) / _stance_time(records(table, to))


@measure
def chart_order(*, gait: str) -> str:
    """Order in which the legs of a gait begin to swing by the rule, from LF; legs in phase joined by +."""
    phases = {}
    for middle, sign, (fore, hind) in zip((0.0, 0.5), signs(gait), PAIRS, strict=True):
        # both legs are shifted alike, in opposite directions (Fig. 5a)
        phases |= {fore: middle - 0.125 * sign, hind: middle + 0.125 * sign}
    return _order(phases)


def _footfalls(part: pd.DataFrame) -> dict[str, float]:
    """Lags of the legs' touchdowns behind those of LF in one row of a trace, cycles."""
    t = part["t"].to_numpy(float)
    lands = {}
    for leg in LEGS:
        # the first stance may have begun before the trace
        lands[leg] = t[stances(t, part[f"F_{leg}"].to_numpy(float) > 0.0)[1:, 0]]
        if len(lands[leg]) < 2:
            raise MeasureError(f"{leg} touches down fewer than two times.")
    turns = TURN / float(np.median(np.diff(lands["LF"])))
    after = {leg: (times[:, None] - lands["LF"][None]).ravel() for leg, times in lands.items()}
    return {leg: float(mean_direction(turns * lag)) / TURN for leg, lag in after.items()}


def _most_frequent(orders: list[str]) -> str:
    """The most frequent order."""
    return max(orders, key=orders.count)


def _stance_time(trace: pd.DataFrame) -> float:
    """Mean duration of stance (s)."""
    period = gaits_in(trace).set_index("row")["period"].to_dict()
    times = [
        period[row] * np.mean(samples[list(FLEXORS.values())].to_numpy(float) <= 0.0)
        for row, samples in trace.groupby("row")
    ]
    return float(np.mean(times))


def _order(phases: dict[str, float]) -> str:
    """The legs in the order of their phases (cycles), from LF; both legs of a pair in phase are joined."""
    mates = dict(PAIRS) | {hind: fore for fore, hind in PAIRS}

    def after(leg: str) -> float:
        ahead = (phases[leg] - phases["LF"]) % 1.0
        # a leg that swings with LF may be slightly before it
        return ahead - 1.0 if leg == mates["LF"] and ahead > 1.0 - THRESHOLD else ahead

    legs = sorted(LEGS, key=after)
    steps: list[str] = []
    while legs:
        leg = legs.pop(0)
        mate = mates[leg]
        lag = abs((phases[leg] - phases[mate] + 0.5) % 1.0 - 0.5)
        if mate in legs and lag <= THRESHOLD:
            legs.remove(mate)
            steps.append("+".join(sorted((leg, mate))))
        else:
            steps.append(leg)
    first = next(i for i, step in enumerate(steps) if "LF" in step)
    return "-".join(steps[first:] + steps[:first])


@measure
def rule_agreement(table: pd.DataFrame, *, measure: str, where: Condition | None = None) -> float:
    """Share of the pairs whose load or pitch has the sign of the rule (1).

    Args:
        table: as for `pairs_in`.
        measure: one of `MEASURES`.
        where: a condition that selects records.
    """
    return _right(loading_rule(records(table, where)), measure)


@measure
def foretold(table: pd.DataFrame, *, measure: str) -> float:
    """Share of walks with the sign that a load or pitch of the trot without feedback foretells (1).

    Args:
        table: as for `load_prediction`.
        measure: one of `MEASURES`.
    """
    return _right(loading_rule(load_prediction(table)), measure)


def _right(judged: pd.DataFrame, measure: str) -> float:
    """The share of right signs of one measure in a result of `loading_rule`; refuses one that it lacks."""
    of_measure = masked(judged, judged["measure"] == measure)
    if of_measure.empty:
        known = judged["measure"].astype(str).unique()
        raise MeasureError(f"The loading rule has no measure {measure}{suggestion(measure, known)}")
    return value(of_measure, column="right")


@measure
def pair_measure(table: pd.DataFrame, *, gait: str, pair: Literal[1, 2], measure: str) -> float:
    """Mean load, fore less hind (N), pitch, nose down (rad), or shift (cycles) of a pair in a gait.

    Args:
        table: as for `pairs_in`.
        gait: one of the nine.
        pair: 1 (RF and LH) or 2 (LF and RH).
        measure: a column of `pairs_in`.
    """
    of_gait = records_of_gait(pairs_in(table), gait)
    return value(of_gait, column=measure, where=f"pair_number == {pair}", take="mean")


@measure
def pairs_measure(table: pd.DataFrame, *, gait: str, measure: str) -> list[float]:
    """The `pair_measure` of each of the two pairs."""
    first = pair_measure(table, gait=gait, pair=1, measure=measure)
    return [first, pair_measure(table, gait=gait, pair=2, measure=measure)]


@measure
def late_tilt(table: pd.DataFrame, *, gait: str) -> list[float]:
    """Pitch of each pair's late stance in a gait, nose down, over the range of the pitch (1)."""
    pitch_range = float(np.mean([np.ptp(numbers(part, "pitch")) for part in rows_of_gait(table, gait)]))
    return [tilt / pitch_range for tilt in pairs_measure(table, gait=gait, measure="tilt_late")]


@measure
def pair_ratio(
    table: pd.DataFrame, *, gait: str, pair: Literal[1, 2], to: Literal[1, 2], measure: str
) -> float:
    """Size of the `pair_measure` of one pair, over that of the other (1).

    Args:
        table, gait, measure: as for `pair_measure`.
        pair, to: numbers of the two pairs.
    """
    size = abs(pair_measure(table, gait=gait, pair=pair, measure=measure))
    return size / abs(pair_measure(table, gait=gait, pair=to, measure=measure))
