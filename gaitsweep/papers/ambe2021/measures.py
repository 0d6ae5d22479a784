"""The measures of Ambe, Aoi, Tsuchiya and Matsuno (2021): its equations, its theory, its simulations."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

import gaitsweep as gs
from gaitsweep.analyses import wrapped_difference
from gaitsweep.claims import (
    Condition,
    MeasureError,
    defaults,
    masked,
    measure,
    numbers,
    one_row,
    records,
    value,
)
from gaitsweep.expression import evaluate
from gaitsweep.papers.ambe2021.analysis.gait_shares import gait_shares
from gaitsweep.papers.ambe2021.analysis.source_place import source_drift, source_place
from gaitsweep.papers.ambe2021.analysis.travelling_wave import passages, waves
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import psi_columns, relative_phases, springs_of
from gaitsweep.papers.ambe2021.multilegged.mechanics import obstacle_problem
from gaitsweep.papers.ambe2021.multilegged.model import LANDING, STANCE, TAKEOFF, Multilegged
from gaitsweep.papers.ambe2021.multilegged.parameters import PARAMETERS
from gaitsweep.papers.ambe2021.multilegged.reduced import MultileggedReduced
from gaitsweep.papers.ambe2021.theory.chain import (
    Chain,
    end_resets,
    lag,
    touchdown_phase,
    wave_speed,
    wavelength,
)
from gaitsweep.papers.ambe2021.theory.gaits import GAITS, WAVES, free_link, gait_of, nearest_set
from gaitsweep.papers.ambe2021.theory.order import (
    TABLE_2,
    jumps,
    order_sets,
    reset_sets,
    sets_of_order,
    touchdown_residuals,
)
from gaitsweep.papers.ambe2021.theory.solution_sets import (
    Branch,
    LagRule,
    branches,
    lag_rules,
    places,
    rule_of,
    solution,
)
from gaitsweep.papers.ambe2021.theory.stability import (
    characteristic_polynomial,
    eigenvalues,
    linear_map,
    multipliers,
)


@functools.cache
def chain_defaults() -> dict[str, float]:
    """The default parameters of `multilegged`, those of Table 1, with its N."""
    return {"N": 3.0, **defaults(PARAMETERS)}


@measure
def chain_parameter(*, formula: str) -> float:
    """Value of a formula over the default parameters of `multilegged`, in the formula's unit."""
    return float(evaluate(formula, chain_defaults()))


@measure
def equation_of_motion() -> float:
    """Largest difference of the model's accelerations from eq. (1) at random states (m/s2)."""
    values, random, N = chain_defaults(), np.random.default_rng(1), 3
    model = Multilegged(N=N)
    params = model.params(_arrays(values))
    start = _arrays({f"psi_{i}": 1.0 for i in range(1, N + 1)} | {"phi_1": float("nan")})
    rest, acceleration = model.init(params, start), jax.jit(lambda state: model.flow(params, state)["v"])
    largest = 0.0
    for _ in range(20):
        x, v = random.uniform(0.5, 1.1, N + 1), random.uniform(-1.0, 1.0, N + 1)
        phi, y = random.uniform(0.0, 2 * np.pi, N + 1), random.uniform(0.0, 0.5, N + 1)
        length, rate = _printed_leg(phi, values)
        contact = length >= x  # eq. (2)
        segment = np.digitize(phi, [2 * values["beta"] * np.pi, (1 + values["beta"]) * np.pi])
        leaves = {"x": x, "v": v, "phi": phi, "y": y, "contact": contact, "segment": segment}
        state = dataclasses.replace(rest, **{name: jnp.asarray(leaf) for name, leaf in leaves.items()})
        theirs = _printed_acceleration(x, v, length, rate * (values["omega"] + y), contact, values)
        largest = max(largest, float(np.abs(np.asarray(acceleration(state)) - theirs).max()))
    return largest


def _arrays(values: Mapping[str, float]) -> dict[str, jax.Array]:
    """Values as arrays of JAX, by name."""
    return {name: jnp.asarray(value) for name, value in values.items()}


