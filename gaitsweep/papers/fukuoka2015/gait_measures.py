"""Measures of the planar quadruped: its equations and constants, its gaits, its legs and their loads."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Annotated, Literal

import jax.numpy as jnp
import numpy as np
import pandas as pd
from pydantic import AfterValidator

from gaitsweep import ArgumentError
from gaitsweep.analyses import TURN, is_circular, mean_direction, require, wrapped_difference
from gaitsweep.claims import (
    Condition,
    MeasureError,
    default_values,
    masked,
    measure,
    numbers,
    one_row,
    records,
    stances,
    value,
)
from gaitsweep.dynamics.matsuoka import EXTENSOR, FLEXOR, leg_feedback
from gaitsweep.near_miss import suggestion
from gaitsweep.papers.fukuoka2015.analysis.gait_bouts import body_oscillation
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import cases_of, gaits_in
from gaitsweep.papers.fukuoka2015.analysis.loading_rule import load_prediction, loading_rule, pairs_in
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import FLEXORS, GAITS
from gaitsweep.papers.fukuoka2015.planar_quadruped.mechanics import HIP, KNEE
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import (
    CHART,
    LEGS,
    PAIRS,
    THRESHOLD,
    family,
    signs,
)
from gaitsweep.papers.fukuoka2015.planar_quadruped.rhythm import ACROSS, BESIDE, Motors, swinging

# Largest deviation of the times between touchdowns from one cycle, where a foot lands once a cycle; its share
_CYCLE_TOLERANCE = 0.2


def _known_gait(name: str) -> str:
    """The name of a gait unchanged, for a claim's arguments; raises ArgumentError for another name."""
    if name not in GAITS:
        raise ArgumentError(f"{name} is not a gait{suggestion(name, GAITS)}")
    return name


# The name of a gait; a claim's is checked when its list is read.
Gait = Annotated[str, AfterValidator(_known_gait)]
Leg = Literal["LF", "LH", "RF", "RH"]


@measure
def total_mass() -> float:
    """Mass of the torso and four legs (kg)."""
    names = [f"{part}_mass" for part in ("torso", "upper", "lower", "foot")]
    torso, *leg = default_values(model="planar_quadruped", names=names)
    return torso + len(LEGS) * sum(leg)


@measure
def motors() -> float:
    """Number of driven joints (1)."""
    return float(len(HIP) + len(KNEE))


@measure
def motor_targets() -> list[float]:
    """Forces of hip (N m) and knee (N) at the targets of swing and of stance, in these phases."""
    names = [field.name for field in dataclasses.fields(Motors)]
    values = dict(zip(names, default_values(model="planar_quadruped", names=names), strict=True))
    driven = Motors(**{name: jnp.asarray(value) for name, value in values.items()})
    forces = []
    for phase, active in (("sw", 1.0), ("st", -1.0)):
        swings = swinging(jnp.full((2, len(LEGS)), active))
        at = [jnp.full(len(LEGS), values[f"{name}_{phase}"]) for name in ("theta", "l")]
        forces += [float(jnp.abs(force).max()) for force in driven.forces(swings, *at)]
    return forces


@measure
def load_feedback(*, F: float, k2: float) -> list[float]:
    """Feedback of a load F (N) to extensor and flexor, over -k2 F (1)."""
    theta = jnp.zeros(len(LEGS))
    inputs = leg_feedback(theta, jnp.full(len(LEGS), F), theta0=0.0, k1=0.0, k2=k2)
    return [float(inputs[half][0]) / (-k2 * F) + 0.0 for half in (EXTENSOR, FLEXOR)]


@measure
def diagonal_links() -> float:
    """Number of links between the legs of the diagonal pairs (1)."""
    between = ACROSS + BESIDE
    return float(sum(between[LEGS.index(fore), LEGS.index(hind)] for fore, hind in PAIRS))


@measure
def gait_share(
    table: pd.DataFrame, *, gaits: Sequence[Gait], where: Condition | None = None, begin: float = -math.inf
) -> float:
    """Share of the rows with one of the gaits, by their swing onsets (1).

    Args:
        table: as for `gaits_in`.
        gaits: names of the gaits.
        where: a condition that selects rows.
        begin: the time from which on onsets count, s.
    """
    shown = gaits_in(records(table, where), window=(begin, math.inf))
    return float(np.mean(shown["gait"].isin(gaits).to_numpy()))


@measure
def gaits_shown(table: pd.DataFrame, *, speeds: int = 1) -> float:
    """Number of the nine gaits that occur in at least a given number of cases (1).

    Args:
        table: as for `gaits_in`.
        speeds: the least number of combinations of the swept parameters, without repetitions, at which a gait
            occurs; in a sweep of speed alone, of speeds.
    """
    shown = gaits_in(table)
    cases = shown.loc[shown["gait"].isin(CHART)].drop_duplicates(["gait", *cases_of(table)])
    return float((cases["gait"].astype(str).value_counts() >= speeds).sum())


