"""Where the three gaits exist: what must hold for the analytic solutions to be motions of the chain.

Along a wave each inner leg touches while one neighbour stands and the other is in takeoff (eq. 12). That is
consistent only as long as the neighbour in takeoff is a little way into it (t > 0), and still on the ground.
At the touchdown of leg i, reset by D, its neighbour j in takeoff bears

    m_j g - kappa_jh (L - l_j) - kappa_ij (l_i - l_j),   h being the leg beyond j, which stands.

In a uniform chain t > 0 is m_B > m/2, and a load above zero is m_B < m: the paper's m/2 < m_B < m.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from gaitsweep.analysis.multilegged.chain import (
    Chain,
    Scalar,
    amplitudes,
    reset,
    springs,
    takeoffs,
)


class Conditions(NamedTuple):
    """Margins of the conditions of one wave, each above 0 where it holds; scalars.

    takeoff: the least t over the legs, as a share of the takeoff segment. load: the least load on a leg in
    takeoff when its neighbour touches, over the inner legs' weight. landing: what is left of the landing
    segment at a touchdown, as a share of it, so that m g/kappa < a for the mass that sets it. length: the
    shortest leg over L, where a < L.
    """

    takeoff: jax.Array
    load: jax.Array
    landing: jax.Array
    length: jax.Array

    @property
    def hold(self) -> jax.Array:
        """Whether all are above zero."""
        return jnp.min(jnp.stack(self)) > 0.0


def wave_conditions(N: int, chain: Chain, L: Scalar = 1.0) -> tuple[Conditions, Conditions]:
    """The conditions of the direct and of the retrograde wave; a source wave is made of both.

    Args:
        N: springs, 3 at least.
        chain: parameters; may be traced.
        L: longest leg length, m.

    Source: sec. 2.1 of the paper for uniform chains; eq. (12) with the load of a leg in takeoff for others.
    """
    k, a, D = springs(N, chain), amplitudes(N, chain), reset(chain)
    segment = jnp.asarray((1.0 - chain.beta) * jnp.pi)
    into = takeoffs(N, chain)
    weights = jnp.full(N + 1, segment * chain.m * chain.g)
    weights = weights.at[0].set(segment * chain.m_1 * chain.g).at[-1].set(segment * chain.m_end * chain.g)
    landing, length = 1.0 - D / segment, 1.0 - jnp.max(a) / L
    waves = []
    for neighbours, end, way in ((into.front, into.last, 1), (into.rear, into.first, -1)):
        takeoff = _least_takeoff(neighbours, end, segment)
        load = _least_load(neighbours[::way], k[::way], a[::way], weights[::way], D)
        waves.append(Conditions(takeoff, load, landing, length))
    return waves[0], waves[1]


def _least_takeoff(front: jax.Array, end: jax.Array, segment: jax.Array) -> jax.Array:
    """The least that neighbours are from both ends of their takeoff; 0 is allowed at the chain's end."""
    inside = jnp.minimum(jnp.min(front), segment - jnp.max(front))
    return jnp.minimum(inside, segment - end) / segment


def _least_load(front: jax.Array, k: jax.Array, a: jax.Array, weights: jax.Array, D: jax.Array) -> jax.Array:
    """The least load on legs 1 .. N-1 when legs 2 .. N touch, over the weight of an inner leg.

    Lengths in units of a leg's change over its phase: leg i is short by a_i D, its neighbour by a_j t.
    """
    short, touching = a[:-2] * front, a[1:-1] * D
    beyond = jnp.concatenate([jnp.zeros_like(k[:1]), k[:-2]])  # leg 1 has nothing beyond it
    load = weights[:-2] - beyond * short - k[:-1] * (short - touching)
    return jnp.min(load) / weights[1]