def _printed_leg(phi: np.ndarray, values: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Leg lengths (m) and their derivative by the phase (m/rad), eq. (3)."""
    beta, slope = values["beta"], values["a"] / ((1 - values["beta"]) * np.pi)
    takeoff, landing = phi - 2 * beta * np.pi, 2 * np.pi - phi
    segments = [phi <= 2 * beta * np.pi, phi < (1 + beta) * np.pi]
    length = values["L"] - slope * np.select(segments, [0.0 * phi, takeoff], landing)
    return length, np.select(segments, [0.0 * phi, 0.0 * phi - slope], slope)


def _printed_acceleration(
    x: np.ndarray,
    v: np.ndarray,
    length: np.ndarray,
    rate: np.ndarray,
    p: np.ndarray,
    values: Mapping[str, float],
) -> np.ndarray:
    """Accelerations (m/s2) of the masses, eq. (1).

    Args:
        x, v: heights (m) and velocities (m/s) of the masses.
        length, rate: lengths (m) of the legs and their derivatives (m/s).
        p: the paper's symbol for contact, 1 on the ground and 0 in the air.
        values: parameters by name.
    """
    masses = np.full(len(x), values["m"])
    masses[[0, -1]] = values["m_B"]
    force = -masses * values["g"] - p * (values["K"] * (x - length) + values["D"] * (v - rate))
    for i in range(len(x)):
        for j in (i - 1, i + 1):
            if 0 <= j < len(x):
                force[i] -= values["kappa"] * (x[i] - x[j]) + values["sigma"] * (v[i] - v[j])
    return force / masses


@measure
def leg_length_error(table: pd.DataFrame) -> float:
    """Largest difference of the traced leg lengths from eq. (3) of the traced phases (m)."""
    values, largest = chain_defaults(), 0.0
    for leg in range(1, springs_of(table) + 2):
        length, _ = _printed_leg(numbers(table, f"phase_{leg}"), values)
        largest = max(largest, float(np.abs(length - numbers(table, f"l_{leg}")).max()))
    return largest


@measure
def contact_as_printed(table: pd.DataFrame) -> float:
    """Share of the traced contacts that are those of eq. (2) (1)."""
    legs = range(1, springs_of(table) + 2)
    right = [
        (numbers(table, f"contact_{i}") > 0.5) == (numbers(table, f"l_{i}") >= numbers(table, f"x_{i}"))
        for i in legs
    ]
    return float(np.mean(right))


@measure
def air_in_swing(table: pd.DataFrame) -> float:
    """Share of takeoff and landing in which a leg is in the air, the smallest of all legs and rows (1)."""
    beta, shares = chain_defaults()["beta"], []
    for _, part in table.groupby("row"):
        for leg in range(1, springs_of(table) + 2):
            swing = part[part[f"phase_{leg}"] > 2 * beta * np.pi]
            shares.append(float(np.mean(numbers(pd.DataFrame(swing), f"contact_{leg}") < 0.5)))
    return min(shares)


@measure
def phase_gain(table: pd.DataFrame) -> float:
    """Gain of leg 1's phase on omega t from just before a touchdown to ten tau after it (rad)."""
    part, values = one_row(table, 0), chain_defaults()
    t, contact = numbers(part, "t"), numbers(part, "contact_1") > 0.5
    phase = np.unwrap(numbers(part, "phase_1"))
    down = np.flatnonzero(~contact[:-1] & contact[1:] & (np.mod(phase[:-1], 2 * np.pi) > 1.8 * np.pi))
    if not len(down) or t[down[0]] + 10 * values["tau"] > t[-1]:
        raise MeasureError("Leg 1 does not touch down early enough in the recorded time.")
    after = int(np.searchsorted(t, t[down[0]] + 10 * values["tau"]))
    gained = phase[after] - phase[down[0]] - values["omega"] * (t[after] - t[down[0]])
    return float(gained)


@measure
def force_balance_error() -> float:
    """Largest residual of the force balance, eq. (8), of heights and loads at random leg lengths (N)."""
    values, random, legs = chain_defaults(), np.random.default_rng(1), 4
    masses, heights = _masses(legs), _equilibrium(legs)
    largest = 0.0
    for _ in range(50):
        length = values["L"] - random.uniform(0.0, values["a"], legs)
        x, load = (np.asarray(solved)[0] for solved in heights(length[None]))
        pull = values["kappa"] * np.diff(x)
        sides = np.append(pull, 0.0) - np.append(0.0, pull) + load - masses * values["g"]
        in_the_air = np.where(x > length + 1e-12, np.abs(load), 0.0)
        largest = max(largest, float(np.abs(sides).max()), float(in_the_air.max()), -float(load.min()))
    return largest


def _masses(legs: int) -> np.ndarray:
    """Masses (kg) of a chain of legs, those of both ends m_B."""
    values = chain_defaults()
    return np.array([values["m_B"], *[values["m"]] * (legs - 2), values["m_B"]])


def _equilibrium(legs: int) -> Callable[[np.ndarray], tuple[jax.Array, jax.Array]]:
    """Heights and loads from leg lengths (n, legs), by eq. (8)."""
    values, masses = chain_defaults(), jnp.asarray(_masses(legs))
    kappa, g = jnp.full(legs - 1, values["kappa"]), jnp.asarray(values["g"])
    return jax.jit(jax.vmap(lambda length: obstacle_problem(length, masses, kappa, g)))


@measure
def height_error(table: pd.DataFrame) -> float:
    """Median distance of traced heights from those of force balance, eq. (8), at the same legs (m)."""
    legs = range(1, springs_of(table) + 2)
    lengths = np.asarray(table[[f"l_{i}" for i in legs]], float)
    solved, _ = _equilibrium(len(legs))(lengths)
    return float(np.median(np.abs(np.asarray(solved) - np.asarray(table[[f"x_{i}" for i in legs]], float))))


# shares of a set's range, without its middle, where two legs of A touch down at the same time
_INSIDE = (0.1, 0.3, 0.45, 0.7, 0.9)


@functools.cache
def _sets(N: int) -> list[tuple[Branch, float]]:
    """Each set of a chain at a few free phases."""
    return [(branch, _at(N, *branch, share)[2]) for branch in branches(N) for share in _INSIDE]


def _at(N: int, kind: str, k: int, share: float) -> tuple[Branch, LagRule, float]:
    """A set of solutions, its rule, and the free phase at a share of its range (rad)."""
    branch = _branch(kind, k)
    rule = rule_of(N, branch, Chain())
    return branch, rule, float(rule.low + share * (rule.high - rule.low))


def _branch(kind: str, k: int) -> Branch:
    """A set of solutions by its kind and boundary leg; refuses an unknown kind."""
    if kind not in ("A", "B", "direct"):
        raise MeasureError(f"kind is {kind}. Allowed: A, B, direct.")
    return Branch(kind, k)


@measure
def set_range(*, kind: str, k: int = 3, N: int = 3) -> list[float]:
    """Ends of the free phase on the section of leg k: psi_{k-1}, or psi_N of the direct wave (rad)."""
    rule = rule_of(N, _branch(kind, k), Chain())
    ends = [float(rule.low), float(rule.high)]
    return [2 * np.pi - ends[1], 2 * np.pi - ends[0]] if kind == "direct" else ends


@measure
def set_phase(*, kind: str, k: int, link: int, N: int = 9, at: float = 0.45) -> float:
    """The relative phase of one link on the section of leg k, at a share of the set's range (rad)."""
    _, rule, s = _at(N, kind, k, at)
    return float(solution(rule, jnp.asarray(s), touchdown_phase(Chain()), k)[link - 1])


@measure
def reduced_map_error(*, N: int = 3, kinds: Sequence[str] = ("A", "B", "direct"), step: int = 1) -> float:
    """Largest change in a cycle of the reduced chain from the solutions of sets of these kinds (rad).

    Args:
        N: springs.
        kinds: A, B or direct.
        step: every so many of the sets, for long chains.
    """
    chosen = [(branch, s) for branch, s in _sets(N) if branch.kind in kinds][::step]
    circle = touchdown_phase(Chain())
    psi = np.stack([np.asarray(_solution(N, branch, s, circle)) for branch, s in chosen])
    mapping, points = _reduced_map(N, psi)
    return float(np.abs(wrapped_difference(mapping(points).at - points.at)).max())


@functools.partial(jax.jit, static_argnums=(0, 1))
def _solution(N: int, branch: Branch, s: float, circle: jax.Array) -> jax.Array:
    return solution(rule_of(N, branch, Chain()), jnp.asarray(s), circle, 1)


def _reduced_map(N: int, psi: np.ndarray) -> tuple[gs.PoincareMap, Any]:
    """The simulated return map of the reduced chain, and its points at psi (n, N) on section 1."""
    mapping = gs.return_map(MultileggedReduced(N=N), numerics={"method": "propagator"})
    return mapping, mapping.settled({f"psi_{i + 1}": psi[:, i] for i in range(N)}, 0)


@measure
def reduced_multipliers(*, kind: str, k: int) -> list[float]:
    """Eigenvalues of the simulated return map of the reduced chain at a solution, in falling order (1)."""
    N = 3
    branch, _, s = _at(N, kind, k, 0.45)
    psi = _solution(N, branch, s, touchdown_phase(Chain()))
    mapping, points = _reduced_map(N, np.asarray(psi)[None])
    factors = mapping.multipliers(points)
    return sorted((float(factor) for factor in np.real(np.ravel(factors))), reverse=True)


@measure
def theory_eigenvalues(*, kind: str, k: int, N: int) -> list[float]:
    """Eigenvalues of the linear map of a cycle, eq. (21), in falling order (1)."""
    branch, _, s = _at(N, kind, k, 0.45)
    factors = eigenvalues(linear_map(N, branch, s))
    return sorted((float(factor) for factor in np.real(factors)), reverse=True)


@measure
def linear_map_error(*, N: int) -> float:
    """Largest difference of the coefficients of det(lambda - P_k) from those of eqs. (22) and (26) (1)."""
    largest = 0.0
    for branch, s in _sets(N):
        coefficients = characteristic_polynomial(linear_map(N, branch, s))
        largest = max(largest, float(np.abs(coefficients - np.poly(multipliers(N, branch))).max()))
    return largest


@measure
def touchdown_relation_error(*, N: int = 9) -> float:
    """Largest difference of the two sides of eq. (14) over the legs of all sets (m)."""
    return max(float(np.abs(touchdown_residuals(N, branch, s)).max()) for branch, s in _sets(N))


@measure
def table_2(*, number: int) -> list[str]:
    """Whether the legs in front of and behind a leg of the set S are reset before it: no, yes or none."""
    words = {None: "none", False: "no", True: "yes"}
    return [words[reset] for neighbours, known in TABLE_2.items() if known == number for reset in neighbours]


@measure
def order_sets_agree(*, N: int = 9) -> float:
    """Share of solutions at which T_1, T_2 of eq. (18) are the legs of S_3, or S_1, S_7 at the ends (1)."""
    agree = []
    for branch, s in _sets(N):
        sets = reset_sets(N, branch, s)
        alone = {i for i, reset_set in enumerate(sets, 1) if not reset_set.front and not reset_set.rear}
        first = {i for i in alone if i <= branch.k - 2}
        last = {i for i in alone if i >= branch.k + 2}
        agree.append(order_sets(N, branch, s) == (frozenset(first), frozenset(last)))
    return float(np.mean(agree))


@measure
def chain_of_sets(table: pd.DataFrame) -> float:
    """Largest gap between the end of a set and the beginning of the next in the chain of sets (rad)."""
    rules, circle, gaps = lag_rules(springs_of(table), Chain()), float(touchdown_phase(Chain())), []
    for i in range(len(rules.low) - 1):
        one, other = (jax.tree.map(lambda leaf, at=at: leaf[at], rules) for at in (i, i + 1))
        ends = [np.asarray(places(one, s)) for s in (one.low, one.high)]
        starts = [np.asarray(places(other, s)) for s in (other.low, other.high)]
        away = [np.abs((a - b + circle / 2) % circle - circle / 2).max() for a in ends for b in starts]
        gaps.append(min(away))
    return float(max(gaps))


@measure
def ends_of_chain(*, N: int) -> list[str]:
    """The gaits of the first and of the last set of the chain of sets."""
    return [GAITS[gait_of(branches(N)[at])] for at in (0, -1)]


@measure
def jump_sizes(table: pd.DataFrame) -> list[float]:
    """Smallest and largest size of the jumps of all sets on their own sections (rad)."""
    N = springs_of(table)
    sizes = [np.abs(jump.change).max() for branch in branches(N) for jump in jumps(N, branch)]
    if not sizes:
        raise MeasureError(f"The sets of a chain of {N + 1} legs have no jumps.")
    return [float(min(sizes)), float(max(sizes))]


@measure
def wave_numbers(*, which: str, beta: float = 0.8) -> float:
    """The theory's wavelength (legs), speed printed or exact (legs/s), or lag (rad), at a duty factor."""
    chain = Chain(beta=beta)
    speeds = wave_speed(chain_defaults()["omega"], chain)
    allowed = {
        "wavelength": wavelength(chain),
        "printed": speeds.printed,
        "exact": speeds.exact,
        "lag": lag(chain),
    }
    if which not in allowed:
        raise MeasureError(f"which is {which}. Allowed: {', '.join(allowed)}.")
    return float(allowed[which])


@measure
def end_touchdown(*, end: str, m_1: float = 0.9, m_end: float = 0.9) -> float:
    """Touchdown phase of the first or the last leg with its neighbour in stance (rad)."""
    head, tail = end_resets(Chain(m_1=m_1, m_end=m_end))
    return float(2 * np.pi - (head if end == "head" else tail))


@measure
def line_range(*, k: int, N: int = 3) -> list[float]:
    """Ends of psi_{k-1} over the solution sets A and B together (rad)."""
    return [set_range(kind="A", k=k, N=N)[0], set_range(kind="B", k=k, N=N)[1]]


@measure
def slopes_of_fig10(table: pd.DataFrame, *, k: int) -> list[float]:
    """Slopes of psi_k over psi_{k-1} along the solution sets A and B (1)."""
    slopes = []
    for kind in ("A", "B"):
        rule = rule_of(springs_of(table), _branch(kind, k), Chain())
        ends = [rule.low + share * (rule.high - rule.low) for share in (0.6, 0.8)]
        low, high = (np.asarray(solution(rule, s, touchdown_phase(Chain()), k)) for s in ends)
        slopes.append(float((high[k - 1] - low[k - 1]) / (high[k - 2] - low[k - 2])))
    return slopes


@measure
def shorter_set(*, k: int, N: int = 3) -> float:
    """Range of psi_{k-1} over the solution set A, over that over the set B (1)."""
    (a, b), (c, d) = set_range(kind="A", k=k, N=N), set_range(kind="B", k=k, N=N)
    return (b - a) / (d - c)


@measure
def last_change(table: pd.DataFrame) -> float:
    """Largest change of a relative phase over the last cycle of any row (rad)."""
    return float(np.abs(wrapped_difference(_last_steps(table, psi_columns(table, "_n")))).max())


def _last_steps(table: pd.DataFrame, names: list[str]) -> np.ndarray:
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
        a, b = (np.asarray(_settled(table, each), float) for each in (one, other))
        nearest = [np.sqrt((np.asarray(wrapped_difference(b - each)) ** 2).sum(axis=1)).min() for each in a]
        gaps.append(float(min(nearest)))
    return gaps


@measure
def slice_shares(table: pd.DataFrame, *, slice: int) -> list[float]:
    """Shares of direct, source and retrograde waves on one slice of psi_3, in their order, from 0 (1)."""
    gaits = np.asarray(_slice(table, slice)["gait"], str)
    return [float(np.mean(gaits == gait)) for gait in WAVES]


@measure
def largest_part(table: pd.DataFrame, *, slice: int) -> list[float]:
    """Shares of the starts of direct, source, retrograde in one connected part, on the torus (1).

    Parts with at most one cell between them count as one, since the grid does not resolve the gap.
    """
    cells = _slice(table, slice).pivot(index="psi_2", columns="psi_1", values="gait").to_numpy()
    return [float(max(_parts(cells == gait)) / np.count_nonzero(cells == gait)) for gait in WAVES]


def _slice(table: pd.DataFrame, number: int) -> pd.DataFrame:
    """The rows of one value of psi_3, numbered in ascending order."""
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
        back = tuple(-cells for cells in shift)  # np.roll moves the neighbour at `shift` to the cell itself
        both = mask & np.roll(mask, back, (0, 1))
        pairs.append((cell[both], np.roll(cell, back, (0, 1))[both]))
    i, j = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    graph = coo_matrix((np.ones(len(i)), (i, j)), shape=(mask.size, mask.size))
    _, labels = connected_components(graph, directed=False)
    return np.unique(labels[mask.ravel()], return_counts=True)[1]


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
    periods, omega = _last_steps(table, ["t"]), chain_defaults()["omega"]
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


@measure
def three_gaits(table: pd.DataFrame, *, where: Condition | None = None) -> float:
    """Share of the sets of parameters at which all three gaits occur, among those of a condition (1).

    Args:
        where: a condition over the columns of `gait_shares`, such as `conditions`.
    """
    chosen = records(gait_shares(table), where)
    return float(np.mean((np.asarray(chosen[list(WAVES)]) > 0.0).all(axis=1)))


@measure
def no_gaits(table: pd.DataFrame, *, where: Condition, less: Condition) -> float:
    """Share of sets of parameters without any of the three gaits: of one condition minus of another (1)."""
    shares = gait_shares(table)
    one, other = (
        float(np.mean((np.asarray(records(shares, condition)[list(WAVES)]) == 0.0).all(axis=1)))
        for condition in (where, less)
    )
    return one - other


@measure
def gaits_left(table: pd.DataFrame, *, where: Condition) -> list[str]:
    """The gaits in which the settled rows of a condition end, in the order of the gaits."""
    ends = set(records(records(table, where), "status == 'settled'")["gait"].astype(str))
    return [gait for gait in GAITS if gait in ends]


@measure
def distance_share(table: pd.DataFrame) -> float:
    """Largest distance from the analytic solutions as a share of 2 pi (%)."""
    return float(100.0 * numbers(table, "distance").max() / (2 * np.pi))


@measure
def distance_over_lag(table: pd.DataFrame, *, low: float, high: float) -> float:
    """Largest distance from the analytic solutions at one tau over that at another (1)."""
    at_low, at_high = (
        value(masked(table, table["tau"] == tau), column="distance", where="status == 'settled'", take="max")
        for tau in (low, high)
    )
    return at_low / at_high
