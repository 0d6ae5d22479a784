"""Measures of the gaits of the planar quadruped: their shares, speeds, and columns by gait."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.analyses import require
from gaitsweep.claims import Condition, MeasureError, masked, measure, numbers, one_row, records
from gaitsweep.claims import value as median_of
from gaitsweep.papers.fukuoka2015.analysis.body_oscillation import body_oscillation
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import cases_of, gaits_in
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, family


@measure
def gait_share(
    table: pd.DataFrame, *, gaits: Sequence[str], where: Condition | None = None, begin: float = -math.inf
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
def nearest_speed(table: pd.DataFrame, *, gait: str, speed: float, where: Condition | None = None) -> float:
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
def parameter_sets_with(table: pd.DataFrame, *, gaits: Sequence[str]) -> float:
    """Number of parameter sets at which different starts come to each of the gaits (1).

    Args:
        table: a settle table, several starts for each set of parameters.
        gaits: names of the gaits.
    """
    require(table, "gait")
    shown = table.assign(gait=table["gait"].astype(str)).groupby(cases_of(table))["gait"].agg(set)
    return float(sum(set(gaits) <= gaits_of_set for gaits_of_set in shown))


@measure
def difference_of_medians(table: pd.DataFrame, *, column: str, where: Condition, less: Condition) -> float:
    """Median of a column in the records of one condition, less that in the records of another (its unit).

    Args:
        table: any table.
        column: its column.
        where, less: the two conditions.
    """
    return median_of(table, column=column, where=where) - median_of(table, column=column, where=less)


@measure
def pitch_cycles(table: pd.DataFrame, *, where: Condition | None = None) -> float:
    """Pitch oscillations in a gait cycle, 1 or 2: the larger amplitude; median over the rows (1)."""
    oscillation = body_oscillation(records(table, where))
    return float(np.median(np.where(oscillation["twice"] > oscillation["once"], 2.0, 1.0)))


@measure
def largest_deviation(
    table: pd.DataFrame, *, column: str, value: float, where: Condition | None = None
) -> float:
    """Largest distance of a column from a value (its unit).

    Args:
        table: any table.
        column: its column.
        value: in the column's unit.
        where: a condition that selects records.

    Raises:
        MeasureError: no record has a number in the column.
    """
    require(table, column)
    deviations = np.abs(numbers(records(table, where), column) - value)
    if np.all(np.isnan(deviations)):
        raise MeasureError(f"No record has a number in the column {column}.")
    return float(np.nanmax(deviations))


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
