"""The base of models of a body in an MJCF: the file, compiled once for each content; starts and signals.

Functions import MuJoCo themselves, since that takes time.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import abc
import dataclasses
import functools
import hashlib
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Real

from gaitsweep.contract import Model, Quantity, Rates
from gaitsweep.near_miss import suggestion
from gaitsweep.own_modules import Stamp, stamp_of
from gaitsweep.skeleton import Skeleton, contact_signals

DUST = 1e-15  # rounding errors of constants that should be whole numbers
# The stamps of an MJCF and of all files that it refers to; None for a missing file.
Stamps: TypeAlias = tuple[Stamp | None, ...]
# The files of each MJCF, and their stamps when its references were read.
_FILES_OF_MJCF: dict[Path, tuple[tuple[Path, ...], Stamps]] = {}


def compiled(source: Any) -> Any:
    """MuJoCo's compiled model of a path or of the XML itself.

    Args:
        source: a path, the XML, or a compiled model, which is returned.

    Raises:
        ValueError: MuJoCo refuses the XML.
        FileNotFoundError: there is no file at the path.
        IsADirectoryError: there is a folder.
    """
    import mujoco

    if isinstance(source, mujoco.MjModel):
        return source
    if isinstance(source, str) and source.lstrip().startswith("<"):
        return mujoco.MjModel.from_xml_string(source)
    if Path(source).is_dir():
        raise IsADirectoryError(f"The MJCF {source} is a folder, but must be a file.")
    if not Path(source).is_file():
        raise FileNotFoundError(f"The MJCF {source} does not exist.")
    return mujoco.MjModel.from_xml_path(str(source))


@functools.lru_cache(maxsize=32)
def compiled_content(source: str, _stamps: Stamps) -> Any:
    """MuJoCo's compiled model of a path or XML.

    Args:
        source, _stamps: as `content_key` gives them.

    Raises:
        ValueError: MuJoCo refuses it.
        FileNotFoundError: there is no such file.
    """
    return compiled(source)


@functools.lru_cache(maxsize=32)
def content_digest(source: str, stamps: Stamps) -> str:
    """The digest of a compiled model; arguments as `content_key` gives them."""
    import mujoco

    model = compiled_content(source, stamps)
    buffer = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()


def portable_xml(path: Path) -> str:
    """The XML of an MJCF, which compiles in any folder: the paths of meshes and textures are absolute.

    Raises:
        ValueError: MuJoCo refuses it.
        FileNotFoundError: there is no such file.
    """
    if _references(path) in (None, (path,)):
        return path.read_text(encoding="utf-8")
    import mujoco

    spec = mujoco.MjSpec.from_file(str(path))  # which has the elements of included files
    folder = path.parent.resolve()
    spec.meshdir = str(folder / spec.meshdir)
    spec.texturedir = str(folder / spec.texturedir)
    return spec.to_xml()


def stamps_of_mjcf(path: Path) -> Stamps:
    """The stamps of an MJCF and of the files that it refers to: includes, meshes, height fields, textures."""
    files, stamps_as_read = _FILES_OF_MJCF.get(path, ((path,), None))
    stamps = _stamps(files)
    if stamps == stamps_as_read:
        return stamps
    # a file has changed, and may refer to others than before
    references = _references(path)
    stamps = _stamps(references or [path])
    if references is not None:
        _FILES_OF_MJCF[path] = references, stamps
    return stamps


def _stamps(files: Iterable[Path]) -> Stamps:
    """The stamp of each file."""
    return tuple(stamp_of(file) if file.is_file() else None for file in files)


def _references(path: Path) -> tuple[Path, ...] | None:
    """An MJCF and the files that it refers to; None if it, or one that it includes, cannot be read."""
    if not path.is_file():  # of a folder, MuJoCo prints that it is too large
        return None
    import mujoco

    try:
        names = mujoco.mju_getXMLDependencies(str(path))
    except mujoco.FatalError:  # MuJoCo's compiler reports it
        return None
    return tuple(sorted(map(Path, names)))


def keyframe_number(m: Any, name: str) -> int | None:
    """The number of the keyframe of this name, of the first one for an empty name; None: there is none.

    Raises:
        ValueError: the MJCF has no keyframe of this name.
    """
    if not name:
        return 0 if m.nkey else None
    names = [m.key(i).name for i in range(m.nkey)]
    if name not in names:
        near = suggestion(name, names) if names else ": it has none."
        raise ValueError(f"The MJCF has no keyframe '{name}'{near}")
    return names.index(name)


def data_at_keyframe(m: Any, number: int | None) -> Any:
    """MuJoCo's data at a keyframe, or at the reference positions without one."""
    import mujoco

    data = mujoco.MjData(m)
    if number is not None:
        mujoco.mj_resetDataKeyframe(m, data, number)
    return data


