"""What models of a body in an MJCF share: the file, its keyframe, starts by joint names, signals, drawing."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import abc
import dataclasses
import functools
import hashlib
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Real

from gaitsweep.contract import Model, Quantity, Rates
from gaitsweep.near_miss import suggestion
from gaitsweep.skeleton import Skeleton


@dataclasses.dataclass(frozen=True)
class OfMjcf(Model):
    """A model whose body is described by an MJCF, and whose actuators it controls.

    Starts are the positions and velocities of slides and hinges by the joints' names, `JOINT_0` and
    `JOINT_rate_0`; the place and velocity of a free joint, `JOINT_x_0` and `JOINT_x_rate_0`; and the
    orientation of a free or ball joint, `JOINT_roll_0`, `JOINT_pitch_0` and `JOINT_yaw_0`, with the angular
    velocity about the body's axes, `JOINT_w_x_0`, ... Their defaults are those of a keyframe, or of the
    joints where the MJCF has none. Signals are `q_0`, `q_1`, ..., MuJoCo's qpos, and those that are declared.
    """

    body_file: ClassVar[str]  # the MJCF: a path from the folder of the model's module, or the XML itself
    keyframe: ClassVar[str] = ""  # the name of the keyframe of a start; the first one by default

    @abc.abstractmethod
    def control(self, params: Any, state: Any, /) -> Float[Any, " nu"]:
        """The controls (nu,) of the MJCF's actuators, in their order."""

    @abc.abstractmethod
    def positions(self, state: Any) -> Float[Any, " nq"]:
        """MuJoCo's qpos (nq,) of a state."""

    @property
    def keyframe_ctrl(self) -> Float[Any, " nu"]:
        """The controls (nu,) of the keyframe of a start; zeros where the MJCF has none."""
        m = compiled_mjcf(type(self))
        number = keyframe_number(m, self.keyframe)
        return jnp.zeros(m.nu) if number is None else jnp.asarray(m.key_ctrl[number])

    def rates(self, params: Any, state: Any, /) -> Rates:
        """Time derivatives of the declared variables, by name."""
        return {}

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        joints = tuple(quantity for _, _, quantity in _coordinates(type(self)))
        return (*super().initial_conditions, *joints)

    @property
    def signals(self) -> tuple[Quantity, ...]:
        count = compiled_mjcf(type(self)).nq
        return (
            *super().signals,
            *(Quantity(f"q_{i}", "1", f"qpos[{i}] of MuJoCo") for i in range(count)),
        )

    def signal(self, params: Any, state: Any, /) -> dict[str, Real[Any, ""]]:
        q = self.positions(state)
        return {**super().signal(params, state), **{f"q_{i}": q[i] for i in range(q.shape[0])}}

    def started_at(self, start: Mapping[str, Any]) -> tuple[Float[Any, " nq"], Float[Any, " nv"]]:
        """MuJoCo's qpos (nq,) and qvel (nv,) of a start."""
        places = [list(numbers) for numbers in start_places(type(self))]
        for which, i, quantity in _coordinates(type(self)):
            if which != _ORIENTATION:
                places[which][i] = start[quantity.name]
        for at, joint in _oriented(compiled_mjcf(type(self))):
            angles = [start[f"{joint}_{angle}_0"] for angle in _ANGLES]
            places[0][at : at + 4] = quaternion_of_angles(*angles)
        q, v = (jnp.stack([jnp.asarray(x, float) for x in numbers]) for numbers in places)
        return q, v

    def checked_control(self, params: Any, state: Any) -> Float[Any, " nu"]:
        """Values of `control`, (nu,).

        Raises:
            ValueError: it has another shape.
        """
        control = jnp.asarray(self.control(params, state), float)
        m = compiled_mjcf(type(self))
        if control.shape != (m.nu,):
            names = ", ".join(m.actuator(i).name or f"actuator {i}" for i in range(m.nu)) or "none"
            raise ValueError(
                f"control returns the shape {control.shape}, but must return ({m.nu},), a number for each "
                f"actuator of the MJCF ({names})."
            )
        return control

    @property
    def data_digest(self) -> str:
        """A digest of the compiled MJCF, with its meshes."""
        return _digest(*content_key(type(self)))

    def mjcf(self, values: Mapping[str, float]) -> str:
        return source_of(type(self))

    def skeleton(self, values: Mapping[str, float], signals: Mapping[str, np.ndarray]) -> Skeleton:
        """The geoms of the MJCF, and limbs if it has a site foot_1, ... for each signal contact_1, ..."""
        from gaitsweep.dynamics.mjcf.drawing import skeleton
        from gaitsweep.dynamics.tree.from_mjcf import compiled

        feet = sum(name.startswith("contact_") for name in signals)
        return skeleton(compiled(self.mjcf(values)), signals, feet)


