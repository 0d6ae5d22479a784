"""The initial state of the planar quadruped: one diagonal pair about to swing, with a perturbation."""

from __future__ import annotations

import math
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.models.planar_quadruped.mechanics import HIP, KNEE, NQ, Z
from gaitsweep.models.planar_quadruped.nine_gaits import LEGS, PAIRS
from gaitsweep.models.planar_quadruped.state import Params

ABOVE = 0.005  # m, between the lowest foot and the ground
LEAN = 0.2  # rad: hips of standing legs point forward, those of swinging legs backward
ACTIVE, SILENT, TIRED = 1.0, -0.5, 0.1  # potentials and fatigue
# Multipliers of the seed for each potential: the fractional parts are uniform in a cube.
_ROOTS = np.sqrt([[2.0, 3.0, 5.0, 7.0], [11.0, 13.0, 17.0, 19.0]])


def begun(params: Params, start: Mapping[str, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
    """q (11,), potentials and fatigue (2, 4) at the start."""
    m = params.mechanics
    first = np.array([leg in PAIRS[0] for leg in LEGS])
    swings = jnp.where(start["pair"] < 0.5, first, ~first)
    u = jnp.stack([jnp.where(swings, SILENT, ACTIVE), jnp.where(swings, ACTIVE, SILENT)])
    f = jnp.stack([jnp.where(swings, 0.0, TIRED), jnp.where(swings, TIRED, 0.0)])
    hip = jnp.where(swings, -LEAN, LEAN)
    leg = m.l_0 + params.motors.l_st - m.foot_radius
    height = leg * math.cos(LEAN) + m.foot_radius + ABOVE
    q = jnp.zeros((NQ,), hip.dtype).at[Z].set(height).at[HIP].set(hip)
    return q.at[KNEE].set(params.motors.l_st), u + start["scatter"] * perturbation(start["seed"]), f


def perturbation(seed: jax.Array) -> jax.Array:
    """Pseudo-random numbers (2, 4) in [-1, 1) from an integer seed, equal for all engines.

    A Weyl sequence: the fractional parts of (seed + 1) times roots of primes.
    """
    turns = (seed + 1.0) * _ROOTS
    return 2.0 * (turns - jnp.floor(turns)) - 1.0
