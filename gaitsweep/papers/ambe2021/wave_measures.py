"""Measures of simulated waves: lags, touchdowns, drift, and the place of their source."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep import ArgumentError
from gaitsweep.analyses import require, wrapped_difference
from gaitsweep.claims import Condition, MeasureError, measure, numbers, one_row, records, value
from gaitsweep.papers.ambe2021.analysis.travelling_wave import passages, source_drift, source_place, waves
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import (
    chain_of,
    constants_of,
    of_legs,
    relative_phases,
    set_columns,
    springs_of,
)
from gaitsweep.papers.ambe2021.multilegged.state import LANDING, STANCE, TAKEOFF
from gaitsweep.papers.ambe2021.settled_measures import last_steps
from gaitsweep.papers.ambe2021.theory.chain import wavelength
from gaitsweep.papers.ambe2021.theory.gaits import free_link, nearest_set
from gaitsweep.papers.ambe2021.theory.order import sets_of_order


@measure
def settled_phases(table: pd.DataFrame, *, row: int) -> list[float]:
    """Relative phases on section 1 at the end of a row of a trace (rad)."""
    return relative_phases(one_row(table, row)).tolist()


@measure
def leads(table: pd.DataFrame, *, row: int, links: Sequence[int] | None = None) -> list[float]:
    """The time by which each leg swings before the one in front of it, times omega (rad).

    Args:
        table: a trace.
        row: its row.
        links: numbers of the links between legs, from 1 on; by default all.

    Raises:
        ArgumentError: the chain does not have a link.
    """
    part = one_row(table, row)
    phases = passages(part).leads * constants_of(part, ["omega"])["omega"]
    if links is not None:
        phases = phases[_places("links", links, len(phases))]
    return phases.tolist()


def _places(argument: str, numbers_from_1: Sequence[int], count: int) -> list[int]:
    """The indices of legs or links with these numbers; refuses a number that none of them has."""
    for number in numbers_from_1:
        if not 1 <= number <= count:
            raise ArgumentError(f"{argument} has {number}, but the chain has {argument} 1 to {count}.")
    return [number - 1 for number in numbers_from_1]


@measure
def directions(table: pd.DataFrame, *, row: int) -> list[str]:
    """Direction in which swings pass over each link: forwards, backwards, or free where the lag is free."""
    part = one_row(table, row)
    N = springs_of(table)
    swings = passages(part)
    branch, _ = nearest_set(N, chain_of(table, part), relative_phases(part))
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

    Raises:
        ArgumentError: the chain does not have a leg, or has a profile, so that its waves have no wavelength.
    """
    part = one_row(table, row)
    width = int(wavelength(chain_of(table, part)))
    # a foot may leave the ground for a moment after its touchdown: this is part of the stance
    takeoff = 2 * constants_of(part, ["beta"])["beta"] * np.pi
    in_air = (of_legs(part, "contact") < 0.5) & (of_legs(part, "phase") > takeoff)
    in_air = in_air[:, _places("legs", of, in_air.shape[1])]
    starts = range(max(1, len(of) - width + 1))
    return float(min((in_air[:, i : i + width].sum(axis=1) <= 1).mean() for i in starts))


@measure
def worst_ratio(table: pd.DataFrame, *, column: str, over: str, where: Condition | None = None) -> float:
    """The ratio of two columns of measured waves that is farthest from 1, over rows of a condition (1).

    Args:
        table: a trace.
        column, over: columns of `waves`, numerator and denominator.
        where: a condition over the columns of `waves`.
    """
    measured = records(waves(table), where)
    ratio = numbers(measured, column) / numbers(measured, over)
    return float(ratio[np.abs(ratio - 1.0).argmax()])


@measure
def smallest_rise(table: pd.DataFrame, *, column: str) -> float:
    """Smallest rise of a column of measured waves from one duty factor to the next, in its unit."""
    measured = waves(table)
    require(measured, "beta", column)
    rises = np.diff(numbers(pd.DataFrame(measured.groupby("beta")[[column]].mean()), column))
    if not rises.size:
        raise MeasureError("A rise needs two duty factors at least.")
    return float(rises.min())


@measure
def simulated_order(table: pd.DataFrame, *, row: int, legs: Sequence[int]) -> str:
    """Legs in their order of passing mid-stance in a simulated cycle that begins with the first of them.

    Args:
        table: a trace.
        row: its row.
        legs: numbers of the legs.

    Raises:
        ArgumentError: the chain does not have a leg.
    """
    return " ".join(map(str, _order(table, row, legs)))