@measure
def nearest_speed(table: pd.DataFrame, *, gait: Gait, speed: float, where: Condition | None = None) -> float:
    """Speed nearest to a given one at which a row has the gait at its end (m/s).

    Args:
        table: a settle table.
        gait: one of the nine.
        speed: the given speed, m/s.
        where: a condition that selects rows.

    Raises:
        MeasureError: no row with the gait has a speed.
    """
    require(table, "gait", "speed_end")
    speeds = numbers(records_of_gait(records(table, where), gait), "speed_end")
    speeds = speeds[np.isfinite(speeds)]
    if not speeds.size:
        raise MeasureError(f"No row with the gait {gait} has a speed.")
    return float(speeds[np.abs(speeds - speed).argmin()])


@measure
def speed_gap(
    table: pd.DataFrame, *, slow: Sequence[str], fast: Sequence[str], where: Condition | None = None
) -> float:
    """Least speed of the fast families of gaits less the largest speed of the slow ones (m/s).

    Args:
        table: a settle table.
        slow, fast: names of families.
        where: a condition that selects rows.

    Raises:
        MeasureError: one side has no row with a speed.
    """
    part = records(table, where)
    require(part, "gait", "speed_end")
    families = part["gait"].astype(str).map(family)

    def speeds_of(names: Sequence[str]) -> pd.Series:
        speeds = part.loc[families.isin(names), "speed_end"].dropna()
        if speeds.empty:
            raise MeasureError(f"No row with a gait of the family {' or '.join(names)} has a speed.")
        return speeds

    return float(speeds_of(fast).min() - speeds_of(slow).max())


@measure
def parameter_sets_with(table: pd.DataFrame, *, gaits: Sequence[Gait]) -> float:
    """Number of parameter sets at which different starts come to each of the gaits (1).

    Args:
        table: a settle table, several starts for each set of parameters.
        gaits: names of the gaits.
    """
    require(table, "gait")
    cases = cases_of(table)
    sets = [part for _, part in table.groupby(cases)] if cases else [table]
    return float(sum(set(gaits) <= set(part["gait"].astype(str)) for part in sets))


@measure
def difference_of_medians(table: pd.DataFrame, *, column: str, where: Condition, less: Condition) -> float:
    """Median of a column in the records of one condition, less that in the records of another (its unit).

    Args:
        table: any table.
        column: its column.
        where, less: the two conditions.
    """
    difference = value(table, column=column, where=where) - value(table, column=column, where=less)
    return wrapped_difference(difference) if is_circular(table, column) else difference


@measure
def pitch_cycles(table: pd.DataFrame, *, where: Condition | None = None) -> float:
    """Pitch oscillations in a gait cycle, 1 or 2: the larger amplitude; median over the rows (1).

    Args:
        table: a trace.
        where: a condition that selects rows.

    Raises:
        MeasureError: no row has one of the nine gaits and a pitch.
    """
    oscillation = body_oscillation(records(table, where)).dropna(subset=["once", "twice"])
    if oscillation.empty:
        raise MeasureError("No row has one of the nine gaits and a pitch.")
    return float(np.median(np.where(oscillation["twice"] > oscillation["once"], 2.0, 1.0)))


@measure
def largest_deviation(
    table: pd.DataFrame, *, column: str, centre: float, where: Condition | None = None
) -> float:
    """Largest distance of a column from a centre (its unit).

    Args:
        table: any table.
        column: its column.
        centre: in the column's unit.
        where: a condition that selects records.

    Raises:
        MeasureError: no record has a number in the column.
    """
    deviations = numbers(records(table, where), column) - centre
    if is_circular(table, column):
        deviations = wrapped_difference(deviations)
    if np.all(np.isnan(deviations)):
        raise MeasureError(f"No record has a number in the column {column}.")
    return float(np.nanmax(np.abs(deviations)))


def rows_of_gait(table: pd.DataFrame, gait: str) -> list[pd.DataFrame]:
    """The records of each row of a trace with a gait, in order of time."""
    return [one_row(table, row) for row in records_of_gait(gaits_in(table), gait)["row"]]


def records_of_gait(table: pd.DataFrame, gait: str) -> pd.DataFrame:
    """The records with a gait.

    Raises:
        MeasureError: no record has it.
    """
    with_gait = masked(table, table["gait"] == gait)
    if with_gait.empty:
        raise MeasureError(f"No record of the table has the gait {gait}.")
    return with_gait