# MuJoCo is imported when a body is made, since that takes time


def source_of(kind: type[OfMjcf]) -> str:
    """The XML of a model's body."""
    if kind.body_file.lstrip().startswith("<"):
        return kind.body_file
    return mjcf_path(kind).read_text(encoding="utf-8")


def mjcf_path(kind: type[OfMjcf]) -> Path:
    """The file of a model's body, from the folder of the class that names it."""
    owner = next(base for base in kind.__mro__ if "body_file" in vars(base))
    file = getattr(sys.modules.get(owner.__module__), "__file__", None)
    folder = Path() if file is None else Path(file).parent
    return folder / kind.body_file


def content_key(kind: type[OfMjcf]) -> tuple[str, int | None]:
    """The source of a model's body, and when its file was written: a key of what is made of it."""
    if kind.body_file.lstrip().startswith("<"):
        return kind.body_file, None
    path = mjcf_path(kind)
    return str(path), path.stat().st_mtime_ns if path.is_file() else None


def compiled_mjcf(kind: type[OfMjcf]) -> Any:
    """MuJoCo's compiled model of a body, made once for each content of its file.

    Raises:
        ValueError: MuJoCo refuses it.
        FileNotFoundError: there is no such file.
    """
    return compiled_content(*content_key(kind))


@functools.lru_cache(maxsize=32)
def compiled_content(source: str, _written: int | None) -> Any:
    """MuJoCo's compiled model of a path or XML, as `content_key` gives it."""
    from gaitsweep.dynamics.tree.from_mjcf import compiled

    return compiled(source)


@functools.lru_cache(maxsize=32)
def _digest(source: str, written: int | None) -> str:
    import mujoco

    model = compiled_content(source, written)
    buffer = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()


def keyframe_number(m: Any, name: str) -> int | None:
    """The number of the keyframe of this name, of the first one for an empty name; None: there is none.

    Raises:
        ValueError: the MJCF has no keyframe of this name.
    """
    if not name:
        return 0 if m.nkey else None
    names = [m.key(i).name for i in range(m.nkey)]
    if name not in names:
        raise ValueError(f"The MJCF has no keyframe '{name}'{suggestion(name, names)}")
    return names.index(name)


def start_places(kind: type[OfMjcf]) -> tuple[np.ndarray, np.ndarray]:
    """The qpos and qvel of the keyframe of a start, or of the joints where there is no keyframe."""
    m = compiled_mjcf(kind)
    number = keyframe_number(m, kind.keyframe)
    if number is None:
        return np.array(m.qpos0), np.zeros(m.nv)
    return np.array(m.key_qpos[number]), np.array(m.key_qvel[number])


def identifier(name: str) -> str:
    """The name of an element of an MJCF as that of a quantity: other characters are underscores."""
    word = re.sub(r"\W", "_", name)
    return f"_{word}" if word[:1].isdigit() else word


_ANGLES = ("roll", "pitch", "yaw")
_ORIENTATION = 2  # stands for qpos and qvel's number where angles give several numbers of qpos


