"""Measures of the planar quadruped: Fukuoka, Habu and Fukui 2015, Sci. Rep. 5:8169."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd

from gaitsweep.analyses import TURN, axes_of, mean_direction, require
from gaitsweep.claims import (
    Condition,
    MeasureError,
    default_values,
    measure,
    numbers,
    one_row,
    records,
    stances,
    value,
)
from gaitsweep.dynamics.matsuoka import EXTENSOR, FLEXOR, leg_feedback
from gaitsweep.papers.fukuoka2015.analysis.body_oscillation import body_oscillation, oscillation_along
from gaitsweep.papers.fukuoka2015.analysis.gait_bouts import after_dwell, gait_bouts, gaits_along
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import FLEXORS, gaits_in
from gaitsweep.papers.fukuoka2015.analysis.loading_rule import (
    REPEATS,
    load_prediction,
    loading_rule,
    pairs_in,
)
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

# The mirror images of gaits with a left lead.
RIGHT = {"L-canter": "R-canter", "LT-gallop": "RT-gallop", "uL-canter": "uR-canter"}
# The canter of each gallop's lead.
SAME_LEAD = {"RT-gallop": "R-canter", "LT-gallop": "L-canter"}


@measure
def gait_share(
    table: pd.DataFrame, *, gaits: Sequence[str], where: Condition | None = None, begin: float = -math.inf
) -> float:
    """Share of the rows with one of the gaits, by their swing onsets after the time `begin` (1)."""
    shown = gaits_in(records(table, where), window=(begin, math.inf))
    return float(np.mean(shown["gait"].isin(gaits).to_numpy()))


@measure
def gaits_shown(table: pd.DataFrame, *, speeds: int = 1) -> float:
    """Number of the nine gaits that occur at so many values of the swept parameters or more (1)."""
    shown = gaits_in(table)
    axes = [name for name in axes_of(table) if name not in REPEATS]
    places = shown.loc[shown["gait"].isin(CHART)].drop_duplicates(["gait", *axes])
    return float((places["gait"].astype(str).value_counts() >= speeds).sum())


@measure
def nearest_speed(table: pd.DataFrame, *, gait: str, speed: float, where: Condition | None = None) -> float:
    """Speed nearest to `speed` at which a row has the gait at its end (m/s)."""
    require(table, "gait", "speed_end")
    speeds = numbers(_of_gait(records(table, where), gait), "speed_end")
    return float(speeds[np.abs(speeds - speed).argmin()])


@measure
def speed_gap(
    table: pd.DataFrame, *, slow: Sequence[str], fast: Sequence[str], where: Condition | None = None
) -> float:
    """Least speed of the fast families of gaits less the largest speed of the slow ones (m/s)."""
    part = records(table, where)
    require(part, "gait", "speed_end")
    kind = part["gait"].astype(str).map(family)
    speed = part["speed_end"].to_numpy(float)
    sides = [speed[kind.isin(kinds_of_side).to_numpy()] for kinds_of_side in (slow, fast)]
    if not all(len(side) for side in sides):
        raise MeasureError(f"The table lacks {' and '.join([*slow, *fast])}.")
    return float(sides[1].min() - sides[0].max())


@measure
def parameter_sets_with(
    table: pd.DataFrame, *, gaits: Sequence[str], where: Condition | None = None
) -> float:
    """Number of parameter sets at which different starts come to each of the gaits (1)."""
    part = records(table, where)
    require(part, "gait")
    axes = [name for name in axes_of(part) if name not in REPEATS]
    names = part.assign(gait=part["gait"].astype(str)).groupby(axes)["gait"].agg(set)
    return float(sum(set(gaits) <= shown for shown in names))


@measure
def difference_of_medians(table: pd.DataFrame, *, column: str, where: Condition, less: Condition) -> float:
    """Median of a column in the records of one condition, less that in the records of another (its unit)."""
    return value(table, column=column, where=where) - value(table, column=column, where=less)


@measure
def share_in_order(
    table: pd.DataFrame,
    *,
    order: Sequence[str],
    falling: bool = False,
    where: Condition | None = None,
    by: str = "family",
    at: str = "all",
) -> float:
    """Share of the rows of a ramp with this order of gaits in one pass, `all`, its `begin` or `end` (1)."""
    sequences = _sequences(records(table, where), falling, by).values()
    parts = {"all": slice(None), "begin": slice(len(order)), "end": slice(-len(order), None)}
    if at not in parts:
        raise MeasureError(f"at is {at}. Allowed: {', '.join(parts)}.")
    return float(np.mean([names[parts[at]] == list(order) for names in sequences]))


@measure
def share_up_and_down(
    table: pd.DataFrame, *, up: Sequence[str], down: Sequence[str], where: Condition | None = None
) -> float:
    """Share of the rows of a ramp with one order of gaits as it rises and one as it falls (1).

    Rows whose first lead is a left one count as their mirror images.
    """
    rising, falling = (_sequences(records(table, where), way, "right") for way in (False, True))
    rows = rising.keys() & falling.keys()
    return float(np.mean([rising[row] == list(up) and falling[row] == list(down) for row in rows]))


@measure
def most_frequent_order(
    table: pd.DataFrame, *, falling: bool = False, where: Condition | None = None, by: str = "family"
) -> list[str]:
    """The sequence of gaits that most rows of a ramp show in one pass."""
    sequences = [tuple(names) for names in _sequences(records(table, where), falling, by).values()]
    return list(max(sequences, key=sequences.count))


@measure
def acceleration(
    table: pd.DataFrame, *, between: Sequence[float], falling: bool = False, where: Condition | None = None
) -> float:
    """Slope of the speed over time in one pass of a ramp, of the cycles between two speeds (m/s2)."""
    part = _passes(records(table, where))
    low, high = between
    part = part.loc[(part["pass"] == int(falling)) & part["speed_n"].between(low, high)]
    slopes = [np.polyfit(crossings["t"], crossings["speed_n"], 1)[0] for _, crossings in part.groupby("row")]
    return float(np.mean(slopes))


@measure
def narrowest_family(table: pd.DataFrame, *, where: Condition | None = None) -> str:
    """The family of gaits with the least median range of speeds in the rising pass of a ramp."""
    bouts = _bouts(records(table, where), False, "family")
    bouts["width"] = np.abs(bouts["speed_end"].to_numpy(float) - bouts["speed_begin"].to_numpy(float))
    widths = {
        str(name): np.median([bouts_of_row["width"].sum() for _, bouts_of_row in part.groupby("row")])
        for name, part in bouts.groupby("family")
    }
    return min(widths, key=lambda name: widths[name])


@measure
def bout_time_ratio(
    table: pd.DataFrame, other: pd.DataFrame, *, family: str, where: Condition | None = None
) -> float:
    """Median time in a family of gaits in the rising passes of one ramp, over that of another (1)."""
    times = []
    for job_table in (table, other):
        bouts = _bouts(records(job_table, where), False, "family")
        in_family = (bouts["family"] == family).to_numpy()
        lasted = (bouts["end"] - bouts["begin"]).to_numpy(float) * in_family
        row = bouts["row"].to_numpy()
        times.append(np.median([lasted[row == number].sum() for number in np.unique(row)]))
    return float(times[0] / times[1])


@measure
def gallops_by_their_canter_or_trot(table: pd.DataFrame, *, where: Condition | None = None) -> float:
    """Share of the gallops of rising passes that follow the canter of the same lead, or a trot (1)."""
    before = []
    for _, bouts in _bouts(records(table, where), False, "gait").groupby("row"):
        names = [str(name) for name in bouts["gait"]]
        for first, then in itertools.pairwise(names):
            if then in SAME_LEAD:
                before.append(first in ("trot", SAME_LEAD[then]))
    if not before:
        raise MeasureError("No row gallops as the parameter rises.")
    return float(np.mean(before))


@measure
def swing_order(table: pd.DataFrame, *, gait: str) -> str:
    """Order in which the legs of a gait begin to swing, from LF; legs within the threshold joined by +."""
    rows = _of_gait(gaits_in(table), gait).to_dict("records")
    return _most([_order({leg: float(row[f"phase_{leg}"]) for leg in LEGS}) for row in rows])


@measure
def footfall_order(table: pd.DataFrame, *, gait: str) -> str:
    """Order in which the feet touch down in a gait, named by its swings; as `swing_order`."""
    return _most([_order(_footfalls(part)) for part in _rows_of(table, gait)])


@measure
def flight_between(table: pd.DataFrame, *, gait: str, legs: Sequence[str]) -> float:
    """Share of the time in a gait with no foot on the ground, between the stances of two legs (1)."""
    shares = []
    for part in _rows_of(table, gait):
        down = part[[f"F_{leg}" for leg in LEGS]].to_numpy(float) > 0.0
        turns = np.diff(down.any(axis=1).astype(int))
        lifts, lands = np.flatnonzero(turns < 0), np.flatnonzero(turns > 0)
        flights = ((at, lands[lands > at][0]) for at in lifts if (lands > at).any())
        sides = [(down[at], down[end + 1], end - at) for at, end in flights]
        one, other = (LEGS.index(leg) for leg in legs)
        between = (n for a, b, n in sides if (a[one] and b[other]) or (a[other] and b[one]))
        shares.append(sum(between) / len(part))
    return float(np.mean(shares))


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
    pairs = _of_gait(pairs_in(records(table, where)), gait)
    return float(pairs.loc[pairs["pair_number"] == pair, measure].mean())


@measure
def pairs_measure(table: pd.DataFrame, *, gait: str, measure: str) -> list[float]:
    """The `pair_measure` of each of the two pairs."""
    return [pair_measure(table, gait=gait, pair=pair, measure=measure) for pair in (1, 2)]


@measure
def late_tilt(table: pd.DataFrame, *, gait: str) -> list[float]:
    """Pitch of each pair's late stance in a gait, nose down, over the range of the pitch (1)."""
    nods = float(np.mean([np.ptp(part["pitch"].to_numpy(float)) for part in _rows_of(table, gait)]))
    return [tilt / nods for tilt in pairs_measure(table, gait=gait, measure="tilt_late")]


