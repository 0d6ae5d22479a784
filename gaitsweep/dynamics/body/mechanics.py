"""Mechanics of a located body: its parameters by name, its stops, its actuators, its accelerations.

A stop is a spring and a damper that push but do not pull: of a point of a geom that touches a plane, or of a
joint at a limit of its range.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import copy
import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Bool, Float

from gaitsweep.contract import Quantity
from gaitsweep.dynamics.body.coverage import Softness, limits, refusals, touches
from gaitsweep.dynamics.mjcf.source import identifier
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
from gaitsweep.near_miss import suggestion

Values = Mapping[str, Scalar]
# Stretch (m, rad) below zero at which a stop is left; at zero itself, rounding could meet and leave it
# without end.
RELEASE = 1.0e-9
# Slip (m/s) below which friction is viscous where the load vanishes.
_SLOWEST = 1.0e-4
_AXES = "xyz"


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
        return jnp.minimum(self.stretch, self.stretch + self.D / self.K * self.rate)


@dataclasses.dataclass(frozen=True)
class Contact(Stretch):
    """The stretch of a point of a geom below a plane.

    `link` carries the point; `at` (3,) m is the contact in the world, `slip` (3,) m/s its velocity along the
    plane, `normal` (3,) the plane's; `friction` is None without friction, and `grip` (N s/m) the damper along
    the plane below the limit of friction.
    """

    link: int
    at: Float[Array, " 3"]
    slip: Float[Array, " 3"]
    normal: Float[np.ndarray, " 3"]
    friction: Scalar | None
    grip: Scalar

    def on_body(self, load: Scalar) -> Float[Array, " 3"]:
        """The force (3,) N on the body at this `load` (N): normal, and friction that is viscous at no slip.

        Friction is mu load v / sqrt(v2 + (mu load / grip)2): grip v for slow slips v, mu load for fast ones.
        """
        force = load * self.normal
        if self.friction is None:
            return force
        most = self.friction * load
        viscous = most / self.grip
        speed = jnp.sqrt(self.slip @ self.slip + viscous * viscous + _SLOWEST**2)
        return force - (most / speed) * self.slip


class LocatedBody:
    """A body of an MJCF with located stops.

    `values` of its functions are the numbers of `parameters` by name.

    Args:
        m: the compiled MJCF.

    Raises:
        ValueError: the MJCF has a feature that a located body lacks; the message names its element.
    """

    def __init__(self, m: Any) -> None:
        for refusal in refusals(m):
            raise ValueError(refusal)
        unlimited = copy.copy(m)
        unlimited.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
        self._m = m
        self.tree, self._geometry = tree_of(unlimited)
        self._touches, self._limits = touches(m), limits(m)
        self.nq, self.nv, self.nu = int(m.nq), int(m.nv), int(m.nu)
        weightless = m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
        self._gravity = np.array(m.opt.gravity) * (0.0 if weightless else 1.0)
        self._quantities: dict[str, Quantity] = {}
        self._declare()
        self.parameters = tuple(self._quantities.values())
        points = [self.name_of_geom(touch.geom) for touch in self._touches for _ in touch.points]
        ends = [(self._joint(j), end) for j in self._limits for end in ("lower", "upper")]
        self.geom_of_stop = (*points, *(None for _ in ends))  # the geom's name; None for a limit
        self.stop_names = (
            *(f"geom {name} touches or leaves a plane" for name in points),
            *(f"joint {joint} meets or leaves its {end} limit" for joint, end in ends),
        )

    @property
    def is_free(self) -> bool:
        """Whether the root is a free body."""
        return bool(self._m.njnt and self._m.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE)

    @functools.cached_property
    def joints(self) -> list[tuple[str, str, int | None, int]]:
        """Name, unit, place in q and place in v of each hinge and slide.

        The place in q is None for a slide along the ground that carries the whole body: its position changes
        nothing.
        """
        m = self._m
        data = mujoco.MjData(m)
        mujoco.mj_kinematics(m, data)
        normals = [touch.normal for touch in self._touches]
        joints: list[tuple[str, str, int | None, int]] = []
        for j in self._jointed():
            slides = m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
            # slides alone before it, from the world on
            carries = all(m.jnt_type[i] == mujoco.mjtJoint.mjJNT_SLIDE for i in self._before(j))
            along = bool(normals) and all(abs(normal @ data.xaxis[j]) < 1e-12 for normal in normals)
            held = m.jnt_stiffness[j] or j in self._limits
            place = None if slides and carries and along and not held else int(m.jnt_qposadr[j])
            joints.append((self._joint(j), "m" if slides else "rad", place, int(m.jnt_dofadr[j])))
        return joints

    def _before(self, joint: int) -> list[int]:
        """The joints between the world and a joint."""
        m = self._m
        body = int(m.jnt_bodyid[joint])
        joints = list(range(m.body_jntadr[body], joint))
        while (body := int(m.body_parentid[body])) > 0:
            joints += range(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body])
        return joints

    # parameters

    def _add(
        self,
        name: str,
        unit: str,
        meaning: str,
        default: Scalar,
        low: float = -math.inf,
        *,
        above: bool = False,
    ) -> None:
        quantity = Quantity(name, unit, meaning, float(default), low=low, open_ends=above)
        self._quantities[name] = quantity

    def _declare(self) -> None:
        m, geometry = self._m, self._geometry
        for body in range(1, m.nbody):
            name, i = self.name_of_body(body), self._link(body)
            if geometry.mass[i]:
                self._add(f"{name}_mass", "kg", f"mass of {name}", geometry.mass[i], 0.0, above=True)
                self._add(
                    f"{name}_inertia", "1", f"inertia of {name}, per that of its mass", 1.0, 0.0, above=True
                )
            self._add(f"{name}_size", "1", f"factor of the lengths of {name}", 1.0, 0.0, above=True)
            first = self._links(body)[0]
            for row, at, what in ((geometry.position, first, ""), (geometry.com, i, "com_")):
                for k in np.flatnonzero(row[at]):
                    words = "centre of mass" if what else "place in its parent"
                    self._add(f"{name}_{what}{_AXES[k]}", "m", f"{_AXES[k]} of {name}'s {words}", row[at][k])
        for j in self._jointed():
            name, i = self._joint(j), self._link_of_joint(j)
            turning = m.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
            unit, stiff, damped = ("rad", "N m/rad", "N m s/rad") if turning else ("m", "N/m", "N s/m")
            self._add(f"{name}_damping", damped, f"damper of {name}", geometry.damping[m.jnt_dofadr[j]], 0.0)
            self._add(f"{name}_stiffness", stiff, f"spring of {name}", geometry.stiffness[i], 0.0)
            self._add(f"{name}_springref", unit, f"{name} at which its spring is slack", geometry.rest[i])
            if armature := geometry.armature[m.jnt_dofadr[j]]:
                inertia = "kg m2" if turning else "kg"
                self._add(f"{name}_armature", inertia, f"rotor inertia of {name}", armature, 0.0, above=True)
            if j in self._limits:
                low, high = m.jnt_range[j]
                self._add(f"{name}_low", unit, f"lower limit of {name}", low)
                self._add(f"{name}_high", unit, f"upper limit of {name}", high)
                words = f"{{}} at the limits of {name}"
                self._add_softness(f"{name}_limit", self._limits[j], words, (stiff, damped))
        for touch in self._touches:
            name = self.name_of_geom(touch.geom)
            if touch.radius:
                self._add(f"{name}_radius", "m", f"radius of {name}", touch.radius, 0.0)
            if touch.friction is not None:
                self._add(f"{name}_friction", "1", f"coefficient of friction of {name}", touch.friction, 0.0)
                words = f"damper of {name} along the ground, below the limit of friction"
                self._add(f"{name}_grip", "N s/m", words, touch.softness.D, 0.0, above=True)
            self._add_softness(
                f"{name}_contact", touch.softness, f"{{}} between {name} and the ground", ("N/m", "N s/m")
            )
        for k in range(m.nu):
            self._add_actuator(k)
        self._add("gravity", "m/s2", "acceleration of gravity", float(np.linalg.norm(self._gravity)), 0.0)
        self._add("slope", "rad", "slope of the ground, downhill along x", 0.0)

    def _add_softness(self, name: str, softness: Softness, words: str, units: tuple[str, str]) -> None:
        self._add(f"{name}_stiffness", units[0], words.format("spring"), softness.K, 0.0, above=True)
        self._add(f"{name}_damping", units[1], words.format("damper"), softness.D, 0.0)

    def _add_actuator(self, k: int) -> None:
        m, name = self._m, self._actuator(k)
        gain, bias = m.actuator_gainprm[k, 0], m.actuator_biasprm[k]
        self._add(f"{name}_gear", "1", f"gear of actuator {name}", m.actuator_gear[k, 0])
        if _is_position(m, k):
            self._add(f"{name}_kp", "N/m or N m/rad", f"position gain of actuator {name}", gain)
            self._add(f"{name}_kv", "N s/m or N m s/rad", f"velocity gain of actuator {name}", 0.0 - bias[2])
        elif _is_velocity(m, k):
            self._add(f"{name}_kv", "N s/m or N m s/rad", f"velocity gain of actuator {name}", gain)
        else:
            self._add(f"{name}_gain", "1", f"gain of actuator {name}", gain)

    def geometry(self, values: Values) -> Geometry:
        """The tree's geometry with these values."""
        m, of_mjcf = self._m, self._geometry
        position, com = ([list(row) for row in rows] for rows in (of_mjcf.position, of_mjcf.com))
        mass: dict[str, Scalar] = {}
        size: dict[str, Scalar] = {}
        inertia: dict[int, Scalar] = {}
        for body in range(1, m.nbody):
            name, i, links = self.name_of_body(body), self._link(body), self._links(body)
            for row, at, what in ((position, links[0], ""), (com, i, "com_")):
                for k in range(3):
                    row[at][k] = values.get(f"{name}_{what}{_AXES[k]}", row[at][k])
            if f"{name}_mass" in values:
                mass[self.tree.links[i].name] = values[f"{name}_mass"] / of_mjcf.mass[i]
                inertia[i] = values[f"{name}_inertia"]
            size |= {self.tree.links[link].name: values[f"{name}_size"] for link in links}
        scaled = rescaled(
            self.tree, dataclasses.replace(of_mjcf, position=_table(position), com=_table(com)), mass, size
        )
        damping, armature = list(of_mjcf.damping), list(of_mjcf.armature)
        stiffness, rest = list(of_mjcf.stiffness), list(of_mjcf.rest)
        for j in self._jointed():
            name, dof, i = self._joint(j), m.jnt_dofadr[j], self._link_of_joint(j)
            damping[dof], stiffness[i] = values[f"{name}_damping"], values[f"{name}_stiffness"]
            rest[i], armature[dof] = (
                values[f"{name}_springref"],
                values.get(f"{name}_armature", armature[dof]),
            )
        return dataclasses.replace(
            scaled,
            inertia=jnp.stack(
                [jnp.asarray(inertia.get(i, 1.0) * about) for i, about in enumerate(scaled.inertia)]
            ),
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
        c, s = jnp.cos(values["slope"]), jnp.sin(values["slope"])
        along = jnp.stack([jnp.asarray(c * x - s * z), jnp.asarray(y, float), jnp.asarray(s * x + c * z)])
        return values["gravity"] * along

    # forces: `jax.jit`, so that JAX traces each function once, however often a program calls it

    def stretches(self, values: Values, q: Array, v: Array) -> list[Stretch]:
        """The stretch of each stop: of contacts, then of the lower and upper limits of joints."""
        geometry = self.geometry(values)
        placed = places(self.tree, geometry, q)
        moving = movements(self.tree, placed, v)
        stops: list[Stretch] = []
        for touch in self._touches:
            name, link = self.name_of_geom(touch.geom), self._link(touch.body)
            size = values[f"{self.name_of_body(touch.body)}_size"]
            radius = size * values[f"{name}_radius"] if touch.radius else 0.0
            K, D = values[f"{name}_contact_stiffness"], values[f"{name}_contact_damping"]
            friction, grip = None, D
            if touch.friction is not None:
                friction, grip = values[f"{name}_friction"], values[f"{name}_grip"]
            for point in touch.points:
                centre = placed[link].position(size * point)
                depth = radius - touch.normal @ (centre - touch.origin)
                # between the lowest point and the plane, as in MuJoCo
                at = centre - touch.normal * (radius - 0.5 * depth)
                speed = velocity_at(placed[link], moving[link], at)
                rise = touch.normal @ speed
                slip = speed - rise * touch.normal
                stops.append(Contact(depth, -rise, K, D, link, at, slip, touch.normal, friction, grip))
        for j in self._limits:
            name, at, dof = self._joint(j), self._m.jnt_qposadr[j], self._m.jnt_dofadr[j]
            K, D = values[f"{name}_limit_stiffness"], values[f"{name}_limit_damping"]
            margin = float(self._m.jnt_margin[j])  # from which on MuJoCo's limit is stretched
            stops.append(Stretch(values[f"{name}_low"] + margin - q[at], -v[dof], K, D))
            stops.append(Stretch(q[at] + margin - values[f"{name}_high"], v[dof], K, D))
        return stops

    @functools.partial(jax.jit, static_argnums=0)
    def depths_and_forces(
        self, values: Values, q: Array, v: Array
    ) -> tuple[Float[Array, " stops"], Float[Array, " stops"]]:
        """The stretch (m, rad) and the force (N, N m), were it pushing, of each stop, (stops,)."""
        stops = self.stretches(values, q, v)
        if not stops:
            return jnp.zeros((0,)), jnp.zeros((0,))
        return _row([stop.stretch for stop in stops]), _row([stop.force for stop in stops])

    @functools.partial(jax.jit, static_argnums=0)
    def heights(self, values: Values, q: Array, v: Array) -> Float[Array, " stops"]:
        """The `Stretch.height` (stops,) of each stop."""
        stops = self.stretches(values, q, v)
        return _row([stop.height for stop in stops]) if stops else jnp.zeros((0,))

    @functools.partial(jax.jit, static_argnums=0)
    def accelerations(
        self, values: Values, q: Array, v: Array, control: Array, pushing: Bool[Array, " stops"]
    ) -> Float[Array, " nv"]:
        """dv/dt (nv,), rad/s2 and m/s2.

        Args:
            values: the parameters.
            q, v: positions (nq,) and velocities (nv,), as MuJoCo's qpos and qvel.
            control: controls (nu,) of the actuators.
            pushing: whether each stop pushes.
        """
        tau = self._actuated(values, q, v, control)
        external: list[WorldForce] = []
        dofs = [int(self._m.jnt_dofadr[j]) for j in self._limits for _ in range(2)]
        stops = self.stretches(values, q, v)
        for k, stop in enumerate(stops):
            load = jnp.where(pushing[k], stop.force, 0.0)
            if isinstance(stop, Contact):
                external.append(WorldForce(stop.link, stop.at, stop.on_body(load)))
            else:
                joint = k - (len(stops) - len(dofs))
                tau[dofs[joint]] = tau[dofs[joint]] + (-load if joint % 2 else load)
        return jnp.asarray(
            forward_dynamics(
                self.tree, self.geometry(values), q, v, _row(tau), external, gravity=self.gravity(values)
            )
        )

    def _actuated(self, values: Values, q: Array, v: Array, control: Array) -> list[Scalar]:
        """Generalised forces (nv,) of the actuators."""
        m = self._m
        tau: list[Scalar] = [0.0] * self.nv
        clamped = not m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
        for k in range(self.nu):
            name, joint = self._actuator(k), m.actuator_trnid[k, 0]
            at, dof = m.jnt_qposadr[joint], m.jnt_dofadr[joint]
            gear, u = values[f"{name}_gear"], control[k]
            if clamped and m.actuator_ctrllimited[k]:
                u = jnp.clip(u, *m.actuator_ctrlrange[k])
            length, speed = gear * q[at], gear * v[dof]
            if _is_position(m, k):
                force = values[f"{name}_kp"] * (u - length) - values[f"{name}_kv"] * speed
            elif _is_velocity(m, k):
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

    # names

    def name_of_body(self, body: int) -> str:
        """The name of a body in its parameters, from its number."""
        return identifier(self._m.body(body).name or f"body_{body}")

    def _joint(self, joint: int) -> str:
        return identifier(self._m.jnt(joint).name or f"joint_{joint + 1}")

    def name_of_geom(self, geom: int) -> str:
        """The name of a geom in its parameters, from its number."""
        return identifier(self._m.geom(geom).name or f"geom_{geom}")

    def _actuator(self, actuator: int) -> str:
        return identifier(self._m.actuator(actuator).name or f"actuator_{actuator + 1}")

    def _link(self, body: int) -> int:
        """The link of a body, the last one of its joints."""
        return self._links(body)[-1]

    def _links(self, body: int) -> list[int]:
        """The links of a body, one for each joint."""
        # bodies without joints have one link
        count = [max(1, int(number)) for number in self._m.body_jntnum]
        first = sum(count[1:body])
        return list(range(first, first + count[body]))

    def _jointed(self) -> list[int]:
        """The hinges and slides."""
        return [j for j in range(self._m.njnt) if self._m.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE]

    def _link_of_joint(self, joint: int) -> int:
        body = int(self._m.jnt_bodyid[joint])
        return self._links(body)[joint - int(self._m.body_jntadr[body])]

    def _numbered(self, joint: str) -> int:
        """The number of a hinge or slide, by its name.

        Raises:
            ValueError: there is none.
        """
        names = {self._joint(j): j for j in self._jointed()}
        if (plain := identifier(joint)) not in names:
            raise ValueError(f"The MJCF has no hinge or slide '{joint}'{suggestion(joint, names)}")
        return names[plain]

    def address(self, joint: str) -> tuple[int, int]:
        """The places of a hinge or slide in q and in v, by its name."""
        j = self._numbered(joint)
        return int(self._m.jnt_qposadr[j]), int(self._m.jnt_dofadr[j])

    def body_of_joint(self, joint: str) -> str:
        """The name in the parameters of the body that a hinge or slide moves, by the joint's name."""
        return self.name_of_body(int(self._m.jnt_bodyid[self._numbered(joint)]))

    def stops_of(self, geom: str) -> list[int]:
        """The numbers of the stops of a geom, by its name.

        Raises:
            ValueError: no geom of this name can touch a plane.
        """
        numbers = [k for k, name in enumerate(self.geom_of_stop) if name == identifier(geom)]
        if not numbers:
            names = dict.fromkeys(name for name in self.geom_of_stop if name)
            raise ValueError(f"No geom '{geom}' can touch a plane{suggestion(geom, names)}")
        return numbers


def _is_position(m: Any, k: int) -> bool:
    """Whether an actuator is a position servo."""
    gain, bias = m.actuator_gainprm[k, 0], m.actuator_biasprm[k]
    affine = m.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
    return bool(affine and gain and bias[0] == 0.0 and bias[1] == -gain)


def _is_velocity(m: Any, k: int) -> bool:
    """Whether an actuator is a velocity servo."""
    gain, bias = m.actuator_gainprm[k, 0], m.actuator_biasprm[k]
    affine = m.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
    return bool(affine and gain and not bias[:2].any() and bias[2] == -gain)


def _row(numbers: Sequence[Scalar]) -> Array:
    """An array of numbers, of which some may be traced."""
    return jnp.stack([jnp.asarray(number, float) for number in numbers])


def _table(rows: Sequence[Sequence[Scalar]]) -> Array:
    return jnp.stack([_row(row) for row in rows])
