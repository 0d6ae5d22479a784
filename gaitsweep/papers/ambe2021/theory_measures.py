"""Measures of the theory: its sets of solutions, their order of touchdowns, and their stability."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float, Inexact

import gaitsweep as gs
from gaitsweep.analyses import wrapped_difference
from gaitsweep.claims import MeasureError, measure
from gaitsweep.papers.ambe2021.equation_measures import chain_defaults
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import chain_of, springs_of
from gaitsweep.papers.ambe2021.multilegged.parameters import SPRINGS
from gaitsweep.papers.ambe2021.multilegged.reduced import MultileggedReduced
from gaitsweep.papers.ambe2021.theory.chain import (
    Chain,
    end_resets,
    lag,
    touchdown_phase,
    wave_speed,
    wavelength,
)
from gaitsweep.papers.ambe2021.theory.gaits import GAITS, gait_of
from gaitsweep.papers.ambe2021.theory.order import (
    TABLE_2,
    characteristic_polynomial,
    eigenvalues,
    jumps,
    linear_map,
    multipliers,
    order_sets,
    reset_sets,
    touchdown_residuals,
)
from gaitsweep.papers.ambe2021.theory.solution_sets import (
    Branch,
    Kind,
    branches,
    places,
    rule_of,
    solution,
)

# shares of a set's range, without its middle, where two legs of A touch down at the same time
_INSIDE = (0.1, 0.3, 0.45, 0.7, 0.9)
_SHARE = 0.45  # of these the one at which a single solution is taken
_LONG = 9  # springs of the longer chain of the paper


@functools.cache
def _sets(N: int) -> list[tuple[Branch, float]]:
    """Each set of a chain at a few free phases."""
    pairs = itertools.product(branches(N), _INSIDE)
    return [(branch, _free_phase(N, branch, share)) for branch, share in pairs]


def _free_phase(N: int, branch: Branch, share: float = _SHARE) -> float:
    """The free phase s (rad) at a share of a set's range."""
    rule = rule_of(N, branch, Chain())
    return float(rule.low + share * (rule.high - rule.low))


@measure
def set_range(*, kind: Kind, k: int = SPRINGS) -> list[float]:
    """Ends of the free phase on the section of leg k: psi_{k-1}, or psi_3 of the direct wave (rad)."""
    rule = rule_of(SPRINGS, Branch(kind, k), Chain())
    ends = [float(rule.low), float(rule.high)]
    return [2 * np.pi - ends[1], 2 * np.pi - ends[0]] if kind == "direct" else ends


@measure
def set_phase(*, kind: Kind, k: int, link: int) -> float:
    """The relative phase of one link on the section of leg k of ten, at 0.45 of the set's range (rad).

    Args:
        kind, k: the set, and its boundary leg.
        link: its number, 1 .. 9.

    Raises:
        ArgumentError: there is no link of this number.
    """
    if not 1 <= link <= _LONG:
        raise gs.ArgumentError(f"link is {link}, but the links of ten legs are 1 to {_LONG}.")
    branch = Branch(kind, k)
    s = jnp.asarray(_free_phase(_LONG, branch))
    return float(solution(rule_of(_LONG, branch, Chain()), s, touchdown_phase(Chain()), k)[link - 1])


@measure
def reduced_map_error(
    *, N: int = SPRINGS, kinds: Sequence[Kind] = ("A", "B", "direct"), step: int = 1
) -> float:
    """Largest change in a cycle of the reduced chain from the solutions of sets of these kinds (rad).

    Args:
        N: springs.
        kinds: the kinds of sets.
        step: every so many of the sets, for long chains.
    """
    chosen = [(branch, s) for branch, s in _sets(N) if branch.kind in kinds][::step]
    circle = touchdown_phase(Chain())
    psi = np.stack([np.asarray(_solution(N, branch, s, circle)) for branch, s in chosen])
    mapping, points = _reduced_map(N, psi)
    return float(np.abs(wrapped_difference(mapping(points).at - points.at)).max())


@functools.partial(jax.jit, static_argnums=(0, 1))
def _solution(N: int, branch: Branch, s: float, circle: jax.Array) -> jax.Array:
    """The relative phases (N,) of a set on section 1, at its free phase s; `circle` rad is a cycle."""
    return solution(rule_of(N, branch, Chain()), jnp.asarray(s), circle, 1)


def _reduced_map(N: int, psi: Float[np.ndarray, "points springs"]) -> tuple[gs.PoincareMap, Any]:
    """The simulated return map of the reduced chain, and its points at psi (n, N) on section 1."""
    mapping = gs.return_map(MultileggedReduced(N=N), numerics={"method": "propagator"})
    return mapping, mapping.settled({f"psi_{i + 1}": psi[:, i] for i in range(N)}, 0)


@measure
def reduced_multipliers(*, kind: Kind, k: int) -> list[float]:
    """Eigenvalues of the simulated return map of the reduced chain at a solution, in falling order (1)."""
    branch = Branch(kind, k)
    psi = _solution(SPRINGS, branch, _free_phase(SPRINGS, branch), touchdown_phase(Chain()))
    mapping, points = _reduced_map(SPRINGS, np.asarray(psi)[None])
    return _in_falling_order(mapping.multipliers(points))


@measure
def theory_eigenvalues(*, kind: Kind, k: int, N: int) -> list[float]:
    """Eigenvalues of the linear map of a cycle, eq. (21), in falling order (1).

    Args:
        kind, k: the set, and its boundary leg.
        N: springs.
    """
    branch = Branch(kind, k)
    return _in_falling_order(eigenvalues(linear_map(N, branch, _free_phase(N, branch))))


