"""Existence conditions of the three gaits: when the analytic solutions are motions of the chain.

Along a wave each inner leg touches down while one neighbour is in stance and the other in takeoff (eq. 12).
This is consistent only if the takeoff of that neighbour has begun (t > 0) and it is still on the ground. At
the touchdown of leg i, reset by D, its neighbour j in takeoff has the load

    m_j g - kappa_jh (l_h - l_j) - kappa_ij (l_i - l_j),   with h the next leg after j.

In a uniform chain t > 0 means m_B > m/2. If h is in stance, a positive load means m_B < m: together the
paper's m/2 < m_B < m. In a soft chain phase lags are so small that h is in takeoff as well. A positive load
then means m_B < m or (2 m_B + m) g/kappa > 2 a.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from gaitsweep.papers.ambe2021.theory.chain import Chain, Scalar, amplitudes, masses, reset, springs, takeoffs


class Conditions(NamedTuple):
    """Margins of the conditions of one wave, scalars; a condition is satisfied if its margin is above 0.

    `takeoff` is the smallest t of all legs as a share of the takeoff segment; `load` the smallest load on a
    leg in takeoff at the touchdown of its neighbour, divided by an inner leg's mean weight; `landing` the
    remaining share of the landing segment at touchdown, above 0 if m g/kappa < a for the mass that determines
    it; `length` the shortest leg length divided by L, above 0 if a < L. No equation depends on `length`, so
    `hold` ignores it.
    """

    takeoff: jax.Array
    load: jax.Array
    landing: jax.Array
    length: jax.Array

    @property
    def hold(self) -> jax.Array:
        """Whether the wave is a motion of the chain, with takeoff, load and landing above zero."""
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
    shared = _landing_and_length(chain, jnp.max(amplitudes(N, chain)) / L)
    ends = _takeoff_beside_ends(N, chain)
    direct = Conditions(jnp.minimum(jnp.min(front.takeoff), ends[1]), jnp.min(front.load), *shared)
    retrograde = Conditions(jnp.minimum(jnp.min(rear.takeoff), ends[0]), jnp.min(rear.load), *shared)
    return direct, retrograde


def source_conditions(N: int, chain: Chain, k: int, L: Scalar = 1.0) -> Conditions:
    """The conditions of the source wave with the boundary leg k, set B.

    Legs 2 .. k-1 touch down as in a direct wave, legs k .. N as in a retrograde one. If all neighbours in
    takeoff are ends, as for N = 3 and k = 3, one spring lifts them instead of two.

    Args:
        N, chain, L: as for `wave_conditions`.
        k: boundary leg, 3 .. N.
    """
    front, rear = _touchdowns(N, chain)
    takeoff = jnp.concatenate([front.takeoff[: k - 2], rear.takeoff[k - 2 :]])
    load = jnp.concatenate([front.load[: k - 2], rear.load[k - 2 :]])
    return Conditions(
        jnp.min(takeoff), jnp.min(load), *_landing_and_length(chain, jnp.max(amplitudes(N, chain)) / L)
    )


class _Touchdowns(NamedTuple):
    """Margins of legs 2 .. N at touchdown with one neighbour in takeoff, (N-1,)."""

    takeoff: jax.Array
    load: jax.Array


def _segment(chain: Chain) -> jax.Array:
    """The phase, rad, that takeoff and landing take each."""
    return jnp.asarray((1.0 - chain.beta) * jnp.pi)


def _landing_and_length(chain: Chain, shortening: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The margins `landing` and `length`, the same for all waves; `shortening` is the largest a / L."""
    return 1.0 - reset(chain) / _segment(chain), 1.0 - shortening


def _takeoff_beside_ends(N: int, chain: Chain) -> tuple[jax.Array, jax.Array]:
    """The remaining share of takeoff of the neighbours of both ends, at the touchdowns of these."""
    since_takeoff = takeoffs(N, chain)
    return 1.0 - since_takeoff.first / _segment(chain), 1.0 - since_takeoff.last / _segment(chain)


def _touchdowns(N: int, chain: Chain) -> tuple[_Touchdowns, _Touchdowns]:
    """The margins with the neighbour towards the head in takeoff, and with that towards the tail."""
    k = springs(N, chain)
    a = amplitudes(N, chain)
    D = reset(chain)
    segment = _segment(chain)
    since_takeoff = takeoffs(N, chain)
    weights = segment * masses(N, chain) * chain.g
    inner_mass = jnp.mean(jnp.asarray(chain.m))
    margins = []
    for t, order in ((since_takeoff.front, 1), (since_takeoff.rear, -1)):
        takeoff = jnp.minimum(t, segment - t) / segment
        load = _loads(t[::order], k[::order], a[::order], weights[::order], D, 2.0 * segment - D)
        margins.append(_Touchdowns(takeoff, load[::order] / (segment * inner_mass * chain.g)))
    return margins[0], margins[1]


def _loads(
    t: jax.Array, k: jax.Array, a: jax.Array, weights: jax.Array, D: jax.Array, psi_B: jax.Array
) -> jax.Array:
    """The loads on legs 1 .. N-1 in takeoff, with phases t (N-1,), at the touchdowns of legs 2 .. N.

    Lengths are in units of the derivative of leg length by phase: leg i is shorter by a_i D, its neighbour by
    a_j t. Leg 1 has no further neighbour; any other further neighbour lags by psi_B less its own t.
    """
    zero = jnp.zeros_like(k[:1])
    shortened, landed = a[:-2] * t, a[1:-1] * D
    beyond = jnp.concatenate([zero, a[:-3] * jnp.maximum(t[1:] + t[:-1] - psi_B, 0.0)])
    spring = jnp.concatenate([zero, k[:-2]])
    return weights[:-2] - spring * (shortened - beyond) - k[:-1] * (shortened - landed)
