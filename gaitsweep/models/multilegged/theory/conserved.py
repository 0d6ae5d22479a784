"""The conserved quantity of a symmetric chain, and how it drifts where head and tail differ."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from gaitsweep.models.multilegged.theory.chain import Chain, end_resets
from gaitsweep.models.multilegged.theory.section import TWO_PI
from gaitsweep.models.multilegged.theory.solution_sets import lag_rules


def total(psi: jax.Array) -> jax.Array:
    """E, the sum of the relative phases (rad, last axis N) on any one section; in [0, 2 pi), as only that
    is defined by angles; eq. (29)."""
    return jnp.mod(jnp.sum(jnp.asarray(psi), axis=-1), TWO_PI)


def end_touchdowns(chain: Chain) -> tuple[jax.Array, jax.Array]:
    """Phases at which the first and the last leg touch while their neighbours stand, rad; eqs. (31), (32)."""
    head, tail = end_resets(chain)
    return TWO_PI - head, TWO_PI - tail


def drift(chain: Chain) -> jax.Array:
    """Change of E a cycle while the neighbours of both ends stand as these touch, rad.

    E is phi_{N+1} - phi_1, and grows by what a touchdown resets the last leg by less the first leg's:
    (1 - beta) pi g (m_end/(kappa_end a_end) - m_1/(kappa_1 a_1)), or (m_end - m_1) b for unequal masses
    alone. Where it is positive (the tail heavier, softer or of less amplitude) the chain goes along its line
    of solutions to the retrograde wave, else to the direct wave. Zero for ends that differ but m/(kappa a).

    Source: eqs. (30) to (32), with a spring and an amplitude of each end's own.
    """
    head, tail = end_resets(chain)
    return tail - head


def line_length(N: int, chain: Chain | None = None) -> jax.Array:
    """How far E moves from the direct end of the line of all solutions to its retrograde end, rad.

    Along B and the direct wave E moves by as much as the free phase, along A by twice as much.
    """
    chain = Chain() if chain is None else chain
    rules = lag_rules(N, chain)
    rate = jnp.abs(jnp.sum(rules.slope, axis=1))
    return jnp.sum(rate * (rules.high - rules.low))


def worst_case_cycles(N: int, chain: Chain) -> jax.Array:
    """Cycles that a chain with unequal ends takes to drift along all of its line; infinite if they are equal.

    The transient to the line comes on top, about 50 cycles at Table 1.
    """
    rate = jnp.abs(drift(chain))
    return jnp.where(rate > 0.0, line_length(N, chain) / jnp.where(rate > 0.0, rate, 1.0), jnp.inf)