def _in_falling_order(values: Inexact[np.ndarray, " *points springs"]) -> list[float]:
    """The real parts of eigenvalues, largest first."""
    return sorted(np.real(np.ravel(values)).tolist(), reverse=True)


@measure
def linear_map_error(*, N: int) -> float:
    """Largest difference of the coefficients of det(lambda - P_k) from those of eqs. (22) and (26) (1)."""
    errors = [
        characteristic_polynomial(linear_map(N, branch, s)) - np.poly(multipliers(N, branch))
        for branch, s in _sets(N)
    ]
    return float(np.abs(errors).max())


@measure
def touchdown_relation_error(*, N: int = _LONG) -> float:
    """Largest difference of the two sides of eq. (14) over the legs of all sets (m)."""
    return max(float(np.abs(touchdown_residuals(N, branch, s)).max()) for branch, s in _sets(N))


@measure
def table_2(*, number: int) -> list[str]:
    """Whether the legs in front of and behind a leg of the set S are reset before it: no, yes or none."""
    words = {None: "none", False: "no", True: "yes"}
    neighbours_of = {reset_set: neighbours for neighbours, reset_set in TABLE_2.items()}
    if number not in neighbours_of:
        raise MeasureError(f"number is {number}, but the sets S have numbers 1 to {len(TABLE_2)}.")
    return [words[reset] for reset in neighbours_of[number]]


@measure
def order_sets_agree(*, N: int = _LONG) -> float:
    """Share of solutions at which T_1, T_2 of eq. (18) are the legs of S_3, or S_1, S_7 at the ends (1)."""
    agree = []
    for branch, s in _sets(N):
        alone = {i for i, reset_set in enumerate(reset_sets(N, branch, s), 1) if reset_set.is_first}
        first, last = {i for i in alone if i <= branch.k - 2}, {i for i in alone if i >= branch.k + 2}
        agree.append(order_sets(N, branch, s) == (first, last))
    return float(np.mean(agree))


@measure
def chain_of_sets(table: pd.DataFrame) -> float:
    """Largest gap between the end of a set and the beginning of the next in the chain of sets (rad)."""
    chain = chain_of(table)
    N = springs_of(table)
    rules = [rule_of(N, branch, chain) for branch in branches(N)]
    ends_of_sets = [[np.asarray(places(rule, s)) for s in (rule.low, rule.high)] for rule in rules]
    circle = float(touchdown_phase(chain))
    gaps = []
    for ends, next_ends in itertools.pairwise(ends_of_sets):
        # of either set either end may be the common one
        apart = [one - other for one, other in itertools.product(ends, next_ends)]
        gaps.append(np.abs((np.array(apart) + circle / 2) % circle - circle / 2).max(axis=1).min())
    return float(max(gaps))


@measure
def ends_of_chain(*, N: int) -> list[str]:
    """The gaits of the first and of the last set of the chain of sets."""
    return [GAITS[gait_of(branches(N)[at])] for at in (0, -1)]


@measure
def jump_sizes(table: pd.DataFrame) -> list[float]:
    """Smallest and largest size of the jumps of all sets on their own sections (rad)."""
    N = springs_of(table)
    chain = chain_of(table)
    sizes = [float(np.abs(jump.change).max()) for branch in branches(N) for jump in jumps(N, branch, chain)]
    if not sizes:
        raise MeasureError(f"The sets of a chain of {N + 1} legs have no jumps.")
    return [min(sizes), max(sizes)]


@measure
def wave_numbers(*, which: Literal["wavelength", "printed", "exact", "lag"]) -> float:
    """The theory's wavelength (legs), speed printed or exact (legs/s), or lag (rad)."""
    speeds = wave_speed(chain_defaults()["omega"])._asdict()
    return float({"wavelength": wavelength(), "lag": lag(Chain()), **speeds}[which])


@measure
def end_touchdown(*, end: Literal["head", "tail"], m_1: float = 0.9, m_end: float = 0.9) -> float:
    """Touchdown phase of the first or the last leg with its neighbour in stance (rad).

    Args:
        end: which of the two.
        m_1, m_end: masses of the head and of the tail, kg.
    """
    head, tail = end_resets(Chain(m_1=m_1, m_end=m_end))
    return float(2 * np.pi - (head if end == "head" else tail))


@measure
def line_range(*, k: int) -> list[float]:
    """Ends of psi_{k-1} over the solution sets A and B together (rad)."""
    return [set_range(kind="A", k=k)[0], set_range(kind="B", k=k)[1]]


@measure
def slopes_of_fig10(table: pd.DataFrame, *, k: int) -> list[float]:
    """Slopes of psi_k over psi_{k-1} along the solution sets A and B (1)."""
    slopes = []
    chain = chain_of(table)
    for branch in (Branch("A", k), Branch("B", k)):
        rule = rule_of(springs_of(table), branch, chain)
        places_in_range = [rule.low + share * (rule.high - rule.low) for share in (0.6, 0.8)]
        low, high = (np.asarray(solution(rule, s, touchdown_phase(chain), k)) for s in places_in_range)
        slopes.append(float((high[k - 1] - low[k - 1]) / (high[k - 2] - low[k - 2])))
    return slopes


@measure
def shorter_set(*, k: int) -> float:
    """Range of psi_{k-1} over the solution set A, over that over the set B (1)."""
    lengths = np.ptp([set_range(kind="A", k=k), set_range(kind="B", k=k)], axis=1)
    return float(lengths[0] / lengths[1])