def quaternion_of_angles(roll: Any, pitch: Any, yaw: Any) -> list[Any]:
    """The quaternion (w, x, y, z) of a yaw about z, a pitch about the new y, a roll about the new x.

    Args:
        roll, pitch, yaw: angles, rad; the body's x axis points at (cos yaw cos pitch, sin yaw cos pitch,
            -sin pitch).
    """
    (a, b, c), (r, p, y) = (
        [turn(0.5 * angle) for angle in (roll, pitch, yaw)] for turn in (jnp.cos, jnp.sin)
    )
    return [a * b * c + r * p * y, r * b * c - a * p * y, a * p * c + r * b * y, a * b * y - r * p * c]


def angles_of_quaternion(quaternion: Float[np.ndarray, " 4"]) -> tuple[float, float, float]:
    """Roll, pitch and yaw (rad) of a quaternion, as `quaternion_of_angles` takes them."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    pitch = float(np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)))
    if abs(2.0 * (w * y - z * x)) > 1.0 - 1e-12:  # only the difference of roll and yaw matters
        return 2.0 * float(np.arctan2(x, w)), pitch, 0.0
    roll = float(np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)))
    return roll, pitch, float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def _oriented(m: Any) -> list[tuple[int, str]]:
    """The place in qpos of the quaternion of each free or ball joint, and the joint's name."""
    import mujoco

    first = {int(mujoco.mjtJoint.mjJNT_FREE): 3, int(mujoco.mjtJoint.mjJNT_BALL): 0}
    return [
        (int(m.jnt_qposadr[j]) + first[int(m.jnt_type[j])], _joint_name(m, j))
        for j in range(m.njnt)
        if int(m.jnt_type[j]) in first
    ]


def _joint_name(m: Any, joint: int) -> str:
    return identifier(m.jnt(joint).name or f"joint_{joint + 1}")


def _coordinates(kind: type[OfMjcf]) -> list[tuple[int, int, Quantity]]:
    """The starts of joints: 0 for qpos, 1 for qvel or 2 for angles, the place there, and the quantity."""
    import mujoco

    m = compiled_mjcf(kind)
    defaults = start_places(kind)
    oriented = {name: at for at, name in _oriented(m)}
    coordinates: list[tuple[int, int, Quantity]] = []

    def add(which: int, i: int, name: str, unit: str, meaning: str) -> None:
        coordinates.append((which, int(i), Quantity(name, unit, meaning, float(defaults[which][i]))))

    for j in range(m.njnt):
        name = _joint_name(m, j)
        q, v, type_ = m.jnt_qposadr[j], m.jnt_dofadr[j], int(m.jnt_type[j])
        if type_ == mujoco.mjtJoint.mjJNT_FREE:
            for k, axis in enumerate("xyz"):
                add(0, q + k, f"{name}_{axis}_0", "m", f"{axis} of {name} at the start")
                add(1, v + k, f"{name}_{axis}_rate_0", "m/s", f"velocity along {axis} of {name} at the start")
            v += 3
        if name in oriented:
            angles = angles_of_quaternion(np.asarray(defaults[0][oriented[name] : oriented[name] + 4]))
            for angle, default in zip(_ANGLES, angles, strict=True):
                meaning = f"{angle} of {name} at the start"
                quantity = Quantity(f"{name}_{angle}_0", "rad", meaning, default + 0.0)
                coordinates.append((_ORIENTATION, oriented[name], quantity))
            for k, axis in enumerate("xyz"):
                meaning = f"angular velocity of {name} about the body's {axis} at the start"
                add(1, v + k, f"{name}_w_{axis}_0", "rad/s", meaning)
        else:
            unit = "rad" if type_ == mujoco.mjtJoint.mjJNT_HINGE else "m"
            add(0, q, f"{name}_0", unit, f"position of joint {name} at the start")
            add(1, v, f"{name}_rate_0", f"{unit}/s", f"velocity of joint {name} at the start")
    return coordinates
