"""The quadruped with fixed steps: semi-implicit Euler, with landings interpolated inside a step.

A step first detects touchdowns and ends of segments in the previous step, then integrates. So a crossing is
detected one step after its landing, and forward kinematics are computed once a step.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaitsweep.contract import FixedStepDynamics
from gaitsweep.dynamics import evaluated_in
from gaitsweep.papers.aoi2011.waist_quadruped.bodies import WaistBody
from gaitsweep.papers.aoi2011.waist_quadruped.kinematics import LATE, Point
from gaitsweep.papers.aoi2011.waist_quadruped.mechanics import RELEASE_HEIGHT, WaistMechanics
from gaitsweep.papers.aoi2011.waist_quadruped.rhythm import (
    Transitions,
    after_events,
    anchors,
    corner,
    desired_velocities,
    landing_points,
    phase_rates,
    transitions,
)
from gaitsweep.papers.aoi2011.waist_quadruped.state import Params, State

# Largest value of dt times the fastest rate, below 2, the limit of stability.
MAX_STEP_RATE = 1.25


@dataclasses.dataclass(frozen=True)
class SemiImplicit(FixedStepDynamics):
    """Semi-implicit Euler steps of the quadruped with a body."""

    body: WaistBody

    def step(self, params: Params, state: State, dt: Float[Array, ""]) -> State:
        p = params
        s = state
        m = params.mechanics
        dt = jnp.asarray(dt)
        at, speed = self.body.feet(m, s, dt)
        crossings = _crossings(p, s, at, speed, dt)
        actual = evaluated_in(dt.dtype, WaistMechanics.from_hips)(m, s.q, p.landing_actual)
        s, x, z = _with_events(p, s, crossings, actual)
        if m.T_slip is not None:
            # exact for a force that stays: no step is too long for it
            slid = -jnp.expm1(-dt / m.T_slip) * m.T_slip * m.creep(at, speed, s.anchor, s.contact)
            s = dataclasses.replace(s, anchor=s.anchor + slid)

        # in the step in which delta_13 is released, it is held for a share of the step
        share = jnp.where(s.held, jnp.minimum((p.T_hold - s.clock) / dt, 1.0), 0.0)
        coupling = p.K_hold * share
        desired = desired_velocities(p, s, coupling) if p.damping == "rate_error" else None
        forces = m.ground_forces(at, speed, s.anchor, s.contact)
        tau = evaluated_in(dt.dtype, WaistMechanics.torques)(m, s.q, s.v, x, z, desired)
        q, v = self.body.stepped(m, s, tau, forces, dt)
        gain, clock = dt * phase_rates(p, s, coupling), s.clock + dt
        return dataclasses.replace(
            s,
            q=q,
            v=v,
            phi=s.phi + gain,
            clock=clock,
            growing=clock < p.T_grow,
            held=clock < p.T_hold,
            height=m.heights(at),
            gain=gain,
        )

    def longest_step(self, params: Params) -> Float[Array, ""]:
        """The longest step (s), below the stability limit at which dt times the fastest rate is 2."""
        rate, _ = params.mechanics.fastest_motion(params.farthest_foot)
        return MAX_STEP_RATE / rate

    def events(self, params: Params, before: State, after: State) -> Bool[Array, " events"]:
        """Whether limb 3 has landed; the step itself has applied the jump."""
        return after.closed[None]

    def jump(self, params: Params, state: State, fired: Bool[Array, " events"]) -> State:
        return state

    def section(self, params: Params, before: State, fired: Bool[Array, " events"]) -> Bool[Array, ""]:
        return fired[0]


class _Crossings(NamedTuple):
    """The events of the last step, (4,) each.

    `over` (rad): phase since each landing; `landing_in`: the segment in which the limb lands; `since` (s):
    time since the foot touched the ground or left it; `anchor` (4, 2) m: touchdown points after them.
    """

    now: Transitions
    over: jax.Array
    landing_in: jax.Array
    since: jax.Array
    anchor: jax.Array


def _crossings(p: Params, s: State, at: jax.Array, speed: jax.Array, dt: jax.Array) -> _Crossings:
    """The events of the last step of `dt` (s); positions and velocities of the feet (4, 3) are after it."""
    height = p.mechanics.heights(at)
    switched = jnp.where(s.contact, height > RELEASE_HEIGHT, height <= 0.0)
    past = s.phi - corner(p, s.segment)
    now = transitions(s, past >= 0.0, switched)
    touches = now.contact & ~s.contact
    # the share of the last step after the foot's height was zero
    sunk = s.height - height
    drop = jnp.where(sunk != 0.0, sunk, 1.0)
    share = jnp.where(touches, -height / drop, 0.0)
    lifts = s.contact & ~now.contact
    since = dt * jnp.where(lifts, (RELEASE_HEIGHT - height) / drop, share)
    # of a touchdown and a segment's end in one step, the later one is the landing; but in the second half
    # of the swing a touchdown alone is a landing
    since_touch = jnp.where(touches, share * s.gain, jnp.inf)
    since_corner = jnp.where((past >= 0.0) & ~(touches & (s.segment == LATE)), past, jnp.inf)
    over = jnp.where(now.lands, jnp.minimum(since_touch, since_corner), 0.0)
    landing_in = jnp.where(past > over, s.segment + 1, s.segment)
    anchor = anchors(p, s, touches, at[:, :2] - (share * dt)[:, None] * speed[:, :2])
    return _Crossings(now, over, landing_in, since, anchor)


def _with_events(
    p: Params, s: State, crossings: _Crossings, actual: Point
) -> tuple[State, jax.Array, jax.Array]:
    """The state after the events, and the desired x and z (4,) m of the feet.

    A limb that lands has its landing point from its desired position then, and goes on along the stance line.

    Args:
        p, s: parameters, and the state before the events.
        crossings: the events.
        actual: x and z (4,) m of the feet from their hips, times `landing_actual`.
    """
    now, over = crossings.now, crossings.over
    path = p.path(s.clock, s.growing)
    phi = jnp.where(now.lands, s.phi - over, jnp.where(now.wraps, s.phi - 2.0 * jnp.pi, s.phi))
    x, z = path.target(
        phi, jnp.where(now.lands, crossings.landing_in, now.segment), (s.landing_x, s.landing_z)
    )
    landing = landing_points(p, s, now.late, (x, z), actual)
    s = after_events(p, dataclasses.replace(s, anchor=crossings.anchor), now, landing, over, crossings.since)
    on_line = path.line(*landing, path.progress(s.phi))
    x, z = jnp.where(now.lands, on_line[0], x), jnp.where(now.lands, on_line[1], z)
    return s, x, z