def _order(table: pd.DataFrame, row: int, legs: Sequence[int]) -> list[int]:
    """Legs in their order of passing mid-stance after the first of them."""
    swings = passages(one_row(table, row))
    behind = np.mod(-np.append(0.0, np.cumsum(swings.leads)), swings.period)  # of leg 1, s
    behind = behind[_places("legs", legs, len(behind))]
    after = np.mod(behind - behind[0] + 1e-9, swings.period)
    return [legs[i] for i in np.argsort(after, kind="stable")]


@measure
def reset_set_numbers(table: pd.DataFrame, *, row: int, k: int) -> list[float]:
    """The number 1 to 8 of the set S of each leg, by the simulated order of a cycle from leg k on (1)."""
    others = [leg for leg in range(1, springs_of(table) + 2) if leg != k]
    return [float(reset_set.number) for reset_set in sets_of_order(_order(table, row, [k, *others]))]


@measure
def neighbours_at_touchdown(table: pd.DataFrame, *, row: int, k: int) -> float:
    """Share of touchdowns at which both neighbours are in the segments of Fig. 8, in a source wave (1).

    Args:
        table: a trace.
        row: its row.
        k: the leg at the boundary of the source wave.

    Raises:
        MeasureError: no leg touches down.
    """
    part = one_row(table, row)
    N = springs_of(table)
    beta = constants_of(part, ["beta"])["beta"]
    phase = np.mod(of_legs(part, "phase"), 2 * np.pi)
    segment = np.digitize(phase, [2 * beta * np.pi, (1 + beta) * np.pi])
    agree = []
    for leg, down in enumerate(of_legs(part, "contact").T > 0.5, start=1):
        lands = np.flatnonzero(~down[:-1] & down[1:] & (segment[:-1, leg - 1] == LANDING))
        # a foot that bounces lands again within its landing segment
        elsewhere = np.cumsum(segment[:, leg - 1] != LANDING)
        lands = lands[np.diff(elsewhere[lands], prepend=-1) > 0]
        expected = _segments_of_neighbours(leg, N, k)
        agree += [all(segment[at, j - 1] in allowed for j, allowed in expected.items()) for at in lands]
    if not agree:
        raise MeasureError(f"No leg of row {row} touches down in the recorded time.")
    return float(np.mean(agree))


def _segments_of_neighbours(leg: int, N: int, k: int) -> dict[int, set[int]]:
    """The segments of Fig. 8 in which each neighbour of a leg may be at its touchdown, by their numbers.

    Args:
        leg: 1 .. N+1.
        N: springs.
        k: the leg at the boundary of the source wave.
    """
    if leg in (1, N + 1):
        return {2 if leg == 1 else N: {STANCE}}
    if leg < k:
        return {leg - 1: {TAKEOFF}, leg + 1: {STANCE}}
    if leg == k:
        return {leg - 1: {STANCE, TAKEOFF}, leg + 1: {TAKEOFF}}
    return {leg - 1: {STANCE}, leg + 1: {TAKEOFF}}


@measure
def touchdown_phases_apart(table: pd.DataFrame) -> float:
    """Largest difference of the legs' times from one passage of mid-stance to the next, times omega (rad)."""
    periods = []
    for _, part in records(table, None).groupby("row"):
        part = part.sort_values(by="t")
        for leg in range(1, springs_of(table) + 2):
            # the period of `passages` is the mean over all legs of a table
            alone = {"t": part["t"], "phase_1": part[f"phase_{leg}"]}
            periods.append(passages(pd.DataFrame(alone)).period)
    return float(constants_of(table, ["omega"])["omega"] * (max(periods) - min(periods)))


@measure
def period_in_phase(table: pd.DataFrame) -> list[float]:
    """Smallest and largest omega T over the rows, T the time between the last two crossings (rad).

    A leg touches down at this phase, since it is reset from there to 2 pi.
    """
    periods = last_steps(table, ["t"])
    omega = constants_of(table, ["omega"])["omega"]
    return [float(omega * periods.min()), float(omega * periods.max())]


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
    starts = records(table, where)
    places = source_place(starts)
    parameters = set_columns(starts)
    sets = [part for _, part in places.groupby(parameters)] if parameters else [places]
    return float(min(np.count_nonzero(part["source"] > 0) for part in sets))


@measure
def meeting_share(table: pd.DataFrame, *, leg: int, where: Condition | None = None) -> float:
    """Share of the starts whose waves meet at a leg, the smallest over the sets of a condition (1).

    Args:
        table: a settle table, several starts for each set of parameters.
        leg: the leg's number.
        where: a condition over the table's columns.
    """
    return value(source_place(records(table, where)), column="meeting", where=f"leg == {leg}", take="min")


@measure
def mirror_error(table: pd.DataFrame) -> float:
    """Largest difference of the phases of row 0 from those of row 1 with the legs in reversed order (rad)."""
    first, second = (of_legs(one_row(table, row), "phase") for row in (0, 1))
    return float(np.abs(wrapped_difference(first - second[:, ::-1])).max())
