"""Parameters of a located body: numbers of its MJCF by the names of their elements."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from gaitsweep.contract import Quantity
from gaitsweep.dynamics.body.coverage import Softness, Touch
from gaitsweep.dynamics.mjcf import (
    hinges_and_slides,
    identifier,
    is_position_servo,
    is_velocity_servo,
    joint_name,
)
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

    def link_of_joint(self, joint: int) -> int:
        """The link of a joint, from its number."""
        body = int(self.m.jnt_bodyid[joint])
        return self.links_of_body(body)[joint - int(self.m.body_jntadr[body])]


@dataclasses.dataclass(frozen=True)
class BodyParameters:
    """The parameters of a located body, with the numbers of the MJCF as defaults.

    Attributes:
        elements: the names of its elements.
        geometry: the geometry of its tree.
        touches: the geoms that may touch the ground.
        limits: the limited joints, with the softness of their limits.
    """

    elements: BodyElements
    geometry: Geometry
    touches: Sequence[Touch]
    limits: Mapping[int, Softness]

    def quantities(self, gravity: float) -> tuple[Quantity, ...]:
        """The parameters of bodies, joints, contacts and actuators; `gravity` (m/s2) is that of the MJCF.

        Raises:
            ValueError: two elements would share a parameter.
        """
        m = self.elements.m
        # a geom that may touch several surfaces has its parameters once
        touches = {touch.geom: touch for touch in self.touches}.values()
        several = itertools.chain(
            *map(self._of_body, range(1, m.nbody)),
            *map(self._of_joint, hinges_and_slides(m)),
            *map(self._of_touch, touches),
            *map(self._of_actuator, range(m.nu)),
        )
        of_all = (
            _quantity("gravity", "m/s2", "acceleration of gravity", gravity, 0.0),
            _quantity("slope", "rad", "slope of the ground, downhill along x", 0.0),
        )
        quantities = (*several, *of_all)
        names = [quantity.name for quantity in quantities]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(
                    f"Two elements of the MJCF have the parameter {name}, in which other characters than "
                    "letters and digits are underscores: rename one of them."
                )
        return quantities

    def _of_body(self, body: int) -> Iterator[Quantity]:
        """The mass, the inertia, the size and the places of a body."""
        name = self.elements.name_of_body(body)
        link = self.elements.link_of_body(body)
        mass = self.geometry.mass[link]
        if mass:
            yield _quantity(f"{name}_mass", "kg", f"mass of {name}", mass, 0.0, above=True)
            meaning = f"inertia of {name}, per that of its mass"
            yield _quantity(f"{name}_inertia", "1", meaning, 1.0, 0.0, above=True)
        yield _quantity(f"{name}_size", "1", f"factor of the lengths of {name}", 1.0, 0.0, above=True)
        position = self.geometry.position[self.elements.links_of_body(body)[0]]
        for k in np.flatnonzero(position):
            meaning = f"{AXES[k]} of {name}'s place in its parent"
            yield _quantity(f"{name}_{AXES[k]}", "m", meaning, position[k])
        centre = self.geometry.com[link]
        for k in np.flatnonzero(centre):
            yield _quantity(f"{name}_com_{AXES[k]}", "m", f"{AXES[k]} of {name}'s centre of mass", centre[k])

    def _of_joint(self, joint: int) -> Iterator[Quantity]:
        """The damper, the spring, the rotor inertia and the limits of a hinge or slide."""
        m = self.elements.m
        geometry = self.geometry
        name = joint_name(m, joint)
        link = self.elements.link_of_joint(joint)
        dof = m.jnt_dofadr[joint]
        turning = m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        unit, stiff, damped, heavy = (
            ("rad", "N m/rad", "N m s/rad", "kg m2") if turning else ("m", "N/m", "N s/m", "kg")
        )
        yield _quantity(f"{name}_damping", damped, f"damper of {name}", geometry.damping[dof], 0.0)
        yield _quantity(f"{name}_stiffness", stiff, f"spring of {name}", geometry.stiffness[link], 0.0)
        yield _quantity(
            f"{name}_springref", unit, f"{name} at which its spring is slack", geometry.rest[link]
        )
        armature = geometry.armature[dof]
        if armature:
            yield _quantity(f"{name}_armature", heavy, f"rotor inertia of {name}", armature, 0.0, above=True)
        if joint in self.limits:
            low, high = m.jnt_range[joint]
            yield _quantity(f"{name}_low", unit, f"lower limit of {name}", low)
            yield _quantity(f"{name}_high", unit, f"upper limit of {name}", high)
            place = f"at the limits of {name}"
            yield from _of_softness(f"{name}_limit", self.limits[joint], place, (stiff, damped))

    def _of_touch(self, touch: Touch) -> Iterator[Quantity]:
        """The radius, the friction and the softness of a geom that may touch the ground."""
        name = self.elements.name_of_geom(touch.geom)
        if touch.radius:
            yield _quantity(f"{name}_radius", "m", f"radius of {name}", touch.radius, 0.0)
        if touch.friction is not None:
            meaning = f"coefficient of friction of {name}"
            yield _quantity(f"{name}_friction", "1", meaning, touch.friction, 0.0)
            meaning = f"damper of {name} along the ground, below the limit of friction"
            yield _quantity(f"{name}_grip", "N s/m", meaning, touch.softness.D, 0.0, above=True)
        place = f"between {name} and the ground"
        yield from _of_softness(f"{name}_contact", touch.softness, place, ("N/m", "N s/m"))

    def _of_actuator(self, k: int) -> Iterator[Quantity]:
        """The gear and the gains of an actuator."""
        m = self.elements.m
        name = self.elements.name_of_actuator(k)
        gain = m.actuator_gainprm[k, 0]
        yield _quantity(f"{name}_gear", "1", f"gear of actuator {name}", m.actuator_gear[k, 0])
        of_position = (f"{name}_kp", "N/m or N m/rad", f"position gain of actuator {name}")
        of_velocity = (f"{name}_kv", "N s/m or N m s/rad", f"velocity gain of actuator {name}")
        if is_position_servo(m, k):
            yield _quantity(*of_position, gain)
            # from 0, so that no rate has the default -0.0
            yield _quantity(*of_velocity, 0.0 - m.actuator_biasprm[k, 2])
        elif is_velocity_servo(m, k):
            yield _quantity(*of_velocity, gain)
        else:
            yield _quantity(f"{name}_gain", "1", f"gain of actuator {name}", gain)


def _quantity(
    name: str, unit: str, meaning: str, default: Scalar, low: float = -math.inf, *, above: bool = False
) -> Quantity:
    """A parameter from `low` on, or `above` it."""
    return Quantity(name, unit, meaning, float(default), low=low, open_ends=above)


def _of_softness(name: str, softness: Softness, place: str, units: tuple[str, str]) -> Iterator[Quantity]:
    """The spring and the damper of a stop, in these units."""
    yield _quantity(f"{name}_stiffness", units[0], f"spring {place}", softness.K, 0.0, above=True)
    yield _quantity(f"{name}_damping", units[1], f"damper {place}", softness.D, 0.0)
