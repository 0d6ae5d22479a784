"""Measures of steady gaits: values by gait, drifts, slip of the feet, and footfalls."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from gaitsweep.analyses import (
    TURN,
    AnalysisError,
    is_circular,
    mean_direction,
    require,
    unwrap_from,
    wrapped_difference,
)
from gaitsweep.claims import (
    Condition,
    masked,
    measure,
    numbers,
    one_row,
    records,
    row_params,
    stances,
    stored_job,
    value,
)
from gaitsweep.papers.aoi2011.waist_quadruped.mechanics import WaistMechanics
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import LIMBS
from gaitsweep.status import Status

# Largest deviation of the times between touchdowns from one cycle, where a foot lands once a cycle; its share
_CYCLE_TOLERANCE = 0.2
_TOGETHER = 0.2  # rad, the largest difference of limbs that land together


@measure
def means_of_feet(table: pd.DataFrame, *, column: str, where: Condition | None = None) -> list[float]:
    """Mean of a column of each of the four feet, in its unit.

    Args:
        table: a return map's table.
        column: the column, with {} in place of the foot's number.
        where: a condition that selects records.

    Raises:
        MeasureError: no record fulfils the condition, or the table lacks a column.
    """
    return [value(table, column=column.replace("{}", f"{i + 1}"), where=where, take="mean") for i in LIMBS]


@measure
def spread_over(table: pd.DataFrame, *, column: str, over: str, where: Condition) -> float:
    """Range of the medians of a column at the values of another, in its unit.

    Args:
        table: any table.
        column, over: the column of the medians, and that of the groups.
        where: a condition that selects records.

    Raises:
        AnalysisError: no record fulfils the condition or has a value, or the table lacks a column.
    """
    part = records(table, where)
    require(part, column, over)
    values = pd.Series(part[column])
    if is_circular(part, column):
        middle = mean_direction(values.dropna().to_numpy(float))
        values = middle + wrapped_difference(values - middle)
    medians = values.groupby(part[over]).median().dropna()
    if medians.empty:
        raise AnalysisError(f"No record has a value of {column}.")
    return float(np.ptp(medians))


@measure
def difference_of_gaits(
    table: pd.DataFrame, other: pd.DataFrame, *, observable: str, where: Condition, gaits: Sequence[str]
) -> float:
    """Largest difference (rad) of the median of an angle in each gait, between a settle table and holds.

    Args:
        table: the settle table.
        other: the table of holds.
        observable: the angle.
        where: a condition that selects records of the holds.
        gaits: names of the gaits.

    Raises:
        AnalysisError: a gait is missing.
    """
    holds = records(other, where)
    require(table, "gait")
    require(holds, "gait")

    def median(part: pd.DataFrame, gait: str, column: str) -> float:
        angles = _present(masked(part, part["gait"] == gait), column, f"No record with the gait {gait}")
        middle = mean_direction(angles)
        return float(np.median(middle + wrapped_difference(angles - middle)))

    differences = [
        median(table, gait, f"{observable}_end") - median(holds, gait, f"{observable}_n") for gait in gaits
    ]
    return float(np.abs(wrapped_difference(np.array(differences))).max())


@measure
def farthest_angle(
    table: pd.DataFrame, *, column: str, centre: float, where: Condition | None = None
) -> float:
    """Largest distance (rad) of an angle from a centre.

    Args:
        table: any table.
        column: the angle, rad.
        centre: rad.
        where: a condition that selects records.

    Raises:
        AnalysisError: no record has a value.
    """
    angles = _present(records(table, where), column, "No record")
    return float(np.abs(wrapped_difference(angles - centre)).max())


def _present(table: pd.DataFrame, column: str, subject: str) -> Float[np.ndarray, " values"]:
    """The values of a column that are not missing; without any, an AnalysisError begins with `subject`."""
    values = numbers(table, column)
    values = values[~np.isnan(values)]
    if not values.size:
        raise AnalysisError(f"{subject} has a value of {column}.")
    return values


@measure
def gait_kept(table: pd.DataFrame, *, gait: str) -> float:
    """Share of the rows with a gait on the first stair that have it on all stairs to the last (1).

    Args:
        table: a staircase's table.
        gait: name of the gait.

    Raises:
        AnalysisError: no row has the gait on the first stair.
    """
    require(table, "row", "stair", "gait", "status")
    has_gait = table["gait"].astype(str) == gait
    # a row that ends early has no records of the stairs that it did not reach
    keeps_gait = has_gait & Status.SOUND.among(table["status"])
    rows = table.loc[has_gait & (table["stair"] == table["stair"].min()), "row"]
    if rows.empty:
        raise AnalysisError(f"No row has the gait {gait} on the first stair.")
    return float(np.mean(keeps_gait.groupby(table["row"]).all().loc[rows.unique()].to_numpy()))


@measure
def drift_from_start(table: pd.DataFrame, *, start: str, end: str, where: Condition | None = None) -> float:
    """Largest distance (rad) between an angle at the start of a row and at its end.

    Args:
        table: a settle table.
        start, end: the columns of the angle at both times.
        where: a condition that selects rows.

    Raises:
        AnalysisError: no row fulfils the condition, the table lacks a column, or a row lacks an angle.
    """
    part = records(table, where)
    require(part, start, end)
    drifts = np.abs(wrapped_difference(numbers(part, end) - numbers(part, start)))
    if np.isnan(drifts).any():
        raise AnalysisError(f"A row has no value of {start} or {end}: select rows that settled by where.")
    return float(drifts.max())


@measure
def sideways_share(table: pd.DataFrame) -> float:
    """Largest distance from the line between begin and end of a trace, as a share of its length (1).

    Args:
        table: a trace with the positions q_0, q_1.

    Raises:
        AnalysisError: the table does not have a column or a row, or a row has no complete cycle, lacks a
            position, or begins and ends at one place.
    """
    require(table, "row", "t", "q_0", "q_1")
    if table.empty:
        raise AnalysisError("The table has no rows.")
    design = stored_job(table.attrs).design
    shares = []
    for row, part in table.groupby("row"):
        part = part.sort_values("t")
        path = part[["q_0", "q_1"]].to_numpy(float)
        t = part["t"].to_numpy(float)
        cycle = TURN / float(row_params(design, int(str(row))).omega)
        samples = max(round(cycle / float(np.median(np.diff(t)))), 1) if len(t) > 1 else 1
        if samples >= len(path):
            raise AnalysisError(f"The trace of row {row} is shorter than a cycle.")
        # averaged over a cycle, in which the body sways
        window = np.full(samples, 1.0 / samples)
        path = np.stack([np.convolve(path[:, k], window, "valid") for k in (0, 1)], axis=1)
        line = path[-1] - path[0]
        length = float(np.hypot(*line))
        if not length > 0.0 or np.isnan(path).any():
            reason = "does not move along" if length == 0.0 else "lacks a position at some samples of"
            raise AnalysisError(f"The body of row {row} {reason} its trace.")
        sideways = (path - path[0]) @ np.array([-line[1], line[0]]) / length
        shares.append(float(np.max(np.abs(sideways))) / length)
    return max(shares)


@measure
def foot_slip(table: pd.DataFrame, *, take: Literal["median", "max"] = "median") -> float:
    """Distance (m) that a foot moves along the ground in a stance: `median` or `max` of all stances.

    A foot that bounces is still in its stance; the time off the ground does not count.

    Args:
        table: a trace with the positions q_0, q_1, ...
        take: whether the median or the largest distance counts.

    Raises:
        AnalysisError: the table lacks a column, or no foot has a stance.
    """
    coordinates = [f"q_{i}" for i in range(16)]
    require(table, "row", "t", *coordinates)
    design = stored_job(table.attrs).design

    @jax.jit
    def feet(mechanics: WaistMechanics, q: Float[Array, "times 16"]) -> Float[Array, "times 4 3"]:
        return jax.vmap(lambda q_now: mechanics.feet(q_now, jnp.zeros(15))[0])(q)

    slips = []
    for row, part in table.groupby("row"):
        part = part.sort_values("t")
        mechanics = row_params(design, int(str(row))).mechanics
        places = np.asarray(feet(mechanics, jnp.asarray(part[coordinates].to_numpy(float))))
        for i in LIMBS:
            down = numbers(part, f"contact_{i + 1}") > 0.5
            for first, last in stances(numbers(part, "t"), down):
                on_ground = places[first:last, i, :2][down[first:last]]
                slips.append(float(np.linalg.norm(on_ground - on_ground[0], axis=1).max()))
    if not slips:
        raise AnalysisError("No foot is on the ground at any sample of the table.")
    return float(np.max(slips) if take == "max" else np.median(slips))


@measure
def touchdown_lags(
    table: pd.DataFrame,
    *,
    row: int,
    pairs: Sequence[Sequence[int]],
    window: Sequence[float] | None = None,
    near: Sequence[float] | None = None,
) -> list[float]:
    """Phase (rad) by which foot i of each pair [i, j] touches down before foot j.

    Args:
        table: a trace.
        row: its row.
        pairs: numbers of feet.
        window: begin and end of the time that is used, s.
        near: for each pair, the middle of the turn in which its phase is given, rad; pi without it.

    Raises:
        AnalysisError: a foot touches down less or more than once a cycle, or the table lacks a column or row.
    """
    if window is not None:
        require(table, "t")
        begin, end = window
        table = masked(table, table["t"].between(begin, end))
    lags = []
    for (i, j), middle in zip(pairs, near or [math.pi] * len(pairs), strict=True):
        first, second = _touchdowns(table, row, i), _touchdowns(table, row, j)
        cycle = float(np.median(np.diff(first)))
        for foot, times in ((i, first), (j, second)):
            if np.max(np.abs(np.diff(times) / cycle - 1.0)) > _CYCLE_TOLERANCE:
                raise AnalysisError(f"Foot {foot} of row {row} does not touch down once a cycle.")
        after = second[:, None] - first[None, :]
        lag = np.asarray(mean_direction(TURN * (after / cycle).ravel()))
        lags.append(float(unwrap_from(lag, middle - math.pi)))
    return lags


@measure
def order_of_footfalls(table: pd.DataFrame, *, row: int) -> str:
    """Limbs in their order of touchdown from limb 1 on; + joins those that land together with the one before.

    Args:
        table: a trace.
        row: its row.

    Raises:
        AnalysisError: as for `touchdown_lags`.
    """
    lags = touchdown_lags(table, row=row, pairs=[[1, 2], [1, 3], [1, 4]])
    order = sorted(zip(np.mod([0.0, *lags], TURN), "1234", strict=True))
    groups = [[order[0][1]]]
    for (before, _), (after, limb) in itertools.pairwise(order):
        if after - before > _TOGETHER:
            groups.append([])
        groups[-1].append(limb)
    if TURN - order[-1][0] <= _TOGETHER:  # limb 1 lands together with the last one
        groups[0] += groups.pop()
    return "-".join("+".join(sorted(limbs)) for limbs in groups)


def _touchdowns(table: pd.DataFrame, row: int, foot: int) -> Float[np.ndarray, " touchdowns"]:
    """Times (s) at which a swing of a foot ends; breaks of a stance do not count as swings."""
    require(table, "row", "t", f"contact_{foot}")
    part = one_row(table, row)
    t = numbers(part, "t")
    # without its lift-off before it, the first stance is not known to begin with a touchdown
    lands = stances(t, numbers(part, f"contact_{foot}") > 0.5)[1:, 0]
    if len(lands) < 2:
        raise AnalysisError(f"Foot {foot} of row {row} has fewer than two touchdowns.")
    return t[lands]