@measure
def swing_order(table: pd.DataFrame, *, gait: Gait) -> str:
    """Order in which the legs of a gait begin to swing, from LF; legs within the threshold joined by +."""
    phases = records_of_gait(gaits_in(table), gait)[[f"phase_{leg}" for leg in LEGS]].to_numpy(float)
    return _most_frequent([_order(dict(zip(LEGS, of_row, strict=True))) for of_row in phases.tolist()])


@measure
def footfall_order(table: pd.DataFrame, *, gait: Gait) -> str:
    """Order in which the feet touch down in a gait, named by its swings; as `swing_order`."""
    return _most_frequent([_order(_footfalls(part)) for part in rows_of_gait(table, gait)])


@measure
def flight_between(table: pd.DataFrame, *, gait: Gait, legs: Sequence[Leg]) -> float:
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
def loaded_longer(table: pd.DataFrame, *, gait: Gait) -> list[float]:
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
def chart_order(*, gait: Gait) -> str:
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
    cycle = float(np.median(np.diff(lands["LF"])))
    for leg, times in lands.items():
        if np.any(np.abs(np.diff(times) / cycle - 1.0) > _CYCLE_TOLERANCE):
            raise MeasureError(f"{leg} does not touch down once a cycle.")
    turns = TURN / cycle
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
    steps: dict[str, float] = {}
    for one, other in PAIRS:
        lag = (phases[other] - phases[one] + 0.5) % 1.0 - 0.5
        if abs(lag) <= THRESHOLD:  # the first leg of a pair in phase counts, wherever the cycle is cut
            steps["+".join(sorted((one, other)))] = phases[one] + min(lag, 0.0)
        else:
            steps |= {leg: phases[leg] for leg in (one, other)}
    first = next(step for step in steps if "LF" in step)
    return "-".join(sorted(steps, key=lambda step: (step != first, (steps[step] - steps[first]) % 1.0)))


@measure
def rule_agreement(table: pd.DataFrame, *, quantity: str, where: Condition | None = None) -> float:
    """Share of the pairs whose load or pitch has the sign of the rule (1).

    Args:
        table: as for `pairs_in`.
        quantity: one of `MEASURES`.
        where: a condition that selects records.
    """
    return _right(loading_rule(records(table, where)), quantity)


@measure
def foretold(table: pd.DataFrame, *, quantity: str) -> float:
    """Share of walks with the sign that a load or pitch of the trot without feedback foretells (1).

    Args:
        table: as for `load_prediction`.
        quantity: one of `MEASURES`.
    """
    return _right(loading_rule(load_prediction(table)), quantity)


def _right(judged: pd.DataFrame, quantity: str) -> float:
    """The share of right signs of one quantity in a result of `loading_rule`; refuses one that it lacks."""
    of_measure = masked(judged, judged["measure"] == quantity)
    if of_measure.empty:
        known = judged["measure"].astype(str).unique()
        raise ArgumentError(f"The loading rule has no measure {quantity}{suggestion(quantity, known)}")
    return value(of_measure, column="right")


@measure
def pair_measure(table: pd.DataFrame, *, gait: Gait, pair: Literal[1, 2], quantity: str) -> float:
    """Mean load, fore less hind (N), pitch, nose down (rad), or shift (cycles) of a pair in a gait.

    Args:
        table: as for `pairs_in`.
        gait: one of the nine.
        pair: 1 (RF and LH) or 2 (LF and RH).
        quantity: a column of `pairs_in`.
    """
    of_gait = records_of_gait(pairs_in(table), gait)
    return value(of_gait, column=quantity, where=f"pair_number == {pair}", take="mean")


@measure
def pairs_measure(table: pd.DataFrame, *, gait: Gait, quantity: str) -> list[float]:
    """The `pair_measure` of each of the two pairs."""
    first = pair_measure(table, gait=gait, pair=1, quantity=quantity)
    return [first, pair_measure(table, gait=gait, pair=2, quantity=quantity)]


@measure
def late_tilt(table: pd.DataFrame, *, gait: Gait) -> list[float]:
    """Pitch of each pair's late stance in a gait, nose down, over the range of the pitch (1)."""
    pitch_range = float(np.mean([np.ptp(numbers(part, "pitch")) for part in rows_of_gait(table, gait)]))
    return [tilt / pitch_range for tilt in pairs_measure(table, gait=gait, quantity="tilt_late")]


@measure
def pair_ratio(
    table: pd.DataFrame, *, gait: Gait, pair: Literal[1, 2], to: Literal[1, 2], quantity: str
) -> float:
    """Size of the `pair_measure` of one pair, over that of the other (1).

    Args:
        table, gait, quantity: as for `pair_measure`.
        pair, to: numbers of the two pairs.
    """
    size = abs(pair_measure(table, gait=gait, pair=pair, quantity=quantity))
    return size / abs(pair_measure(table, gait=gait, pair=to, quantity=quantity))
