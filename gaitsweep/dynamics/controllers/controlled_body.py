"""The class of the model of a body in an MJCF whose legs a controller moves, as a model file describes it."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaitsweep.dynamics.controllers.leg_targets import Targets, control_of_legs, unit_of_joints
from gaitsweep.dynamics.controllers.oscillators import HIP, LegSenses
from gaitsweep.dynamics.declarations import Variable, observable, parameter, signal, variable
from gaitsweep.dynamics.event_declarations import event
from gaitsweep.dynamics.gaits_by_footfalls import KNOWN_LEGS, SHORTEST_CONTACT, footfalls, have_names
from gaitsweep.dynamics.ground import is_uneven
from gaitsweep.dynamics.mjcf import cleaned, identifier, is_position_servo
from gaitsweep.dynamics.tree import tilt_and_heading
from gaitsweep.dynamics.tree.spatial import rotation_about, rotation_of

if TYPE_CHECKING:
    from gaitsweep.dynamics.body.body_model import BodyModel
    from gaitsweep.dynamics.controllers.model_file import ModelFile
    from gaitsweep.dynamics.mjx.mjcf_model import MjcfModel

# Members that a class of a model needs; an MJCF is compiled by a class with these before its controller is
# known.
UNCONTROLLED: Mapping[str, Any] = {
    "control": lambda model, params, state: jnp.zeros(0),
    "period": lambda model, params: jnp.ones(()),
}
_LEVEL = 1e-9  # m: motion along the ground below which the trunk does not move
_ALONG = 1.0 - 1e-6  # cosine of the angle between two axes that count as one
# Names of legs in other conventions, in capitals.
_OTHER_NAMES = {
    "FL": "LF", "FR": "RF", "HL": "LH", "HR": "RH", "BL": "LH", "BR": "RH", "RL": "LH", "RR": "RH",
    "LEFT": "L", "RIGHT": "R",
}  # fmt: skip
_DIGITS = 16  # of a digest, in the name of a class


@dataclasses.dataclass(frozen=True)
class Leg:
    """A leg: its name, the geom of its foot, and the joint of each role."""

    name: str
    foot: str
    joints: Mapping[str, str]


@dataclasses.dataclass(frozen=True, eq=False)
class ControlledBody:
    """A body and the controller of its legs, from which the members of a model's class are made.

    Attributes:
        m: the compiled MJCF.
        is_located: whether contacts are located events, of a `BodyModel`.
        file: the content of the model file.
        legs: the legs.
        targets: the targets of their joints.
        actuators: the number of the actuator of each joint.
    """

    m: Any
    is_located: bool
    file: ModelFile
    legs: list[Leg]
    targets: Targets
    actuators: Mapping[str, int]

    def members(self) -> dict[str, Any]:
        """The declarations and functions of the model, by name."""
        members = {**self._of_controller(), **self._of_feet(), **self._of_trunk()}
        if self.is_located:
            # `begin` follows from the positions, and nothing follows from `speed` and the clock
            moving = [name for name, declared in members.items() if isinstance(declared, Variable)]
            others = ("clock", "begin", "speed")
            members["section_coordinates"] = ("q", "v", *(name for name in moving if name not in others))
        return members

    def _of_controller(self) -> dict[str, Any]:
        """Parameters, variables, rates and control of the oscillators."""
        controller = self.file.controller
        oscillators = controller.oscillators
        names = self._leg_names

        def rates(model: Any, params: Any, state: Any) -> dict[str, Any]:
            senses = LegSenses(lambda: self._loads(model, params, state), lambda: self._hips(model, state))
            return {**oscillators.rates(names, params, state, senses), "clock": 1.0}

        members: dict[str, Any] = {**oscillators.declarations(names), **self.targets.declarations()}
        if controller.kp is not None and controller.kd is not None:
            motors = [joint for joint, k in self.actuators.items() if not is_position_servo(self.m, k)]
            stiffness = unit_of_joints(self.m, motors, "N m/rad", "N/m")
            damping = unit_of_joints(self.m, motors, "N m s/rad", "N s/m")
            members["kp"] = parameter(stiffness, "position gain of motors", controller.kp, low=0.0)
            members["kd"] = parameter(damping, "velocity gain of motors", controller.kd, low=0.0)
        members |= {
            "clock": variable("s", "time since the section", observed=False, signal=False),
            "control": control_of_legs(self.m, self.file, self.targets, self.actuators),
            "rates": rates,
            "period": lambda model, params: oscillators.period(params),
            "force": signal("N", "force of the ground on foot", count=len(names))(self._loads),
        }
        if oscillators.resets:
            members["landing"] = self._landing()
        return members

    def _landing(self) -> Any:
        """The event of landing feet, which reset their oscillators."""

        def depths(model: Any, params: Any, state: Any) -> Float[Array, " legs"]:
            return jnp.stack([model.depth(params, state, leg.foot) for leg in self.legs])

        def contacts(model: Any, params: Any, state: Any) -> Float[Array, " legs"]:
            return jnp.where(self._touches(model, state), 1.0, -1.0)

        def landed(model: Any, params: Any, state: Any, i: int) -> Any:
            return self.file.controller.oscillators.landed(params, state, i)

        declare = event("foot {} lands", count=len(self.legs))
        landing = declare(depths if self.is_located else contacts)
        landing.jump(landed)
        return landing

    @property
    def trunk(self) -> Trunk:
        """The trunk."""
        return Trunk(self.m, [leg.foot for leg in self.legs])

    @property
    def _leg_names(self) -> tuple[str, ...]:
        return tuple(leg.name for leg in self.legs)

    @property
    def remark_on_names(self) -> str:
        """A sentence on legs whose footfalls have no names of gaits, with the names that have; else ''."""
        names = self._leg_names
        if have_names(names):
            return ""
        text = f"the legs {', '.join(names)} have no lags, duty factors and names of gaits: these need the "
        text += f"names {KNOWN_LEGS} (left and right, fore and hind, or pairs from the front), in any order"
        renamed = {name: _OTHER_NAMES.get(name.upper(), name) for name in names}
        if have_names(list(renamed.values())):
            pairs = [f"{name} {better}" for name, better in renamed.items() if name != better]
            text += f"; here call {', '.join(pairs)}"
        return text

    def _of_feet(self) -> dict[str, Any]:
        """Footfalls of legs that have names of gaits; else the signals contact_1, ..."""

        def feet(model: Any, params: Any, state: Any) -> Bool[Array, " legs"]:
            return self._touches(model, state)

        def contact(model: Any, params: Any, state: Any) -> Float[Array, " legs"]:
            return self._touches(model, state).astype(float)

        names = self._leg_names
        if have_names(names):
            chosen = self.file.shortest_contact
            shortest = SHORTEST_CONTACT if chosen is None else chosen
            return {"feet": footfalls("clock", legs=names, shortest_contact=shortest)(feet)}
        from gaitsweep.dynamics.mjcf_drawing import looks_of_feet  # imports MuJoCo

        looks = looks_of_feet(names, self._feet_aside())
        contacts = signal("1", "whether foot is down", count=len(names))(contact)
        return {"contact": contacts, "limbs": property(lambda model: looks)}

    def _feet_aside(self) -> list[float]:
        """The place (m) of each foot to the left of the body's origin, in the MJCF's own pose."""
        import mujoco

        data = mujoco.MjData(self.m)
        mujoco.mj_kinematics(self.m, data)
        return [float(data.geom(leg.foot).xpos[1]) for leg in self.legs]

    def _of_trunk(self) -> dict[str, Any]:
        """The section, with the mean speed of each cycle; the trunk's height; and its fall."""
        trunk = self.trunk
        level = _level_of_ground(self.m)
        lowest = self.file.fallen

        def height(model: Any, params: Any, state: Any) -> Float[Array, ""]:
            place = trunk.place(model.positions(state))
            if not is_uneven(model):
                return place[2] - level
            own = model.own_ground(place[0], place[1])
            return place[2] - params.ground(place[0]) - (level if own is None else own)

        observed_height = observable("m", "height of the trunk over the ground", scale=0.1, signal=True)
        members: dict[str, Any] = {"turn": self._section(trunk)}
        if trunk.moves:
            members["begin"] = variable(
                "m", "place of the trunk at the section", count=2, observed=False, signal=False, held=True
            )
            members["speed"] = variable(
                "m/s", "mean speed of the last cycle", observed=True, scale=1.0, held=True
            )

            def complete(model: Any, params: Any, state: Any) -> Any:
                return state.replace(begin=trunk.place(model.positions(state))[:2])

            members["complete"] = complete
        members["height"] = observed_height(height)
        if lowest is not None:

            def failed(model: Any, params: Any, state: Any) -> Bool[Array, ""]:
                return height(model, params, state) < lowest

            failed.__doc__ = f"The trunk sank below `fallen` = {lowest:g} m."
            members["failed"] = failed
        return members

    def _section(self, trunk: Trunk) -> Any:
        """The event that closes a cycle, at which the speed of a moving trunk is computed."""
        oscillators = self.file.controller.oscillators

        def turn(model: Any, params: Any, state: Any) -> Float[Array, ""]:
            return oscillators.turned(state)

        def begin_cycle(model: Any, params: Any, state: Any) -> Any:
            changes: dict[str, Any] = {"clock": 0.0}
            if trunk.moves:
                q = model.positions(state)
                changes["begin"] = trunk.place(q)[:2]
                changes["speed"] = trunk.ahead(q, state.begin) / state.clock
            return oscillators.wrapped(state).replace(**changes)

        section = event("the first leg ends its swing", section=True)(turn)
        section.jump(begin_cycle)
        return section

    def _touches(self, model: Any, state: Any) -> Bool[Array, " legs"]:
        """Whether each foot is on the ground."""
        return jnp.stack([model.touches(state, leg.foot) for leg in self.legs])

    def _loads(self, model: Any, params: Any, state: Any) -> Float[Array, " legs"]:
        """The force (N) of the ground on each foot."""
        return jnp.stack([model.load(params, state, leg.foot) for leg in self.legs])

    def _hips(self, model: Any, state: Any) -> Float[Array, " legs"]:
        """The angles (n,) of the legs' hips, rad, leg forward positive."""
        trunk = self.trunk
        angles = []
        for leg in self.legs:
            position = model.position(state, leg.joints[HIP])
            angles.append(-position if trunk.turns_backwards(leg.joints[HIP]) else position)
        return jnp.stack(angles)


