"""Contacts and the Runge-Kutta step of MuJoCo C, where MJX's own differ.

MJX chooses other friction axes below a steep capsule and other points of boxes and cylinders, and rounds the
points of capsules to a millionth, so that bodies land otherwise than in MuJoCo C. The functions of contacts
take their places in MJX's table.

Its step of order 4 averages the angular velocities of the stages as if turns could be added, which is of
order 2 for a body that turns about changing axes.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import contextlib
import io
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

with contextlib.redirect_stdout(io.StringIO()):  # MJX prints that Warp is not installed
    from mujoco import mjx as mjx  # the other modules take it from here
from mujoco.mjx._src import collision_driver, collision_primitive, forward, math, scan
from mujoco.mjx._src.collision_primitive import collider
from mujoco.mjx._src.collision_types import GeomInfo
from mujoco.mjx._src.types import GeomType

Contacts = tuple[jax.Array, jax.Array, jax.Array]  # distances (k,), positions (k, 3), frames (k, 3, 3)

_STAGES = (0.5, 0.5, 1.0)  # shares of the step at the second to the fourth stage
_WEIGHTS = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
_SIGNS = np.array([[1.0 if i >> axis & 1 else -1.0 for axis in range(3)] for i in range(8)])


def _contacts_with_plane(points: jax.Array, plane: GeomInfo, frame: jax.Array) -> Contacts:
    """Contacts of a body's points (k, 3) with a plane: midway between a point and the plane."""
    normal = plane.mat[:, 2]
    distances = (points - plane.pos) @ normal
    middles = points - 0.5 * distances[:, None] * normal
    return distances, middles, jnp.broadcast_to(frame, (len(points), 3, 3))


@collider(ncon=2)
def _plane_capsule(plane: GeomInfo, capsule: GeomInfo) -> Contacts:
    """Both ends of a capsule; friction acts along the axis as the plane sees it, however steep it is."""
    normal = plane.mat[:, 2]
    axis = capsule.mat[:, 2]
    along = axis - normal * jnp.dot(normal, axis)
    length = jnp.linalg.norm(along)
    upright = length < mujoco.mjMINVAL
    along = jnp.where(upright, jnp.array([1.0, 0.0, 0.0]), along / jnp.where(upright, 1.0, length))
    frame = jnp.stack([normal, along, jnp.cross(normal, along)])
    ends = capsule.pos + jnp.array([[1.0], [-1.0]]) * axis * capsule.size[1]
    return _contacts_with_plane(ends - capsule.size[0] * normal, plane, frame)


@collider(ncon=4)
def _plane_box(plane: GeomInfo, box: GeomInfo) -> Contacts:
    """The four lowest corners, which are those below the centre."""
    normal = plane.mat[:, 2]
    corners = (_SIGNS * box.size) @ box.mat.T
    _, lower = jax.lax.top_k(-(corners @ normal), 4)
    return _contacts_with_plane(box.pos + corners[lower], plane, math.make_frame(normal))


@collider(ncon=4)
def _plane_cylinder(plane: GeomInfo, cylinder: GeomInfo) -> Contacts:
    """The lowest point of each end, and two more of the lower end, a third of a turn to either side."""
    normal = plane.mat[:, 2]
    axis = cylinder.mat[:, 2]
    axis = jnp.where(jnp.dot(normal, axis) > 0.0, -axis, axis)
    radius = cylinder.size[0]
    half = cylinder.size[1]
    down = axis * jnp.dot(normal, axis) - normal
    length = jnp.linalg.norm(down)
    flat = length < mujoco.mjMINVAL
    down = jnp.where(flat, cylinder.mat[:, 0], down / jnp.where(flat, 1.0, length)) * radius
    aside = np.sqrt(0.75) * radius * math.normalize(jnp.cross(down, axis))
    end = half * axis
    points = jnp.stack([down + end, down - end, aside - 0.5 * down + end, -aside - 0.5 * down + end])
    return _contacts_with_plane(cylinder.pos + points, plane, math.make_frame(normal))


@collider(ncon=1)
def _sphere_capsule(sphere: GeomInfo, capsule: GeomInfo) -> Contacts:
    """The point of a capsule's axis that is nearest to a sphere."""
    axis = capsule.mat[:, 2]
    half = capsule.size[1]
    nearest = capsule.pos + jnp.clip(jnp.dot(axis, sphere.pos - capsule.pos), -half, half) * axis
    return _touching(sphere.pos, sphere.size[0], nearest, capsule.size[0])


