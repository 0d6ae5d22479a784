"""Measures of Ambe, Aoi, Tsuchiya and Matsuno (2021): relative phases, gaits and waves in simulations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from gaitsweep.analyses import wrapped_difference
from gaitsweep.claims import Condition, MeasureError, masked, measure, numbers, one_row, records
from gaitsweep.papers.ambe2021.analysis.gait_shares import GAITS, gait_shares
from gaitsweep.papers.ambe2021.analysis.source_place import source_drift, source_place
from gaitsweep.papers.ambe2021.analysis.travelling_wave import passages, springs_of, waves
from gaitsweep.papers.ambe2021.measures.equations import chain_defaults
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import relative_phases
from gaitsweep.papers.ambe2021.multilegged.model import LANDING, STANCE, TAKEOFF
from gaitsweep.papers.ambe2021.theory.chain import Chain, wavelength
from gaitsweep.papers.ambe2021.theory.gaits import GAITS as LABELS
from gaitsweep.papers.ambe2021.theory.gaits import free_link, nearest_set
from gaitsweep.papers.ambe2021.theory.reset_sets import TABLE_2


@measure
def last_change(table: pd.DataFrame) -> float:
    """Largest change of a relative phase over the last cycle of any row (rad)."""
    names = [name for name in table.columns if name.startswith("psi_") and name.endswith("_n")]
    return float(np.abs(wrapped_difference(_last_steps(table, names))).max())


def _last_steps(table: pd.DataFrame, names: list[str]) -> np.ndarray:
    """The change of columns from the last but one to the last crossing of each row."""
    rows = [part.sort_values(by="crossing")[names].to_numpy(float) for _, part in table.groupby("row")]
    if min(map(len, rows)) < 2:
        raise MeasureError("A row has fewer than two crossings.")
    return np.stack([each[-1] - each[-2] for each in rows])


@measure
def distinct_ends(table: pd.DataFrame, *, within: float = 0.02) -> list[float]:
    """Number of values of each relative phase over all rows, taken as one if within `within` rad (1)."""
    counts = []
    for name in [name for name in table.columns if name.startswith("psi_") and name.endswith("_n")]:
        parts = (part.sort_values(by="crossing") for _, part in table.groupby("row"))
        ends = np.sort([numbers(part, name)[-1] for part in parts])
        counts.append(float(1 + np.count_nonzero(np.diff(ends) > within)))
    return counts


@measure
def gait_ends(table: pd.DataFrame, *, gait: str, phases: Sequence[str]) -> list[float]:
    """Median settled values of relative phases in a gait (rad)."""
    rows = _settled(table, gait)
    return [float(np.median(numbers(rows, f"{each}_end"))) for each in phases]


@measure
def free_range(table: pd.DataFrame, *, gait: str, phase: str) -> list[float]:
    """Smallest and largest settled value of a relative phase in a gait (rad)."""
    values = numbers(_settled(table, gait), f"{phase}_end")
    return [float(values.min()), float(values.max())]


def _settled(table: pd.DataFrame, gait: str) -> pd.DataFrame:
    """The settled relative phases of the rows of one gait, columns psi_1_end, ..."""
    rows = masked(table, (table["gait"] == gait) & (table["status"] == "settled"))
    if rows.empty:
        raise MeasureError(f"No row has settled in the gait {gait}.")
    names = [name for name in table.columns if name.startswith("psi_") and name.endswith("_end")]
    return pd.DataFrame(rows[names])


@measure
def angles_of_lines(table: pd.DataFrame) -> list[float]:
    """Angles between the lines of direct and source, and of source and retrograde waves (deg)."""
    ways = []
    for gait in GAITS:
        states = np.asarray(_settled(table, gait), float)
        ways.append(np.linalg.svd(states - states.mean(axis=0), full_matrices=False)[2][0])
    pairs = ((0, 1), (1, 2))
    return [float(np.degrees(np.arccos(min(1.0, abs(float(ways[i] @ ways[j])))))) for i, j in pairs]


@measure
def distance_from_planes(table: pd.DataFrame) -> float:
    """Largest distance of settled states from the nearer of two planes, one of psi_1, one of psi_3 (rad).

    The planes are at the medians of psi_1 over direct and source waves, and of psi_3 over source and
    retrograde waves.
    """
    first = np.median(np.concatenate([numbers(_settled(table, each), "psi_1_end") for each in GAITS[:2]]))
    third = np.median(np.concatenate([numbers(_settled(table, each), "psi_3_end") for each in GAITS[1:]]))
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
    found = []
    for one, other in (("direct", "source"), ("source", "retrograde")):
        a, b = (np.asarray(_settled(table, each), float) for each in (one, other))
        nearest = [np.sqrt((np.asarray(wrapped_difference(b - each)) ** 2).sum(axis=1)).min() for each in a]
        found.append(float(min(nearest)))
    return found


@measure
def slice_shares(table: pd.DataFrame, *, slice: int) -> list[float]:
    """Shares of direct, source and retrograde waves on one slice of psi_3, in their order, from 0 (1)."""
    gaits = np.asarray(_slice(table, slice)["gait"], str)
    return [float(np.mean(gaits == gait)) for gait in GAITS]


@measure
def largest_part(table: pd.DataFrame, *, slice: int) -> list[float]:
    """Shares of the starts of direct, source, retrograde in one connected part, on the torus (1).

    Parts with at most one cell between them count as one, since the grid does not resolve the gap.
    """
    cells = _slice(table, slice).pivot(index="psi_2", columns="psi_1", values="gait").to_numpy()
    return [float(max(_parts(cells == gait)) / np.count_nonzero(cells == gait)) for gait in GAITS]


def _slice(table: pd.DataFrame, number: int) -> pd.DataFrame:
    values = np.unique(table["psi_3"])
    if number >= len(values):
        raise MeasureError(f"The table has no slice {number}: psi_3 has {len(values)} values.")
    return masked(table, table["psi_3"] == values[number])


def _parts(mask: np.ndarray) -> np.ndarray:
    """The numbers of cells of the connected parts of a mask on the torus; gaps of one cell do not part."""
    if not mask.any():
        raise MeasureError("A gait does not occur on the slice.")
    cell = np.arange(mask.size).reshape(mask.shape)
    shifts = [(down, right) for down in range(3) for right in range(-2, 3) if (down, right) > (0, 0)]
    pairs = []
    for shift in shifts:
        there = tuple(-each for each in shift)
        both = mask & np.roll(mask, there, (0, 1))
        pairs.append((cell[both], np.roll(cell, there, (0, 1))[both]))
    i, j = (np.concatenate(each) for each in zip(*pairs, strict=True))
    graph = coo_matrix((np.ones(len(i)), (i, j)), shape=(mask.size, mask.size))
    _, labels = connected_components(graph, directed=False)
    return np.unique(labels[mask.ravel()], return_counts=True)[1]


@measure
def settled_phases(table: pd.DataFrame, *, row: int) -> list[float]:
    """Relative phases on section 1 at the end of a row of a trace (rad)."""
    return [float(each) for each in relative_phases(one_row(table, row), springs_of(table))]


@measure
def leads(table: pd.DataFrame, *, row: int, links: Sequence[int] | None = None) -> list[float]:
    """The time by which each leg swings before the one in front of it, times omega (rad)."""
    part, N = one_row(table, row), springs_of(table)
    found = passages(part, N)
    return [float(found.leads[link - 1]) * chain_defaults()["omega"] for link in links or range(1, N + 1)]


@measure
def directions(table: pd.DataFrame, *, row: int) -> list[str]:
    """Direction in which swings pass over each link: forwards, backwards, or free where the lag is free."""
    part, N = one_row(table, row), springs_of(table)
    found = passages(part, N)
    branch, _ = nearest_set(N, Chain(), relative_phases(part, N))
    words = ["forwards" if lead < found.period / 2 else "backwards" for lead in found.leads]
    words[free_link(N, branch) - 1] = "free"
    return words


@measure
def unequal_intervals(table: pd.DataFrame, *, row: int) -> float:
    """Largest difference of the intervals between swings of a row's wave, over their mean (1)."""
    return wave_column(table, row=row, column="spread", over="lag")


