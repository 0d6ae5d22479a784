"""Targets of joints of legs from the pattern of oscillators, and the actuators that follow them.

Targets are waveforms of joints, or follow from a path of the foot. A position servo takes its joint's target,
a motor the torque of position and velocity gains.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field

from gaitsweep.dynamics.declarations import TWO_PI, parameter
from gaitsweep.dynamics.mjcf import hinges_and_slides, is_position_servo, keyframe_number
from gaitsweep.near_miss import suggestion
from gaitsweep.schema.numbers import NotNegative, Positive, Real
from gaitsweep.schema.strict_model import StrictModel

if TYPE_CHECKING:
    from gaitsweep.dynamics.controllers.model_file import ModelFile

_BENT = 0.8  # share of a leg's length at which its two bends are compared
_STRAIGHT = 1.0 - 1e-9  # cosine of a knee's angle beyond which a leg counts as straight, for finite slopes


class Waveform(StrictModel):
    """A joint's target: offset + swing times the leg's place (-1 to 1) + lift times its lift (0 to 1)."""

    offset: Real = Field(default=0.0, description="target without a pattern, rad or m")
    swing: Real = Field(default=0.0, description="amplitude with the leg's place, rad or m")
    lift: Real = Field(default=0.0, description="amplitude with the leg's lift in swing, rad or m")


class FootPath(StrictModel):
    """A path of the foot from the hip, in the trunk's frame; hip and knee follow by inverse kinematics."""

    stride: NotNegative = Field(description="length of the path, m")
    lift: NotNegative = Field(description="height of the foot's lift in swing, m")
    height: Positive = Field(description="height of the hip above the foot in stance, m")
    ahead: Real = Field(default=0.0, description="place of the path's middle ahead of the hip, m")


class Targets(abc.ABC):
    """Targets of joints: their parameters, and their values from the pattern."""

    @abc.abstractmethod
    def declarations(self) -> dict[str, Any]:
        """The parameters, by name."""

    @abc.abstractmethod
    def of_joints(
        self, model: Any, params: Any, place: Float[Array, " legs"], lift: Float[Array, " legs"]
    ) -> dict[str, Float[Array, ""]]:
        """The target (rad, m) of each joint, by its name.

        Args:
            model, params: the model of a body and its parameters.
            place: the place of each leg, from -1 (back) to 1 (ahead).
            lift: the lift of each leg, from 0 to 1.
        """


class JointPatterns(Targets):
    """Waveforms of joints.

    Args:
        m: the compiled MJCF.
        waveforms: by role, such as hip and knee.
        joints: the joint of each role, for each leg.
    """

    def __init__(
        self, m: Any, waveforms: Mapping[str, Waveform], joints: Sequence[Mapping[str, str]]
    ) -> None:
        self._m = m
        self._waveforms = waveforms
        self._joints = joints

    def declarations(self) -> dict[str, Any]:
        words = {"offset": "target without a pattern", "swing": "amplitude of the swing", "lift": "lift"}
        declared = {}
        for role, waveform in self._waveforms.items():
            unit = unit_of_joints(self._m, [joints[role] for joints in self._joints if role in joints])
            for part, default in dict(waveform).items():
                meaning = f"{words[part]} of the joints {role}"
                declared[f"{role}_{part}"] = parameter(unit, meaning, default)
        return declared

    def of_joints(
        self, model: Any, params: Any, place: Float[Array, " legs"], lift: Float[Array, " legs"]
    ) -> dict[str, Float[Array, ""]]:
        targets = {}
        for i, joints in enumerate(self._joints):
            for role, joint in joints.items():
                offset, swing, rise = (getattr(params, f"{role}_{part}") for part in Waveform.model_fields)
                targets[joint] = offset + swing * place[i] + rise * lift[i]
        return targets


