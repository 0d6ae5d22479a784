"""Measures of the drift of a wave's source, and of the legs at which sources settle."""

from __future__ import annotations

import numpy as np
import pandas as pd

from gaitsweep.analyses import wrapped_difference
from gaitsweep.claims import Condition, masked, measure, numbers, one_row, records
from gaitsweep.papers.ambe2021.analysis.source_place import source_drift, source_place
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import springs_of


@measure
def drift_of_sum(table: pd.DataFrame, *, row: int) -> float:
    """Mean change of E, the sum of the relative phases, in a cycle over the last cycles of a row (rad)."""
    return float(numbers(source_drift(one_row(table, row)), "drift")[0])


@measure
def drift_over_law(table: pd.DataFrame, *, where: Condition | None = None) -> list[float]:
    """Smallest and largest drift of E over that of the law on a ground of finite stiffness (1).

    Args:
        table: a return_map table.
        where: a condition over the columns of `source_drift`, such as `m_slope != 0`.
    """
    drifts = records(source_drift(table), where)
    ratios = numbers(drifts, "drift") / numbers(drifts, "law_on_ground")
    return [float(ratios.min()), float(ratios.max())]


@measure
def largest_drift(table: pd.DataFrame, *, where: Condition | None = None) -> float:
    """Largest absolute drift of E in a cycle over the rows of a condition (rad)."""
    return float(np.abs(numbers(records(source_drift(table), where), "drift")).max())


@measure
def fewest_source_legs(table: pd.DataFrame, *, where: Condition | None = None) -> float:
    """The number of legs at which the source settles, the smallest over the sets of a condition (1).

    Args:
        table: a settle table, several starts for each set of parameters.
        where: a condition over the table's columns.
    """
    places = source_place(records(table, where))
    names = [name for name in places.columns if name not in ("leg", "source", "meeting", "neither", "starts")]
    sets = [part for _, part in places.groupby(names)] if names else [places]
    return float(min(np.count_nonzero(part["source"] > 0) for part in sets))


@measure
def meeting_share(table: pd.DataFrame, *, leg: int, where: Condition | None = None) -> float:
    """Share of the starts whose waves meet at a leg, the smallest over the sets of a condition (1)."""
    places = source_place(records(table, where))
    return float(numbers(masked(places, places["leg"] == leg), "meeting").min())


@measure
def mirror_error(table: pd.DataFrame) -> float:
    """Largest difference of the phases of row 0 from those of row 1 with the legs in reversed order (rad)."""
    legs = springs_of(table) + 1
    one = one_row(table, 0)[[f"phase_{i}" for i in range(1, legs + 1)]].to_numpy(float)
    other = one_row(table, 1)[[f"phase_{i}" for i in range(legs, 0, -1)]].to_numpy(float)
    return float(np.abs(wrapped_difference(one - other)).max())
