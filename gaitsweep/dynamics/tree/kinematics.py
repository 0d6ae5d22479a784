"""Kinematics of an articulated tree: places and velocities of links, and integration of positions.

Equations and tables are those of Featherstone 2008, "Rigid Body Dynamics Algorithms".
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from gaitsweep.dynamics.tree.articulated_tree import WORLD, Geometry, Link, LinkAxes, Tree
from gaitsweep.dynamics.tree.spatial import (
    EYE,
    ZERO,
    Array,
    MotionVector,
    Scalar,
    cross,
    quaternion_exponential,
    quaternion_product,
    rotation_about,
    rotation_of,
)


@dataclasses.dataclass(frozen=True)
class Place:
    """The place of a link; its point is its joint's anchor, its axes are those of `Tree.link_axes`.

    `across` (3, 3) rotates from the link's axes to its parent's, None where they are equal; `offset` (3,) m
    is the point relative to the parent's point, in the parent's axes; `axis` (3,) is the axis of a hinge or
    slide in the link's axes, `axis_across` in the parent's; `turn` (3, 3) the body's orientation in the
    link's axes; `anchor` (3,) m the point in the body's frame.

    Links with the same axes share a base: `frame` (3, 3) is its orientation and `base` (3,) m its position in
    the world; `reach` (3,) m is the link's point relative to the base, in the link's axes.
    """

    across: Array | None
    offset: Array
    axis: Array
    axis_across: Array
    turn: Array
    anchor: Array
    frame: Array
    base: Array
    reach: Array

    def position(self, point: Float[Array, " 3"]) -> Float[Array, " 3"]:
        """The position in the world (3,), m, of a `point` (3,) of the body, m in the body's frame."""
        return self.base + self.frame @ (self.reach + self.turn @ (point - self.anchor))


_GROUND = Place(
    across=None,
    offset=ZERO,
    axis=ZERO,
    axis_across=ZERO,
    turn=EYE,
    anchor=ZERO,
    frame=EYE,
    base=ZERO,
    reach=ZERO,
)


def places(tree: Tree, geometry: Geometry, q: Float[Array, " nq"]) -> list[Place]:
    """The place of each link.

    Args:
        tree, geometry: the n links.
        q: positions (nq,): rad, m, and free joints' positions and quaternions, of any norm.
    """
    placed: list[Place] = []
    angles: list[Scalar | None] = []  # sums of the hinge angles of each limb up to a link
    for i, (link, axes) in enumerate(zip(tree.links, tree.link_axes, strict=True)):
        if link.kind == "free":
            angles.append(None)
            placed.append(_free(geometry.anchor[i], q[tree.q_of[i]]))
            continue
        parent = _GROUND if link.parent == WORLD else placed[link.parent]
        angle = None if link.parent == WORLD else angles[link.parent]
        moved = 0.0 if link.kind == "fixed" else q[tree.q_of[i]][0] - geometry.reference[i]
        if link.kind == "hinge" and not axes.own:
            turned = axes.sign * moved
            angle = turned if angle is None else angle + turned
        angles.append(angle)
        hung = geometry.position[i] + np.array(link.orientation) @ geometry.anchor[i] - parent.anchor
        placed.append(_jointed(link, axes, geometry.anchor[i], parent, parent.turn @ hung, moved, angle))
    return placed


def _free(anchor: Array, q: Array) -> Place:
    """The place of a free body."""
    frame = rotation_of(q[3:])
    return dataclasses.replace(_GROUND, across=frame, offset=q[:3], anchor=anchor, frame=frame, base=q[:3])


def _jointed(
    link: Link,
    axes: LinkAxes,
    anchor: Array,
    parent: Place,
    offset: Array,
    moved: Scalar,
    angle: Scalar | None,
) -> Place:
    """The place of a link whose joint has `moved` (rad, m); `angle` is the sum of its limb's hinges."""
    turn = axes.still if angle is None else rotation_about(axes.normal, angle) @ axes.still
    # the rotation of a hinge does not change its axis
    axis = axes.still @ np.array(link.axis) if link.kind == "hinge" else turn @ np.array(link.axis)
    across = axes.across
    axis_across = axis if across is None else across @ axis
    if link.kind == "slide":
        offset = offset + axis_across * moved
    if axes.own and link.kind == "hinge":
        spun = rotation_about(np.array(link.axis), moved)
        across = spun if across is None else across @ spun
    frame = parent.frame
    base = parent.base
    reach = parent.reach + offset
    if across is not None:
        frame, base, reach = frame @ across, base + frame @ reach, ZERO
    return Place(
        across=across,
        offset=offset,
        axis=axis,
        axis_across=axis_across,
        turn=turn,
        anchor=anchor,
        frame=frame,
        base=base,
        reach=reach,
    )


@dataclasses.dataclass(frozen=True)
class Movement:
    """The velocity of a link.

    `angular` (3,) rad/s is in its axes; `base` (3,) m/s is the velocity of its base in the world; `linear`
    (3,) m/s is the velocity of its point relative to the base, in its axes.
    """

    angular: Float[Array, " 3"]
    linear: Float[Array, " 3"]
    base: Float[Array, " 3"]


