"""Parameters of a located body: numbers of its MJCF by the names of their elements."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from gaitsweep.contract import Quantity
from gaitsweep.dynamics.body.coverage import Softness, Touch
from gaitsweep.dynamics.mjcf import identifier
from gaitsweep.dynamics.tree import Geometry, Scalar

AXES = "xyz"


class BodyElements:
    """The names of the elements of an MJCF in parameters, and the links of its bodies and joints in the tree.

    Args:
        m: the compiled MJCF.
    """

    def __init__(self, m: Any) -> None:
        self.m = m

    def name_of_body(self, body: int) -> str:
        """The name of a body in its parameters, from its number."""
        return identifier(self.m.body(body).name or f"body_{body}")

    def name_of_joint(self, joint: int) -> str:
        """The name of a joint in its parameters, from its number."""
        return identifier(self.m.jnt(joint).name or f"joint_{joint + 1}")

    def name_of_geom(self, geom: int) -> str:
        """The name of a geom in its parameters, from its number."""
        return identifier(self.m.geom(geom).name or f"geom_{geom}")

    def name_of_actuator(self, actuator: int) -> str:
        """The name of an actuator in its parameters, from its number."""
        return identifier(self.m.actuator(actuator).name or f"actuator_{actuator + 1}")

    def link_of_body(self, body: int) -> int:
        """The link of a body, the last one of its joints."""
        return self.links_of_body(body)[-1]

    def links_of_body(self, body: int) -> list[int]:
        """The links of a body, one for each joint."""
        # bodies without joints have one link
        count = [max(1, int(number)) for number in self.m.body_jntnum]
        first = sum(count[1:body])
        return list(range(first, first + count[body]))

    def hinges_and_slides(self) -> list[int]:
        """The hinges and slides."""
        return [j for j in range(self.m.njnt) if self.m.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE]

    def link_of_joint(self, joint: int) -> int:
        """The link of a joint, from its number."""
        body = int(self.m.jnt_bodyid[joint])
        return self.links_of_body(body)[joint - int(self.m.body_jntadr[body])]


class BodyParameters:
    """The parameters of a located body, with the numbers of the MJCF as defaults.

    Args:
        elements: the names of its elements.
        geometry: the geometry of its tree.
        touches: the geoms that may touch the ground.
        limits: the limited joints, with the softness of their limits.
    """

    def __init__(
        self,
        elements: BodyElements,
        geometry: Geometry,
        touches: Sequence[Touch],
        limits: Mapping[int, Softness],
    ) -> None:
        self._elements = elements
        self._m = elements.m
        self._geometry = geometry
        self._touches = touches
        self._limits = limits
        self._quantities: dict[str, Quantity] = {}

    def quantities(self, gravity: float) -> tuple[Quantity, ...]:
        """The parameters of bodies, joints, contacts and actuators; `gravity` (m/s2) is that of the MJCF."""
        self._quantities = {}
        for body in range(1, self._m.nbody):
            self._add_body(body)
        for joint in self._elements.hinges_and_slides():
            self._add_joint(joint)
        for touch in self._touches:
            self._add_touch(touch)
        for k in range(self._m.nu):
            self._add_actuator(k)
        self._add("gravity", "m/s2", "acceleration of gravity", gravity, 0.0)
        self._add("slope", "rad", "slope of the ground, downhill along x", 0.0)
        return tuple(self._quantities.values())

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
        """Add a parameter from `low` on, or `above` it; one that several contacts share is added once."""
        self._quantities[name] = Quantity(name, unit, meaning, float(default), low=low, open_ends=above)

    def _add_body(self, body: int) -> None:
        """Add the mass, the inertia, the size and the places of a body."""
        name = self._elements.name_of_body(body)
        link = self._elements.link_of_body(body)
        mass = self._geometry.mass[link]
        if mass:
            self._add(f"{name}_mass", "kg", f"mass of {name}", mass, 0.0, above=True)
            meaning = f"inertia of {name}, per that of its mass"
            self._add(f"{name}_inertia", "1", meaning, 1.0, 0.0, above=True)
        self._add(f"{name}_size", "1", f"factor of the lengths of {name}", 1.0, 0.0, above=True)
        position = self._geometry.position[self._elements.links_of_body(body)[0]]
        for k in np.flatnonzero(position):
            meaning = f"{AXES[k]} of {name}'s place in its parent"
            self._add(f"{name}_{AXES[k]}", "m", meaning, position[k])
        centre = self._geometry.com[link]
        for k in np.flatnonzero(centre):
            meaning = f"{AXES[k]} of {name}'s centre of mass"
            self._add(f"{name}_com_{AXES[k]}", "m", meaning, centre[k])

    def _add_joint(self, joint: int) -> None:
        """Add the damper, the spring, the rotor inertia and the limits of a hinge or slide."""
        geometry = self._geometry
        name = self._elements.name_of_joint(joint)
        link = self._elements.link_of_joint(joint)
        dof = self._m.jnt_dofadr[joint]
        turning = self._m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        unit, stiff, damped, heavy = (
            ("rad", "N m/rad", "N m s/rad", "kg m2") if turning else ("m", "N/m", "N s/m", "kg")
        )
        self._add(f"{name}_damping", damped, f"damper of {name}", geometry.damping[dof], 0.0)
        self._add(f"{name}_stiffness", stiff, f"spring of {name}", geometry.stiffness[link], 0.0)
        self._add(f"{name}_springref", unit, f"{name} at which its spring is slack", geometry.rest[link])
        armature = geometry.armature[dof]
        if armature:
            self._add(f"{name}_armature", heavy, f"rotor inertia of {name}", armature, 0.0, above=True)
        if joint in self._limits:
            low, high = self._m.jnt_range[joint]
            self._add(f"{name}_low", unit, f"lower limit of {name}", low)
            self._add(f"{name}_high", unit, f"upper limit of {name}", high)
            place = f"at the limits of {name}"
            self._add_softness(f"{name}_limit", self._limits[joint], place, (stiff, damped))

    def _add_touch(self, touch: Touch) -> None:
        """Add the radius, the friction and the softness of a geom that may touch the ground."""
        name = self._elements.name_of_geom(touch.geom)
        if touch.radius:
            self._add(f"{name}_radius", "m", f"radius of {name}", touch.radius, 0.0)
        if touch.friction is not None:
            self._add(f"{name}_friction", "1", f"coefficient of friction of {name}", touch.friction, 0.0)
            meaning = f"damper of {name} along the ground, below the limit of friction"
            self._add(f"{name}_grip", "N s/m", meaning, touch.softness.D, 0.0, above=True)
        place = f"between {name} and the ground"
        self._add_softness(f"{name}_contact", touch.softness, place, ("N/m", "N s/m"))

    def _add_softness(self, name: str, softness: Softness, place: str, units: tuple[str, str]) -> None:
        """Add the spring and the damper of a stop, in these units."""
        self._add(f"{name}_stiffness", units[0], f"spring {place}", softness.K, 0.0, above=True)
        self._add(f"{name}_damping", units[1], f"damper {place}", softness.D, 0.0)

    def _add_actuator(self, k: int) -> None:
        """Add the gear and the gains of an actuator."""
        m = self._m
        name = self._elements.name_of_actuator(k)
        gain = m.actuator_gainprm[k, 0]
        # from 0, so that no rate has the default -0.0
        rate_gain = 0.0 - m.actuator_biasprm[k, 2]
        self._add(f"{name}_gear", "1", f"gear of actuator {name}", m.actuator_gear[k, 0])
        if is_position_servo(m, k):
            self._add(f"{name}_kp", "N/m or N m/rad", f"position gain of actuator {name}", gain)
            self._add(f"{name}_kv", "N s/m or N m s/rad", f"velocity gain of actuator {name}", rate_gain)
        elif is_velocity_servo(m, k):
            self._add(f"{name}_kv", "N s/m or N m s/rad", f"velocity gain of actuator {name}", gain)
        else:
            self._add(f"{name}_gain", "1", f"gain of actuator {name}", gain)


def is_position_servo(m: Any, k: int) -> bool:
    """Whether an actuator is a position servo."""
    gain = m.actuator_gainprm[k, 0]
    bias = m.actuator_biasprm[k]
    affine = m.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
    return bool(affine and gain and bias[0] == 0.0 and bias[1] == -gain)


def is_velocity_servo(m: Any, k: int) -> bool:
    """Whether an actuator is a velocity servo."""
    gain = m.actuator_gainprm[k, 0]
    bias = m.actuator_biasprm[k]
    affine = m.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
    return bool(affine and gain and not bias[:2].any() and bias[2] == -gain)
