"""A round foot on level ground that gives way: a spring and a damper, friction that never sticks fast."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from gaitsweep.dynamics.external_force import YieldingForce
from gaitsweep.dynamics.tree.spatial import Array, Scalar


def normal_force(depth: Array, rate: Array, K: Scalar, D: Scalar) -> jax.Array:
    """Force of the ground upwards, N: a spring and a damper that push and never pull.

    Args:
        depth: of the lowest point below the ground, m, of any shape; above it there is no force.
        rate: of the depth, m/s.
        K, D: spring, N/m, and damper, N s/m.
    """
    return jnp.where(depth > 0.0, jnp.maximum(K * depth + D * rate, 0.0), 0.0)


def friction_slope(load: jax.Array, slip: Array, mu: Scalar, v_slip: Scalar) -> jax.Array:
    """Friction over slip speed, N s/m: Coulomb's mu load, less in proportion where it slips below `v_slip`.

    Args:
        load: force of the ground upwards, N.
        slip: velocity along the ground, m/s, of one shape with `load`.
        mu: coefficient of friction.
        v_slip: m/s.
    """
    return jnp.asarray(mu * load) / jnp.maximum(jnp.abs(slip), v_slip)


def ground_force(
    link: int,
    at: Array,
    velocity: Array,
    dt: Scalar,
    *,
    K: Scalar,
    D: Scalar,
    mu: Scalar,
    v_slip: Scalar,
) -> YieldingForce:
    """The force of ground at z = 0 on a foot that moves in the plane of x and z, for a step of `dt` (s).

    The friction is that at the step's end, in which it would otherwise turn the slip around: its slope,
    taken at the beginning, times the velocity that the foot then has.

    Args:
        link: the foot's link.
        at: its lowest point in the world, (3,) m.
        velocity: of the foot there, (3,) m/s.
        dt: the step, s.
        K, D, mu, v_slip: as above.
    """
    load = normal_force(-at[2], -velocity[2], K, D)
    slope = friction_slope(load, velocity[0], mu, v_slip)
    zero = jnp.zeros_like(load)
    force = jnp.stack([-slope * velocity[0], zero, load])
    return YieldingForce(link, at, force, jnp.stack([dt * slope, zero, zero]))
