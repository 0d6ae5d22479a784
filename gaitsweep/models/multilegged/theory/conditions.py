"""Where the three gaits exist: what must hold for the analytic solutions to be motions of the chain.

Along a wave each inner leg touches while one neighbour stands and the other is in takeoff (eq. 12). That is
consistent only as long as the neighbour in takeoff is a little way into it (t > 0), and still on the ground.
At the touchdown of leg i, reset by D, its neighbour j in takeoff bears

    m_j g - kappa_jh (l_h - l_j) - kappa_ij (l_i - l_j),   h being the leg beyond j.

In a uniform chain t > 0 is m_B > m/2. As long as h stands, a load above zero is m_B < m: together the paper's
m/2 < m_B < m. In a soft chain legs follow one another so closely that h is in takeoff as well. A load above
zero is then m_B < m or, just as well, (2 m_B + m) g/kappa > 2 a.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from gaitsweep.models.multilegged.theory.chain import Chain, Scalar, amplitudes, reset, springs, takeoffs


class Conditions(NamedTuple):
    """Margins of the conditions of one wave, each above 0 where it holds; scalars.

    takeoff: the least t over the legs, as a share of the takeoff segment. load: the least load on a leg in
    takeoff when its neighbour touches, over the inner legs' weight. landing: what is left of the landing
    segment at a touchdown, as a share of it, so that m g/kappa < a for the mass that sets it. length: the
    shortest leg over L, above 0 where a < L; no equation asks for it, so it is not among those that `hold`.
    """

    takeoff: jax.Array
    load: jax.Array
    landing: jax.Array
    length: jax.Array

    @property
    def hold(self) -> jax.Array:
        """Whether the wave is a motion of the chain: takeoff, load and landing are above zero."""
        return jnp.min(jnp.stack([self.takeoff, self.load, self.landing])) > 0.0


def wave_conditions(N: int, chain: Chain, L: Scalar = 1.0) -> tuple[Conditions, Conditions]:
    """The conditions of the direct and of the retrograde wave.

    Args:
        N: springs, 3 at least.
        chain: parameters; may be traced.
        L: longest leg length, m.

    Source: sec. 2.1 of the paper for uniform chains; eq. (12) with the load of a leg in takeoff for others.
    """
    front, rear = _touchdowns(N, chain)
    common = _common(chain, jnp.max(amplitudes(N, chain)) / L)
    ends = _ends(N, chain)
    direct = Conditions(jnp.minimum(jnp.min(front.takeoff), ends[1]), jnp.min(front.load), *common)
    retrograde = Conditions(jnp.minimum(jnp.min(rear.takeoff), ends[0]), jnp.min(rear.load), *common)
    return direct, retrograde


def source_conditions(N: int, chain: Chain, k: int, L: Scalar = 1.0) -> Conditions:
    """The conditions of the source wave with the boundary leg k, set B.

    Legs 2 .. k-1 touch as in a direct wave, legs k .. N as in a retrograde one. Where all neighbours in
    takeoff are ends, as for N = 3 and k = 3, these have one spring to lift them instead of two.

    Args:
        N, chain, L: as for `wave_conditions`.
        k: boundary leg, 3 .. N.
    """
    front, rear = _touchdowns(N, chain)
    takeoff = jnp.concatenate([front.takeoff[: k - 2], rear.takeoff[k - 2 :]])
    load = jnp.concatenate([front.load[: k - 2], rear.load[k - 2 :]])
    return Conditions(jnp.min(takeoff), jnp.min(load), *_common(chain, jnp.max(amplitudes(N, chain)) / L))


class _Touchdowns(NamedTuple):
    """Margins of legs 2 .. N as they touch with one neighbour in takeoff, (N-1,)."""

    takeoff: jax.Array
    load: jax.Array


def _segment(chain: Chain) -> jax.Array:
    return jnp.asarray((1.0 - chain.beta) * jnp.pi)


def _common(chain: Chain, shortening: jax.Array) -> tuple[jax.Array, jax.Array]:
    return 1.0 - reset(chain) / _segment(chain), 1.0 - shortening


def _ends(N: int, chain: Chain) -> tuple[jax.Array, jax.Array]:
    """What is left of the takeoff of the first and of the last leg's neighbour as these touch, as a share."""
    into = takeoffs(N, chain)
    return 1.0 - into.first / _segment(chain), 1.0 - into.last / _segment(chain)


def _touchdowns(N: int, chain: Chain) -> tuple[_Touchdowns, _Touchdowns]:
    """With the neighbour towards the head in takeoff, and with that towards the tail."""
    k, a, D, segment = springs(N, chain), amplitudes(N, chain), reset(chain), _segment(chain)
    into = takeoffs(N, chain)
    weights = jnp.full(N + 1, segment * chain.m * chain.g)
    weights = weights.at[0].set(segment * chain.m_1 * chain.g).at[-1].set(segment * chain.m_end * chain.g)
    ways = []
    for t, way in ((into.front, 1), (into.rear, -1)):
        takeoff = jnp.minimum(t, segment - t) / segment
        load = _loads(t[::way], k[::way], a[::way], weights[::way], D, 2.0 * segment - D)
        ways.append(_Touchdowns(takeoff, load[::way] / (segment * chain.m * chain.g)))
    return ways[0], ways[1]


def _loads(
    t: jax.Array, k: jax.Array, a: jax.Array, weights: jax.Array, D: jax.Array, psi_B: jax.Array
) -> jax.Array:
    """The loads on legs 1 .. N-1 when legs 2 .. N touch, t (N-1,) being their phases in takeoff.

    Lengths in units of a leg's change over its phase: leg i is short by a_i D, its neighbour by a_j t. Leg 1
    has nothing beyond it; the leg beyond another is behind it by psi_B less that one's own t.
    """
    nothing = jnp.zeros_like(k[:1])
    short, touching = a[:-2] * t, a[1:-1] * D
    beyond = jnp.concatenate([nothing, a[:-3] * jnp.maximum(t[1:] + t[:-1] - psi_B, 0.0)])
    spring = jnp.concatenate([nothing, k[:-2]])
    return weights[:-2] - spring * (short - beyond) - k[:-1] * (short - touching)