@measure
def pair_ratio(table: pd.DataFrame, *, gait: str, pair: int, to: int, measure: str) -> float:
    """Size of the `pair_measure` of one pair, over that of the other (1)."""
    own, other = (abs(pair_measure(table, gait=gait, pair=p, measure=measure)) for p in (pair, to))
    return own / other


@measure
def loaded_longer(table: pd.DataFrame, *, gait: str) -> list[float]:
    """Share of the cycle by which each pair's hind foot is loaded longer than its fore foot in a gait (1)."""
    trace = pd.concat(_rows_of(table, gait))
    return [
        float(np.mean(numbers(trace, f"F_{hind}") > 0.0) - np.mean(numbers(trace, f"F_{fore}") > 0.0))
        for fore, hind in PAIRS
    ]


@measure
def pitch_cycles(table: pd.DataFrame, *, where: Condition | None = None) -> float:
    """Pitch oscillations in a gait cycle, 1 or 2: the larger amplitude; median over the rows (1)."""
    oscillation = body_oscillation(records(table, where))
    return float(np.median(np.where(oscillation["twice"] > oscillation["once"], 2.0, 1.0)))


@measure
def body_cycles_along(
    table: pd.DataFrame, *, families: Sequence[str], where: Condition | None = None
) -> list[float]:
    """Pitch oscillations in a gait cycle, 1 or 2, of each family's longest bout along a ramp (1)."""
    bouts = oscillation_along(records(table, where))
    by_family = [records(bouts, f"family == '{name}'") for name in families]
    return [float(numbers(part, "body_cycles")[numbers(part, "windows").argmax()]) for part in by_family]


