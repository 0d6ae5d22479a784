"""Joint torques of a controller: a motor follows its joint's target by position and velocity gains."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaitsweep.dynamics.controllers.leg_targets import Targets
from gaitsweep.dynamics.mjcf.source import keyframe_number

if TYPE_CHECKING:
    from gaitsweep.dynamics.controllers.model_file import ModelFile


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
    resting = np.zeros(m.nu) if keyframe is None else np.array(m.key_ctrl[keyframe])

    def control(model: Any, params: Any, state: Any) -> Float[Array, " nu"]:
        place, lift = file.controller.oscillators.pattern(params, state)
        controls: list[Any] = [float(number) for number in resting]
        for joint, target in targets.of_joints(model, params, place, lift).items():
            k = actuators[joint]
            if follows_targets(m, k):
                controls[k] = target
                continue
            error = target - model.position(state, joint)
            torque = params.kp * error - params.kd * model.rate(state, joint)
            controls[k] = torque / (float(m.actuator_gear[k, 0]) * float(m.actuator_gainprm[k, 0]))
        return jnp.stack([jnp.asarray(value, float) for value in controls])

    return control


def follows_targets(m: Any, k: int) -> bool:
    """Whether actuator `k` of a compiled MJCF is a position servo, whose control is a target."""
    return bool(m.actuator_biasprm[k, 1])
