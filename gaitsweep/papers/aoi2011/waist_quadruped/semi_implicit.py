"""The quadruped with fixed steps: semi-implicit Euler, with landings interpolated inside a step.

A step first detects touchdowns and ends of segments in the previous step, then integrates. So a crossing is
detected one step after its landing, and forward kinematics are computed once a step.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaitsweep.contract import FixedStepDynamics
from gaitsweep.dynamics import worked_in
from gaitsweep.dynamics.tree import PointForce, integrate
from gaitsweep.papers.aoi2011.waist_quadruped.foot_path import LATE
from gaitsweep.papers.aoi2011.waist_quadruped.mechanics import RELEASE, WaistMechanics, body
from gaitsweep.papers.aoi2011.waist_quadruped.rhythm import (
    after_events,
    anchors,
    corner,
    desired_velocities,
    landing_points,
    phase_rates,
    transitions,
)
from gaitsweep.papers.aoi2011.waist_quadruped.state import Params, State

# Largest value of dt times the fastest rate.
STEPS_TO_RATE = 1.25


class WaistBody(abc.ABC):
    """The rigid-body dynamics of the quadruped: positions of the feet, a step, and values of a row."""

    @property
    def compiled_of(self) -> tuple[str, ...]:
        """The parameters that `on_host` needs."""
        return ()

    def on_host(
        self, values: Mapping[str, Float[np.ndarray, " rows"]]
    ) -> dict[str, Float[np.ndarray, "rows ..."]]:
        """`Model.on_host` of the quadruped with this body."""
        return dict(values)

    def numbers(self, values: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        """`WaistMechanics.numbers` of a row's values."""
        return {}

    @abc.abstractmethod
    def feet(self, m: WaistMechanics, s: State, dt: jax.Array) -> tuple[jax.Array, jax.Array]:
        """As `WaistMechanics.feet`, in the precision of a step of `dt`."""

    @abc.abstractmethod
    def moved(
        self, m: WaistMechanics, s: State, tau: jax.Array, forces: list[PointForce], dt: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Q (16,) and v (15,) after a step of `dt` (s) with joint forces `tau` (15,) and ground forces."""


class WaistTreeBody(WaistBody):
    """The body as gaitsweep's articulated tree."""

    def feet(self, m: WaistMechanics, s: State, dt: jax.Array) -> tuple[jax.Array, jax.Array]:
        return worked_in(dt.dtype, WaistMechanics.feet)(m, s.q, s.v)

    def moved(
        self, m: WaistMechanics, s: State, tau: jax.Array, forces: list[PointForce], dt: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        v = s.v + dt * worked_in(dt.dtype, WaistMechanics.accelerations)(m, s.q, s.v, tau, forces)
        return jnp.asarray(integrate(body()[0], s.q, v, dt)), v


@dataclasses.dataclass(frozen=True)
class SemiImplicit(FixedStepDynamics):
    """Semi-implicit Euler steps of the quadruped with a body."""

    body: WaistBody

    def step(self, params: Params, state: State, dt: Float[Array, ""]) -> State:
        p, s, m, dt = params, state, params.mechanics, jnp.asarray(dt)
        at, speed = self.body.feet(m, s, dt)
        height = at[:, 2]
        switched = jnp.where(s.contact, height > RELEASE, height <= 0.0)
        past = s.phi - corner(p, s.segment)
        now = transitions(s, past >= 0.0, switched)
        touches = now.contact & ~s.contact
        # the share of the last step after the foot's height was zero
        sunk = s.height - height
        drop = jnp.where(sunk != 0.0, sunk, 1.0)
        rest = jnp.where(touches, -height / drop, 0.0)
        lifts = s.contact & ~now.contact
        since = dt * jnp.where(lifts, (RELEASE - height) / drop, rest)
        # of a touchdown and a segment's end in one step, the later one is the landing; but in the second half
        # of the swing a touchdown alone is a landing
        since_touch = jnp.where(touches, rest * s.gain, jnp.inf)
        since_corner = jnp.where((past >= 0.0) & ~(touches & (s.segment == LATE)), past, jnp.inf)
        over = jnp.where(now.lands, jnp.minimum(since_touch, since_corner), 0.0)
        landing_in = jnp.where(past > over, s.segment + 1, s.segment)
        anchor = anchors(p, s, touches, at[:, :2] - (rest * dt)[:, None] * speed[:, :2])

        # desired positions of the feet; for a landing limb the one at its landing, then its progress since
        path = p.path(s.clock, s.growing)
        phi = jnp.where(now.lands, s.phi - over, jnp.where(now.wraps, s.phi - 2.0 * jnp.pi, s.phi))
        x, z = path.target(phi, jnp.where(now.lands, landing_in, now.segment), (s.landing_x, s.landing_z))
        actual = worked_in(dt.dtype, WaistMechanics.from_hips)(m, s.q, p.landing_actual)
        landing = landing_points(p, s, now.late, (x, z), actual)
        s = after_events(p, dataclasses.replace(s, anchor=anchor), now, landing, over, since)
        on_line = path.line(*landing, path.progress(s.phi))
        x, z = jnp.where(now.lands, on_line[0], x), jnp.where(now.lands, on_line[1], z)
        if m.T_slip is not None:
            # exact for a force that stays: no step is too long for it
            slid = -jnp.expm1(-dt / m.T_slip) * m.T_slip * m.creep(at, speed, s.anchor, s.contact)
            s = dataclasses.replace(s, anchor=s.anchor + slid)

        # in the step in which delta_13 is released, it is held for a share of the step
        share = jnp.where(s.held, jnp.minimum((p.T_hold - s.clock) / dt, 1.0), 0.0)
        coupling = p.K_hold * share
        desired = desired_velocities(p, s, coupling) if p.damping == "rate_error" else None
        forces = m.ground_forces(at, speed, s.anchor, s.contact)
        tau = worked_in(dt.dtype, WaistMechanics.torques)(m, s.q, s.v, x, z, desired)
        q, v = self.body.moved(m, s, tau, forces, dt)
        gain, clock = dt * phase_rates(p, s, coupling), s.clock + dt
        return dataclasses.replace(
            s,
            q=q,
            v=v,
            phi=s.phi + gain,
            clock=clock,
            growing=clock < p.T_grow,
            held=clock < p.T_hold,
            height=height,
            gain=gain,
        )

    def longest_step(self, params: Params) -> Float[Array, ""]:
        """The longest step (s), below the stability limit at which dt times the fastest rate is 2."""
        rate, _ = fastest_motion(params)
        return STEPS_TO_RATE / rate

    def events(self, params: Params, before: State, after: State) -> Bool[Array, " events"]:
        """Whether limb 3 has landed; the step itself has applied the jump."""
        return after.closed[None]

    def jump(self, params: Params, state: State, fired: Bool[Array, " events"]) -> State:
        return state

    def section(self, params: Params, before: State, fired: Bool[Array, " events"]) -> Bool[Array, ""]:
        return fired[0]


def fastest_motion(p: Params) -> tuple[jax.Array, jax.Array]:
    """Rate (1/s) and damping ratio of the fastest motion, estimated for the straightest limb.

    A limb is two rods on a hip whose compliance is that of half a body; ground and joints act as springs and
    dampers. Compared with the largest eigenvalue of the Jacobian of the whole body, its error is between -6 %
    and 50 %, for nine of ten parameter sets between 0 and 15 % (`tests/engine/test_flow_spectrum.py`).
    """
    m = p.mechanics
    # the straighter limb's, and the stiffer direction's
    farthest = jnp.max(jnp.hypot(p.H, 0.5 * p.D + jnp.abs(p.x_c)))
    damper, spring = jnp.maximum(m.D_TL, m.D_N), jnp.maximum(m.K_TL, m.K_N)
    reach = jnp.minimum(farthest, 2.0 * m.link_length)
    cosine = reach * reach / (2.0 * m.link_length * m.link_length) - 1.0  # of the knee angle
    free = 1.0 + 0.5 * m.link_mass / jnp.minimum(m.front_mass, m.rear_mass)
    c = free * _fastest(damper, m.sigma_1, m.sigma_2, cosine, m.link_mass, m.link_length)
    k = free * _fastest(spring, m.kappa_1, m.kappa_2, cosine, m.link_mass, m.link_length)
    root = jnp.sqrt(k)
    # stiffness and damping may be largest along different motions
    decays = 0.5 * c + jnp.sqrt(jnp.maximum(0.25 * c * c - 0.5 * k, 0.0))
    return jnp.maximum(root, decays), jnp.minimum(0.5 * c / root, 1.0)


def _fastest(
    ground: jax.Array, hip: jax.Array, knee: jax.Array, cosine: jax.Array, mass: jax.Array, length: jax.Array
) -> jax.Array:
    """The largest eigenvalue of M^-1 K of a limb of two rods, with K its stiffness or damping."""
    square = length * length
    determinant = 4.0 / 9.0 - 0.25 * cosine * cosine
    i11, i12, i22 = (x / (determinant * mass * square) for x in (1.0 / 3.0, -0.5 * cosine, 4.0 / 3.0))
    a11, a12, a22 = ground * square + hip + knee, ground * square * cosine - knee, ground * square + knee
    b11, b12 = i11 * a11 + i12 * a12, i11 * a12 + i12 * a22
    b21, b22 = i12 * a11 + i22 * a12, i12 * a12 + i22 * a22
    half = 0.5 * (b11 + b22)
    return half + jnp.sqrt(jnp.maximum(half * half - (b11 * b22 - b12 * b21), 0.0))