def model_class(
    path: Path, base: type[BodyModel] | type[MjcfModel], body_file: str, body: ControlledBody, digest: str
) -> type[BodyModel] | type[MjcfModel]:
    """The class of the model of a model file.

    Args:
        path: the model file.
        base: the class to derive from.
        body_file: the path of the MJCF.
        body: the body and its controller.
        digest: the digest of the file's content.
    """
    data_digest_of_base: Any = base.data_digest
    remarks = tuple(filter(None, [body.remark_on_names]))
    members: dict[str, Any] = {
        "__doc__": f"The model of {path.name}.",
        "__module__": __name__,
        # classes of other files and contents have other names, since programs are stored by names
        "__qualname__": f"ModelOfFile_{digest[:_DIGITS]}",
        "model_file": path,
        "name": identifier(path.stem),
        "source": body.file.source,
        "body_file": body_file,
        "keyframe": body.file.keyframe,
        "data_digest": property(lambda model: data_digest_of_base.fget(model) + digest),
        "remarks": remarks,
        "caveats": lambda model: [*base.caveats(model), *remarks],
        **({"begins_standing": body.file.start == "standing"} if body.is_located else {}),
        **body.members(),
    }
    class_: Any = type(_class_name(path), (base,), members)
    return class_


def _class_name(path: Path) -> str:
    """The name of a model's class from that of its file."""
    words = re.findall(r"[A-Za-z0-9]+", path.stem)
    return identifier("".join(word[:1].upper() + word[1:] for word in words)) or "Walker"


