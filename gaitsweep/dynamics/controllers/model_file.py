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

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PlainValidator, ValidationError

from gaitsweep.dynamics.body.body_model import BodyModel
from gaitsweep.dynamics.controllers.controlled_body import UNCONTROLLED, ControlledBody, Leg, model_class
from gaitsweep.dynamics.controllers.leg_targets import (
    FootPath,
    FootPaths,
    JointPatterns,
    Targets,
    Waveform,
    actuator_of,
    two_link_leg,
)
from gaitsweep.dynamics.controllers.oscillators import HIP, OSCILLATORS, Oscillators
from gaitsweep.dynamics.gaits_by_footfalls import SHORTEST_CONTACT
from gaitsweep.dynamics.mjcf import Stamps, compiled_mjcf, is_position_servo, keyframe_number, stamps_of_mjcf
from gaitsweep.dynamics.mjx.mjcf_model import MjcfModel
from gaitsweep.errors import JobError
from gaitsweep.near_miss import suggestion
from gaitsweep.schema.diagnostics import Diagnostic, wrong_kind
from gaitsweep.schema.numbers import NotNegative, Real, Text, Word, checked, read_real
from gaitsweep.schema.strict_model import OneOf, SchemaSection, StrictModel, from_pydantic
from gaitsweep.schema.yaml_document import Document, read_document

_FOOT = "foot"  # the entry of a leg that names its foot; the others are roles of joints
_KNEE = "knee"
_ROLES_OF_A_PATH = (HIP, _KNEE)
ContactShare = Annotated[float, PlainValidator(checked(read_real, low=0.0, high=0.5))]


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
    dynamics: Annotated[Literal["located", "stepped"], Word()] = Field(
        default="located",
        description="located: contacts as events, in the kernels (BodyModel); stepped: MuJoCo's steps and "
        "contacts (MjcfModel)",
    )
    keyframe: str = Field(default="", description="keyframe of the start; by default the first one")
    start: Literal["keyframe", "standing"] = Field(
        default="keyframe",
        description="keyframe: rows begin there; standing: they begin at rest on the ground near it, under "
        "constant targets",
    )
    controller: Controller = Field(description="the controller")
    fallen: Real | None = Field(
        default=None, description="height of the trunk below which it has fallen, m; left out: it never falls"
    )
    shortest_contact: ContactShare | None = Field(
        default=None,
        description="share of the model's period for which a foot stays down, or up, to have landed, or "
        f"lifted, 0 to 0.5; {SHORTEST_CONTACT} if left out",
    )
    source: str = Field(default="", description="paper of the model")


_SECTIONS: dict[str, SchemaSection] = {
    "": SchemaSection("a model file", ModelFile),
    "controller": SchemaSection("controller", Controller),
    "joints": SchemaSection("a joint", Waveform),
    "path": SchemaSection("path", FootPath),
    **{
        kind: SchemaSection(f"oscillators ({kind})", part, "oscillators")
        for kind, part in OSCILLATORS.items()
    },
}


@dataclasses.dataclass(frozen=True)
class _Source:
    """A model file as it was read; equal to another of the same path, content and files of the MJCF.

    `content` is the document as text, `stamps` are those of the MJCF and of the files that it refers to.
    """

    path: Path
    content: str
    stamps: Stamps
    document: Document = dataclasses.field(compare=False)


def model_of_file(path: Path) -> type[BodyModel] | type[MjcfModel]:
    """The class of the model that a model file describes, made once for each content of its files.

    Args:
        path: the model file, whose folder its MJCF is named from.

    Raises:
        JobError: the file or its MJCF cannot be read, or it names what its MJCF does not have; with the line.
    """
    path = path.resolve()
    document = read_document(path, noun="a model file", fields=("body", "controller"))
    content = json.dumps(document.data, default=str)  # legs and joints count in their order
    stamps = stamps_of_mjcf(path.parent / str(document.data.get("body")))
    return _class_of(_Source(path, content, stamps, document))


@functools.lru_cache(maxsize=64)
def _class_of(source: _Source) -> type[BodyModel] | type[MjcfModel]:
    """The class of a model file's model; raises JobError with the line of a wrong field."""
    file = _validated(source.document)
    base = BodyModel if file.dynamics == "located" else MjcfModel
    body_file = str(source.path.parent / file.body)
    # a class without legs, by which the MJCF is compiled as the model compiles it
    uncontrolled: Any = type("OfFile", (base,), {"body_file": body_file, **UNCONTROLLED})
    with _errors_at(source.document, "body"):
        m = compiled_mjcf(uncontrolled)
        if base is BodyModel:
            _ = uncontrolled().body  # refuses what a located body lacks; the model finds it in memory
    body = _controlled_body(source.document, file, m)
    digest = hashlib.sha256(source.content.encode()).hexdigest()
    return model_class(source.path, base, body_file, body, digest)


