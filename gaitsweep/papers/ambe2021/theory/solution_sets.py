"""The analytic periodic solutions: source waves with any boundary leg, and the direct wave.

Section j is just before the touchdown of leg j. Along a periodic solution every leg touches down at the same
phase C (eq. 15) and is reset to 0: the phases move on circles of circumference C instead of 2 pi, and a
solution is given by the legs' places theta_i on that circle. The touchdown order, with the sets T_1 and T_2
of eq. (18), and psi on any section follow from the places exactly.

Each set is a line of solutions with one free relative phase s. The places of neighbouring legs differ by

    direct region (legs 1 .. k-1):     +delta a leg,
    retrograde region (legs k .. N+1): -delta a leg,       delta = 2 (1-beta) pi - (3 m_B - m) b,
    between legs k-1 and k:            +s,

which is eq. (17), since the places determine the order of touchdowns. In set B s runs from psi_B =
2 (1-beta) pi - m_B b to 2 beta pi; in set A from delta to psi_B, and the difference of legs k and k+1 is
-(delta + psi_B - s) (eq. 20). The direct wave (24, 25) is the mirror image of set B with k = 2: all
differences are +delta, the last one -s. Sets A and B of k = 2 are the retrograde wave. If an end has a
different spring or amplitude, the lags follow from eq. (12) with it (`chain.py`).

The sets follow one another along a line, on which E, the sum of the relative phases, is conserved if head and
tail are alike; else the chain drifts along it.
"""

from __future__ import annotations

import functools
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep import ArgumentError
from gaitsweep.dynamics import TWO_PI
from gaitsweep.papers.ambe2021.theory.chain import (
    TABLE_1,
    Chain,
    Scalar,
    amplitudes,
    end_resets,
    masses,
    reset,
    takeoffs,
)

Leg = int | jax.Array  # 1 .. N+1
Kind = Literal["A", "B", "direct"]


def phases_on_section(theta: jax.Array, touchdown: jax.Array, leg: Leg) -> jax.Array:
    """Phases of the legs (rad, in (0, touchdown]) just before `leg` touches down, from their places.

    Args:
        theta: places of the legs, rad, shape (N+1,), up to a common shift and multiples of `touchdown`.
        touchdown: touchdown phase, rad.
        leg: 1 .. N+1.
    """
    behind = jnp.mod(theta[leg - 1] - theta, touchdown)
    return touchdown - behind


def relative(phi: jax.Array) -> jax.Array:
    """psi_i = phi_{i+1} - phi_i in [0, 2 pi), rad, shape (N,), from phases of shape (N+1,); eq. (7)."""
    return jnp.mod(phi[1:] - phi[:-1], TWO_PI)


def phases_from_relative(psi: jax.Array, touchdown: jax.Array, leg: Leg) -> jax.Array:
    """The phase of each leg in [0, 2 pi), rad, shape (N+1,), from the relative phases on a section.

    Args:
        psi: relative phases, rad, shape (N,).
        touchdown: phase of `leg`, rad.
        leg: the leg of the section, 1 .. N+1.
    """
    phi = jnp.concatenate([jnp.zeros_like(psi[:1]), jnp.cumsum(psi)])
    return jnp.mod(phi - phi[leg - 1] + touchdown, TWO_PI).at[leg - 1].set(touchdown)


def touches_early(psi: jax.Array, touchdown: jax.Array, threshold: jax.Array, leg: Leg) -> jax.Array:
    """The union of the sets T_1 and T_2, a bool for each leg (N+1,).

    Args:
        psi: relative phases on the section of the boundary leg `leg`, rad, shape (N,).
        touchdown, threshold: 2 pi - m_B b and 2 beta pi + (2 m_B - m) b, rad.

    Source: eq. (18); T_1 are legs up to k-2, T_2 legs from k+2.
    """
    phi = phases_from_relative(psi, touchdown, leg)
    number = jnp.arange(1, phi.shape[0] + 1)
    outside = (number <= leg - 2) | (number >= leg + 2)
    return outside & (threshold < phi) & (phi <= touchdown)


