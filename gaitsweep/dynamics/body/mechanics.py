"""Mechanics of a located body: its stops, its actuators, its accelerations.

A stop is a spring and a damper that push but do not pull: of a point of a geom that touches the ground, or of
a joint at a limit of its range.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Bool, Float

from gaitsweep.dynamics.body.body_parameters import AXES, BodyElements, BodyParameters
from gaitsweep.dynamics.body.coverage import Touch, limits, refusals, touches
from gaitsweep.dynamics.body.surfaces import Edge, Plane, Relief, Surface
from gaitsweep.dynamics.ground import Ground
from gaitsweep.dynamics.mjcf import (
    hinges_and_slides,
    identifier,
    is_position_servo,
    is_velocity_servo,
    joint_name,
    pulls_back,
)
from gaitsweep.dynamics.tree import (
    Array,
    Geometry,
    Scalar,
    WorldForce,
    forward_dynamics,
    movements,
    places,
    rescaled,
    tree_of,
    velocity_at,
)
from gaitsweep.dynamics.tree.kinematics import Place
from gaitsweep.near_miss import suggestion

Values = Mapping[str, Scalar]
EVEN = Ground("even", {})
# Stretch (m, rad) below zero at which a stop is left; at zero itself, rounding could meet and leave it
# without end.
RELEASE = 1.0e-9
# Component of a unit axis along a plane's normal below which a slide moves along the plane.
_ACROSS = 1.0e-12
# Tangent of the tilt below which the end of a cylinder is domed.
_DOMED = 0.02
# The slip s (m/s) in the formula of friction.
_SLOWEST = 1.0e-4


@dataclasses.dataclass(frozen=True)
class Stretch:
    """The stretch of a stop (m, rad) and its rate, with its spring K and damper D.

    The force is K stretch + D rate where both this and the stretch are positive, and else 0.
    """

    stretch: Scalar
    rate: Scalar
    K: Scalar
    D: Scalar

    @property
    def force(self) -> Scalar:
        """The force of spring and damper (N, N m), which may be negative."""
        return self.K * self.stretch + self.D * self.rate

    @property
    def height(self) -> Scalar:
        """A continuous function (m, rad) that is positive while the stop pushes."""
        # the minimum of both, with half the operations of `jnp.minimum` and its derivative
        moved = self.stretch + self.D / self.K * self.rate
        return jnp.where(self.rate <= 0.0, moved, self.stretch)


@dataclasses.dataclass(frozen=True)
class Contact(Stretch):
    """The stretch of a point of a geom below a surface.

    `link` carries the point; `at` (3,) m is the contact in the world, `slip` (3,) m/s its velocity along the
    surface, `normal` (3,) the surface's; `friction` is None without friction, and `grip` (N s/m) the damper
    along the surface below the limit of friction.
    """

    link: int
    at: Float[Array, " 3"]
    slip: Float[Array, " 3"]
    normal: Float[Array, " 3"] | Float[np.ndarray, " 3"]
    friction: Scalar | None
    grip: Scalar

    def on_body(self, load: Scalar) -> Float[Array, " 3"]:
        """The force (3,) N on the body at this `load` (N): normal, and friction that is viscous at no slip.

        Friction is mu load v / sqrt(v2 + (mu load / grip)2 + s2): grip v for slow slips v, mu load for fast
        ones. The constant s (0.1 mm/s) keeps it smooth where the load vanishes.
        """
        force = load * self.normal
        if self.friction is None:
            return force
        most = self.friction * load
        viscous = most / self.grip
        speed = jnp.sqrt(self.slip @ self.slip + viscous * viscous + _SLOWEST**2)
        return force - (most / speed) * self.slip


@dataclasses.dataclass(frozen=True)
class Limit(Stretch):
    """The stretch of a joint beyond a limit of its range.

    `dof` is the joint's place in v; the force on it is positive at the lower limit.
    """

    dof: int
    is_lower: bool


class JointPlace(NamedTuple):
    """The places of a hinge or slide in q and in v, with its name and the unit of its position.

    `along_ground` marks a slide along the ground that carries the whole body: the ground and gravity are the
    same at all its positions.
    """

    name: str
    unit: str
    in_q: int
    in_v: int
    along_ground: bool


class LocatedBody:
    """A body of an MJCF with located stops.

    `values` of its functions are the numbers of `parameters` by name, `ground` is added to the heights of
    level planes. `depths_and_forces`, `heights`, `bounds` and `accelerations` are the compiled methods of
    these names.

    Args:
        m: the compiled MJCF.

    Raises:
        ValueError: the MJCF has a feature that a located body lacks; the message names its element.
    """

    def __init__(self, m: Any) -> None:
        refusal = next(refusals(m), None)
        if refusal is not None:
            raise ValueError(refusal)
        unlimited = copy.copy(m)
        unlimited.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
        self._m = m
        self.tree, self._geometry = tree_of(unlimited)
        self._touches = touches(m)
        self._limits = limits(m)
        self.nq = int(m.nq)
        self.nv = int(m.nv)
        self.nu = int(m.nu)
        weightless = m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
        self._gravity = np.array(m.opt.gravity) * (0.0 if weightless else 1.0)
        self.elements = BodyElements(m)
        parameters = BodyParameters(self.elements, self._geometry, self._touches, self._limits)
        self.parameters = parameters.quantities(float(np.linalg.norm(self._gravity)))
        points = [
            self.elements.name_of_geom(touch.geom) for touch in self._touches for _ in range(touch.contacts)
        ]
        ends = [(joint_name(self._m, j), end) for j in self._limits for end in ("lower", "upper")]
        self.geom_of_stop = (*points, *(None for _ in ends))  # the geom's name; None for a limit
        self.stop_names = (
            *(
                f"geom {self.elements.name_of_geom(touch.geom)} touches or leaves {touch.surface.description}"
                for touch in self._touches
                for _ in range(touch.contacts)
            ),
            *(f"joint {joint} meets or leaves its {end} limit" for joint, end in ends),
        )
        self.bound_names = tuple(
            f"{self.elements.name_of_geom(touch.geom)} meets {touch.surface.description} {place}"
            for touch in self._touches
            for place in _bounds_of(touch)
        )
        # JAX then traces each once for a body, however often a program calls it; with `jax.jit` as a
        # decorator of methods, its memory would keep every body alive
        self.depths_and_forces = jax.jit(self._depths_and_forces)
        self.heights = jax.jit(self._heights)
        self.bounds = jax.jit(self._bounds)
        self.accelerations = jax.jit(self._accelerations)

    @property
    def is_free(self) -> bool:
        """Whether the root is a free body."""
        return bool(self._m.njnt and self._m.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE)

    @property
    def has_level_plane(self) -> bool:
        """Whether a geom may touch a level plane, on which uneven ground lies."""
        return any(isinstance(touch.surface, Plane) and touch.surface.is_level for touch in self._touches)

    @property
    def has_uneven_surface(self) -> bool:
        """Whether a geom may touch a box or height field of the world."""
        return any(not isinstance(touch.surface, Plane) for touch in self._touches)

    def ground_height(self, x: Array, y: Array) -> Array:
        """The height (m) of the highest surface at places x, y (m), without uneven ground on level planes.

        It is NaN where there is none: beside boxes and height fields without a level plane.
        """
        tops = jnp.stack([touch.surface.top(x, y) for touch in self._touches])
        highest = jnp.max(jnp.where(jnp.isnan(tops), -jnp.inf, tops), axis=0)
        return jnp.where(jnp.isinf(highest), jnp.nan, highest)

    @functools.cached_property
    def joints(self) -> list[JointPlace]:
        """The hinges and slides."""
        m = self._m
        data = mujoco.MjData(m)
        mujoco.mj_kinematics(m, data)
        normals = [touch.surface.normal for touch in self._touches if isinstance(touch.surface, Plane)]
        servos = {int(m.actuator_trnid[k, 0]) for k in range(m.nu) if pulls_back(m, k)}
        joints = []
        for j in hinges_and_slides(m):
            is_slide = m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
            # slides alone before it, from the world on
            carries = all(m.jnt_type[i] == mujoco.mjtJoint.mjJNT_SLIDE for i in self._before(j))
            invariant = bool(normals) and not self.has_uneven_surface
            along = invariant and all(abs(normal @ data.xaxis[j]) < _ACROSS for normal in normals)
            held = m.jnt_stiffness[j] or j in self._limits or j in servos
            along_ground = bool(is_slide and carries and along and not held)
            places = int(m.jnt_qposadr[j]), int(m.jnt_dofadr[j])
            joints.append(
                JointPlace(joint_name(self._m, j), "m" if is_slide else "rad", *places, along_ground)
            )
        return joints

    @property
    def is_on_level_planes(self) -> bool:
        """Whether all that the body may touch are level planes, along which it may be anywhere."""
        surfaces = [touch.surface for touch in self._touches]
        return all(isinstance(surface, Plane) and surface.is_level for surface in surfaces)

    @property
    def velocities_along_ground(self) -> tuple[int, ...]:
        """The places in v of the velocities of the whole body along the ground, where it has friction."""
        if any(touch.friction is None for touch in self._touches):
            return ()
        free = (0, 1) if self.is_free and self.is_on_level_planes else ()
        return (*free, *(joint.in_v for joint in self.joints if joint.along_ground))

    def _before(self, joint: int) -> list[int]:
        """The joints between the world and a joint."""
        m = self._m
        body = int(m.jnt_bodyid[joint])
        joints = list(range(m.body_jntadr[body], joint))
        while (body := int(m.body_parentid[body])) > 0:
            joints += range(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body])
        return joints

    def geometry(self, values: Values) -> Geometry:
        """The tree's geometry with these values."""
        m = self._m
        of_mjcf = self._geometry
        position = [list(row) for row in of_mjcf.position]
        com = [list(row) for row in of_mjcf.com]
        mass: dict[str, Scalar] = {}
        size: dict[str, Scalar] = {}
        inertia: dict[int, Scalar] = {}
        for body in range(1, m.nbody):
            name = self.elements.name_of_body(body)
            i = self.elements.link_of_body(body)
            links = self.elements.links_of_body(body)
            for k, axis in enumerate(AXES):
                position[links[0]][k] = values.get(f"{name}_{axis}", position[links[0]][k])
                com[i][k] = values.get(f"{name}_com_{axis}", com[i][k])
            if f"{name}_mass" in values:
                mass[self.tree.links[i].name] = values[f"{name}_mass"] / of_mjcf.mass[i]
                inertia[i] = values[f"{name}_inertia"]
            size |= {self.tree.links[link].name: values[f"{name}_size"] for link in links}
        moved = dataclasses.replace(of_mjcf, position=_table(position), com=_table(com))
        scaled = rescaled(self.tree, moved, mass, size)
        damping = list(of_mjcf.damping)
        armature = list(of_mjcf.armature)
        stiffness = list(of_mjcf.stiffness)
        rest = list(of_mjcf.rest)
        for j in hinges_and_slides(m):
            name = joint_name(self._m, j)
            dof = m.jnt_dofadr[j]
            i = self.elements.link_of_joint(j)
            damping[dof] = values[f"{name}_damping"]
            stiffness[i] = values[f"{name}_stiffness"]
            rest[i] = values[f"{name}_springref"]
            armature[dof] = values.get(f"{name}_armature", armature[dof])
        tensors = [jnp.asarray(inertia.get(i, 1.0) * tensor) for i, tensor in enumerate(scaled.inertia)]
        return dataclasses.replace(
            scaled,
            inertia=jnp.stack(tensors),
            damping=_row(damping),
            # constants keep their zeros, which the dynamics look for
            armature=_row(armature) if of_mjcf.armature.any() else of_mjcf.armature,
            stiffness=_row(stiffness),
            rest=_row(rest),
        )

    def gravity(self, values: Values) -> Float[Array, " 3"]:
        """The acceleration of gravity (3,), m/s2, in axes whose z is normal to a ground that slopes."""
        size = float(np.linalg.norm(self._gravity))
        x, y, z = (self._gravity / size if size else np.array([0.0, 0.0, -1.0])).tolist()
        c = jnp.cos(values["slope"])
        s = jnp.sin(values["slope"])
        along = jnp.stack([jnp.asarray(c * x - s * z), jnp.asarray(y, float), jnp.asarray(s * x + c * z)])
        return values["gravity"] * along

    def stretches(
        self, geometry: Geometry, values: Values, q: Array, v: Array, ground: Ground = EVEN
    ) -> list[Contact | Limit]:
        """The stretch of each stop: of contacts, then of the lower and upper limits of joints.

        Args:
            geometry: the tree's geometry with these values.
            values: the parameters.
            q, v: positions (nq,) and velocities (nv,), as MuJoCo's qpos and qvel.
            ground: the ground on level planes.
        """
        return [*self._contacts(geometry, values, q, v, ground), *self._stretches_of_limits(values, q, v)]

    def _contacts(
        self, geometry: Geometry, values: Values, q: Array, v: Array, ground: Ground
    ) -> Iterator[Contact]:
        """The contacts of each geom that may touch the ground; arguments as of `stretches`.

        The side of a capsule at an edge has the energy K (s2 - e2) / 2 with the depth s of the side and e, if
        positive, of the nearer end at this edge: a second contact, of stiffness -K. So energy and force are
        continuous as the edge passes from the side to the end, which has a contact of its own.
        """
        placed = places(self.tree, geometry, q)
        moving = movements(self.tree, placed, v)
        for touch in self._touches:
            name = self.elements.name_of_geom(touch.geom)
            link = self.elements.link_of_body(touch.body)
            centres, axes, radius = self._points(touch, values, placed)
            damper = values[f"{name}_contact_damping"]
            has_friction = touch.friction is not None
            stiffness = values[f"{name}_contact_stiffness"]
            met: list[tuple[Array, Array | None, Surface | Edge, float]] = [
                (centre, axis, touch.surface, 1.0) for centre, axis in zip(centres, axes, strict=True)
            ]
            for edge in touch.edges:
                side, end = _side(edge, centres)
                met += [(side, None, edge, 1.0), (end, None, edge, -1.0)]
            for centre, axis, surface, sign in met:
                normal, depth, at = _met(centre, axis, radius, surface, ground)
                speed = velocity_at(placed[link], moving[link], at)
                rise = normal @ speed
                yield Contact(
                    stretch=depth,
                    rate=-rise,
                    K=sign * stiffness,
                    D=sign * damper,
                    link=link,
                    at=at,
                    slip=speed - rise * normal,
                    normal=normal,
                    friction=values[f"{name}_friction"] if has_friction else None,
                    grip=values[f"{name}_grip"] if has_friction else damper,
                )

    def _stretches_of_limits(self, values: Values, q: Array, v: Array) -> Iterator[Limit]:
        """The stretches of the lower and the upper limit of each joint; arguments as of `stretches`."""
        for j in self._limits:
            name = joint_name(self._m, j)
            dof = int(self._m.jnt_dofadr[j])
            position = q[self._m.jnt_qposadr[j]]
            speed = v[dof]
            K = values[f"{name}_limit_stiffness"]
            D = values[f"{name}_limit_damping"]
            margin = float(self._m.jnt_margin[j])  # from which on MuJoCo's limit is stretched
            yield Limit(values[f"{name}_low"] + margin - position, -speed, K, D, dof, True)
            yield Limit(position + margin - values[f"{name}_high"], speed, K, D, dof, False)

    def _depths_and_forces(
        self, values: Values, q: Array, v: Array, ground: Ground = EVEN
    ) -> tuple[Float[Array, " stops"], Float[Array, " stops"]]:
        """The stretch (m, rad) and the force (N, N m), were it pushing, of each stop, (stops,)."""
        stops = self.stretches(self.geometry(values), values, q, v, ground)
        return _row([stop.stretch for stop in stops]), _row([stop.force for stop in stops])

    def contact_depths(
        self, values: Values, q: Array, ground: Ground = EVEN
    ) -> tuple[Float[Array, " points"], Float[Array, " points"]]:
        """The depth (m) of each point, and that at which its contact alone carries the body, (points,)."""
        geometry = self.geometry(values)
        contacts = list(self._contacts(geometry, values, q, jnp.zeros(self.nv), ground))
        weight = values["gravity"] * sum(jnp.asarray(mass) for mass in geometry.mass)
        rests = [weight / contact.K for contact in contacts]
        return _row([contact.stretch for contact in contacts]), _row(rests)

    def _heights(self, values: Values, q: Array, v: Array, ground: Ground = EVEN) -> Float[Array, " stops"]:
        """The `Stretch.height` (stops,) of each stop."""
        stops = self.stretches(self.geometry(values), values, q, v, ground)
        return _row([stop.height for stop in stops])

    def _bounds(self, values: Values, q: Array) -> Float[Array, " bounds"]:
        """The lengths (m), (bounds,), by which contacts are beyond what is covered; else negative.

        The side of a capsule meets edges of a box, but not corners. Beyond its ends a height field has no
        surface.
        """
        placed = places(self.tree, self.geometry(values), q)
        bounds: list[Scalar] = []
        for touch in self._touches:
            surface = touch.surface
            if isinstance(surface, Plane):
                continue
            points, axes, radius = self._points(touch, values, placed)
            if isinstance(surface, Relief):
                for point, axis in zip(points, axes, strict=True):
                    depth = _met(point, axis, radius, surface, EVEN)[1]
                    bounds.append(jnp.minimum(depth, surface.beyond(point)))
            elif touch.edges:
                at_corner = []
                for edge in touch.edges:
                    side, end = _side(edge, points)
                    depth, of_end = (radius - edge.below(point, EVEN)[1] for point in (side, end))
                    apart = jnp.minimum(depth, depth - of_end - RELEASE)
                    at_corner.append(jnp.minimum(apart, edge.beyond(side)))
                bounds.append(functools.reduce(jnp.maximum, at_corner))
        return _row(bounds)

    def _points(
        self, touch: Touch, values: Values, placed: Sequence[Place]
    ) -> tuple[list[Array], Sequence[Array | None], Scalar]:
        """Places (3,) m and `Touch.axes` (3,) in the world, and the radius (m), of the points of a geom."""
        size = values[f"{self.elements.name_of_body(touch.body)}_size"]
        radius = size * values[f"{self.elements.name_of_geom(touch.geom)}_radius"] if touch.radius else 0.0
        place = placed[self.elements.link_of_body(touch.body)]
        points = [place.position(size * point) for point in touch.points]
        if touch.axes is None:
            return points, [None] * len(points), radius
        return points, [place.frame @ (place.turn @ axis) for axis in touch.axes], radius

    def _accelerations(
        self,
        values: Values,
        q: Array,
        v: Array,
        control: Array,
        pushing: Bool[Array, " stops"] | None,
        ground: Ground = EVEN,
    ) -> Float[Array, " nv"]:
        """dv/dt (nv,), rad/s2 and m/s2.

        Args:
            values: the parameters.
            q, v: positions (nq,) and velocities (nv,), as MuJoCo's qpos and qvel.
            control: controls (nu,) of the actuators.
            pushing: whether each stop pushes; None: where its height is positive.
            ground: the ground on level planes.
        """
        tau = self._actuated(values, q, v, control)
        external: list[WorldForce] = []
        geometry = self.geometry(values)
        for k, stop in enumerate(self.stretches(geometry, values, q, v, ground)):
            pushes = stop.height > 0.0 if pushing is None else pushing[k]
            load = jnp.where(pushes, stop.force, 0.0)
            if isinstance(stop, Contact):
                external.append(WorldForce(stop.link, stop.at, stop.on_body(load)))
            else:
                tau[stop.dof] = tau[stop.dof] + (load if stop.is_lower else -load)
        gravity = self.gravity(values)
        return jnp.asarray(forward_dynamics(self.tree, geometry, q, v, _row(tau), external, gravity=gravity))

    def inverse_inertia(self, values: Values, q: Array) -> Float[jax.Array, "nv nv"]:
        """The inverse of the joint-space inertia (nv, nv) at positions (nq,)."""
        geometry = self.geometry(values)

        def accelerations(tau: Array) -> Array:
            v = jnp.zeros(self.nv)
            return forward_dynamics(self.tree, geometry, q, v, tau, gravity=jnp.zeros(3))

        # linear in the forces, but for those of springs
        by_force = jax.vmap(accelerations)(np.concatenate([np.zeros((1, self.nv)), np.eye(self.nv)]))
        return jnp.asarray(by_force[1:] - by_force[:1]).T

    def _actuated(self, values: Values, q: Array, v: Array, control: Array) -> list[Scalar]:
        """Generalised forces (nv,) of the actuators."""
        m = self._m
        tau: list[Scalar] = [0.0] * self.nv
        clamped = not m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
        for k in range(self.nu):
            name = self.elements.name_of_actuator(k)
            joint = m.actuator_trnid[k, 0]
            at = m.jnt_qposadr[joint]
            dof = m.jnt_dofadr[joint]
            gear = values[f"{name}_gear"]
            u = control[k]
            if clamped and m.actuator_ctrllimited[k]:
                u = jnp.clip(u, *m.actuator_ctrlrange[k])
            length = gear * q[at]
            speed = gear * v[dof]
            if is_position_servo(m, k):
                force = values[f"{name}_kp"] * (u - length) - values[f"{name}_kv"] * speed
            elif is_velocity_servo(m, k):
                force = values[f"{name}_kv"] * (u - speed)
            else:
                constant, spring, damper = (float(b) for b in m.actuator_biasprm[k, :3])
                force = values[f"{name}_gain"] * u
                if m.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE:
                    force = force + constant + spring * length + damper * speed
            if m.actuator_forcelimited[k]:
                force = jnp.clip(force, *m.actuator_forcerange[k])
            tau[dof] = tau[dof] + gear * force
        return tau

    def stops_of(self, geom: str) -> list[int]:
        """The numbers of the stops of a geom, by its name.

        Raises:
            ValueError: no geom of this name can touch the ground.
        """
        numbers = [k for k, name in enumerate(self.geom_of_stop) if name == identifier(geom)]
        if not numbers:
            names = dict.fromkeys(name for name in self.geom_of_stop if name)
            remedy = ': give it a contype, and the floor a conaffinity, of "1".'
            why = suggestion(geom, names) if names else remedy
            raise ValueError(f"No geom '{geom}' can touch the ground{why}")
        return numbers


