"""The conserved quantity of a symmetric chain, and its drift if head and tail differ."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from gaitsweep.models.multilegged.theory.chain import Chain, end_resets
from gaitsweep.models.multilegged.theory.section import TWO_PI
from gaitsweep.models.multilegged.theory.solution_sets import lag_rules


def total(psi: jax.Array) -> jax.Array:
    """E, the sum of the relative phases (rad, last axis N) on one section, wrapped to [0, 2 pi); eq. (29)."""
    return jnp.mod(jnp.sum(jnp.asarray(psi), axis=-1), TWO_PI)


def end_touchdowns(chain: Chain) -> tuple[jax.Array, jax.Array]:
    """The touchdown phases of the first and the last leg with neighbours in stance, rad; eqs. (31), (32)."""
    head, tail = end_resets(chain)
    return TWO_PI - head, TWO_PI - tail


def drift(chain: Chain) -> jax.Array:
    """Change of E in a cycle, rad, if neighbours of both ends are in stance when these touch down.

    E is phi_{N+1} - phi_1; in a cycle it changes by the phase reset of the last leg less that of the first:
    (1 - beta) pi g (m_end/(kappa_end a_end) - m_1/(kappa_1 a_1)), or (m_end - m_1) b if only masses differ.
    If it is positive (a heavier tail, with a softer spring or smaller amplitude), the chain drifts along its
    line of solutions to the retrograde wave, else to the direct wave. It is zero for equal m/(kappa a).

    Source: eqs. (30) to (32), with different springs and amplitudes of the ends.
    """
    head, tail = end_resets(chain)
    return tail - head


def line_length(N: int, chain: Chain | None = None) -> jax.Array:
    """The change of E along the line of all solutions, from its direct to its retrograde end, rad.

    Along B and the direct wave E changes as much as the free phase, along A twice as much.
    """
    chain = Chain() if chain is None else chain
    rules = lag_rules(N, chain)
    rate = jnp.abs(jnp.sum(rules.slope, axis=1))
    return jnp.sum(rate * (rules.high - rules.low))


def worst_case_cycles(N: int, chain: Chain) -> jax.Array:
    """Cycles of the drift along the whole line for unequal ends; infinite for equal ends.

    The transient to the line, about 50 cycles for Table 1, is not included.
    """
    rate = jnp.abs(drift(chain))
    return jnp.where(rate > 0.0, line_length(N, chain) / jnp.where(rate > 0.0, rate, 1.0), jnp.inf)
