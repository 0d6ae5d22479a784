"""Measures of waves: lags, orders of touchdown, drifts, sources, and shares of gaits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.claims import Condition, measure, numbers, one_row, records
from gaitsweep.papers.ambe2021.analysis.travelling_wave import passages, waves
from gaitsweep.papers.ambe2021.equation_measures import chain_defaults
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import relative_phases, springs_of
from gaitsweep.papers.ambe2021.theory.chain import Chain, wavelength
from gaitsweep.papers.ambe2021.theory.gaits import free_link, nearest_set


@measure
def settled_phases(table: pd.DataFrame, *, row: int) -> list[float]:
    """Relative phases on section 1 at the end of a row of a trace (rad)."""
    return [float(phase) for phase in relative_phases(one_row(table, row), springs_of(table))]


@measure
def leads(table: pd.DataFrame, *, row: int, links: Sequence[int] | None = None) -> list[float]:
    """The time by which each leg swings before the one in front of it, times omega (rad)."""
    part, N = one_row(table, row), springs_of(table)
    swings = passages(part, N)
    return [float(swings.leads[link - 1]) * chain_defaults()["omega"] for link in links or range(1, N + 1)]


@measure
def directions(table: pd.DataFrame, *, row: int) -> list[str]:
    """Direction in which swings pass over each link: forwards, backwards, or free where the lag is free."""
    part, N = one_row(table, row), springs_of(table)
    swings = passages(part, N)
    branch, _ = nearest_set(N, Chain(), relative_phases(part, N))
    words = ["forwards" if lead < swings.period / 2 else "backwards" for lead in swings.leads]
    words[free_link(N, branch) - 1] = "free"
    return words


@measure
def unequal_intervals(table: pd.DataFrame, *, row: int) -> float:
    """Largest difference of the intervals between swings of a row's wave, over their mean (1)."""
    wave = waves(one_row(table, row))
    return float(numbers(wave, "spread")[0] / numbers(wave, "lag")[0])


@measure
def one_swing_share(table: pd.DataFrame, *, row: int, of: Sequence[int]) -> float:
    """Smallest share of time with at most one leg in the air among adjacent legs of a wavelength (1).

    Args:
        table: a trace.
        row: its row.
        of: legs that follow one another in a wave; a wavelength is the next smaller whole number of legs.
    """
    part, beta, width = one_row(table, row), chain_defaults()["beta"], int(wavelength())
    # a foot may leave the ground for a moment after its touchdown: this is part of the stance
    air = np.stack(
        [
            (numbers(part, f"contact_{leg}") < 0.5) & (numbers(part, f"phase_{leg}") > 2 * beta * np.pi)
            for leg in of
        ]
    )
    starts = range(max(1, len(air) - width + 1))
    return float(min((air[i : i + width].sum(axis=0) <= 1).mean() for i in starts))


@measure
def worst_ratio(table: pd.DataFrame, *, column: str, over: str, where: Condition | None = None) -> float:
    """The ratio of two columns of measured waves that is farthest from 1, over rows of a condition (1)."""
    measured = records(waves(table), where)
    ratio = numbers(measured, column) / numbers(measured, over)
    return float(ratio[np.abs(ratio - 1.0).argmax()])


@measure
def smallest_rise(table: pd.DataFrame, *, column: str) -> float:
    """Smallest rise of a column of measured waves from one duty factor to the next, in its unit."""
    means = waves(table).groupby("beta")[[column]].mean()
    return float(np.diff(numbers(pd.DataFrame(means), column)).min())
