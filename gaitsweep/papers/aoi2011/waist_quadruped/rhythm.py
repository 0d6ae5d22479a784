"""The oscillators of the limbs: coupled phases, segments of foot paths, and phase resets."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp

from gaitsweep.dynamics import TWO_PI
from gaitsweep.papers.aoi2011.waist_quadruped.kinematics import BEYOND, EARLY, LATE, STANCE, Point, Scalar
from gaitsweep.papers.aoi2011.waist_quadruped.state import Params, State

# The limb whose landing ends a stride and closes a cycle: limb 3, the right hind one (Aoi et al. 2011).
STRIDE_LIMB = 2


class Transitions(NamedTuple):
    """Flags of each limb (4,): contact, segment and lifted after the events, landing, wrap of the phase.

    `late`: the limb has passed phi_AEP without a landing.
    """

    contact: jax.Array
    segment: jax.Array
    lifted: jax.Array
    lands: jax.Array
    wraps: jax.Array
    late: jax.Array


def phase_rates(p: Params, s: State, coupling: jax.Array) -> jax.Array:
    """Rates of the phases, (4,) rad/s, eq. (2), (6).

    Args:
        p, s: parameters and state.
        coupling: gain with which delta_13 is pulled to `s.held_lead`, rad/s.
    """
    fore = jnp.sin(s.phi[0] - s.phi[1] - p.delta_star["12"])
    hind = jnp.sin(s.phi[2] - s.phi[3] - p.delta_star["34"])
    # Delta*_ji = -Delta*_ij, so one sine serves both limbs of a pair
    sine_13 = jnp.sin(s.phi[0] - s.phi[2] - p.delta_star["13"])
    sine_24 = jnp.sin(s.phi[1] - s.phi[3] - p.delta_star["24"])
    sine_14 = jnp.sin(s.phi[0] - s.phi[3] - p.delta_star["14"])
    sine_23 = jnp.sin(s.phi[1] - s.phi[2] - p.delta_star["23"])
    hold_13 = coupling * jnp.sin(s.phi[0] - s.phi[2] - s.held_lead)
    hold_24 = coupling * jnp.sin(s.phi[1] - s.phi[3] - s.held_lead)
    pull = [
        -p.K["12"] * fore - hold_13 - (p.K["13"] * sine_13 + p.K["14"] * sine_14),
        p.K["21"] * fore - hold_24 - (p.K["24"] * sine_24 + p.K["23"] * sine_23),
        -p.K["34"] * hind + hold_13 + (p.K["31"] * sine_13 + p.K["32"] * sine_23),
        p.K["43"] * hind + hold_24 + (p.K["42"] * sine_24 + p.K["41"] * sine_14),
    ]
    return p.omega + jnp.stack(pull)


def corner(p: Params, segment: jax.Array) -> jax.Array:
    """The phase (4,), rad, at which each limb's segment ends."""
    after_early = jnp.where(segment == LATE, p.phi_AEP, TWO_PI)
    return jnp.where(segment == EARLY, p.gate * p.phi_AEP, after_early)


def transitions(s: State, at_corner: jax.Array, switched: jax.Array) -> Transitions:
    """The transitions of limbs and of contacts.

    A foot in contact lands in the second part of its swing if it has been off the ground, and later always.

    Args:
        s: the state before them.
        at_corner: whether each limb is at the end of its segment, (4,).
        switched: whether the contact of each foot has changed, (4,).
    """
    contact = s.contact ^ switched
    wraps = at_corner & ((s.segment == STANCE) | (s.segment == BEYOND))
    segment = jnp.where(wraps, EARLY, jnp.where(at_corner, s.segment + 1, s.segment))
    lifted = jnp.where(wraps, ~contact, s.lifted | ~contact)
    lands = contact & ((lifted & (segment == LATE)) | (segment == BEYOND))
    return Transitions(contact, jnp.where(lands, STANCE, segment), lifted, lands, wraps, segment == BEYOND)


def anchors(p: Params, s: State, touches: jax.Array, at: jax.Array) -> jax.Array:
    """The points to which the ground holds the feet, (4, 2) m.

    With `anchor_kept`, a foot that comes down again within a stance is held where it was.

    Args:
        p, s: parameters, and the state before the touchdowns.
        touches: whether each foot touches down, (4,).
        at: where the feet are, (4, 2) m.
    """
    anew = touches & ~((s.segment == STANCE) & (p.anchor_kept > 0.0))
    return jnp.where(anew[:, None], at, s.anchor)