class Branch(NamedTuple):
    """A set of solutions: A or B of the source wave with boundary leg k = 2 .. N, or the direct wave."""

    kind: Kind
    k: int


class LagRule(NamedTuple):
    """Phase lags along a set: theta_{i+1} - theta_i = fixed + slope * s for low <= s <= high.

    `fixed` (N,) rad, `slope` (N,), `low` and `high` rad. For several sets each field has a leading axis.
    """

    fixed: jax.Array
    slope: jax.Array
    low: jax.Array
    high: jax.Array


def branches(N: int) -> tuple[Branch, ...]:
    """All sets of a chain of N + 1 legs, in order along their line: direct, A N, B N, ..., A 2, B 2."""
    if N < 2:
        raise ArgumentError(f"N is {N}, but must be at least 2: the solutions need at least three legs.")
    return (Branch("direct", N), *(Branch(kind, k) for k in range(N, 1, -1) for kind in ("A", "B")))


def lag_rules(N: int, chain: Chain) -> LagRule:
    """The lag rules of all sets, in the order of `branches(N)`, shape (2 N - 1, N) and (2 N - 1,).

    If the ends have different touchdown phases, only the end points of the line are solutions: B of k = 2
    extends to the retrograde end point if the tail's reset is larger, the direct line to the direct one if
    the head's is. A different spring or amplitude of an end changes the lags of the legs next to it.
    """
    sets = branches(N)
    pair = np.arange(1, N + 1)
    kinds, k = np.array([kind for kind, _ in sets]), np.array([k for _, k in sets])
    is_A, is_direct = kinds == "A", kinds == "direct"
    free = np.where(is_direct, N, k - 1)
    side = np.sign(free[:, None] - pair)  # 1 in front of the boundary, -1 behind it, 0 for the free pair
    shared = is_A[:, None] & (pair == k[:, None])

    psi_B = 2.0 * (1.0 - chain.beta) * jnp.pi - reset(chain)
    stance = 2.0 * chain.beta * jnp.pi
    into = takeoffs(N, chain)
    # lags of pairs in front of the boundary (never the last pair) and behind it (never the first)
    direct = psi_B - jnp.concatenate([into.front, psi_B[None]])[None]
    retrograde = psi_B - jnp.concatenate([psi_B[None], into.rear])[None]
    # leg k of set A touches down between two neighbours in takeoff, eq. (20); if neither has begun, as for
    # m_B = m/2, the set is empty and its slope is arbitrary
    slopes = into.rear / jnp.where(into.front == 0.0, 1.0, into.front)
    ratio = jnp.where(shared, jnp.concatenate([jnp.zeros(1), slopes])[None], 0.0)
    over = jnp.zeros(len(sets)).at[0].set(into.last).at[-1].set(into.first)
    low = jnp.where(is_A, direct[0, np.maximum(k - 2, 0)], psi_B)
    return LagRule(
        fixed=jnp.where(side > 0, direct, jnp.where(side < 0, -retrograde, 0.0)) - ratio * psi_B,
        slope=ratio + np.where(side == 0, np.where(is_direct, -1.0, 1.0)[:, None], 0.0),
        low=low,
        high=jnp.maximum(jnp.where(is_A, psi_B, stance + over), low),
    )


def rule_of(N: int, branch: Branch, chain: Chain) -> LagRule:
    """The lag rule of one set.

    Args:
        N: springs; the chain has N + 1 legs.
        branch: the set, one of `branches(N)`.
        chain: parameters of the chain.

    Raises:
        ArgumentError: the chain has no such set.
    """
    return _row_of_rules(N, index_of(N, branch), chain)


def index_of(N: int, branch: Branch) -> int:
    """The index of a set in `branches(N)`.

    Raises:
        ArgumentError: the chain has no such set.
    """
    sets = branches(N)
    if branch not in sets:
        raise ArgumentError(
            f"{branch} is not a set of a chain of {N + 1} legs: A and B have a boundary leg k, one of "
            f"2 .. {N}; the direct wave has k = {N}."
        )
    return sets.index(branch)