@dataclasses.dataclass(frozen=True)
class TwoLinkLeg:
    """A leg of two hinges about y; vectors (2,) m are forward and up, at zero angles.

    `thigh` and `shin` are the vectors from hip to knee and from knee to foot, `hip_at` and `knee_at` the
    places of the joints in their bodies; `turns` (2,) are 1 or -1, the signs of the axes of hip and knee;
    `middles` (2,) rad are the angles from which those of hip and knee differ by half a turn at most; `bend`
    is 1 or -1, the sign of the knee's bend that inverse kinematics chooses.
    """

    hip: str
    knee: str
    thigh: Float[np.ndarray, " 2"]
    shin: Float[np.ndarray, " 2"]
    hip_at: Float[np.ndarray, " 2"]
    knee_at: Float[np.ndarray, " 2"]
    turns: Float[np.ndarray, " 2"]
    middles: Float[np.ndarray, " 2"]
    bend: float

    def of_params(self, model: Any, params: Any) -> tuple[Any, Any]:
        """The vector `thigh` and the factor of the lengths of `shin` at the parameters of a model."""
        shin_size = model.length_factor(params, self.knee)
        place = model.place_of_body(params, self.knee)[jnp.array([0, 2])]
        thigh = model.length_factor(params, self.hip) * (place - self.hip_at) + shin_size * self.knee_at
        return thigh, shin_size

    def angles(
        self, x: Float[Array, ""], z: Float[Array, ""], thigh: Any = None, shin_size: Any = 1.0
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """The angles (rad) of hip and knee with the foot at x, z (m) from the hip; straight if out of reach.

        A turn by q about y takes a vector w = x + i z to w exp(-i q), so that the foot is at
        exp(-i hip) (thigh + exp(-i knee) shin).
        """
        a, b = self.thigh if thigh is None else thigh, self.shin
        long_a, long_b = jnp.sqrt(a[0] ** 2 + a[1] ** 2), shin_size * math.hypot(*b)
        between = jnp.arctan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1])
        cosine = (x * x + z * z - long_a**2 - long_b**2) / (2.0 * long_a * long_b)
        turn = self.bend * jnp.arccos(jnp.clip(cosine, -_STRAIGHT, _STRAIGHT))  # from thigh to shin
        angle_a = jnp.arctan2(a[1], a[0])
        reach = jnp.arctan2(long_b * jnp.sin(turn), long_a + long_b * jnp.cos(turn))
        hip = angle_a + reach - jnp.arctan2(z, x)
        knee = between - turn
        return self._near_middle(0, self.turns[0] * hip), self._near_middle(1, self.turns[1] * knee)

    def _near_middle(self, joint: int, angle: Float[Array, ""]) -> Float[Array, ""]:
        """The angle of hip (0) or knee (1) less whole turns, next to the middle of the joint's range."""
        return angle - TWO_PI * jnp.round((angle - self.middles[joint]) / TWO_PI)


class FootPaths(Targets):
    """A path of each foot.

    Args:
        path: the path as in the file.
        legs: the legs.
    """

    def __init__(self, path: FootPath, legs: list[TwoLinkLeg]) -> None:
        self._path = path
        self._legs = legs

    def declarations(self) -> dict[str, Any]:
        path = self._path
        return {
            "stride": parameter("m", "length of the feet's path", path.stride),
            "foot_lift": parameter("m", "lift of the feet in swing", path.lift),
            "hip_height": parameter("m", "height of the hips above the feet", path.height, low=0.0),
            "foot_ahead": parameter("m", "place of the feet ahead of the hips", path.ahead),
        }

    def of_joints(
        self, model: Any, params: Any, place: Float[Array, " legs"], lift: Float[Array, " legs"]
    ) -> dict[str, Float[Array, ""]]:
        targets = {}
        for i, leg in enumerate(self._legs):
            x = params.foot_ahead + 0.5 * params.stride * place[i]
            z = params.foot_lift * lift[i] - params.hip_height
            targets[leg.hip], targets[leg.knee] = leg.angles(x, z, *leg.of_params(model, params))
        return targets


def two_link_leg(m: Any, hip: str, knee: str, foot: str, keyframe: str = "") -> TwoLinkLeg:
    """The leg of these joints and of the geom `foot`, from the compiled MJCF; it starts at the `keyframe`.

    Raises:
        ValueError: a joint is no hinge about y, the knee's body is not carried by the hip's, or the foot not
            by the knee's; the message names it.
    """
    import mujoco

    turns = []
    for joint in (hip, knee):
        axis = m.joint(joint).axis
        if m.joint(joint).type[0] != mujoco.mjtJoint.mjJNT_HINGE or abs(abs(axis[1]) - 1.0) > 1e-9:
            raise ValueError(f"Joint '{joint}' is no hinge about y, which a foot path needs: use joints:.")
        turns.append(float(np.sign(axis[1])))
    thigh_body, shin_body = (int(m.joint(joint).bodyid[0]) for joint in (hip, knee))
    if m.body_parentid[shin_body] != thigh_body or m.geom(foot).bodyid[0] != shin_body:
        raise ValueError(
            f"Foot '{foot}' is not on the body of '{knee}', or that is not carried by the body of '{hip}': a "
            "foot path needs a hip, a knee and a foot in a row."
        )
    if not np.array_equal(m.body_quat[[thigh_body, shin_body]], [[1.0, 0.0, 0.0, 0.0]] * 2):
        raise ValueError(
            f"The bodies of '{hip}' and '{knee}' are turned, which a foot path does not support."
        )
    places = m.joint(hip).pos, m.joint(knee).pos, m.body_pos[shin_body], m.geom(foot).pos
    hip_at, knee_at, shin_at, foot_at = (place[[0, 2]] for place in places)
    thigh = shin_at + knee_at - hip_at
    middles = np.array([_middle(m, joint, keyframe) for joint in (hip, knee)])
    leg = TwoLinkLeg(hip, knee, thigh, foot_at - knee_at, hip_at, knee_at, np.array(turns), middles, 1.0)
    return dataclasses.replace(leg, bend=_bend(leg))


