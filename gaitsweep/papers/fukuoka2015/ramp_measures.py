"""Measures of ramps of the planar quadruped: the order, speeds and durations of its gaits."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.analyses import require
from gaitsweep.claims import Condition, MeasureError, measure, numbers, records
from gaitsweep.papers.fukuoka2015.analysis.body_oscillation import oscillation_along
from gaitsweep.papers.fukuoka2015.analysis.gait_bouts import after_dwell, gait_bouts, gaits_along

# The mirror images of gaits with a left lead.
RIGHT = {"L-canter": "R-canter", "LT-gallop": "RT-gallop", "uL-canter": "uR-canter"}
# The canter of each gallop's lead.
SAME_LEAD = {"RT-gallop": "R-canter", "LT-gallop": "L-canter"}


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
    """Share of the rows of a ramp with an order of gaits in one pass (1).

    Args:
        table: a ramp's table.
        order: names of gaits or of families.
        falling: whether it is the pass in which the parameter falls.
        where: a condition that selects records.
        by: the column of the names, family or gait.
        at: which part of the sequence has this order: all of it, its begin or its end.
    """
    sequences = _sequences(records(table, where), by, falling=falling).values()
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

    Args:
        table: a ramp's table.
        up, down: names of gaits.
        where: a condition that selects records.
    """
    ramp = records(table, where)
    rising = _sequences(ramp, "right", falling=False)
    falling = _sequences(ramp, "right", falling=True)
    rows = rising.keys() & falling.keys()
    return float(np.mean([rising[row] == list(up) and falling[row] == list(down) for row in rows]))


@measure
def most_frequent_order(
    table: pd.DataFrame, *, falling: bool = False, where: Condition | None = None, by: str = "family"
) -> list[str]:
    """The sequence of gaits that most rows of a ramp show in one pass.

    Args:
        table, falling, where, by: as for `share_in_order`.
    """
    by_row = _sequences(records(table, where), by, falling=falling)
    sequences = [tuple(names) for names in by_row.values()]
    return list(max(sequences, key=sequences.count))


@measure
def acceleration(
    table: pd.DataFrame, *, between: Sequence[float], falling: bool = False, where: Condition | None = None
) -> float:
    """Slope of the speed over time in one pass of a ramp (m/s2).

    Args:
        table, falling, where: as for `share_in_order`.
        between: the least and the largest speed of the cycles that count, m/s.
    """
    part = _passes(records(table, where))
    low, high = between
    part = part.loc[(part["pass"] == int(falling)) & part["speed_n"].between(low, high)]
    slopes = [np.polyfit(crossings["t"], crossings["speed_n"], 1)[0] for _, crossings in part.groupby("row")]
    return float(np.mean(slopes))


@measure
def narrowest_family(table: pd.DataFrame, *, where: Condition | None = None) -> str:
    """The family of gaits with the least median range of speeds in the rising pass of a ramp."""
    bouts = _bouts(records(table, where), "family", falling=False)
    bouts["width"] = np.abs(bouts["speed_end"].to_numpy(float) - bouts["speed_begin"].to_numpy(float))
    widths = {}
    for name, bouts_of_family in bouts.groupby("family"):
        sums = bouts_of_family.groupby("row")["width"].sum()
        widths[str(name)] = float(np.median(np.asarray(sums, float)))
    return min(widths, key=widths.__getitem__)


@measure
def bout_time_ratio(
    table: pd.DataFrame, other: pd.DataFrame, *, family: str, where: Condition | None = None
) -> float:
    """Median time in a family of gaits in the rising passes of one ramp, over that of another (1).

    Args:
        table, other: the tables of the two ramps.
        family: walk, trot, canter or gallop.
        where: a condition that selects records of both.
    """
    times = []
    for job_table in (table, other):
        bouts = _bouts(records(job_table, where), "family", falling=False)
        in_family = (bouts["family"] == family).to_numpy()
        lasted = (bouts["end"] - bouts["begin"]).to_numpy(float) * in_family
        row = bouts["row"].to_numpy()
        times.append(np.median([lasted[row == number].sum() for number in np.unique(row)]))
    return float(times[0] / times[1])


@measure
def gallops_by_their_canter_or_trot(table: pd.DataFrame, *, where: Condition | None = None) -> float:
    """Share of the gallops of rising passes that follow the canter of the same lead, or a trot (1)."""
    before = []
    for _, bouts in _bouts(records(table, where), "gait", falling=False).groupby("row"):
        names = [str(name) for name in bouts["gait"]]
        for first, then in itertools.pairwise(names):
            if then in SAME_LEAD:
                before.append(first in ("trot", SAME_LEAD[then]))
    if not before:
        raise MeasureError("No row gallops as the parameter rises.")
    return float(np.mean(before))


@measure
def body_cycles_along(
    table: pd.DataFrame, *, families: Sequence[str], where: Condition | None = None
) -> list[float]:
    """Pitch oscillations in a gait cycle, 1 or 2, of each family's longest bout along a ramp (1).

    Args:
        table: a ramp's table.
        families: names of families.
        where: a condition that selects records.
    """
    bouts = oscillation_along(records(table, where))
    cycles = []
    for name in families:
        bouts_of_family = records(bouts, f"family == '{name}'")
        longest = numbers(bouts_of_family, "windows").argmax()
        cycles.append(float(numbers(bouts_of_family, "body_cycles")[longest]))
    return cycles


@measure
def rise_with(
    table: pd.DataFrame, *, parameter: str, where: Condition | None = None, columns: Sequence[str]
) -> float:
    """Spearman's correlation of the mean size of columns with a parameter as it rises (1).

    Args:
        table: a ramp's table.
        parameter: the parameter that moves.
        where: a condition that selects records.
        columns: the columns whose absolute values are averaged.
    """
    part = records(table, where)
    part = part.loc[part["pass"] == 0]
    sizes = part[list(columns)].abs().mean(axis=1).groupby(part[parameter]).mean()
    return float(pd.Series(sizes.index, dtype=float).corr(sizes.reset_index(drop=True), method="spearman"))


def _passes(table: pd.DataFrame) -> pd.DataFrame:
    """The records of the passes of a ramp, after its initial dwell."""
    require(table, "t", "pass", "speed_n")
    return after_dwell(table)


def _bouts(table: pd.DataFrame, by: str, *, falling: bool) -> pd.DataFrame:
    """The bouts of gaits in one pass of a ramp, without irregular ones."""
    along = gaits_along(_passes(table))
    names = along[by].astype(str)
    steady = ~names.isin(["unsteady", "none"])
    along = along.loc[steady & (along["pass"] == int(falling))]
    return gait_bouts(along, by, least=3)


def _sequences(table: pd.DataFrame, by: str, *, falling: bool) -> dict[Any, list[str]]:
    """The gaits of each row in one pass of a ramp, in order.

    `by` is a column of `gaits_along`, or `right`: gaits, rows whose first lead is a left one mirrored.
    """
    column = "gait" if by == "right" else by
    bouts = _bouts(table, column, falling=falling)
    by_row = {row: list(map(str, bouts_of_row[column])) for row, bouts_of_row in bouts.groupby("row")}
    return {row: _mirrored(names) for row, names in by_row.items()} if by == "right" else by_row


def _mirrored(names: list[str]) -> list[str]:
    """A sequence of gaits whose first canter or gallop has a right lead; else its mirror image."""
    leads = [name for name in names if name in RIGHT or name in RIGHT.values()]
    if not leads or leads[0] not in RIGHT:
        return names
    mirror = RIGHT | {right: left for left, right in RIGHT.items()}
    return [mirror.get(name, name) for name in names]
