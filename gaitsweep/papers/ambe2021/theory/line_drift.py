"""The drift of a chain with unequal ends along its line of solutions, and the length of that line."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from gaitsweep.papers.ambe2021.theory.chain import TABLE_1, Chain, Scalar, amplitudes, end_resets, masses
from gaitsweep.papers.ambe2021.theory.solution_sets import lag_rules


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