def _validated(document: Document) -> ModelFile:
    """The content of a model file.

    Raises:
        JobError: a field is wrong; with its line.
    """
    controller = document.data.get("controller")
    if isinstance(controller, Mapping) and "oscillators" in controller:
        place = ("controller", "oscillators")
        wrong = wrong_kind(place, controller["oscillators"], OSCILLATORS, noun="a kind of oscillators")
        if wrong is not None:
            raise document.located(JobError([wrong]))
    try:
        return ModelFile.model_validate(document.data)
    except ValidationError as error:
        raise document.located(JobError(from_pydantic(error, _SECTIONS, ""))) from None


def _controlled_body(document: Document, file: ModelFile, m: Any) -> ControlledBody:
    """The body of a model file and its controller.

    Args:
        document: the file, with the lines of fields.
        file: its content.
        m: the compiled MJCF.

    Raises:
        JobError: the file names what the MJCF does not have, or contradicts it or itself; with the line.
    """
    controller = file.controller
    if file.start == "standing" and file.dynamics != "located":
        raise _error(document, "is standing, which needs dynamics: located.", "start")
    with _errors_at(document, "keyframe"):
        keyframe_number(m, file.keyframe)
    legs = _legs(document, controller, m)
    actuators = _actuators(document, legs, m)
    _refuse_gains(document, controller, actuators, m)
    targets = _targets(document, file, legs, m)
    controlled = ControlledBody(m, file.dynamics == "located", file, legs, targets, actuators)
    for leg in legs if HIP in controller.oscillators.roles_of_feedback else ():
        with _errors_at(document, "controller", "legs", leg.name, HIP):
            controlled.trunk.turns_backwards(leg.joints[HIP])
    if file.shortest_contact is not None and (remark := controlled.remark_on_names):
        raise _error(document, f"has no effect: {remark}.", "shortest_contact")
    return controlled


def _legs(document: Document, controller: Controller, m: Any) -> list[Leg]:
    """The legs of a controller, each with its foot and joints.

    Raises:
        JobError: a leg lacks a name, a foot or a joint that the controller needs, or two legs have the same;
            with the field, what it has, and the near miss.
    """
    if not controller.legs:
        text = "is empty: write a leg, such as L: {foot: foot_l, hip: hip_l}."
        raise _error(document, text, "controller")
    if (controller.joints is None) == (controller.path is None):
        raise _error(document, "needs either joints: or path:.", "controller")
    if _FOOT in (controller.joints or ()):
        text = "is the entry of a leg that names the geom of its foot: give the joint a role such as ankle."
        raise _error(document, text, "controller", "joints", _FOOT)
    legs = [_leg(document, controller, m, name) for name in controller.legs]
    for role in controller.joints or ():
        if not any(role in leg.joints for leg in legs):
            text = f"moves nothing, since no leg has it: write {role}: JOINT in a leg, or leave it out."
            raise _error(document, text, "controller", "joints", role)
    _refuse_shared(document, controller)
    for field, groups in controller.oscillators.named_legs.items():
        place = ("controller", "oscillators", field)
        for names in groups:
            for name in names:
                if name not in controller.legs:
                    text = f"has {name}, which is not a leg{suggestion(name, controller.legs)}"
                    raise _error(document, text, *place)
            if len(set(names)) < len(names):
                text = f"has {' and '.join(names)} as a pair: give two different legs."
                raise _error(document, text, *place)
    phases = [name for (name,) in controller.oscillators.named_legs.get("phases", [])]
    if phases and (missing := [name for name in controller.legs if name not in phases]):
        text = (
            f"has no phase of {' and '.join(missing)}: give each leg one, such as {missing[0]}: pi, or leave "
            "phases out for legs that are evenly spread over a turn."
        )
        raise _error(document, text, "controller", "oscillators", "phases")
    return legs