def identifier(name: str) -> str:
    """The name of an element of an MJCF as that of a quantity: other characters are underscores."""
    word = re.sub(r"\W", "_", name)
    return f"_{word}" if word[:1].isdigit() else word


def element_name(m: Any, kind: str, number: int) -> str:
    """The name of an element in messages, or its kind and number where it has none."""
    return getattr(m, kind)(number).name or f"{kind} {number}"


def named(m: Any, kind: str, number: int) -> str:
    """The kind of an element and its name, at the beginning of a sentence."""
    return f"{kind.capitalize()} '{element_name(m, kind, number)}'"


def elements_with(m: Any, field: str, absent: float = 0.0) -> list[int]:
    """The elements whose numbers in a field of the compiled MJCF differ from those of an absent feature.

    Some versions of MuJoCo do not have all fields; then there are none.
    """
    values = np.asarray(getattr(m, field, ()), float)
    if not values.size:
        return []
    return np.flatnonzero((values.reshape(len(values), -1) != absent).any(axis=1)).tolist()


def cleaned(values: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """The values with whole numbers in place of those within rounding errors of them.

    So constants keep their zeros and ones, as the axes of elements that are turned.
    """
    rounded = np.round(values) + 0.0  # the sum turns -0.0 into 0.0
    return np.where(np.abs(values - rounded) < DUST, rounded, values)


def joint_name(m: Any, joint: int) -> str:
    """The name of a joint in quantities, from its number."""
    return identifier(m.jnt(joint).name or f"joint_{joint + 1}")


def hinges_and_slides(m: Any) -> list[int]:
    """The numbers of the hinges and slides."""
    import mujoco

    kinds = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    return np.flatnonzero(np.isin(m.jnt_type, kinds)).tolist()


def joint_number(m: Any, joint: str) -> int:
    """The number of a hinge or slide, by its name in the MJCF or in quantities.

    Raises:
        ValueError: there is none; the message has the near miss.
    """
    names = {joint_name(m, j): j for j in hinges_and_slides(m)}
    if (plain := identifier(joint)) not in names:
        raise ValueError(f"The MJCF has no hinge or slide '{joint}'{suggestion(joint, names)}")
    return names[plain]


def is_position_servo(m: Any, k: int) -> bool:
    """Whether actuator `k` is a position servo, whose control is a target."""
    return _is_servo(m, k, 1)


def is_velocity_servo(m: Any, k: int) -> bool:
    """Whether actuator `k` is a velocity servo."""
    return _is_servo(m, k, 2)


def pulls_back(m: Any, k: int) -> bool:
    """Whether the force of actuator `k` depends on the position of its joint, as a position servo's does."""
    import mujoco

    return bool(m.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE and m.actuator_biasprm[k, 1])


def _is_servo(m: Any, k: int, term: int) -> bool:
    """Whether the gain of an actuator is minus its bias of the position (term 1) or velocity (term 2)."""
    import mujoco

    gain = m.actuator_gainprm[k, 0]
    bias = m.actuator_biasprm[k]
    is_affine = m.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
    return bool(is_affine and gain and not bias[:term].any() and bias[term] == -gain)


_ANGLES = ("roll", "pitch", "yaw")
_AT_START = " at the start"  # the end of the meaning of a start
_UPRIGHT = 1.0 - 1e-9  # vertical component of a unit axis from which a slide is a height


@dataclasses.dataclass(frozen=True)
class OfMjcf(Model):
    """A model whose body is described by an MJCF, and whose actuators it controls.

    Starts are the positions and velocities of slides and hinges by the joints' names, `JOINT_0` and
    `JOINT_rate_0`; the place and velocity of a free joint, `JOINT_x_0` and `JOINT_x_rate_0`; and the
    orientation of a free or ball joint, `JOINT_roll_0`, `JOINT_pitch_0` and `JOINT_yaw_0`, with the angular
    velocity about the body's axes, `JOINT_w_x_0`, ... Their defaults are those of a keyframe, or of the
    joints where the MJCF has none. Signals are those that are declared, and `q_0`, `q_1`, ..., MuJoCo's qpos,
    whose meanings name their joints.
    """

    body_file: ClassVar[str]  # the MJCF: a path from the folder of the model's module, or the XML itself
    keyframe: ClassVar[str] = ""  # the name of the keyframe of a start; the first one by default
    remarks: ClassVar[tuple[str, ...]] = ()  # on the file that describes the model; they are among `caveats`

    @abc.abstractmethod
    def control(self, params: Any, state: Any, /) -> Float[Any, " nu"]:
        """The controls (nu,) of the MJCF's actuators, in their order."""

    def positions(self, state: Any) -> Float[Any, " nq"]:
        """MuJoCo's qpos (nq,) of a state."""
        return state.body.q

    def position(self, state: Any, joint: str) -> Float[Any, ""]:
        """The position of a hinge (rad) or slide (m), by the joint's name."""
        m = compiled_mjcf(type(self))
        return state.body.q[int(m.jnt_qposadr[joint_number(m, joint)])]

    def rate(self, state: Any, joint: str) -> Float[Any, ""]:
        """The velocity of a hinge (rad/s) or slide (m/s), by the joint's name."""
        m = compiled_mjcf(type(self))
        return state.body.v[int(m.jnt_dofadr[joint_number(m, joint)])]

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
        return (*super().initial_conditions, *(start.quantity for start in _joint_starts(type(self))))

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return (*super().signals, *_positions_of_joints(type(self)))

    def signal(self, params: Any, state: Any, /) -> dict[str, Real[Any, ""]]:
        q = self.positions(state)
        return {**super().signal(params, state), **{f"q_{i}": q[i] for i in range(q.shape[0])}}

    def started_at(self, start: Mapping[str, Any]) -> tuple[Float[Any, " nq"], Float[Any, " nv"]]:
        """MuJoCo's qpos (nq,) and qvel (nv,) of a start.

        Args:
            start: the initial conditions by name.
        """
        qpos, qvel = (list(numbers) for numbers in _start_places(type(self)))
        for joint_start in _joint_starts(type(self)):
            if joint_start.field != "angle":
                numbers = qpos if joint_start.field == "qpos" else qvel
                numbers[joint_start.place] = start[joint_start.quantity.name]
        for place, joint in _oriented(compiled_mjcf(type(self))):
            angles = [start[f"{joint}_{angle}_0"] for angle in _ANGLES]
            qpos[place : place + 4] = quaternion_of_angles(*angles)
        q = jnp.stack([jnp.asarray(number, float) for number in qpos])
        v = jnp.stack([jnp.asarray(number, float) for number in qvel])
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
        return content_digest(*content_key(type(self)))

    def mjcf(self, values: Mapping[str, float]) -> str:
        return source_of(type(self))

    def skeleton(self, values: Mapping[str, float], signals: Mapping[str, np.ndarray]) -> Skeleton:
        """The geoms of the MJCF, and limbs if it has a site foot_1, ... for each signal contact_1, ..."""
        from gaitsweep.dynamics.mjcf_drawing import skeleton

        feet = len(contact_signals(signals))
        return skeleton(compiled(self.mjcf(values)), signals, feet, self.limbs)


def source_of(kind: type[OfMjcf]) -> str:
    """The XML of a model's body, which compiles in any folder: the paths of meshes and textures are absolute.

    Raises:
        ValueError: MuJoCo refuses it.
        FileNotFoundError: there is no such file.
    """
    if kind.body_file.lstrip().startswith("<"):
        return kind.body_file
    return portable_xml(mjcf_path(kind))


def mjcf_path(kind: type[OfMjcf]) -> Path:
    """The file of a model's body, from the folder of the class that names it."""
    owner = next(base for base in kind.__mro__ if "body_file" in vars(base))
    file = getattr(sys.modules.get(owner.__module__), "__file__", None)
    folder = Path() if file is None else Path(file).parent
    return folder / kind.body_file


def content_key(kind: type[OfMjcf]) -> tuple[str, Stamps]:
    """The source of a model's body, and the stamps of its files: a key of what is made of it."""
    if kind.body_file.lstrip().startswith("<"):
        return kind.body_file, ()
    path = mjcf_path(kind)
    return str(path), stamps_of_mjcf(path)


def compiled_mjcf(kind: type[OfMjcf]) -> Any:
    """MuJoCo's compiled model of a body, made once for each content of its files.

    Raises:
        ValueError: MuJoCo refuses it.
        FileNotFoundError: there is no such file.
    """
    return compiled_content(*content_key(kind))


def _start_places(kind: type[OfMjcf]) -> tuple[np.ndarray, np.ndarray]:
    """The qpos and qvel of the keyframe of a start, or of the joints where there is no keyframe."""
    m = compiled_mjcf(kind)
    number = keyframe_number(m, kind.keyframe)
    if number is None:
        return np.array(m.qpos0), np.zeros(m.nv)
    return np.array(m.key_qpos[number]), np.array(m.key_qvel[number])


class _StartOfJoint(NamedTuple):
    """A start of a joint: a number of qpos or of qvel, or an angle of the quaternion that begins there.

    `field` is the array that has the number, or "angle"; `place` is the place there, of an angle in qpos.
    """

    field: Literal["qpos", "qvel", "angle"]
    place: int
    quantity: Quantity


def height_start(kind: type[OfMjcf]) -> str | None:
    """The name of the start that is the height of the whole body; None where there is none."""
    import mujoco

    m = compiled_mjcf(kind)
    if not m.njnt:
        return None
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    first = int(m.jnt_bodyid[0])  # whose joints move the others too
    for j in range(int(m.body_jntnum[first])):
        if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
            return f"{joint_name(m, j)}_z_0"
        if m.jnt_type[j] != mujoco.mjtJoint.mjJNT_SLIDE:
            return None
        if data.xaxis[j][2] > _UPRIGHT:
            return f"{joint_name(m, j)}_0"
    return None


def quaternion_of_angles(roll: Any, pitch: Any, yaw: Any) -> list[Any]:
    """The quaternion (w, x, y, z) of a yaw about z, a pitch about the new y, a roll about the new x.

    Args:
        roll, pitch, yaw: angles, rad; the body's x axis points at (cos yaw cos pitch, sin yaw cos pitch,
            -sin pitch).
    """
    half_angles = [0.5 * angle for angle in (roll, pitch, yaw)]
    a, b, c = (jnp.cos(half) for half in half_angles)
    r, p, y = (jnp.sin(half) for half in half_angles)
    return [a * b * c + r * p * y, r * b * c - a * p * y, a * p * c + r * b * y, a * b * y - r * p * c]


def angles_of_quaternion(quaternion: Float[np.ndarray, " 4"]) -> tuple[float, float, float]:
    """Roll, pitch and yaw (rad) of a quaternion, as `quaternion_of_angles` takes them."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    sine_of_pitch = 2.0 * (w * y - z * x)
    pitch = float(np.arcsin(np.clip(sine_of_pitch, -1.0, 1.0)))
    if abs(sine_of_pitch) > 1.0 - 1e-12:  # only the difference of roll and yaw matters
        return 2.0 * float(np.arctan2(x, w)), pitch, 0.0
    roll = float(np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)))
    return roll, pitch, float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def _oriented(m: Any) -> list[tuple[int, str]]:
    """The place in qpos of the quaternion of each free or ball joint, and the joint's name."""
    import mujoco

    # a free joint's position comes before its quaternion
    place_of_quaternion = {int(mujoco.mjtJoint.mjJNT_FREE): 3, int(mujoco.mjtJoint.mjJNT_BALL): 0}
    return [
        (int(m.jnt_qposadr[j]) + place_of_quaternion[kind], joint_name(m, j))
        for j, kind in enumerate(m.jnt_type.tolist())
        if kind in place_of_quaternion
    ]


def _joint_starts(kind: type[OfMjcf]) -> list[_StartOfJoint]:
    """The starts of joints."""
    import mujoco

    m = compiled_mjcf(kind)
    qpos, qvel = _start_places(kind)
    oriented = {name: place for place, name in _oriented(m)}
    starts: list[_StartOfJoint] = []
    for j in range(m.njnt):
        name = joint_name(m, j)
        joint_type = int(m.jnt_type[j])
        q = int(m.jnt_qposadr[j])
        v = int(m.jnt_dofadr[j])
        if joint_type == mujoco.mjtJoint.mjJNT_FREE:
            starts += _starts_of_place(name, q, v, qpos, qvel)
            v += 3
        if name in oriented:
            starts += _starts_of_orientation(name, oriented[name], v, qpos, qvel)
        else:
            unit = "rad" if joint_type == mujoco.mjtJoint.mjJNT_HINGE else "m"
            joint = f"joint {name}{_AT_START}"
            starts.append(_start("qpos", q, qpos, f"{name}_0", unit, f"position of {joint}"))
            starts.append(_start("qvel", v, qvel, f"{name}_rate_0", f"{unit}/s", f"velocity of {joint}"))
    return starts


def _positions_of_joints(kind: type[OfMjcf]) -> tuple[Quantity, ...]:
    """The numbers of MuJoCo's qpos as signals: positions of joints, and unit quaternions of orientations."""
    m = compiled_mjcf(kind)
    positions = {
        start.place: (start.quantity.unit, start.quantity.meaning.removesuffix(_AT_START))
        for start in _joint_starts(kind)
        if start.field == "qpos"
    }
    for first, name in _oriented(m):
        positions |= {
            first + k: ("1", f"{part} of the quaternion of {name}") for k, part in enumerate("wxyz")
        }
    return tuple(Quantity(f"q_{i}", *positions[i]) for i in range(m.nq))


def _start(
    field: Literal["qpos", "qvel"], place: int, numbers: np.ndarray, name: str, unit: str, meaning: str
) -> _StartOfJoint:
    """The start of one number, with its default among `numbers`."""
    return _StartOfJoint(field, place, Quantity(name, unit, meaning, float(numbers[place])))


def _starts_of_place(
    name: str, q: int, v: int, qpos: np.ndarray, qvel: np.ndarray
) -> Iterator[_StartOfJoint]:
    """The starts of the place of a free joint and of its velocity; they begin at `q` and `v`."""
    for k, axis in enumerate("xyz"):
        place = f"{axis} of {name}{_AT_START}"
        velocity = f"velocity along {axis} of {name}{_AT_START}"
        yield _start("qpos", q + k, qpos, f"{name}_{axis}_0", "m", place)
        yield _start("qvel", v + k, qvel, f"{name}_{axis}_rate_0", "m/s", velocity)


def _starts_of_orientation(
    name: str, q: int, v: int, qpos: np.ndarray, qvel: np.ndarray
) -> Iterator[_StartOfJoint]:
    """The starts of the angles of a free or ball joint, and of its angular velocity."""
    angles = angles_of_quaternion(qpos[q : q + 4])
    for angle, default in zip(_ANGLES, angles, strict=True):
        # the sum turns -0.0 into 0.0
        quantity = Quantity(f"{name}_{angle}_0", "rad", f"{angle} of {name}{_AT_START}", default + 0.0)
        yield _StartOfJoint("angle", q, quantity)
    for k, axis in enumerate("xyz"):
        meaning = f"angular velocity of {name} about the body's {axis}{_AT_START}"
        yield _start("qvel", v + k, qvel, f"{name}_w_{axis}_0", "rad/s", meaning)
