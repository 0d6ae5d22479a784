"""Measures of ramps of the planar quadruped: the order, speeds and durations of its gaits."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Literal

import numpy as np
import pandas as pd

from gaitsweep.analyses import require
from gaitsweep.claims import Condition, MeasureError, masked, measure, numbers, records
from gaitsweep.papers.fukuoka2015.analysis.gait_bouts import (
    MIN_WINDOWS,
    after_dwell,
    gait_bouts,
    gaits_along,
    oscillation_along,
)

# Names of a sequence: families, gaits, or gaits with the rows mirrored whose first lead is a left one.
Names = Literal["family", "gait", "right"]
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
    by: Names = "family",
    at: Literal["all", "begin", "end"] = "all",
) -> float:
    """Share of the rows of a ramp with an order of gaits in one pass (1).

    Args:
        table: a ramp's table.
        order: names of gaits or of families.
        falling: whether it is the pass in which the parameter falls.
        where: a condition that selects records.
        by: which names the order has.
        at: which part of the sequence has this order: all of it, its begin or its end.
    """
    sequences = _sequences(records(table, where), by, falling=falling)
    part = {"all": slice(None), "begin": slice(len(order)), "end": slice(-len(order), None)}[at]
    return float(np.mean([names[part] == list(order) for names in sequences.values()]))


@measure
def share_up_and_down(table: pd.DataFrame, *, up: Sequence[str], down: Sequence[str]) -> float:
    """Share of the rows of a ramp with one order of gaits as it rises and one as it falls (1).

    Rows whose first lead is a left one count as their mirror images.

    Args:
        table: a ramp's table.
        up, down: names of gaits.
    """
    rising, falling = (_sequences(records(table, None), "right", falling=falls) for falls in (False, True))
    return float(np.mean([rising[row] == list(up) and falling[row] == list(down) for row in rising]))


@measure
def most_frequent_order(
    table: pd.DataFrame, *, where: Condition | None = None, by: Names = "family"
) -> list[str]:
    """The sequence of gaits that most rows of a ramp show as the parameter rises.

    Args:
        table, where, by: as for `share_in_order`.
    """
    sequences = list(_sequences(records(table, where), by, falling=False).values())
    return max(sequences, key=sequences.count)


@measure
def acceleration(
    table: pd.DataFrame, *, between: Sequence[float], falling: bool = False, where: Condition | None = None
) -> float:
    """Slope of the speed over time in one pass of a ramp (m/s2).

    Args:
        table, falling, where: as for `share_in_order`.
        between: the least and the largest speed of the cycles that count, m/s.

    Raises:
        MeasureError: no row has two such cycles.
    """
    passes = _passes(records(table, where))
    low, high = between
    crossings = masked(passes, (passes["pass"] == int(falling)) & passes["speed_n"].between(low, high))
    groups = [group for _, group in crossings.groupby("row") if len(group) > 1]
    if not groups:
        raise MeasureError(f"No row has two cycles between {low:g} and {high:g} m/s in this pass.")
    return float(np.mean([np.polyfit(group["t"], group["speed_n"], 1)[0] for group in groups]))


@measure
def narrowest_family(table: pd.DataFrame, *, where: Condition | None = None) -> str:
    """The family of gaits with the least median range of speeds in the rising pass of a ramp.

    Raises:
        MeasureError: there is no gait bout in this pass.
    """
    bouts = _bouts(records(table, where), "family", falling=False)
    if bouts.empty:
        raise MeasureError("The ramp has no gait bout as the parameter rises.")
    bouts["width"] = np.abs(numbers(bouts, "speed_end") - numbers(bouts, "speed_begin"))
    widths = {}
    for name, bouts_of_family in bouts.groupby("family"):
        of_rows = bouts_of_family.groupby("row").agg(width=("width", "sum"))
        widths[str(name)] = float(np.median(numbers(of_rows, "width")))
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
    one, another = (_median_time(records(ramp, where), family) for ramp in (table, other))
    return one / another


def _median_time(ramp: pd.DataFrame, family: str) -> float:
    """The median over the rows of the time (s) in a family of gaits in the rising pass, 0 without any."""
    bouts = _bouts(ramp, "family", falling=False)
    bouts["lasted"] = (bouts["end"] - bouts["begin"]) * (bouts["family"] == family)
    of_rows = bouts.groupby("row").agg(lasted=("lasted", "sum"))
    return float(np.median(numbers(of_rows.reindex(ramp["row"].unique(), fill_value=0.0), "lasted")))


@measure
def gallops_by_their_canter_or_trot(table: pd.DataFrame, *, where: Condition | None = None) -> float:
    """Share of the gallops of rising passes that follow the canter of the same lead, or a trot (1)."""
    follow = []
    for names in _sequences(records(table, where), "gait", falling=False).values():
        for before, gait in itertools.pairwise(names):
            if gait in SAME_LEAD:
                follow.append(before in ("trot", SAME_LEAD[gait]))
    if not follow:
        raise MeasureError("No row gallops as the parameter rises.")
    return float(np.mean(follow))


@measure
def body_cycles_along(
    table: pd.DataFrame, *, families: Sequence[str], where: Condition | None = None
) -> list[float]:
    """Pitch oscillations in a gait cycle, 1 or 2, of each family's longest bout along a ramp (1).

    Args:
        table: a ramp's table.
        families: names of families.
        where: a condition that selects records.

    Raises:
        MeasureError: the ramp has no bout of a family.
    """
    bouts = oscillation_along(records(table, where))
    cycles = []
    for name in families:
        bouts_of_family = masked(bouts, bouts["family"] == name)
        if bouts_of_family.empty:
            raise MeasureError(f"The ramp has no bout of the family {name}.")
        longest = numbers(bouts_of_family, "windows").argmax()
        cycles.append(float(numbers(bouts_of_family, "body_cycles")[longest]))
    return cycles


@measure
def rise_with(table: pd.DataFrame, *, parameter: str, columns: Sequence[str]) -> float:
    """Spearman's correlation of the mean size of columns with a parameter as it rises (1).

    Args:
        table: a ramp's table.
        parameter: the parameter that moves.
        columns: the columns whose absolute values are averaged.

    Raises:
        AnalysisError: the table lacks a column, or the parameter never rises.
    """
    require(table, "pass")
    rising = records(masked(table, table["pass"] == 0), None)
    require(rising, parameter, *columns)
    sizes = pd.DataFrame(rising[list(columns)]).abs().mean(axis=1)
    means = rising.assign(size=sizes).groupby(parameter, as_index=False).agg(size=("size", "mean"))
    along, size = (pd.Series(numbers(means, name)) for name in (parameter, "size"))
    return float(along.corr(size, method="spearman"))


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
    return gait_bouts(along, by, MIN_WINDOWS)


def _sequences(table: pd.DataFrame, by: Names, *, falling: bool) -> dict[object, list[str]]:
    """The names of the gaits of each row in one pass of a ramp, in order; none of a row without a bout."""
    column = "gait" if by == "right" else by
    sequences: dict[object, list[str]] = {row: [] for row in table["row"].unique()}
    for row, bouts in _bouts(table, column, falling=falling).groupby("row"):
        names = bouts[column].astype(str).tolist()
        sequences[row] = _with_right_lead(names) if by == "right" else names
    return sequences


def _with_right_lead(names: list[str]) -> list[str]:
    """The mirror image of a sequence of gaits if its first canter or gallop has a left lead."""
    leads = [name for name in names if name in RIGHT or name in RIGHT.values()]
    if not leads or leads[0] not in RIGHT:
        return names
    mirror = RIGHT | {right: left for left, right in RIGHT.items()}
    return [mirror.get(name, name) for name in names]
