"""Contact of a round foot with compliant ground: a spring, a damper, regularised Coulomb friction."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Float

from gaitsweep.dynamics.ground import Ground
from gaitsweep.dynamics.tree.dynamics import YieldingForce
from gaitsweep.dynamics.tree.spatial import Array, Scalar


def normal_force(
    depth: Float[Array, " ..."], rate: Float[Array, " ..."], K: Scalar, D: Scalar
) -> Float[Array, " ..."]:
    """The normal force of the ground, N: a spring and a damper that push but do not pull.

    Args:
        depth: depth of the lowest point below the ground, m, of any shape; no force above the ground.
        rate: time derivative of the depth, m/s.
        K, D: spring, N/m, and damper, N s/m.
    """
    return jnp.where(depth > 0.0, jnp.maximum(K * depth + D * rate, 0.0), 0.0)


def friction_slope(
    load: Float[Array, " ..."], slip: Float[Array, " ..."], mu: Scalar, v_slip: Scalar
) -> Float[Array, " ..."]:
    """Friction divided by slip speed, N s/m: Coulomb friction mu load, viscous below the speed `v_slip`.

    Args:
        load: normal force, N.
        slip: velocity along the ground, m/s, with the shape of `load`.
        mu: coefficient of friction.
        v_slip: slip speed below which friction is viscous, m/s.
    """
    return jnp.asarray(mu * load) / jnp.maximum(jnp.abs(slip), v_slip)


def ground_force(
    link: int,
    at: Float[Array, " 3"],
    velocity: Float[Array, " 3"],
    dt: Scalar,
    *,
    K: Scalar,
    D: Scalar,
    mu: Scalar,
    v_slip: Scalar,
) -> YieldingForce:
    """The force of ground at z = 0 on a foot that moves in the x-z plane, for a step of `dt` (s).

    Friction is implicit: its slope at the beginning of the step times the foot's velocity at the end, since
    explicit friction could reverse the slip within a step.

    Args:
        link: the foot's link.
        at: the foot's lowest point in the world, (3,) m.
        velocity: its velocity there, (3,) m/s.
        dt: the step, s.
        K, D, mu, v_slip: as for `normal_force` and `friction_slope`.
    """
    load = normal_force(-at[2], -velocity[2], K, D)
    slope = friction_slope(load, velocity[0], mu, v_slip)
    zero = jnp.zeros_like(load)
    force = jnp.stack([-slope * velocity[0], zero, load])
    return YieldingForce(link, at, force, jnp.stack([dt * slope, zero, zero]))


def uneven_ground_force(
    link: int,
    at: Float[Array, " 3"],
    velocity: Float[Array, " 3"],
    dt: Scalar,
    ground: Ground,
    normal: Float[Array, " 3"],
    *,
    K: Scalar,
    D: Scalar,
    mu: Scalar,
    v_slip: Scalar,
) -> tuple[YieldingForce, Scalar]:
    """The force of uneven ground on a foot, as `ground_force` of level ground, and its load (N).

    The load is the part of the force across the ground; friction is along the ground.

    Args:
        link: the foot's link.
        at: the foot's point that is nearest to the ground, in the world, (3,) m.
        velocity: its velocity there, (3,) m/s.
        dt: the step, s.
        ground: the ground.
        normal: the unit vector across the ground, (3,).
        K, D, mu, v_slip: as for `normal_force` and `friction_slope`.
    """
    along = jnp.stack([normal[2], jnp.zeros_like(normal[0]), -normal[0]])
    depth = (ground(at[0]) - at[2]) * normal[2]
    load = normal_force(depth, -jnp.sum(velocity * normal), K, D)
    slip = jnp.sum(velocity * along)
    slope = friction_slope(load, slip, mu, v_slip)
    force = load * normal - slope * slip * along
    return YieldingForce(link, at, force, dt * slope * along[:, None] * along[None, :]), load