@collider(ncon=1)
def _capsule_capsule(one: GeomInfo, other: GeomInfo) -> Contacts:
    """The nearest points of two capsules; of parallel ones, a point in the middle, where C has two."""
    a = one.mat[:, 2] * one.size[1]
    b = other.mat[:, 2] * other.size[1]
    offset = one.pos - other.pos
    aa = jnp.dot(a, a)
    ab = jnp.dot(a, b)
    bb = jnp.dot(b, b)
    along_a = -jnp.dot(a, offset)
    along_b = jnp.dot(b, offset)
    determinant = aa * bb - ab * ab
    parallel = determinant < mujoco.mjMINVAL
    free = jnp.where(parallel, 0.0, bb * along_a + ab * along_b) / jnp.where(parallel, 1.0, determinant)
    # shares of the half lengths: of one, then of the other, then of one again if the other was beyond its end
    share_a = jnp.clip(free, -1.0, 1.0)
    share_b = (along_b + ab * share_a) / bb
    beyond = jnp.abs(share_b) > 1.0
    share_b = jnp.clip(share_b, -1.0, 1.0)
    share_a = jnp.where(beyond, jnp.clip((along_a + ab * share_b) / aa, -1.0, 1.0), share_a)
    return _touching(one.pos + share_a * a, one.size[0], other.pos + share_b * b, other.size[0])


def _touching(one: jax.Array, radius: jax.Array, other: jax.Array, radius_of_other: jax.Array) -> Contacts:
    """The contact of two spheres."""
    distance, place, normal = collision_primitive._sphere_sphere(one, radius, other, radius_of_other)
    return distance, place, math.make_frame(normal)


def replace_contacts() -> None:
    """Put these functions into MJX's table, for the whole process."""
    for shapes, function in (
        ((GeomType.PLANE, GeomType.CAPSULE), _plane_capsule),
        ((GeomType.PLANE, GeomType.BOX), _plane_box),
        ((GeomType.PLANE, GeomType.CYLINDER), _plane_cylinder),
        ((GeomType.SPHERE, GeomType.CAPSULE), _sphere_capsule),
        ((GeomType.CAPSULE, GeomType.CAPSULE), _capsule_capsule),
    ):
        collision_driver._COLLISION_FUNC[shapes] = function


def runge_kutta(model: Any, data: Any) -> Any:
    """MJX's data one step later by a Runge-Kutta step of order 4, also for turns of free and ball joints.

    Args:
        model: an mjx.Model.
        data: MJX's data at the beginning of the step, after `mjx.forward`.
    """
    start = data
    turns = _turns(model)
    rates = data.qvel, data.qacc, data.act_dot
    stages = [rates]
    for share in _STAGES:
        dt = share * model.opt.timestep
        change_of_q, change_of_v, change_of_act = (dt * rate for rate in rates)
        q = scan.flat(model, _moved, "jqv", "q", model.jnt_type, start.qpos, change_of_q)
        v = start.qvel + change_of_v
        data = data.replace(qpos=q, qvel=v, act=start.act + change_of_act, time=start.time + dt)
        data = forward.forward(model, data)
        rates = _rate(change_of_q, v, turns), data.qacc, data.act_dot
        stages.append(rates)
    v, qacc, act = (
        sum(weight * rate for weight, rate in zip(_WEIGHTS, rates_of_stages, strict=True))
        for rates_of_stages in zip(*stages, strict=True)
    )
    data = data.replace(qpos=start.qpos, qvel=start.qvel, act=start.act, time=start.time)
    return forward._advance(model, data, act, qacc, v)


def _moved(joints: Any, q: jax.Array, change: jax.Array) -> jax.Array:
    """Positions after a change in the directions of the velocities."""
    return forward._integrate_pos(joints, q, change, dt=1.0)


def _turns(model: Any) -> np.ndarray:
    """The degrees of freedom (n, 3) of the turns of free and ball joints."""
    first = [
        address + (3 if kind == mujoco.mjtJoint.mjJNT_FREE else 0)
        for kind, address in zip(model.jnt_type.tolist(), model.jnt_dofadr.tolist(), strict=True)
        if kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL)
    ]
    return np.array(first, int)[:, None] + np.arange(3)


def _rate(change: jax.Array, v: jax.Array, turns: np.ndarray) -> jax.Array:
    """The rate (nv,) of a change of positions (nv,) from its value and the velocities there.

    For a turn u this is the inverse of the derivative of the exponential map: w + u x w / 2 + ...
    (Munthe-Kaas 1998, BIT 38:92).
    """
    u = change[turns]
    w = v[turns]
    square = jnp.sum(u * u, axis=1, keepdims=True)
    small = square < 1e-4
    half = 0.5 * jnp.sqrt(jnp.where(small, 1.0, square))
    factor = jnp.where(small, 1.0 / 12.0 + square / 720.0, (1.0 - half / jnp.tan(half)) / (4.0 * half * half))
    across = jnp.cross(u, w)
    return v.at[turns].set(w + 0.5 * across + factor * jnp.cross(u, across))
