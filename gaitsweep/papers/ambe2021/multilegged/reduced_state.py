"""The state of the reduced chain, and its changes at events."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from gaitsweep.dynamics import TWO_PI, wrapped
from gaitsweep.papers.ambe2021.multilegged.state import LANDING, STANCE, Params

# A leg closer than this to the ground (m) touches it, so that simultaneous touchdowns stay simultaneous in
# spite of rounding.
TOUCHING = 1e-13


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class State:
    """Phases phi (N+1,), rad, and the modes.

    `segment` (N+1,) is the segment of each leg's length: stance, takeoff or landing; `held` (N+1,): the leg
    has been on the ground since before its landing segment, and so cannot touch down; `psi` (N,), rad, are
    the relative phases at the last crossing of section 1; `landed`: leg 1 touched down there; `late` (s) is
    the time by which fixed steps are ahead of this state.
    """

    phi: jax.Array
    segment: jax.Array
    held: jax.Array
    psi: jax.Array
    landed: jax.Array
    late: jax.Array


def after_events(s: State, corner: jax.Array, touches: jax.Array, lifts: jax.Array) -> State:
    """The state after legs (N+1,) reach the end of a segment (`corner`), touch down (`touches`), or lift off.

    A leg begins its landing segment as held; if it is not, it lifts off at the same instant.
    """
    landing = s.segment == LANDING
    resets = touches & landing
    wraps = corner & landing & ~resets
    ends = resets | wraps
    segment = jnp.where(ends, STANCE, jnp.where(corner, s.segment + 1, s.segment))
    crosses = ends[0]
    psi = wrapped(s.phi[1:] - s.phi[:-1])  # eq. (7), before the reset
    return State(
        phi=jnp.where(resets, 0.0, jnp.where(wraps, s.phi - TWO_PI, s.phi)),
        segment=segment,
        held=jnp.where(corner | ends, (segment == LANDING), s.held & ~lifts),
        psi=jnp.where(crosses, psi, s.psi),
        landed=jnp.where(crosses, resets[0], s.landed),
        late=s.late,
    )


def with_legs_reversed(params: Params, s: State) -> State:
    """The state of the chain with its legs in reversed order."""
    phi = s.phi[::-1]
    psi = wrapped(phi[1:] - phi[:-1])
    return dataclasses.replace(s, phi=phi, segment=s.segment[::-1], held=s.held[::-1], psi=psi)