def _bounds_of(touch: Touch) -> list[str]:
    """The places at which the contact of a geom with a surface is not covered."""
    if isinstance(touch.surface, Relief):
        return ["beyond its end"] * len(touch.points)
    return ["with its side at a corner"] if touch.edges else []


def _met(
    centre: Array, axis: Array | None, radius: Scalar, surface: Surface | Edge, ground: Ground
) -> tuple[Array, Scalar, Array]:
    """The normal (3,), the depth (m) and the place (3,) m of the contact of a sphere or a cylinder's end.

    The place is between the deepest point and the surface, as in MuJoCo. The end of a cylinder is a disc
    whose deepest point is on its rim, but for tilts whose tangent is below `_DOMED`: there the disc is domed
    by up to half of that times its radius, so that the deepest point moves over it continuously.
    """
    normal, above = surface.below(centre, ground)
    if axis is None:
        depth = radius - above
        return normal, depth, centre - normal * (radius - 0.5 * depth)
    along = normal @ axis
    across = normal - along * axis
    square = across @ across
    flat = _DOMED * jnp.abs(along)
    is_flat = square < flat * flat
    # the root of 0 has no derivative
    size = jnp.where(is_flat, flat, jnp.sqrt(jnp.where(is_flat, 1.0, square)))
    dome = jnp.where(is_flat, 0.5 * _DOMED * (1.0 - square / jnp.where(is_flat, flat * flat, 1.0)), 0.0)
    deepest = radius * (dome * axis - across / size)
    depth = -(normal @ deepest) - above
    return normal, depth, centre + deepest + 0.5 * depth * normal


def _side(edge: Edge, ends: Sequence[Array]) -> tuple[Array, Array]:
    """The places (3,) m on a capsule's axis, and at its nearer end, that are nearest to an edge."""
    first, second = (edge.below(end, EVEN)[1] for end in ends)
    return edge.nearest_of_segment(*ends), jnp.where(first < second, *ends)


def _row(numbers: Sequence[Scalar]) -> Array:
    """An array (n,) of numbers, of which some may be traced; n may be 0."""
    return jnp.stack([jnp.asarray(number, float) for number in numbers]) if numbers else jnp.zeros((0,))


def _table(rows: Sequence[Sequence[Scalar]]) -> Array:
    """A table of numbers, of which some may be traced."""
    return jnp.stack([_row(row) for row in rows])