@measure
def one_swing_share(table: pd.DataFrame, *, row: int, of: Sequence[int]) -> float:
    """Smallest share of time with at most one leg in the air among adjacent legs of a wavelength (1).

    Args:
        table: a trace.
        row: its row.
        of: legs that follow one another in a wave; a wavelength is the next smaller whole number of legs.
    """
    part, beta, width = one_row(table, row), chain_defaults()["beta"], int(wavelength())
    # in stance a foot leaves the ground for a moment after a touchdown, which is no swing
    air = np.stack(
        [
            (numbers(part, f"contact_{leg}") < 0.5) & (numbers(part, f"phase_{leg}") > 2 * beta * np.pi)
            for leg in of
        ]
    )
    starts = range(max(1, len(air) - width + 1))
    return float(min((air[i : i + width].sum(axis=0) <= 1).mean() for i in starts))


@measure
def simulated_order(table: pd.DataFrame, *, row: int, legs: Sequence[int]) -> str:
    """Legs in their order of passing mid-stance in a simulated cycle that begins with the first of them."""
    return " ".join(map(str, _order(table, row, legs)))


def _order(table: pd.DataFrame, row: int, legs: Sequence[int]) -> list[int]:
    found = passages(one_row(table, row), springs_of(table))
    behind = np.mod(-np.append(0.0, np.cumsum(found.leads)), found.period)  # of leg 1, s
    after = {leg: np.mod(behind[leg - 1] - behind[legs[0] - 1] + 1e-9, found.period) for leg in legs}
    return sorted(legs, key=lambda leg: after[leg])