def _level_of_ground(m: Any) -> float:
    """The height (m) of the highest level plane of the world; 0 without one."""
    import mujoco

    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    planes = (m.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (m.body_weldid[m.geom_bodyid] == 0)
    is_level = cleaned(data.geom_xmat[:, 8]) == 1.0  # the vertical component of its normal
    return max(data.geom_xpos[planes & is_level, 2].tolist(), default=0.0)


class Trunk:
    """Place and heading of the trunk, by its free joint or its slides, hinges and balls.

    The trunk is the first body with a joint among those that carry all feet, or the body that the arms of a
    boom carry, which turn in place; of a robot that is fixed to the world, whose legs alone have joints, it
    is the first body.

    Args:
        m: the compiled MJCF.
        feet: the geoms of the feet.
    """

    def __init__(self, m: Any, feet: Sequence[str]) -> None:
        import mujoco

        kinds = mujoco.mjtJoint
        carriers = set.intersection(*(set(_carriers(m, int(m.geom(foot).bodyid[0]))) for foot in feet))
        first = min((b for b in carriers if m.body_jntnum[b]), default=1)
        data = mujoco.MjData(m)
        mujoco.mj_kinematics(m, data)
        self._m = m
        self._data = data  # at qpos0
        self._bodies = self._arms(first, carriers)
        self._body = self._bodies[-1]
        joints = [j for j in range(m.njnt) if m.jnt_bodyid[j] in self._bodies]
        self._free = (
            int(m.jnt_qposadr[joints[0]]) if joints and m.jnt_type[joints[0]] == kinds.mjJNT_FREE else None
        )
        # turns about its own origin move nothing but the slides after them
        while joints and m.jnt_bodyid[joints[-1]] == self._body:
            if m.jnt_type[joints[-1]] == kinds.mjJNT_SLIDE or m.jnt_pos[joints[-1]].any():
                break
            joints.pop()
        self._joints = {j: kinds(m.jnt_type[j]).name.removeprefix("mjJNT_").lower() for j in joints}
        # a boom: its hinge turns the trunk, which walks around it
        on_boom = any(k == "hinge" and abs(data.xaxis[j][2]) > _ALONG for j, k in self._joints.items())
        self._turns = self._free is not None or on_boom

    def _arms(self, first: int, carriers: Iterable[int]) -> list[int]:
        """The `first` body with a joint, and if it is an arm of a boom, those behind it up to the trunk."""
        behind = sorted(b for b in carriers if b >= first)
        number = next((k for k, body in enumerate(behind) if self._is_moved(body)), 0)
        arms = behind[:number]
        hinges = [j for j in range(self._m.njnt) if self._m.jnt_bodyid[j] in arms]
        on_boom = any(abs(self._data.xaxis[j][2]) > _ALONG for j in hinges)
        return behind[: number + 1] if on_boom else [first]

    @property
    def moves(self) -> bool:
        """Whether its joints move it along the ground."""
        return self._is_moved(self._body)

    def _is_moved(self, body: int) -> bool:
        """Whether joints move a body along the ground."""
        import mujoco

        data = mujoco.MjData(self._m)
        data.qpos[:] = self._m.qpos0 + np.random.default_rng(0).uniform(0.1, 1.0, self._m.nq)
        mujoco.mj_kinematics(self._m, data)
        return bool(abs(data.xpos[body] - self._data.xpos[body])[:2].max() > _LEVEL)

    def place(self, q: Float[Array, " nq"]) -> Float[Array, " 3"]:
        """Its place (3,), m: the origin of the body in the world."""
        if self._free is not None:
            return q[self._free : self._free + 3]
        return jnp.asarray(self._pose(q)[0])

    def _pose(self, q: Float[Array, " nq"]) -> tuple[Any, Any]:
        """Its place (3,), m, and its orientation (3, 3) without the turns that do not move it."""
        import mujoco

        m = self._m
        parent = int(m.body_parentid[self._bodies[0]])  # static
        place: Any = self._data.xpos[parent]
        turn: Any = self._data.xmat[parent].reshape(3, 3)
        for body in self._bodies:
            orientation = np.zeros(9)
            mujoco.mju_quat2Mat(orientation, m.body_quat[body])
            place = place + turn @ m.body_pos[body]
            turn = turn @ orientation.reshape(3, 3)
            for j, kind in self._joints.items():
                if m.jnt_bodyid[j] != body:
                    continue
                at = int(m.jnt_qposadr[j])
                axis = np.array(m.jnt_axis[j])
                anchor = np.array(m.jnt_pos[j])
                moved = q[at] - float(m.qpos0[at])
                if kind == "slide":
                    place = place + moved * (turn @ axis)
                    continue
                spun = rotation_about(axis, moved) if kind == "hinge" else rotation_of(q[at : at + 4])
                place = place + turn @ anchor - turn @ spun @ anchor
                turn = turn @ spun
        return place, turn

    def ahead(self, q: Float[Array, " nq"], begin: Float[Array, " 2"]) -> Float[Array, ""]:
        """The way (m) from a place (2,) along its heading; along x without a free joint or a boom."""
        way = self.place(q)[:2] - begin
        if not self._turns:
            return way[0]
        if self._free is not None:
            _, heading = tilt_and_heading(q[self._free + 3 : self._free + 7])
            return (way @ heading)[0]
        forward = self._pose(q)[1][:2, 0]
        return way @ forward / jnp.sqrt(forward @ forward)

    def turns_backwards(self, hip: str) -> bool:
        """Whether a rising angle of a hip moves its leg backwards, as a turn about y does.

        Raises:
            ValueError: the hip is no hinge about y; the message has its axis.
        """
        import mujoco

        j = self._m.joint(hip).id
        frame = self._data.xmat[self._body].reshape(3, 3) if self._turns else np.eye(3)
        axis = self._data.xaxis[j] @ frame
        if self._m.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE or abs(axis[1]) < _ALONG:
            what = ", ".join(f"{number:.3g}" for number in cleaned(axis))
            raise ValueError(
                f"Joint '{hip}' is no hinge about y, whose angle the oscillators feel: it is a "
                f"{mujoco.mjtJoint(self._m.jnt_type[j]).name.removeprefix('mjJNT_').lower()} with the axis "
                f"({what}) {'of the trunk' if self._turns else 'of the world'}. Give a hinge about y or -y, "
                "or leave hip: out of oscillators:."
            )
        return bool(axis[1] > 0.0)


def _carriers(m: Any, body: int) -> Iterator[int]:
    """A body and those that carry it, without the world."""
    while body:
        yield body
        body = int(m.body_parentid[body])
