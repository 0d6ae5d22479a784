"""Points of the chain's analytic solutions, and their transport from one leg's section to another's."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.papers.ambe2021.theory.chain import Chain, touchdown_phase
from gaitsweep.papers.ambe2021.theory.solution_sets import (
    TWO_PI,
    Branch,
    LagRule,
    Leg,
    branches,
    lag_rules,
    phases_from_relative,
    relative,
    solution,
)


@partial(jax.jit, static_argnames=("N", "samples", "section"))
def solution_sets(
    N: int, chain: Chain | None = None, samples: int = 65, section: int | None = None
) -> jax.Array:
    """Evenly spaced points of all sets, in the order of `branches(N)`: psi, shape (2 N - 1, samples, N), rad.

    Args:
        N: springs; the chain has N + 1 legs.
        chain: parameters; Table 1's if not given.
        samples: number of points of each set, both ends included.
        section: the leg whose section is used; by default each set's k, or N for the direct wave.

    Source: eqs. (16)-(20), (24), (25).
    """
    chain = Chain() if chain is None else chain
    circle = touchdown_phase(chain)

    def points(rule: LagRule, leg: jax.Array) -> jax.Array:
        free = jnp.linspace(rule.low, rule.high, samples)
        return jax.vmap(lambda s: solution(rule, s, circle, leg))(free)

    legs = jnp.array([branch.k if section is None else section for branch in branches(N)])
    return jax.vmap(points)(lag_rules(N, chain), legs)


def solution_set(
    N: int, branch: Branch, chain: Chain | None = None, samples: int = 65, section: int | None = None
) -> jax.Array:
    """Evenly spaced points of one set, one of `branches(N)`, shape (samples, N); else as `solution_sets`."""
    return solution_sets(N, chain, samples, section)[branches(N).index(branch)]


def transport(psi: jax.Array, touchdown: jax.Array, source: Leg, target: Leg) -> jax.Array:
    """Psi on the section of leg `target`, from psi on the section of leg `source`.

    A leg whose phase exceeds that of the target touches down between the sections, and advances by
    2 pi - touchdown.

    Args:
        psi: relative phases on section `source`, rad, shape (N,).
        touchdown: touchdown phase, rad; eq. (16).
        source, target: legs, 1 .. N+1.
    """
    phi = phases_from_relative(psi, touchdown, source)
    resets = phi > phi[target - 1]
    return relative(phi + jnp.where(resets, TWO_PI - touchdown, 0.0))


def total(psi: jax.Array | np.ndarray) -> jax.Array:
    """E, the sum of the relative phases (rad, last axis N) on one section, wrapped to [0, 2 pi); eq. (29)."""
    return jnp.mod(jnp.sum(jnp.asarray(psi), axis=-1), TWO_PI)