@measure
def stance_ratio(table: pd.DataFrame, *, where: Condition, to: Condition) -> float:
    """Mean duration of stance in the rows of one condition, over that in the rows of another (1)."""
    return _stance_time(records(table, where)) / _stance_time(records(table, to))


@measure
def largest_deviation(
    table: pd.DataFrame, *, column: str, value: float, where: Condition | None = None
) -> float:
    """Largest distance of a column from a value (its unit)."""
    require(table, column)
    return float(np.nanmax(np.abs(records(table, where)[column].to_numpy(float) - value)))


@measure
def rise_with(
    table: pd.DataFrame, *, parameter: str, where: Condition | None = None, columns: Sequence[str]
) -> float:
    """Spearman's correlation of the mean size of columns with a parameter as it rises (1)."""
    part = records(table, where)
    part = part.loc[part["pass"] == 0]
    sizes = part[list(columns)].abs().mean(axis=1).groupby(part[parameter]).mean()
    return float(pd.Series(sizes.index, dtype=float).corr(sizes.reset_index(drop=True), method="spearman"))


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
def chart_order(*, gait: str) -> str:
    """Order in which the legs of a gait begin to swing by the rule, from LF; legs in phase joined by +."""
    phases = {}
    for middle, sign, (fore, hind) in zip((0.0, 0.5), signs(gait), PAIRS, strict=True):
        # both legs are shifted alike, in opposite directions (Fig. 5a)
        phases |= {fore: middle - 0.125 * sign, hind: middle + 0.125 * sign}
    return _order(phases)


