"""Existence conditions of the three gaits: when the analytic solutions are motions of the chain.

Along a wave each inner leg touches down while one neighbour is in stance and the other in takeoff (eq. 12).
This is consistent only if the takeoff of that neighbour has begun (t > 0) and it is still on the ground. At
the touchdown of leg i, reset by D, its neighbour j in takeoff has the load

    m_j g - kappa_jh (l_h - l_j) - kappa_ij (l_i - l_j),   with h the next leg after j.

The other neighbour stands if the lag of the two, psi_B - t (`solution_sets.py`), is below 2 beta pi: so psi_B
is, too, and else no lag of the wave is free. This fails for duty factors below about 1/2.

In a uniform chain t > 0 means m_B > m/2. If h is in stance, a positive load means m_B < m: together the
paper's m/2 < m_B < m. In a soft chain phase lags are so small that h is in takeoff as well. A positive load
then means m_B < m or (2 m_B + m) g/kappa > 2 a.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from gaitsweep.papers.ambe2021.theory.chain import Chain, amplitudes, masses, reset, springs, takeoffs


class Conditions(NamedTuple):
    """Margins of the conditions of one wave; a condition is satisfied if its margin is above 0.

    `takeoff` has, of each leg in takeoff at the touchdown of its neighbour, the distance of t from the nearer
    end of the takeoff segment, as a share of the segment: (N - 1,), or (N,) of a wave along the whole chain,
    whose last one is that of the neighbour of an end. `stance` is the least distance of the others from the
    end of stance, as a share of it, a scalar. `load` (N - 1,) has the loads on the first N - 1 of
    these legs, divided by an inner leg's mean weight; `landing` is the remaining share of the landing segment
    at touchdown, a scalar above 0 if m g/kappa < a for the mass that determines it.
    """

    takeoff: jax.Array
    stance: jax.Array
    load: jax.Array
    landing: jax.Array

    @property
    def hold(self) -> jax.Array:
        """Whether the wave is a motion of the chain, with all margins above zero."""
        return jnp.min(jnp.concatenate([*map(jnp.atleast_1d, self)])) > 0.0


def wave_conditions(N: int, chain: Chain) -> tuple[Conditions, Conditions]:
    """The conditions of the direct and of the retrograde wave.

    Args:
        N: springs, 3 at least.
        chain: parameters; may be traced.

    Source: sec. 2.1 of the paper for uniform chains; eq. (12) with the load of a leg in takeoff for others.
    """
    direct, retrograde = _touchdowns(N, chain)
    since_takeoff, segment = takeoffs(N, chain), _segment(chain)
    # the neighbours of the ends, at the touchdowns of these
    beside_head, beside_tail = 1.0 - since_takeoff.first / segment, 1.0 - since_takeoff.last / segment
    return (
        direct._replace(
            takeoff=jnp.append(direct.takeoff, beside_tail),
            stance=_stance(chain, jnp.append(since_takeoff.front, since_takeoff.last)),
        ),
        retrograde._replace(
            takeoff=jnp.append(retrograde.takeoff, beside_head),
            stance=_stance(chain, jnp.append(since_takeoff.rear, since_takeoff.first)),
        ),
    )


def source_conditions(N: int, chain: Chain, k: int) -> Conditions:
    """The conditions of the source wave with the boundary leg k, of the solution set B (`solution_sets.py`).

    Legs 2 .. k-1 touch down as in a direct wave, legs k .. N as in a retrograde one. If all neighbours in
    takeoff are ends, as for N = 3 and k = 3, one spring lifts them instead of two.

    Args:
        N, chain: as for `wave_conditions`.
        k: boundary leg, 3 .. N.
    """
    direct, retrograde = _touchdowns(N, chain)
    takeoff = jnp.concatenate([direct.takeoff[: k - 2], retrograde.takeoff[k - 2 :]])
    load = jnp.concatenate([direct.load[: k - 2], retrograde.load[k - 2 :]])
    return Conditions(takeoff, direct.stance, load, direct.landing)


def existing_waves(N: int, chain: Chain) -> dict[str, jax.Array]:
    """Whether the direct, a source (of any boundary leg) and the retrograde wave are motions of the chain.

    They are those of the sets B. Where only `stance` is below zero, by little, waves of sets A remain.

    Args:
        N, chain: as for `wave_conditions`.
    """
    direct, retrograde = wave_conditions(N, chain)
    sources = [source_conditions(N, chain, k).hold for k in range(3, N + 1)]
    return {"direct": direct.hold, "source": jnp.any(jnp.stack(sources)), "retrograde": retrograde.hold}


def _segment(chain: Chain) -> jax.Array:
    """The phase, rad, that takeoff and landing take each."""
    return jnp.asarray((1.0 - chain.beta) * jnp.pi)


def _stance(chain: Chain, t: jax.Array) -> jax.Array:
    """The least margin of neighbours in stance whose lags are psi_B less these phases t (n,), rad."""
    stance = 2.0 * chain.beta * jnp.pi
    psi_B = 2.0 * _segment(chain) - reset(chain)
    return jnp.asarray((stance - psi_B + jnp.min(t)) / stance)


def _touchdowns(N: int, chain: Chain) -> tuple[Conditions, Conditions]:
    """The margins at the touchdowns of legs 2 .. N, with the neighbour in takeoff towards head and tail."""
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
        load = load[::order] / (segment * inner_mass * chain.g)
        margins.append(Conditions(takeoff, _stance(chain, jnp.zeros(1)), load, 1.0 - D / segment))
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
