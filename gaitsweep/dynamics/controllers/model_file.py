"""Model files: a body of an MJCF and the controller of its legs in YAML, read as the class of a model.

body: biped.xml
controller:
  oscillators: {kind: phase, omega: 6, coupling: 4, phases: {L: 0, R: pi}, sigma: 0.03}
  joints:
    hip: {swing: 0.25}
    knee: {offset: 0.15, lift: 1}
  legs:
    L: {foot: foot_l, hip: hip_l, knee: knee_l}
    R: {foot: foot_r, hip: hip_r, knee: knee_r}
fallen: 0.5
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import functools
import hashlib
import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field, ValidationError

from gaitsweep.dynamics import declarations
from gaitsweep.dynamics.body.body_model import BodyModel
from gaitsweep.dynamics.controllers.leg_targets import (
    FootPath,
    FootPaths,
    JointPatterns,
    Targets,
    Waveform,
    actuator_of,
    two_link_leg,
)
from gaitsweep.dynamics.controllers.oscillators import OSCILLATORS, LegSenses, Oscillators, unknown_legs
from gaitsweep.dynamics.footfalls import LEGS, footfalls
from gaitsweep.dynamics.mjcf.source import compiled_mjcf, identifier
from gaitsweep.dynamics.mjx.mjcf_model import MjcfModel
from gaitsweep.dynamics.tree import tilt_and_heading
from gaitsweep.near_miss import suggestion
from gaitsweep.schema.diagnostics import Diagnostic, JobError, SchemaSection, from_pydantic, wrong_kind
from gaitsweep.schema.numbers import NotNegative, Real, Text, word
from gaitsweep.schema.strict_model import OneOf, StrictModel
from gaitsweep.schema.yaml_document import Document, read_document

_FOOT = "foot"  # the entry of a leg that names its foot; the others are roles of joints


class Controller(StrictModel):
    """The controller of legs."""

    oscillators: Annotated[Oscillators, OneOf(OSCILLATORS)] = Field(
        description="the oscillators, one for each leg (kind: phase, hopf or matsuoka)"
    )
    joints: dict[str, Waveform] | None = Field(
        default=None, description="waveforms of the joints by role, such as hip and knee"
    )
    path: FootPath | None = Field(
        default=None, description="path of the feet instead of joints; legs then have the roles hip and knee"
    )
    legs: dict[str, dict[str, Text]] = Field(
        description="legs by name, each with the geom of its foot and the joint of each role; L and R, or "
        "LF, RF, LH and RH, or L1, R1, ... have names of gaits"
    )
    kp: NotNegative | None = Field(
        default=None, description="position gain of joints with motors, N m/rad or N/m: the parameter kp"
    )
    kd: NotNegative | None = Field(
        default=None, description="velocity gain of joints with motors, N m s/rad or N s/m: the parameter kd"
    )


class ModelFile(StrictModel):
    """A body of an MJCF and its controller."""

    body: Text = Field(description="the MJCF, from the folder of this file")
    dynamics: Annotated[
        Literal["located", "stepped"], word("located", "stepped", former={"mjx": "stepped"})
    ] = Field(
        default="located",
        description="located: contacts as events, in the kernels (BodyModel); stepped: MuJoCo's steps and "
        "contacts (MjcfModel)",
    )
    keyframe: str = Field(default="", description="keyframe of the start; by default the first one")
    controller: Controller = Field(description="the controller")
    fallen: Real | None = Field(
        default=None, description="height of the trunk below which it has fallen, m; left out: it never falls"
    )
    source: str = Field(default="", description="paper of the model")


_SECTIONS: dict[str, SchemaSection] = {
    "": SchemaSection("a model file", ModelFile),
    "controller": SchemaSection("controller", Controller),
    "joints": SchemaSection("a joint", Waveform),
    "path": SchemaSection("path", FootPath),
    **{kind: SchemaSection(f"oscillators ({kind})", part) for kind, part in OSCILLATORS.items()},
}


def model_of_file(path: Path) -> type[BodyModel] | type[MjcfModel]:
    """The class of the model that a model file describes, made once for each content of the file.

    A change of its MJCF is seen by the time of that file; after one of an included file or a mesh, start a
    new Python process.

    Raises:
        JobError: the file is not read, or names what its MJCF does not have; with its line.
    """
    path = path.resolve()
    document = read_document(path)
    body = path.parent / str(document.data.get("body"))
    written = body.stat().st_mtime_ns if body.is_file() else None
    return _model_of(path, json.dumps(document.data, sort_keys=True, default=str), written)


@functools.lru_cache(maxsize=64)
def _model_of(path: Path, content: str, written: int | None) -> type[BodyModel] | type[MjcfModel]:
    document = read_document(path)
    controller = document.data.get("controller")
    if isinstance(controller, Mapping) and "oscillators" in controller:
        place = ("controller", "oscillators")
        wrong = wrong_kind(place, controller["oscillators"], OSCILLATORS, noun="a kind of oscillators")
        if wrong is not None:
            raise document.located(JobError([wrong]))
    try:
        file = ModelFile.model_validate(document.data)
    except ValidationError as error:
        raise document.located(JobError(from_pydantic(error, _SECTIONS, ""))) from None
    return _Builder(path, file, document, content).model()


class _Builder:
    """Builder of the class of a model file's model.

    Args:
        path: the file.
        file: its content, as read.
        document: its content, with the lines of fields.
        content: its content as text, for digests.
    """

    def __init__(self, path: Path, file: ModelFile, document: Document, content: str) -> None:
        self._path, self._file, self._document, self._content = path, file, document, content
        self._controller = file.controller
        self._legs = tuple(file.controller.legs)
        self._base = BodyModel if file.dynamics == "located" else MjcfModel
        of_file: dict[str, Any] = {"body_file": str(path.parent / file.body), "keyframe": file.keyframe}
        # a class without legs, by which the MJCF is compiled as the model compiles it
        bare: Any = type("OfFile", (self._base,), {**of_file, **_UNCONTROLLED})
        self._mjcf = compiled_mjcf(bare)
        self._check_legs()
        self._feet = [leg[_FOOT] for leg in file.controller.legs.values()]
        self._joints = [
            {role: joint for role, joint in leg.items() if role != _FOOT}
            for leg in file.controller.legs.values()
        ]
        self._targets = self._targets_of_joints()
        self._actuators = {
            joint: self._named(lambda joint=joint: actuator_of(self._mjcf, joint), "controller", "legs", leg)
            for leg, joints in zip(self._legs, self._joints, strict=True)
            for joint in joints.values()
        }
        self._check_motors()

    def model(self) -> type[BodyModel] | type[MjcfModel]:
        """The class."""
        digest = hashlib.sha256(self._content.encode()).hexdigest()
        base: Any = self._base
        members: dict[str, Any] = {
            "__doc__": f"The model of {self._path.name}.",
            "__module__": __name__,
            # classes of other files and contents have other names, since programs are stored by names
            "__qualname__": f"ModelOfFile_{digest[:16]}",
            "model_file": self._path,
            "name": identifier(self._path.stem),
            "source": self._file.source,
            "body_file": str(self._path.parent / self._file.body),
            "keyframe": self._file.keyframe,
            "data_digest": property(lambda model: base.data_digest.fget(model) + digest),
            **self._of_controller(),
            **self._of_trunk(),
        }
        return type(_class_name(self._path), (base,), members)

    # checks

    def _refused(self, text: str, *path: str | int) -> JobError:
        return self._document.located(JobError([Diagnostic(path, text)]))

    def _named(self, find: Callable[[], Any], *path: str) -> Any:
        try:
            return find()
        except ValueError as error:
            raise self._refused(f"is not accepted: {str(error).rstrip('.')}.", *path) from None

    def _check_legs(self) -> None:
        controller, legs = self._controller, self._legs
        if not legs:
            raise self._refused("is empty: write a leg, such as L: {foot: foot_l, hip: hip_l}.", "controller")
        if (controller.joints is None) == (controller.path is None):
            raise self._refused("needs either joints: or path:.", "controller")
        roles = ["hip", "knee"] if controller.joints is None else list(controller.joints)
        geoms = [self._mjcf.geom(i).name for i in range(self._mjcf.ngeom)]
        for leg, parts in controller.legs.items():
            at = ("controller", "legs", leg)
            if not leg.isidentifier():
                raise self._refused("must be a name of letters, digits and underscores.", *at)
            if _FOOT not in parts:
                raise self._refused("has no foot: write foot: GEOM, the geom that touches the ground.", *at)
            if parts[_FOOT] not in geoms:
                near = suggestion(parts[_FOOT], geoms)
                raise self._refused(f"is {parts[_FOOT]}, which is no geom of the MJCF{near}", *at, _FOOT)
            for role in parts:
                if role not in (_FOOT, *roles):
                    near = suggestion(role, roles)
                    raise self._refused(f"is no role of a joint that the controller has{near}", *at, role)
            if controller.path is not None and set(parts) != {_FOOT, "hip", "knee"}:
                raise self._refused("needs foot, hip and knee, from which path: moves the foot.", *at)
        if (unknown := unknown_legs(controller.oscillators, legs)) is not None:
            field, name = unknown
            near = suggestion(name, legs)
            raise self._refused(f"has {name}, which is no leg{near}", "controller", "oscillators", field)

    def _targets_of_joints(self) -> Targets:
        if self._controller.joints is not None:
            return JointPatterns(self._controller.joints, self._joints)
        assert self._controller.path is not None
        legs = [
            self._named(
                lambda joints=joints, foot=foot: two_link_leg(
                    self._mjcf, joints["hip"], joints["knee"], foot
                ),
                *("controller", "legs", leg),
            )
            for leg, joints, foot in zip(self._legs, self._joints, self._feet, strict=True)
        ]
        return FootPaths(self._controller.path, legs)

    def _check_motors(self) -> None:
        """Refuse motors without gains, and gains without motors."""
        motors = [joint for joint, k in self._actuators.items() if not _follows_targets(self._mjcf, k)]
        gains = (self._controller.kp, self._controller.kd)
        if motors and None in gains:
            raise self._refused(
                f"needs kp: and kd:, the gains of joints with motors, such as {motors[0]}; or make it a "
                "<position> actuator in the MJCF.",
                "controller",
            )
        if not motors and gains != (None, None):
            raise self._refused(
                "has kp or kd, but all of its joints have <position> actuators, whose gains are parameters "
                "ACTUATOR_kp and ACTUATOR_kv.",
                "controller",
            )

    # the members of the class

    def _of_controller(self) -> dict[str, Any]:
        oscillators, legs = self._controller.oscillators, self._legs
        declared = {**oscillators.declarations(legs), **self._targets.declarations()}
        if self._controller.kp is not None and self._controller.kd is not None:
            declared["kp"] = declarations.parameter(
                "N m/rad", "position gain of motors", self._controller.kp, low=0.0
            )
            declared["kd"] = declarations.parameter(
                "N m s/rad", "velocity gain of motors", self._controller.kd, low=0.0
            )

        def rates(model: Any, params: Any, state: Any) -> dict[str, Any]:
            senses = LegSenses(lambda: self._loads(model, params, state), lambda: self._hips(model, state))
            return {**oscillators.rates(legs, params, state, senses), "clock": 1.0}

        def period(model: Any, params: Any) -> Float[Array, ""]:
            return oscillators.period(params)

        def force(model: Any, params: Any, state: Any) -> Float[Array, " legs"]:
            return self._loads(model, params, state)

        members: dict[str, Any] = {
            **declared,
            "clock": declarations.variable("s", "time since the section", observed=False, signal=False),
            "control": self._control,
            "rates": rates,
            "period": period,
            "force": declarations.signal("N", "force of the ground on foot", count=len(legs))(force),
        }
        if oscillators.resets:
            members |= self._of_landings()
        return members | self._of_feet()

    def _of_landings(self) -> dict[str, Any]:
        """The event of landing feet, which reset their oscillators."""
        located = self._base is BodyModel

        def landing(model: Any, params: Any, state: Any) -> Float[Array, " legs"]:
            if located:
                return jnp.stack([model.depth(params, state, foot) for foot in self._feet])
            return jnp.stack([jnp.where(model.touches(state, foot), 1.0, -1.0) for foot in self._feet])

        def landed(model: Any, params: Any, state: Any, i: int) -> Any:
            return self._controller.oscillators.landed(params, state, i)

        declared = declarations.event("foot {} lands", count=len(self._legs))(landing)
        declared.jump(landed)
        return {"landing": declared}

    def _of_feet(self) -> dict[str, Any]:
        """Footfalls of legs that have names of gaits; else the signals contact_1, ..."""

        def feet(model: Any, params: Any, state: Any) -> Any:
            return jnp.stack([model.touches(state, foot) for foot in self._feet])

        if sorted(self._legs) in [sorted(named) for named in LEGS.values()]:
            return {"feet": footfalls("clock", legs=self._legs)(feet)}

        def contact(model: Any, params: Any, state: Any) -> Any:
            return feet(model, params, state).astype(float)

        return {"contact": declarations.signal("1", "whether foot is down", count=len(self._legs))(contact)}

    def _of_trunk(self) -> dict[str, Any]:
        """The section, with the mean speed of each cycle; the trunk's height; and its fall."""
        trunk, oscillators = _Trunk(self._mjcf), self._controller.oscillators
        members: dict[str, Any] = {}

        def turn(model: Any, params: Any, state: Any) -> Float[Array, ""]:
            return oscillators.turned(state)

        def begin_cycle(model: Any, params: Any, state: Any) -> Any:
            changes: dict[str, Any] = {"clock": 0.0}
            if trunk.moves:
                q = model.positions(state)
                ahead = trunk.ahead(q, state.begin)
                changes |= {"begin": trunk.place(q)[:2], "speed": ahead / state.clock}
            return oscillators.wrapped(state).replace(**changes)

        section = declarations.event("the first leg ends its swing", section=True)(turn)
        section.jump(begin_cycle)
        members["turn"] = section
        if trunk.moves:
            members["begin"] = declarations.variable(
                "m", "place of the trunk at the section", count=2, observed=False, signal=False
            )
            members["speed"] = declarations.variable(
                "m/s", "mean speed of the last cycle", observed=True, scale=1.0
            )

        def height(model: Any, params: Any, state: Any) -> Float[Array, ""]:
            return trunk.place(model.positions(state))[2]

        members["height"] = declarations.observable("m", "height of the trunk", scale=0.1, signal=True)(
            height
        )
        if (lowest := self._file.fallen) is not None:
            members["failed"] = lambda model, params, state: height(model, params, state) < lowest
        return members

    def _loads(self, model: Any, params: Any, state: Any) -> Float[Array, " legs"]:
        return jnp.stack([model.load(params, state, foot) for foot in self._feet])

    def _hips(self, model: Any, state: Any) -> Float[Array, " legs"]:
        """The angles (n,) of the legs' first joints, rad, leg forward positive."""
        hips = [next(iter(joints.values())) for joints in self._joints]
        signs = [-float(np.sign(self._mjcf.joint(hip).axis[1])) or 1.0 for hip in hips]
        return jnp.stack([sign * model.position(state, hip) for sign, hip in zip(signs, hips, strict=True)])

    @property
    def _control(self) -> Callable[..., Float[Array, " nu"]]:
        """The function `control` of the model."""
        m = self._mjcf
        resting = m.key_ctrl[0] if m.nkey and not self._file.keyframe else np.zeros(m.nu)
        if self._file.keyframe:
            resting = m.key(self._file.keyframe).ctrl

        def control(model: Any, params: Any, state: Any) -> Float[Array, " nu"]:
            place, lift = self._controller.oscillators.pattern(params, state)
            controls: list[Any] = [float(number) for number in resting]
            for joint, target in self._targets.of_joints(model, params, place, lift).items():
                k = self._actuators[joint]
                if _follows_targets(m, k):
                    controls[k] = target
                    continue
                error = target - model.position(state, joint)
                force = params.kp * error - params.kd * model.rate(state, joint)
                controls[k] = force / (float(m.actuator_gear[k, 0]) * float(m.actuator_gainprm[k, 0]))
            return jnp.stack([jnp.asarray(value, float) for value in controls])

        return control