@measure
def reset_set_numbers(table: pd.DataFrame, *, row: int, k: int) -> list[float]:
    """The number 1 to 8 of the set S of each leg, by the simulated order of a cycle from leg k on (1)."""
    legs = range(1, springs_of(table) + 2)
    turn = {
        leg: place for place, leg in enumerate(_order(table, row, [k, *(leg for leg in legs if leg != k)]))
    }
    beside = [[turn[j] < turn[i] if j in turn else None for j in (i - 1, i + 1)] for i in legs]
    return [float(TABLE_2[front, rear]) for front, rear in beside]


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
    right = []
    for leg in range(1, N + 2):
        down = numbers(part, f"contact_{leg}") > 0.5
        lands = np.flatnonzero(~down[:-1] & down[1:] & (segment[:-1, leg - 1] == LANDING))
        # a foot that bounces lands again within its landing segment
        lands = lands[np.diff(lands, prepend=-len(down)) > len(down) / 20]
        before = {leg - 1: {TAKEOFF} if leg < k else {STANCE, TAKEOFF} if leg == k else {STANCE}}
        before[leg + 1] = {STANCE} if leg < k else {TAKEOFF}
        if leg in (1, N + 1):  # an end's neighbour is in stance
            before = {2 if leg == 1 else N: {STANCE}}
        right += [all(segment[at, j - 1] in those for j, those in before.items()) for at in lands]
    return float(np.mean(right))


@measure
def touchdown_phases_apart(table: pd.DataFrame) -> float:
    """Largest difference of the legs' times from one passage of mid-stance to the next, times omega (rad)."""
    N, omega = springs_of(table), chain_defaults()["omega"]
    found = []
    for _, part in table.groupby("row"):
        part = part.sort_values(by="t")
        for leg in range(1, N + 2):
            pair = {"t": part["t"], "phase_1": part[f"phase_{leg}"], "phase_2": part[f"phase_{leg}"]}
            found.append(passages(pd.DataFrame(pair), 1).period)
    return float(omega * (max(found) - min(found)))


@measure
def period_in_phase(table: pd.DataFrame) -> list[float]:
    """Smallest and largest omega T over the rows, T the time between the last two crossings (rad).

    A leg touches down at this phase, since it is reset from there to 2 pi.
    """
    periods, omega = _last_steps(table, ["t"]), chain_defaults()["omega"]
    return [float(omega * periods.min()), float(omega * periods.max())]