def _leg(document: Document, controller: Controller, m: Any, name: str) -> Leg:
    """The leg of this name; raises JobError where its foot or a role of a joint is wrong."""
    parts = controller.legs[name]
    place = ("controller", "legs", name)
    if not name.isidentifier():
        raise _error(document, "must be a name of letters, digits and underscores.", *place)
    if _FOOT not in parts:
        raise _error(document, "has no foot: write foot: GEOM, the geom that touches the ground.", *place)
    geoms = [m.geom(i).name for i in range(m.ngeom) if m.geom(i).name]
    if parts[_FOOT] not in geoms:
        text = f"is {parts[_FOOT]}, which is not a geom of the MJCF{suggestion(parts[_FOOT], geoms)}"
        raise _error(document, text, *place, _FOOT)
    roles = list(_ROLES_OF_A_PATH if controller.joints is None else controller.joints)
    for role in parts:
        if role not in (_FOOT, *roles):
            text = f"is not a role of a joint that the controller has{suggestion(role, roles)}"
            raise _error(document, text, *place, role)
    if controller.path is not None and set(parts) != {_FOOT, *_ROLES_OF_A_PATH}:
        raise _error(document, "needs foot, hip and knee, from which path: moves the foot.", *place)
    joints = {role: joint for role, joint in parts.items() if role != _FOOT}
    if not joints:
        text = f"has no joint, so that nothing moves it: write one of {', '.join(roles)}: JOINT."
        raise _error(document, text, *place)
    for role in controller.oscillators.roles_of_feedback:
        if role not in joints:
            raise _error(
                document, f"has no {role}, whose angle the oscillators feel: write {role}: JOINT.", *place
            )
    return Leg(name, parts[_FOOT], joints)


def _refuse_shared(document: Document, controller: Controller) -> None:
    """Refuse a joint or a foot that the legs name twice, since one of them would not be driven."""
    owners: dict[tuple[bool, str], str] = {}  # by whether it is a foot, and the element's name
    for leg, parts in controller.legs.items():
        for role, element in parts.items():
            key = (role == _FOOT, element)
            if key in owners:
                what = "foot" if role == _FOOT else "joint"
                text = f"is {element}, which is already the {owners[key]}: each {what} belongs to one leg."
                raise _error(document, text, "controller", "legs", leg, role)
            owners[key] = f"{role} of leg {leg}"


def _actuators(document: Document, legs: list[Leg], m: Any) -> dict[str, int]:
    """The number of the actuator of each joint of legs.

    Raises:
        JobError: a joint is not one of the MJCF, or has not one actuator.
    """
    numbers: dict[str, int] = {}
    for leg in legs:
        with _errors_at(document, "controller", "legs", leg.name):
            numbers |= {joint: actuator_of(m, joint) for joint in leg.joints.values()}
    return numbers


def _refuse_gains(document: Document, controller: Controller, actuators: Mapping[str, int], m: Any) -> None:
    """Refuse motors without gains, and gains without motors; raises JobError with what to write."""
    motors = [joint for joint, k in actuators.items() if not is_position_servo(m, k)]
    gains = (controller.kp, controller.kd)
    if motors and None in gains:
        text = f"needs kp: and kd:, the gains of joints with motors, such as {motors[0]}; or make it a "
        raise _error(document, f"{text}<position> actuator in the MJCF.", "controller")
    if not motors and gains != (None, None):
        text = "has kp or kd, but all of its joints have <position> actuators, whose gains are parameters "
        raise _error(document, f"{text}ACTUATOR_kp and ACTUATOR_kv.", "controller")


def _targets(document: Document, file: ModelFile, legs: list[Leg], m: Any) -> Targets:
    """The targets of the joints of legs; raises JobError where a leg cannot follow a path."""
    controller = file.controller
    if controller.joints is not None:
        return JointPatterns(m, controller.joints, [leg.joints for leg in legs])
    assert controller.path is not None
    two_link_legs = []
    for leg in legs:
        with _errors_at(document, "controller", "legs", leg.name):
            hip, knee = leg.joints[HIP], leg.joints[_KNEE]
            two_link_legs.append(two_link_leg(m, hip, knee, leg.foot, file.keyframe))
    return FootPaths(controller.path, two_link_legs)


@contextlib.contextmanager
def _errors_at(document: Document, *path: str | int) -> Iterator[None]:
    """Raise errors about an MJCF as those of the field at a path, with its line."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise _error(document, f"is not accepted: {str(error).rstrip('.')}.", *path) from None


def _error(document: Document, text: str, *path: str | int) -> JobError:
    """The error at a field, with its line."""
    return document.located(JobError([Diagnostic(path, text)]))