# what a class of a model needs to be one; the MJCF is compiled by such a class before its controller is known
_UNCONTROLLED: Mapping[str, Any] = {
    "control": lambda model, params, state: jnp.zeros(0),
    "period": lambda model, params: jnp.ones(()),
}


def _follows_targets(m: Any, k: int) -> bool:
    """Whether an actuator is a position servo, whose control is a target."""
    return bool(m.actuator_biasprm[k, 1])


def _class_name(path: Path) -> str:
    words = re.findall(r"[A-Za-z0-9]+", path.stem)
    return identifier("".join(word[:1].upper() + word[1:] for word in words)) or "Walker"


class _Trunk:
    """Place and heading of the first body, by its free joint or its slides.

    Args:
        m: the compiled MJCF.
    """

    def __init__(self, m: Any) -> None:
        import mujoco

        joints = [j for j in range(m.njnt) if m.jnt_bodyid[j] == 1]
        self._is_free = bool(joints) and m.jnt_type[joints[0]] == mujoco.mjtJoint.mjJNT_FREE
        self._at = np.array(m.body_pos[1])
        # hinges turn the slides after them
        slides: list[int] = []
        for j in joints:
            if m.jnt_type[j] != mujoco.mjtJoint.mjJNT_SLIDE:
                break
            slides.append(j)
        self._slides = [(int(m.jnt_qposadr[j]), np.array(m.jnt_axis[j])) for j in slides]

    @property
    def moves(self) -> bool:
        """Whether it moves along the ground."""
        return self._is_free or any(abs(axis[:2]).max() > 1e-9 for _, axis in self._slides)

    def place(self, q: Float[Array, " nq"]) -> Float[Array, " 3"]:
        """Its place (3,), m."""
        if self._is_free:
            return q[:3]
        return sum((q[at] * jnp.asarray(axis) for at, axis in self._slides), jnp.asarray(self._at))

    def ahead(self, q: Float[Array, " nq"], begin: Float[Array, " 2"]) -> Float[Array, ""]:
        """The way (m) along the ground from a place (2,), along its heading; along x without a free joint."""
        way = self.place(q)[:2] - begin
        if not self._is_free:
            return way[0]
        _, heading = tilt_and_heading(q[3:7])
        return (way @ heading)[0]
