"""Measures of the steady gaits: values by gait, drifts, slipping feet, and footfalls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.analyses import AnalysisError, require, wrapped_difference
from gaitsweep.claims import Condition, masked, measure, records, value
from gaitsweep.papers.aoi2011.waist_quadruped.sizes import LIMBS


@measure
def means_of_feet(table: pd.DataFrame, *, column: str, where: Condition | None = None) -> list[float]:
    """Mean of a column of each of the four feet, in its unit.

    Args:
        table: a return map's table.
        column: the column, with {} in place of the foot's number.
        where: a condition that selects records.
    """
    return [value(table, column=column.replace("{}", f"{i + 1}"), where=where, take="mean") for i in LIMBS]


@measure
def spread_over(table: pd.DataFrame, *, column: str, over: str, where: Condition) -> float:
    """Range of the medians of a column at the values of another, in its unit."""
    part = records(table, where)
    require(part, column, over)
    return float(np.ptp(part.groupby(over)[column].median()))


@measure
def difference_of_gaits(
    table: pd.DataFrame, other: pd.DataFrame, *, observable: str, where: Condition, gaits: Sequence[str]
) -> float:
    """Largest difference (rad) of the median of an angle in each gait, between a settle table and holds."""
    worst, chosen = 0.0, records(other, where)
    for gait in gaits:
        one = value(masked(table, table["gait"] == gait), column=f"{observable}_end")
        two = value(masked(chosen, chosen["gait"] == gait), column=f"{observable}_n")
        worst = max(worst, abs(float(wrapped_difference(one - two))))
    return worst


@measure
def farthest_angle(
    table: pd.DataFrame, *, column: str, centre: float, where: Condition | None = None
) -> float:
    """Largest distance (rad) of an angle from a centre."""
    part = records(table, where)
    require(part, column)
    away = np.abs(wrapped_difference(part[column].dropna().to_numpy(float) - centre))
    if not away.size:
        raise AnalysisError(f"No record has a value of {column}.")
    return float(away.max())


@measure
def gait_kept(table: pd.DataFrame, *, gait: str) -> float:
    """Share of the rows with a gait on the first stair that have it on every stair (1)."""
    require(table, "row", "stair", "gait")
    shown = table.assign(same=table["gait"].astype(str) == gait)
    first = shown.loc[shown["stair"] == shown["stair"].min()]
    rows = first.loc[first["same"], "row"]
    if rows.empty:
        raise AnalysisError(f"No row has the gait {gait} on the first stair.")
    always_same = shown.loc[shown["row"].isin(rows)].groupby("row")["same"].all()
    return float(np.mean(always_same.to_numpy()))


@measure
def drift_from_start(table: pd.DataFrame, *, start: str, end: str, where: Condition | None = None) -> float:
    """Largest distance (rad) between an angle at the start of a row and at its end."""
    part = records(table, where)
    require(part, start, end)
    moved = np.abs(wrapped_difference(part[end].to_numpy(float) - part[start].to_numpy(float)))
    return float(np.max(moved))


@measure
def sideways_share(table: pd.DataFrame) -> float:
    """Largest distance from the line between begin and end of a trace, as a share of its length (1)."""
    require(table, "row", "t", "q_0", "q_1")
    worst = 0.0
    for _, part in table.groupby("row"):
        part = part.sort_values("t")
        way = part[["q_0", "q_1"]].to_numpy(float)
        cycle = max(round(0.4 / float(np.median(np.diff(part["t"].to_numpy(float))))), 1)
        # averaged over a cycle, in which the body sways
        way = np.stack([np.convolve(way[:, k], np.full(cycle, 1.0 / cycle), "valid") for k in (0, 1)], axis=1)
        line = way[-1] - way[0]
        length = float(np.hypot(*line))
        off = (way - way[0]) @ np.array([-line[1], line[0]]) / length
        worst = max(worst, float(np.max(np.abs(off))) / length)
    return worst
