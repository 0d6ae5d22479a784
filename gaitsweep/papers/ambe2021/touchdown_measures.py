"""Measures of simulated touchdowns: their order, the phases of neighbours, and the cycle between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.claims import measure, numbers, one_row
from gaitsweep.papers.ambe2021.analysis.travelling_wave import passages
from gaitsweep.papers.ambe2021.equation_measures import chain_defaults
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import springs_of
from gaitsweep.papers.ambe2021.multilegged.state import LANDING, STANCE, TAKEOFF
from gaitsweep.papers.ambe2021.settled_measures import last_steps
from gaitsweep.papers.ambe2021.theory.order import sets_of_order


@measure
def simulated_order(table: pd.DataFrame, *, row: int, legs: Sequence[int]) -> str:
    """Legs in their order of passing mid-stance in a simulated cycle that begins with the first of them."""
    return " ".join(map(str, _order(table, row, legs)))


def _order(table: pd.DataFrame, row: int, legs: Sequence[int]) -> list[int]:
    """Legs in their order of passing mid-stance after the first of them."""
    swings = passages(one_row(table, row), springs_of(table))
    behind = np.mod(-np.append(0.0, np.cumsum(swings.leads)), swings.period)  # of leg 1, s
    after = {leg: np.mod(behind[leg - 1] - behind[legs[0] - 1] + 1e-9, swings.period) for leg in legs}
    return sorted(legs, key=lambda leg: after[leg])


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
    """
    part, N, beta = one_row(table, row), springs_of(table), chain_defaults()["beta"]
    phase = part[[f"phase_{leg}" for leg in range(1, N + 2)]].to_numpy(float)
    segment = np.digitize(np.mod(phase, 2 * np.pi), [2 * beta * np.pi, (1 + beta) * np.pi])
    agree = []
    for leg in range(1, N + 2):
        down = numbers(part, f"contact_{leg}") > 0.5
        lands = np.flatnonzero(~down[:-1] & down[1:] & (segment[:-1, leg - 1] == LANDING))
        # a foot that bounces lands again within its landing segment
        lands = lands[np.diff(lands, prepend=-len(down)) > len(down) / 20]
        before = {leg - 1: {TAKEOFF} if leg < k else {STANCE, TAKEOFF} if leg == k else {STANCE}}
        before[leg + 1] = {STANCE} if leg < k else {TAKEOFF}
        if leg in (1, N + 1):  # an end's neighbour is in stance
            before = {2 if leg == 1 else N: {STANCE}}
        agree += [all(segment[at, j - 1] in allowed for j, allowed in before.items()) for at in lands]
    return float(np.mean(agree))


@measure
def touchdown_phases_apart(table: pd.DataFrame) -> float:
    """Largest difference of the legs' times from one passage of mid-stance to the next, times omega (rad)."""
    N, omega = springs_of(table), chain_defaults()["omega"]
    periods = []
    for _, part in table.groupby("row"):
        part = part.sort_values(by="t")
        for leg in range(1, N + 2):
            pair = {"t": part["t"], "phase_1": part[f"phase_{leg}"], "phase_2": part[f"phase_{leg}"]}
            periods.append(passages(pd.DataFrame(pair), 1).period)
    return float(omega * (max(periods) - min(periods)))


@measure
def period_in_phase(table: pd.DataFrame) -> list[float]:
    """Smallest and largest omega T over the rows, T the time between the last two crossings (rad).

    A leg touches down at this phase, since it is reset from there to 2 pi.
    """
    periods, omega = last_steps(table, ["t"]), chain_defaults()["omega"]
    return [float(omega * periods.min()), float(omega * periods.max())]
