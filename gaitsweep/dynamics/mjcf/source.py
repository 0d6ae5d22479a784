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

    Starts are the positions of slides and hinges, the place of a free joint, and their velocities, by the
    joints' names: `JOINT_0`, `JOINT_rate_0`; their defaults are those of a keyframe, or of the joints where
    the MJCF has none. Signals are `q_0`, `q_1`, ..., MuJoCo's qpos, and those that are declared.
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
            places[which][i] = start[quantity.name]
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


def _coordinates(kind: type[OfMjcf]) -> list[tuple[int, int, Quantity]]:
    """The starts of a body's joints: 0 for qpos or 1 for qvel, the place there, and the quantity."""
    import mujoco

    m = compiled_mjcf(kind)
    defaults = start_places(kind)
    coordinates: list[tuple[int, int, Quantity]] = []

    def add(which: int, i: int, name: str, unit: str, meaning: str) -> None:
        coordinates.append((which, int(i), Quantity(name, unit, meaning, float(defaults[which][i]))))

    for j in range(m.njnt):
        name = identifier(m.jnt(j).name or f"joint_{j + 1}")
        q, v, type_ = m.jnt_qposadr[j], m.jnt_dofadr[j], int(m.jnt_type[j])
        if type_ == mujoco.mjtJoint.mjJNT_FREE:
            for k, axis in enumerate("xyz"):
                add(0, q + k, f"{name}_{axis}_0", "m", f"{axis} of {name} at the start")
                add(1, v + k, f"{name}_{axis}_rate_0", "m/s", f"velocity along {axis} of {name} at the start")
        elif type_ != mujoco.mjtJoint.mjJNT_BALL:
            unit = "rad" if type_ == mujoco.mjtJoint.mjJNT_HINGE else "m"
            add(0, q, f"{name}_0", unit, f"position of joint {name} at the start")
            add(1, v, f"{name}_rate_0", f"{unit}/s", f"velocity of joint {name} at the start")
    return coordinates
