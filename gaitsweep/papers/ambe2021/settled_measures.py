"""Measures of settled states: their gaits, basins, lines of solutions, and distance from the theory."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from gaitsweep.analyses import TURN, mean_direction, require, wrapped_difference
from gaitsweep.claims import Condition, MeasureError, masked, measure, numbers, records, value
from gaitsweep.papers.ambe2021.analysis.gait_shares import gait_shares
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import psi_columns
from gaitsweep.papers.ambe2021.theory.gaits import GAITS, WAVES

_FAR = 0.5  # rad from the smallest value of a free phase, at least
_SAME_WITHIN = 0.02  # rad, between values of a relative phase that count as one


@measure
def three_gaits(table: pd.DataFrame, *, where: Condition | None = None) -> float:
    """Share of the sets of parameters at which all three gaits occur, among those of a condition (1).

    Args:
        table: a settle table, several starts for each set of parameters.
        where: a condition over the columns of `gait_shares`, such as `conditions`.

    Raises:
        AnalysisError: the table lacks a column, or no set of parameters fulfils the condition.
    """
    chosen = records(gait_shares(table), where)
    return float(np.mean((np.asarray(chosen[list(WAVES)]) > 0.0).all(axis=1)))


@measure
def no_gaits(table: pd.DataFrame, *, where: Condition, less: Condition) -> float:
    """Share of sets of parameters without any of the three gaits: of one condition minus of another (1).

    Args:
        table: a settle table, several starts for each set of parameters.
        where, less: the two conditions, over the columns of `gait_shares`.

    Raises:
        AnalysisError: as for `three_gaits`.
    """
    shares = gait_shares(table)

    def share_without(condition: Condition) -> float:
        return float(np.mean((np.asarray(records(shares, condition)[list(WAVES)]) == 0.0).all(axis=1)))

    return share_without(where) - share_without(less)


@measure
def gaits_left(table: pd.DataFrame, *, where: Condition) -> list[str]:
    """The gaits in which the settled rows of a condition end, in the order of the gaits.

    Args:
        table: a settle table with the gait of each row.
        where: a condition over its columns.

    Raises:
        AnalysisError: the table lacks a column, or no settled row fulfils the condition.
    """
    require(table, "gait", "status")
    ends = set(records(records(table, where), "status == 'settled'")["gait"].astype(str))
    return [gait for gait in GAITS if gait in ends]


@measure
def distance_share(table: pd.DataFrame) -> float:
    """Largest distance from the analytic solutions as a share of 2 pi (%).

    Args:
        table: a settle table.

    Raises:
        MeasureError: the table is empty or lacks the column distance.
    """
    return float(100.0 * numbers(records(table, None), "distance").max() / TURN)


@measure
def distance_over_lag(table: pd.DataFrame, *, low: float, high: float) -> float:
    """Largest distance from the analytic solutions at one tau over that at another (1).

    Args:
        table: a settle table in which tau varies.
        low, high: the two values of tau, s.

    Raises:
        AnalysisError: the table lacks a column, or no row settles at one of the values.
    """
    require(table, "tau")

    def largest(tau: float) -> float:
        rows = masked(table, table["tau"] == tau)
        return value(rows, column="distance", where="status == 'settled'", take="max")

    return largest(low) / largest(high)


@measure
def slice_shares(table: pd.DataFrame, *, number: int) -> list[float]:
    """Shares of direct, source and retrograde waves on one slice of psi_3, in their order (1).

    Args:
        table: the gaits from a grid of psi_1, psi_2, psi_3.
        number: that of the value of psi_3, from 0 in ascending order.

    Raises:
        AnalysisError: the table lacks a column or the slice.
    """
    gaits = np.asarray(_slice(table, number)["gait"], str)
    return [float(np.mean(gaits == gait)) for gait in WAVES]


@measure
def largest_part(table: pd.DataFrame, *, number: int) -> list[float]:
    """Shares of the starts of direct, source, retrograde in one connected part, on the torus (1).

    Parts with at most one cell between them count as one, since the grid does not resolve the gap.

    Args:
        table: the gaits from a grid of psi_1, psi_2, psi_3.
        number: that of the value of psi_3, from 0 in ascending order.

    Raises:
        AnalysisError: the table lacks a column or the slice, or a gait does not occur on it.
    """
    cells = _slice(table, number).pivot(index="psi_2", columns="psi_1", values="gait").to_numpy()
    return [float(max(_parts(cells == gait)) / np.count_nonzero(cells == gait)) for gait in WAVES]


def _slice(table: pd.DataFrame, number: int) -> pd.DataFrame:
    """The rows of one value of psi_3, numbered in ascending order."""
    require(table, "psi_1", "psi_2", "psi_3", "gait")
    values = np.unique(table["psi_3"])
    if not 0 <= number < len(values):
        raise MeasureError(f"The table has no slice {number}: psi_3 has {len(values)} values.")
    return masked(table, table["psi_3"] == values[number])


def _parts(mask: Bool[np.ndarray, "rows columns"]) -> Int[np.ndarray, " parts"]:
    """The numbers of cells of the connected parts of a mask on the torus; gaps of one cell do not part."""
    if not mask.any():
        raise MeasureError("A gait does not occur on the slice.")
    cell = np.arange(mask.size).reshape(mask.shape)
    # to all cells with at most one cell between, half of them: the others are the same pairs
    shifts = [shift for shift in itertools.product(range(3), range(-2, 3)) if shift > (0, 0)]
    pairs = []
    for shift in shifts:
        back = tuple(-cells for cells in shift)  # np.roll moves the neighbour at `shift` to the cell itself
        both = mask & np.roll(mask, back, (0, 1))
        pairs.append((cell[both], np.roll(cell, back, (0, 1))[both]))
    i, j = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    graph = coo_matrix((np.ones(len(i)), (i, j)), shape=(mask.size, mask.size))
    _, labels = connected_components(graph, directed=False)
    return np.unique(labels[mask.ravel()], return_counts=True)[1]


@measure
def last_change(table: pd.DataFrame) -> float:
    """Largest change of a relative phase over the last cycle of any row (rad).

    Args:
        table: a return map's table.

    Raises:
        MeasureError: there is no row, or one has fewer than two crossings.
    """
    return float(np.abs(wrapped_difference(last_steps(table, psi_columns(table, "_n")))).max())


def last_steps(table: pd.DataFrame, names: list[str]) -> Float[np.ndarray, "rows columns"]:
    """The change of columns from the last but one to the last crossing of each row.

    Raises:
        MeasureError: there is no row, or one has fewer than two crossings.
    """
    rows = [part.sort_values(by="crossing")[names].to_numpy(float) for _, part in table.groupby("row")]
    if not rows:
        raise MeasureError("The table is empty.")
    if min(map(len, rows)) < 2:
        raise MeasureError("A row has fewer than two crossings.")
    return np.stack([values[-1] - values[-2] for values in rows])


@measure
def distinct_ends(table: pd.DataFrame) -> list[float]:
    """Number of values of each relative phase over all rows, taken as one if within 0.02 rad (1).

    Args:
        table: a return map's table.

    Raises:
        MeasureError: the table is empty, or no row ends with a value of a relative phase.
    """
    ends = records(table, None).sort_values(by="crossing").groupby("row").tail(1)
    counts = []
    for name in psi_columns(table, "_n"):
        values = np.sort(ends[name].dropna().to_numpy(float) % TURN)
        if not values.size:
            raise MeasureError(f"No row ends with a value of {name}.")
        gaps = np.diff(values, append=values[:1] + TURN)  # around the circle
        counts.append(float(max(1, np.count_nonzero(gaps > _SAME_WITHIN))))
    return counts


@measure
def gait_ends(table: pd.DataFrame, *, gait: str, phases: Sequence[str]) -> list[float]:
    """Median settled values of relative phases in a gait (rad), from 0 to 2 pi.

    Args:
        table: a settle table with the gait of each row.
        gait: direct, source or retrograde.
        phases: relative phases, such as psi_1, psi_2.

    Raises:
        MeasureError: no settled row has one of the gaits.
        AnalysisError: the table lacks a column.
    """
    rows = _settled(table, gait)
    return [float(np.median(numbers(rows, f"{phase}_end")) % TURN) for phase in phases]


@measure
def free_range(table: pd.DataFrame, *, gait: str, phase: str) -> list[float]:
    """Smallest and largest settled value of a relative phase in a gait (rad).

    Of a range that goes over 2 pi, one of the two lies outside of [0, 2 pi).

    Args:
        table: a settle table with the gait of each row.
        gait: direct, source or retrograde.
        phase: a relative phase, such as psi_1.

    Raises:
        MeasureError: no settled row has one of the gaits.
        AnalysisError: the table lacks a column.
    """
    values = numbers(_settled(table, gait), f"{phase}_end")
    return [float(values.min()), float(values.max())]


def _settled(table: pd.DataFrame, gait: str) -> pd.DataFrame:
    """The settled relative phases (rad) of the rows of one gait; a range over 2 pi is in one piece."""
    require(table, "gait", "status")
    rows = masked(table, (table["gait"] == gait) & (table["status"] == "settled"))
    if rows.empty:
        raise MeasureError(f"No settled row of the table has the gait {gait}.")
    return pd.DataFrame({name: _together(numbers(rows, name)) for name in psi_columns(table, "_end")})


def _together(angles: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
    """Angles (rad), on the turn about their mean direction where they lie closer together there."""
    mean = mean_direction(angles)
    about_mean = mean + wrapped_difference(angles - mean)
    return about_mean if np.ptp(about_mean) < np.ptp(angles) - _SAME_WITHIN else angles


@measure
def angles_of_lines(table: pd.DataFrame) -> list[float]:
    """Angles between the lines of direct and source, and of source and retrograde waves (deg).

    Args:
        table: a settle table with the gait of each row.

    Raises:
        MeasureError: no two settled rows of one of the gaits differ, so that they are on no line.
        AnalysisError: the table lacks a column.
    """
    directions = []
    for gait in WAVES:
        states = np.asarray(_settled(table, gait), float)
        if np.ptp(states, axis=0).max() <= _SAME_WITHIN:
            raise MeasureError(f"A line needs two settled rows of the gait {gait} that differ.")
        directions.append(np.linalg.svd(states - states.mean(axis=0), full_matrices=False)[2][0])
    cosines = [min(1.0, abs(float(one @ other))) for one, other in itertools.pairwise(directions)]
    return [float(np.degrees(np.arccos(cosine))) for cosine in cosines]


@measure
def distance_from_planes(table: pd.DataFrame) -> float:
    """Largest distance of settled states from the nearer of two planes, one of psi_1, one of psi_3 (rad).

    The planes are at the medians of psi_1 over direct and source waves, and of psi_3 over source and
    retrograde waves.

    Args:
        table: a settle table with the gait of each row.

    Raises:
        MeasureError: no settled row has one of the gaits.
        AnalysisError: the table lacks a column.
    """

    def median(name: str, gaits: Sequence[str]) -> float:
        return float(np.median(_together(np.concatenate([numbers(_settled(table, g), name) for g in gaits]))))

    first, third = median("psi_1_end", WAVES[:2]), median("psi_3_end", WAVES[1:])
    rows = masked(table, table["status"] == "settled")
    away = np.minimum(
        np.abs(wrapped_difference(numbers(rows, "psi_1_end") - first)),
        np.abs(wrapped_difference(numbers(rows, "psi_3_end") - third)),
    )
    return float(away.max())


@measure
def slopes_of_segments(
    table: pd.DataFrame, *, gait: str, free: str, other: str, within: float = 0.06
) -> list[float]:
    """Slopes of a relative phase over the free one: near the smallest free value, and far from it (1).

    Args:
        table: a settle table with the gait of each row.
        gait: direct, source or retrograde.
        free, other: such as psi_2, psi_3.
        within: how far (rad) the free phase is from its smallest value at most, where it is near.

    Raises:
        MeasureError: no settled row has the gait, or fewer than two are near, or far.
        AnalysisError: the table lacks a column.
    """
    rows = _settled(table, gait)
    x, y = numbers(rows, f"{free}_end"), numbers(rows, f"{other}_end")
    above = x - x.min()
    segments = (above <= within, above >= _FAR)
    if any(np.count_nonzero(segment) < 2 for segment in segments):
        raise MeasureError(
            f"A slope needs two settled rows of the gait {gait}, both within {within:g} rad of the smallest "
            f"{free}, and both {_FAR:g} rad or more from it."
        )
    return [float(np.polyfit(x[segment], y[segment], 1)[0]) for segment in segments]


@measure
def gap_between_lines(table: pd.DataFrame) -> list[float]:
    """Smallest distances of settled direct and source, and source and retrograde waves (rad).

    Args:
        table: a settle table with the gait of each row.

    Raises:
        MeasureError: no settled row has one of the gaits.
        AnalysisError: the table lacks a column.
    """
    gaps = []
    for one, other in itertools.pairwise(WAVES):
        states, others = (np.asarray(_settled(table, gait), float) for gait in (one, other))
        away = (np.asarray(wrapped_difference(others - state)) for state in states)
        gaps.append(float(min(np.sqrt((lags**2).sum(axis=1)).min() for lags in away)))
    return gaps