def _middle(m: Any, name: str, keyframe: str) -> float:
    """The middle (rad) of a hinge's range; without limits its place in the keyframe, or 0."""
    joint = m.joint(name)
    if m.jnt_limited[joint.id]:
        return 0.5 * float(sum(joint.range))
    number = keyframe_number(m, keyframe)
    return 0.0 if number is None else float(m.key_qpos[number][int(joint.qposadr[0])])


def _bend(leg: TwoLinkLeg) -> float:
    """The bend whose knee is nearer to its middle."""
    length = _BENT * (math.hypot(*leg.thigh) + math.hypot(*leg.shin))
    knees = {
        bend: float(dataclasses.replace(leg, bend=bend).angles(jnp.zeros(()), jnp.asarray(-length))[1])
        for bend in (1.0, -1.0)
    }
    return min(knees, key=lambda bend: abs(knees[bend] - leg.middles[1]))


def actuator_of(m: Any, joint: str) -> int:
    """The number of the actuator that acts on a joint.

    Raises:
        ValueError: there is no such hinge or slide, or not one position servo or motor of it; the message
            names the near miss.
    """
    import mujoco

    names = [m.jnt(j).name for j in hinges_and_slides(m)]
    if joint not in names:
        raise ValueError(f"The MJCF has no hinge or slide '{joint}'{suggestion(joint, names)}")
    # the numbers of tendons and sites are of their own
    of_joint = np.isin(m.actuator_trntype, (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    numbers = np.flatnonzero(of_joint & (m.actuator_trnid[:, 0] == m.joint(joint).id)).tolist()
    if len(numbers) != 1:
        raise ValueError(
            f"Joint '{joint}' has {len(numbers)} actuators, but a leg's joint needs one: <position> follows "
            "the target, a <motor> needs kp and kd in the model file."
        )
    (k,) = numbers
    dynamics = (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)
    is_motor = m.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_NONE
    has_fixed_gain = m.actuator_gaintype[k] == mujoco.mjtGain.mjGAIN_FIXED
    has_fixed_gain &= np.isin(m.actuator_dyntype[k], dynamics)
    if not (has_fixed_gain and (is_motor or is_position_servo(m, k))):
        raise ValueError(
            f"The actuator of joint '{joint}' is neither a <position> actuator, which follows the target, "
            "nor a <motor>, which needs kp and kd in the model file."
        )
    return k


def unit_of_joints(m: Any, joints: Sequence[str], hinge: str = "rad", slide: str = "m") -> str:
    """The unit of a quantity of joints, from those that it has for hinges and for slides.

    Args:
        m: the compiled MJCF.
        joints: the names of the joints, hinges and slides.
        hinge, slide: the unit for either; by default that of a position.
    """
    import mujoco

    slides = [m.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE for joint in joints]
    if all(slides) and slides:
        return slide
    return f"{hinge} or {slide}" if any(slides) else hinge


def control_of_legs(
    m: Any, file: ModelFile, targets: Targets, actuators: Mapping[str, int]
) -> Callable[[Any, Any, Any], Float[Array, " nu"]]:
    """The function `control` of a model: targets of position servos, and torques of motors.

    Actuators that move no leg keep the controls of the keyframe.

    Args:
        m: the compiled MJCF.
        file: the content of the model file.
        targets: the targets of the legs' joints.
        actuators: the number of the actuator of each joint.
    """
    keyframe = keyframe_number(m, file.keyframe)
    at_keyframe = np.zeros(m.nu) if keyframe is None else np.array(m.key_ctrl[keyframe])

    def control(model: Any, params: Any, state: Any) -> Float[Array, " nu"]:
        place, lift = file.controller.oscillators.pattern(params, state)
        controls: list[Any] = at_keyframe.tolist()
        for joint, target in targets.of_joints(model, params, place, lift).items():
            k = actuators[joint]
            gear = model.actuator_gear(params, k)
            if is_position_servo(m, k):
                controls[k] = gear * target  # the servo's length is that of its joint times its gear
                continue
            error = target - model.position(state, joint)
            torque = params.kp * error - params.kd * model.rate(state, joint)
            controls[k] = torque / (gear * model.actuator_gain(params, k))
        return jnp.stack([jnp.asarray(value, float) for value in controls])

    return control
