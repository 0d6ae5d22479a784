"""Measures of settled states: lines and planes of solutions, and the parts of basins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.analyses import wrapped_difference
from gaitsweep.claims import MeasureError, masked, measure, numbers, records
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import psi_columns
from gaitsweep.papers.ambe2021.theory.gaits import WAVES


@measure
def last_change(table: pd.DataFrame) -> float:
    """Largest change of a relative phase over the last cycle of any row (rad)."""
    return float(np.abs(wrapped_difference(last_steps(table, psi_columns(table, "_n")))).max())


def last_steps(table: pd.DataFrame, names: list[str]) -> Float[np.ndarray, "rows columns"]:
    """The change of columns from the last but one to the last crossing of each row."""
    rows = [part.sort_values(by="crossing")[names].to_numpy(float) for _, part in table.groupby("row")]
    if min(map(len, rows)) < 2:
        raise MeasureError("A row has fewer than two crossings.")
    return np.stack([values[-1] - values[-2] for values in rows])


@measure
def distinct_ends(table: pd.DataFrame) -> list[float]:
    """Number of values of each relative phase over all rows, taken as one if within 0.02 rad (1)."""
    ends = table.sort_values(by="crossing").groupby("row").tail(1)
    steps = (np.diff(np.sort(numbers(ends, name))) for name in psi_columns(table, "_n"))
    return [float(1 + np.count_nonzero(change > 0.02)) for change in steps]


@measure
def gait_ends(table: pd.DataFrame, *, gait: str, phases: Sequence[str]) -> list[float]:
    """Median settled values of relative phases in a gait (rad)."""
    rows = _settled(table, gait)
    return [float(np.median(numbers(rows, f"{phase}_end"))) for phase in phases]


@measure
def free_range(table: pd.DataFrame, *, gait: str, phase: str) -> list[float]:
    """Smallest and largest settled value of a relative phase in a gait (rad)."""
    values = numbers(_settled(table, gait), f"{phase}_end")
    return [float(values.min()), float(values.max())]


def _settled(table: pd.DataFrame, gait: str) -> pd.DataFrame:
    """The settled relative phases of the rows of one gait, columns psi_1_end, ..."""
    rows = records(table, f"gait == '{gait}' and status == 'settled'")
    return pd.DataFrame(rows[psi_columns(table, "_end")])


@measure
def angles_of_lines(table: pd.DataFrame) -> list[float]:
    """Angles between the lines of direct and source, and of source and retrograde waves (deg)."""
    directions = []
    for gait in WAVES:
        states = np.asarray(_settled(table, gait), float)
        directions.append(np.linalg.svd(states - states.mean(axis=0), full_matrices=False)[2][0])
    pairs = ((0, 1), (1, 2))
    cosines = [min(1.0, abs(float(directions[i] @ directions[j]))) for i, j in pairs]
    return [float(np.degrees(np.arccos(cosine))) for cosine in cosines]


@measure
def distance_from_planes(table: pd.DataFrame) -> float:
    """Largest distance of settled states from the nearer of two planes, one of psi_1, one of psi_3 (rad).

    The planes are at the medians of psi_1 over direct and source waves, and of psi_3 over source and
    retrograde waves.
    """
    first = np.median(np.concatenate([numbers(_settled(table, gait), "psi_1_end") for gait in WAVES[:2]]))
    third = np.median(np.concatenate([numbers(_settled(table, gait), "psi_3_end") for gait in WAVES[1:]]))
    rows = masked(table, table["status"] == "settled")
    away = np.minimum(
        np.abs(wrapped_difference(numbers(rows, "psi_1_end") - first)),
        np.abs(wrapped_difference(numbers(rows, "psi_3_end") - third)),
    )
    return float(away.max())


@measure
def slopes_of_segments(
    table: pd.DataFrame, *, gait: str, free: str, other: str, within: float = 0.06, beyond: float = 0.5
) -> list[float]:
    """Slopes of a relative phase over the free one: near the smallest free value, and far from it (1).

    Args:
        gait: direct, source or retrograde.
        free, other: such as psi_2, psi_3.
        within, beyond: how far (rad) the free phase is from its smallest value at most, and at least.
    """
    rows = _settled(table, gait)
    x, y = numbers(rows, f"{free}_end"), numbers(rows, f"{other}_end")
    above = x - x.min()
    return [float(np.polyfit(x[near], y[near], 1)[0]) for near in (above <= within, above >= beyond)]


@measure
def gap_between_lines(table: pd.DataFrame) -> list[float]:
    """Smallest distances of settled direct and source, and source and retrograde waves (rad)."""
    gaps = []
    for one, other in (("direct", "source"), ("source", "retrograde")):
        states, others = (np.asarray(_settled(table, gait), float) for gait in (one, other))
        away = (np.asarray(wrapped_difference(others - state)) for state in states)
        gaps.append(float(min(np.sqrt((lags**2).sum(axis=1)).min() for lags in away)))
    return gaps
