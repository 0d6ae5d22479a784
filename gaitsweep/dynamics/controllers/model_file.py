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

import dataclasses
import functools
import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, ValidationError

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
from gaitsweep.dynamics.controllers.model_class import (
    UNCONTROLLED,
    ControlledBody,
    Leg,
    follows_targets,
    model_class,
)
from gaitsweep.dynamics.controllers.oscillators import OSCILLATORS, Oscillators
from gaitsweep.dynamics.mjcf.source import Stamps, compiled_mjcf, stamps_of_mjcf
from gaitsweep.dynamics.mjx.mjcf_model import MjcfModel
from gaitsweep.near_miss import suggestion
from gaitsweep.schema.diagnostics import Diagnostic, JobError, SchemaSection, from_pydantic, wrong_kind
from gaitsweep.schema.numbers import NotNegative, Real, Text, word
from gaitsweep.schema.strict_model import OneOf, StrictModel
from gaitsweep.schema.yaml_document import Document, read_document

T = TypeVar("T")

_FOOT = "foot"  # the entry of a leg that names its foot; the others are roles of joints
_ROLES_OF_A_PATH = ("hip", "knee")


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
        JobError: the file is not read, or names what its MJCF does not have; with its line.
        FileNotFoundError: there is no such MJCF.
        ValueError: MuJoCo refuses the MJCF.
    """
    path = path.resolve()
    document = read_document(path)
    content = json.dumps(document.data, sort_keys=True, default=str)
    stamps = stamps_of_mjcf(path.parent / str(document.data.get("body")))
    return _class_of(_Source(path, content, stamps, document))


@functools.lru_cache(maxsize=64)
def _class_of(source: _Source) -> type[BodyModel] | type[MjcfModel]:
    """The class of a model file's model."""
    file = _validated(source.document)
    base = BodyModel if file.dynamics == "located" else MjcfModel
    body_file = str(source.path.parent / file.body)
    # a class without legs, by which the MJCF is compiled as the model compiles it
    uncontrolled: Any = type("OfFile", (base,), {"body_file": body_file, **UNCONTROLLED})
    m = compiled_mjcf(uncontrolled)
    checks = _Checks(source.document, file.controller, m)
    checks.check_legs()
    legs = checks.legs()
    actuators = checks.actuators(legs)
    checks.check_gains(actuators)
    body = ControlledBody(m, base is BodyModel, file, legs, checks.targets(legs), actuators)
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


class _Checks:
    """Checks of a controller against its MJCF, whose errors have the line of the field.

    Args:
        document: the file, with the lines of fields.
        controller: its controller.
        m: the compiled MJCF.
    """

    def __init__(self, document: Document, controller: Controller, m: Any) -> None:
        self._document = document
        self._controller = controller
        self._m = m

    def check_legs(self) -> None:
        """Refuse legs without a name, a foot or a joint of the MJCF that the controller needs.

        Raises:
            JobError: with the field, what it has, and the near miss.
        """
        controller = self._controller
        if not controller.legs:
            raise self._error("is empty: write a leg, such as L: {foot: foot_l, hip: hip_l}.", "controller")
        if (controller.joints is None) == (controller.path is None):
            raise self._error("needs either joints: or path:.", "controller")
        for leg, parts in controller.legs.items():
            self._check_leg(leg, parts)
        for field, names in controller.oscillators.named_legs.items():
            for name in names:
                if name not in controller.legs:
                    text = f"has {name}, which is no leg{suggestion(name, controller.legs)}"
                    raise self._error(text, "controller", "oscillators", field)

    def _check_leg(self, leg: str, parts: Mapping[str, str]) -> None:
        """Refuse the foot and the joints of one leg."""
        controller = self._controller
        place = ("controller", "legs", leg)
        if not leg.isidentifier():
            raise self._error("must be a name of letters, digits and underscores.", *place)
        if _FOOT not in parts:
            raise self._error("has no foot: write foot: GEOM, the geom that touches the ground.", *place)
        geoms = [self._m.geom(i).name for i in range(self._m.ngeom)]
        if parts[_FOOT] not in geoms:
            near = suggestion(parts[_FOOT], geoms)
            raise self._error(f"is {parts[_FOOT]}, which is no geom of the MJCF{near}", *place, _FOOT)
        roles = list(_ROLES_OF_A_PATH if controller.joints is None else controller.joints)
        for role in parts:
            if role not in (_FOOT, *roles):
                near = suggestion(role, roles)
                raise self._error(f"is no role of a joint that the controller has{near}", *place, role)
        if controller.path is not None and set(parts) != {_FOOT, *_ROLES_OF_A_PATH}:
            raise self._error("needs foot, hip and knee, from which path: moves the foot.", *place)

    def legs(self) -> list[Leg]:
        """The legs of the controller, which `check_legs` has accepted."""
        legs = []
        for name, parts in self._controller.legs.items():
            joints = {role: joint for role, joint in parts.items() if role != _FOOT}
            legs.append(Leg(name, parts[_FOOT], joints))
        return legs

    def targets(self, legs: list[Leg]) -> Targets:
        """The targets of the joints of legs.

        Raises:
            JobError: a leg cannot follow a path.
        """
        if self._controller.joints is not None:
            return JointPatterns(self._controller.joints, [leg.joints for leg in legs])
        assert self._controller.path is not None
        two_link_legs = []
        for leg in legs:
            parts = (leg.joints["hip"], leg.joints["knee"], leg.foot)
            two_link_legs.append(self._of_leg(leg, functools.partial(two_link_leg, self._m, *parts)))
        return FootPaths(self._controller.path, two_link_legs)

    def actuators(self, legs: list[Leg]) -> dict[str, int]:
        """The number of the actuator of each joint of legs.

        Raises:
            JobError: a joint is not one of the MJCF, or has not one actuator.
        """
        numbers: dict[str, int] = {}
        for leg in legs:
            for joint in leg.joints.values():
                numbers[joint] = self._of_leg(leg, functools.partial(actuator_of, self._m, joint))
        return numbers

    def check_gains(self, actuators: Mapping[str, int]) -> None:
        """Refuse motors without gains, and gains without motors.

        Raises:
            JobError: with what to write.
        """
        motors = [joint for joint, k in actuators.items() if not follows_targets(self._m, k)]
        gains = (self._controller.kp, self._controller.kd)
        if motors and None in gains:
            raise self._error(
                f"needs kp: and kd:, the gains of joints with motors, such as {motors[0]}; or make it a "
                "<position> actuator in the MJCF.",
                "controller",
            )
        if not motors and gains != (None, None):
            raise self._error(
                "has kp or kd, but all of its joints have <position> actuators, whose gains are parameters "
                "ACTUATOR_kp and ACTUATOR_kv.",
                "controller",
            )

    def _of_leg(self, leg: Leg, find: Callable[[], T]) -> T:
        """The result of `find`, whose ValueError is located at a leg."""
        try:
            return find()
        except ValueError as error:
            text = f"is not accepted: {str(error).rstrip('.')}."
            raise self._error(text, "controller", "legs", leg.name) from None

    def _error(self, text: str, *path: str | int) -> JobError:
        """The error at a field, with its line."""
        return self._document.located(JobError([Diagnostic(path, text)]))