def movements(tree: Tree, placed: Sequence[Place], v: Float[Array, " nv"]) -> list[Movement]:
    """The velocity of each link (table 5.1, pass 1).

    Args:
        tree: the n links.
        placed: their places.
        v: velocities (nv,), rad/s and m/s; of a free joint linear in the world, angular in the body.
    """
    moving: list[Movement] = []
    for i, (link, place) in enumerate(zip(tree.links, placed, strict=True)):
        rate = v[tree.v_of[i]]
        if link.kind == "free":
            moving.append(Movement(rate[3:], ZERO, rate[:3]))
            continue
        at_rest = Movement(ZERO, ZERO, ZERO)
        parent = at_rest if link.parent == WORLD else moving[link.parent]
        motion = MotionVector(parent.angular, parent.linear).shifted(place.offset)
        if link.kind == "slide":
            motion = MotionVector(motion.angular, motion.linear + place.axis_across * rate[0])
        angular = motion.angular
        linear = motion.linear
        base = parent.base
        if place.across is not None:
            frame = EYE if link.parent == WORLD else placed[link.parent].frame
            angular, linear, base = place.across.T @ angular, ZERO, base + frame @ linear
        if link.kind == "hinge":
            angular = angular + place.axis * rate[0]
        moving.append(Movement(angular, linear, base))
    return moving


def velocity(place: Place, movement: Movement, point: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """The velocity in the world (3,), m/s, of a point of a link's body.

    Args:
        place, movement: those of the link.
        point: the point (3,), m in the body's frame.
    """
    lever = place.turn @ (point - place.anchor)
    return movement.base + place.frame @ (movement.linear + cross(movement.angular, lever))


def velocity_at(place: Place, movement: Movement, at: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """The velocity in the world (3,), m/s, of a point of a link's body.

    Args:
        place, movement: those of the link.
        at: the point (3,), m in the world.
    """
    lever = place.frame.T @ (at - place.base) - place.reach
    return movement.base + place.frame @ (movement.linear + cross(movement.angular, lever))


def rates(tree: Tree, q: Float[Array, " nq"], v: Float[Array, " nv"]) -> Float[Array, " nq"]:
    """The time derivative of positions (nq,), smooth, for Runge-Kutta methods (eq. 4.13 for quaternions).

    The exact flow conserves the norm of a quaternion; its numerical drift has no effect, since every use of q
    normalises it.

    Args:
        tree: the links.
        q, v: positions (nq,) and velocities (nv,).
    """
    pieces: list[Array] = []
    for at, to, link in zip(tree.v_of, tree.q_of, tree.links, strict=True):
        if link.kind == "free":
            spin = jnp.concatenate([np.zeros(1), v[at][3:]])
            pieces += [v[at][:3], 0.5 * quaternion_product(q[to][3:], spin)]
        else:
            pieces.append(v[at])
    return jnp.concatenate(pieces)


def integrate(tree: Tree, q: Float[Array, " nq"], v: Float[Array, " nv"], dt: Scalar) -> Float[Array, " nq"]:
    """Positions (nq,) after a time at constant velocities, as by mj_integratePos; quaternions have norm 1.

    Args:
        tree: the links.
        q, v: positions (nq,) and velocities (nv,).
        dt: the time, s.
    """
    pieces: list[Array] = []
    for at, to, link in zip(tree.v_of, tree.q_of, tree.links, strict=True):
        if link.kind == "free":
            turned = quaternion_product(q[to][3:], quaternion_exponential(v[at][3:] * dt))
            pieces += [q[to][:3] + v[at][:3] * dt, turned / jnp.sqrt(turned @ turned)]
        else:
            pieces.append(q[to] + v[at] * dt)
    return jnp.concatenate(pieces)


def tilt_and_heading(quaternion: Float[Array, " 4"]) -> tuple[Float[Array, " 2"], Float[Array, "2 2"]]:
    """The tilt of a free body and its heading.

    Returns:
        Vertical components (2,) of the body's x and y axes, and the rotation (2, 2) by its yaw when upright,
        which is NaN exactly upside down, where a body has no heading.
    """
    w, x, y, z = quaternion / jnp.sqrt(quaternion @ quaternion)
    up = jnp.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x)])
    upright = w * w - x * x - y * y + z * z
    back = jnp.stack([1.0 + upright, -up[1], up[0], 0.0 * upright]) / jnp.sqrt(2.0 * (1.0 + upright))
    c, _, _, s = quaternion_product(jnp.stack([w, x, y, z]), back)
    cosine = c * c - s * s
    sine = 2.0 * c * s
    return up, jnp.array([[cosine, -sine], [sine, cosine]])


def is_upright(quaternion: Float[Array, " 4"]) -> Bool[Array, ""]:
    """Whether the z axis of a free body points upwards; `tilted` gives its tilt back only then."""
    w, x, y, z = quaternion
    return w * w + z * z >= x * x + y * y


def tilted(up: Float[Array, " 2"]) -> Float[Array, " 4"]:
    """The quaternion (4,) of a body with heading 0 and this tilt (2,), as `tilt_and_heading` gives it.

    Of the two bodies with a tilt, this one is at most a right angle from upright (`is_upright`).
    """
    upright = jnp.sqrt(1.0 - up @ up)
    quaternion = jnp.stack([1.0 + upright, up[1], -up[0], 0.0 * upright])
    return quaternion / jnp.sqrt(2.0 * (1.0 + upright))