@measure
def drift_of_sum(table: pd.DataFrame, *, row: int, cycles: int = 20) -> float:
    """Mean change of E, the sum of the relative phases, in a cycle over the last cycles of a row (rad)."""
    part = masked(table, table["row"] == row).sort_values(by="crossing").tail(cycles + 1)
    names = [name for name in part.columns if name.startswith("psi_") and name.endswith("_n")]
    E = np.sum([numbers(part, name) for name in names], axis=0)
    return float(np.mean(wrapped_difference(np.diff(E))))


@measure
def drift_over_law(table: pd.DataFrame, *, where: Condition | None = None) -> list[float]:
    """Smallest and largest drift of E over that of the law on a ground of finite stiffness (1).

    Args:
        table: a return_map table.
        where: a condition over the columns of `source_drift`, such as `m_slope != 0`.
    """
    found = records(source_drift(table), where)
    ratios = numbers(found, "drift") / numbers(found, "law_on_ground")
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


@measure
def wave_column(table: pd.DataFrame, *, row: int, column: str, over: str | None = None) -> float:
    """A column of the measured wave of a row of a trace, or its ratio to another column.

    Args:
        column, over: such as wavelength, speed, wavelength_27, speed_28, speed_exact.
    """
    found = waves(one_row(table, row))
    return float(numbers(found, column)[0] / (1.0 if over is None else numbers(found, over)[0]))


@measure
def worst_ratio(table: pd.DataFrame, *, column: str, over: str, where: Condition | None = None) -> float:
    """The ratio of two columns of measured waves that is farthest from 1, over rows of a condition (1)."""
    found = records(waves(table), where)
    ratio = numbers(found, column) / numbers(found, over)
    return float(ratio[np.abs(ratio - 1.0).argmax()])


@measure
def smallest_rise(table: pd.DataFrame, *, column: str, along: str = "beta") -> float:
    """Smallest rise of a column of measured waves from one value of a parameter to the next, in its unit."""
    found = waves(table)
    means = found.groupby(along)[[column]].mean()
    return float(np.diff(numbers(pd.DataFrame(means), column)).min())


@measure
def three_gaits(table: pd.DataFrame, *, where: Condition | None = None) -> float:
    """Share of the sets of parameters at which all three gaits occur, among those of a condition (1).

    Args:
        where: a condition over the columns of `gait_shares`, such as `conditions`.
    """
    chosen = records(gait_shares(table), where)
    return float(np.mean((np.asarray(chosen[list(GAITS)]) > 0.0).all(axis=1)))


@measure
def no_gaits(table: pd.DataFrame, *, where: Condition, less: Condition) -> float:
    """Share of sets of parameters without any of the three gaits: of one condition minus of another (1)."""
    shares = gait_shares(table)
    one, other = (
        float(np.mean((np.asarray(records(shares, each)[list(GAITS)]) == 0.0).all(axis=1)))
        for each in (where, less)
    )
    return one - other


@measure
def gaits_left(table: pd.DataFrame, *, where: Condition) -> list[str]:
    """The gaits in which the settled rows of a condition end, in the order of the gaits."""
    ends = set(records(records(table, where), "status == 'settled'", True)["gait"].astype(str))
    if not ends:
        raise MeasureError(f"No row of {where} has settled.")
    return [gait for gait in LABELS if gait in ends]


@measure
def distance_share(table: pd.DataFrame) -> float:
    """Largest distance from the analytic solutions as a share of 2 pi (%)."""
    return float(100.0 * numbers(table, "distance").max() / (2 * np.pi))


@measure
def distance_over_lag(table: pd.DataFrame, *, low: float, high: float) -> float:
    """Largest distance from the analytic solutions at one tau over that at another (1)."""
    largest = []
    for tau in (low, high):
        rows = masked(table, (table["status"] == "settled") & (table["tau"] == tau))
        if rows.empty:
            raise MeasureError(f"No row has settled at tau = {tau} s.")
        largest.append(numbers(rows, "distance").max())
    return float(largest[0] / largest[1])
