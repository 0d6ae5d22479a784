"""The quadruped's start: standing, with the lead of limb 1 over limb 3 that is held at first."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from gaitsweep.dynamics import wrapped
from gaitsweep.papers.aoi2011.waist_quadruped.foot_path import EARLY, LATE, STANCE
from gaitsweep.papers.aoi2011.waist_quadruped.limb import joint_angles
from gaitsweep.papers.aoi2011.waist_quadruped.posture import HIP, KNEE
from gaitsweep.papers.aoi2011.waist_quadruped.sizes import LIMBS
from gaitsweep.papers.aoi2011.waist_quadruped.state import Params, State


def initial_state(p: Params, lead: jax.Array) -> State:
    """All feet on the ground below their hips, limb 3 at its AEP; `lead` (rad) is delta_13."""
    zero = jnp.zeros_like(p.omega)
    phi_3 = p.phi_AEP
    phi_1 = phi_3 + lead
    phi = wrapped(jnp.stack([phi_1, phi_1 - jnp.pi, phi_3, phi_3 - jnp.pi]))
    early = phi < p.gate * p.phi_AEP
    segment = jnp.where(phi >= p.phi_AEP, STANCE, jnp.where(early, EARLY, LATE))
    path = p.path(zero, True)
    x, z = path.target(phi, segment, (path.x_c, -path.H))
    q = _standing(p, x, z)
    at, _ = p.mechanics.feet(q, jnp.zeros(15, q.dtype))
    return State(
        q=q,
        v=jnp.zeros(15, q.dtype),
        phi=phi,
        clock=zero,
        growing=jnp.ones((), bool),
        held=jnp.ones((), bool),
        contact=jnp.ones(4, bool),
        anchor=at[:, :2],
        segment=segment,
        lifted=jnp.zeros(4, bool),
        landing_x=x,
        landing_z=z,
        height=at[:, 2],
        gain=jnp.zeros(4, q.dtype),
        closed=jnp.zeros((), bool),
        held_lead=lead,
        stride_x=zero,
        stride_t=zero,
        speed=zero,
        period=zero,
        stood=jnp.zeros(4, q.dtype),
        landed=jnp.zeros(4, q.dtype),
        duty=jnp.ones(4, q.dtype),
        touchdowns=jnp.zeros(4, q.dtype),
    )


def _standing(p: Params, x: jax.Array, z: jax.Array) -> jax.Array:
    """Positions (16,) of the standing body, its feet at x and z (4,) m from their hips."""
    m, zero = p.mechanics, jnp.zeros_like(p.omega)
    angles = [zero] * 9
    for i in LIMBS:
        hip, knee = joint_angles(x[i], z[i], m.link_length, m.bends[i])
        angles[HIP[i] - 7], angles[KNEE[i] - 7] = hip, knee
    # pitched so that fore and hind feet are at one height
    fore, (fore_depth, hind_depth) = m.front_hip_x + p.x_c_fore, p.depths()
    pitch = jnp.arctan2(hind_depth - fore_depth, fore + m.body_distance + m.rear_hip_x - p.x_c_hind)
    height = fore_depth * jnp.cos(pitch) + fore * jnp.sin(pitch)
    turn = jnp.cos(0.5 * pitch), zero, jnp.sin(0.5 * pitch), zero
    q = jnp.concatenate([jnp.stack([zero, zero, height, *turn]), jnp.stack(angles)])
    # compression of the ground by the body's weight
    weight = (m.front_mass + m.rear_mass + 8.0 * m.link_mass) * m.g
    return q.at[2].add(-weight / (4.0 * m.K_N))
