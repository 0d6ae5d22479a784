"""What changes along the reduced multi-legged chain: phases, segments, and what events do to them."""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp

from gaitsweep.dynamics.phase_oscillator import TWO_PI, wrapped
from gaitsweep.models.multilegged.model import LANDING, STANCE, TAKEOFF, Params

# A leg touches that is nearer than this to the ground (m): legs that come down together touch together,
# whatever rounding makes of them.
TOUCHING = 1e-13


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["phi", "segment", "held", "psi", "landed", "late"],
    meta_fields=[],
)
@dataclasses.dataclass(frozen=True)
class State:
    """Phases phi (N+1,), rad, and the modes.

    `segment` (N+1,) of each leg's length: stance, takeoff or landing; `held` (N+1,): the leg has been on the
    ground since before its landing segment, and so cannot touch down; `psi` (N,), rad, as read when section 1
    was crossed last; `landed`: leg 1 touched down there; `late`: s, by which steps of fixed length are ahead
    of this state.
    """

    phi: jax.Array
    segment: jax.Array
    held: jax.Array
    psi: jax.Array
    landed: jax.Array
    late: jax.Array


def corner_of(p: Params, s: State) -> jax.Array:
    """Phase at the end of each leg's segment, rad."""
    stance, takeoff = 2.0 * p.beta * jnp.pi, (1.0 + p.beta) * jnp.pi
    return jnp.where(s.segment == STANCE, stance, jnp.where(s.segment == TAKEOFF, takeoff, TWO_PI))


def after_events(s: State, corner: jax.Array, touches: jax.Array, lifts: jax.Array) -> State:
    """The state after legs (N+1,) reach a corner of their phase, touch down (`touches`), or lift off.

    A leg begins its landing segment as held; what it really is shows at once, without time going on.
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