def _rows_of(table: pd.DataFrame, gait: str) -> list[pd.DataFrame]:
    """The records of each row of a trace with a gait, in order of time."""
    return [one_row(table, row) for row in _of_gait(gaits_in(table), gait)["row"]]


def _of_gait(table: pd.DataFrame, gait: str) -> pd.DataFrame:
    """The records with a gait, one at least."""
    return records(table, f"gait == '{gait}'")


def _footfalls(part: pd.DataFrame) -> dict[str, float]:
    """Lags of the legs' touchdowns behind those of LF in one row of a trace, cycles."""
    t, lands = part["t"].to_numpy(float), {}
    for leg in LEGS:
        # the first stance may have begun before the trace
        lands[leg] = t[stances(t, part[f"F_{leg}"].to_numpy(float) > 0.0)[1:, 0]]
        if len(lands[leg]) < 2:
            raise MeasureError(f"{leg} touches down fewer than two times.")
    turns = TURN / float(np.median(np.diff(lands["LF"])))
    after = {leg: (times[:, None] - lands["LF"][None]).ravel() for leg, times in lands.items()}
    return {leg: float(mean_direction(turns * lag)) / TURN for leg, lag in after.items()}


def _most(orders: list[str]) -> str:
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


def _passes(table: pd.DataFrame) -> pd.DataFrame:
    """The records of the passes of a ramp, after its initial dwell."""
    require(table, "t", "pass", "speed_n")
    return after_dwell(table)


def _bouts(table: pd.DataFrame, falling: bool, by: str) -> pd.DataFrame:
    """The bouts of gaits in one pass of a ramp, without irregular ones."""
    along = gaits_along(_passes(table))
    names = along[by].astype(str)
    steady = ~names.isin(["unsteady", "none"])
    along = along.loc[steady & (along["pass"] == int(falling))]
    return gait_bouts(along, by, least=3)


def _sequences(table: pd.DataFrame, falling: bool, by: str) -> dict[Any, list[str]]:
    """The gaits of each row in one pass of a ramp, in order.

    `by` is a column of `gaits_along`, or `right`: gaits, rows whose first lead is a left one mirrored.
    """
    column = "gait" if by == "right" else by
    bouts = _bouts(table, falling, column)
    by_row = {row: list(map(str, bouts_of_row[column])) for row, bouts_of_row in bouts.groupby("row")}
    return {row: _mirrored(names) for row, names in by_row.items()} if by == "right" else by_row


def _mirrored(names: list[str]) -> list[str]:
    """A sequence of gaits whose first canter or gallop has a right lead; else its mirror image."""
    leads = [name for name in names if name in RIGHT or name in RIGHT.values()]
    if not leads or leads[0] not in RIGHT:
        return names
    mirror = RIGHT | {right: left for left, right in RIGHT.items()}
    return [mirror.get(name, name) for name in names]


def _order(phases: dict[str, float]) -> str:
    """The legs in the order of their phases (cycles), from LF; both legs of a pair in phase are joined."""
    mates = {leg: other for pair in PAIRS for leg, other in (pair, pair[::-1])}

    def after(leg: str) -> float:
        ahead = (phases[leg] - phases["LF"]) % 1.0
        # a leg that swings with LF may be slightly before it
        return ahead - 1.0 if leg == mates["LF"] and ahead > 1.0 - THRESHOLD else ahead

    legs = sorted(LEGS, key=after)
    written: list[str] = []
    while legs:
        leg = legs.pop(0)
        mate = mates[leg]
        lag = abs((phases[leg] - phases[mate] + 0.5) % 1.0 - 0.5)
        if mate in legs and lag <= THRESHOLD:
            legs.remove(mate)
            leg = "+".join(sorted((leg, mate)))
        written.append(leg)
    at = next(i for i, leg in enumerate(written) if "LF" in leg)
    return "-".join(written[at:] + written[:at])