@functools.partial(jax.jit, static_argnums=0)
def _row_of_rules(N: int, row: int, chain: Chain) -> LagRule:
    """The lag rule of the set with a number in `branches(N)`."""
    return jax.tree.map(lambda column: column[row], lag_rules(N, chain))


def places(rule: LagRule, s: Scalar) -> jax.Array:
    """Places theta of the legs on the circle at the free phase s, rad, shape (N+1,); leg 1 at 0."""
    return jnp.concatenate([jnp.zeros_like(rule.fixed[:1]), jnp.cumsum(rule.fixed + rule.slope * s)])


def solution(rule: LagRule, s: jax.Array, circle: jax.Array, section: Leg) -> jax.Array:
    """Psi on the section of leg `section` at the free phase s (rad), shape (N,), rad in [0, 2 pi).

    Args:
        rule: lag rule of the set.
        s: the free phase, rad; the relative phase psi_{k-1} on the set's own section, 2 pi - psi_N if direct.
        circle: the touchdown phase, rad.
        section: leg, 1 .. N+1.
    """
    return relative(phases_on_section(places(rule, s), circle, section))


def drift(chain: Chain) -> jax.Array:
    """Change of E in a cycle, rad, if neighbours of both ends are in stance when these touch down.

    E is phi_{N+1} - phi_1; in a cycle it changes by the phase reset of the last leg less that of the first:
    (1 - beta) pi g (m_end/(kappa_end a_end) - m_1/(kappa_1 a_1)), or (m_end - m_1) b if only masses differ,
    with b = (1 - beta) pi g/(kappa a) in rad/kg (`shift`). If it is positive (a heavier tail, with a softer
    spring or smaller amplitude), the chain drifts along its line of solutions to the retrograde wave, else to
    the direct wave. It is zero for equal m/(kappa a).

    It holds everywhere on the line and for every profile of the inner legs: only the ends' resets count. The
    source of a wave is the leg from which touchdowns spread to both ends. No profile of the inner legs keeps
    it at one leg: with equal ends it stays at any leg, with unequal ones it moves along the whole chain.

    Source: eqs. (30) to (32), with different springs and amplitudes of the ends.
    """
    head, tail = end_resets(chain)
    return tail - head


def drift_on_ground(N: int, chain: Chain, K: Scalar) -> jax.Array:
    """Change of E in a cycle, rad, on a ground of stiffness K, N/m, if the legs near both ends stand.

    An end touches down while its neighbour bears both their weights and has sunk by (m_1 + m_2) g/K, so its
    reset is (1 - beta) pi g (m_1/kappa_1 + (m_1 + m_2)/K)/a_1. Equal ends with unequal neighbours then drift:
    the theory of rigid legs leaves out this small term, but nothing else decides where a source goes.

    Args:
        N: springs; the chain has N + 1 legs.
        chain: its parameters.
        K: stiffness of the ground, N/m.

    Source: eqs. (30) to (32), with the springs of the ground from eq. (1).
    """
    m = masses(N, chain)
    a = amplitudes(N, chain)
    sunk = (m[-1] + m[-2]) / a[-1] - (m[0] + m[1]) / a[0]
    return drift(chain) + (1.0 - chain.beta) * jnp.pi * chain.g * sunk / K


def line_length(N: int, chain: Chain = TABLE_1) -> jax.Array:
    """The change of E along the line of all solutions, from its direct to its retrograde end, rad.

    Along B and the direct wave E changes as much as the free phase, along A twice as much.
    """
    rules = lag_rules(N, chain)
    rate = jnp.abs(jnp.sum(rules.slope, axis=1))
    return jnp.sum(rate * (rules.high - rules.low))


def worst_case_cycles(N: int, chain: Chain) -> jax.Array:
    """Cycles of the drift along the whole line for unequal ends; infinite for equal ends.

    The transient from a start to the line is not included.
    """
    rate = jnp.abs(drift(chain))
    return jnp.where(rate > 0.0, line_length(N, chain) / jnp.where(rate > 0.0, rate, 1.0), jnp.inf)