def landing_points(p: Params, s: State, late: jax.Array, desired: Point, actual: Point) -> Point:
    """X and z (4,), m, of the points (LP) at which the stance lines of landing limbs begin.

    A limb that lands late without a reset goes on along the line from the AEP to the PEP.

    Args:
        p, s: parameters, and the state before the landings.
        late: which limbs land after phi_AEP, (4,).
        desired: desired x and z (4,) of the feet at their landings.
        actual: their actual x and z (4,), times `landing_actual`.
    """
    path = p.path(s.clock, s.growing)
    onwards = late & (p.late_reset <= 0.0)
    x = (1.0 - p.landing_actual) * desired[0] + actual[0]
    z = (1.0 - p.landing_actual) * desired[1] + actual[1]
    return jnp.where(onwards, path.PEP + path.D, x), jnp.where(onwards, -path.H, z)


def desired_velocities(p: Params, s: State, coupling: jax.Array) -> Point:
    """Time derivatives of the desired x and z of the feet, (4,) m/s each.

    Args:
        p, s, coupling: as for `phase_rates`.
    """

    def target(phi: jax.Array, clock: jax.Array) -> tuple[jax.Array, jax.Array]:
        return p.path(clock, s.growing).target(phi, s.segment, (s.landing_x, s.landing_z))

    rates = phase_rates(p, s, coupling), jnp.ones_like(s.clock)
    return jax.jvp(target, (s.phi, s.clock), rates)[1]


def after_events(
    p: Params,
    s: State,
    after: Transitions,
    landing: Point,
    since_corner: Scalar = 0.0,
    since_switch: Scalar = 0.0,
) -> State:
    """The state after the transitions of its limbs, without the update of anchors.

    Args:
        p, s: parameters, and the state before the events.
        after: the transitions.
        landing: x and z (4,) m of the landing points.
        since_corner: phase (4,) rad since each landing; 0 where the events are located.
        since_switch: time (4,) s since each foot touched the ground or left it; 0 likewise.
    """
    past_corner = jnp.broadcast_to(since_corner, (4,))
    reset = after.lands & (p.resetting > 0.0) & ~(after.late & (p.late_reset <= 0.0))
    phi = jnp.where(reset, p.phi_AEP + past_corner, jnp.where(after.wraps, s.phi - TWO_PI, s.phi))  # eq. (7)
    s = _with_stride(p, s, after, past_corner[STRIDE_LIMB] / p.omega, since_switch)
    return dataclasses.replace(
        s,
        phi=phi,
        contact=after.contact,
        segment=after.segment,
        lifted=after.lifted,
        landing_x=jnp.where(after.lands, landing[0], s.landing_x),
        landing_z=jnp.where(after.lands, landing[1], s.landing_z),
    )


def _with_stride(
    p: Params, s: State, after: Transitions, since_landing: jax.Array, since_switch: Scalar
) -> State:
    """The state with the averages of the stride, which ends where the limb `STRIDE_LIMB` lands.

    Args:
        p, s, after: as for `after_events`.
        since_landing: time (s) since that landing.
        since_switch: time (4,) s since each foot touched the ground or left it.
    """
    closed = after.lands[STRIDE_LIMB]
    t = s.clock - since_landing
    x = s.q[0] - (s.clock - t) * s.v[0]
    duration = jnp.where(closed, t - s.stride_t, 1.0)
    switched = after.contact ^ s.contact
    switch_t = s.clock - since_switch
    stood = s.stood + jnp.where(switched, jnp.where(after.contact, -switch_t, switch_t), 0.0)
    landed = s.landed + (switched & after.contact)
    # a stance that goes on at the end of the stride is cut there
    open_end = jnp.where(after.contact, t, 0.0)
    return dataclasses.replace(
        s,
        closed=closed,
        stride_x=jnp.where(closed, x, s.stride_x),
        stride_t=jnp.where(closed, t, s.stride_t),
        speed=jnp.where(closed, (x - s.stride_x) / duration, s.speed),
        period=jnp.where(closed, duration, s.period),
        stood=jnp.where(closed, -open_end, stood),
        landed=jnp.where(closed, 0.0, landed),
        duty=jnp.where(closed, (stood + open_end) / duration, s.duty),
        touchdowns=jnp.where(closed, landed, s.touchdowns),
    )
