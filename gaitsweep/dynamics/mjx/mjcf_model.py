"""A model of a body in an MJCF and declared oscillators that control its actuators, stepped by MJX.

The body is MuJoCo's, with its contacts, actuators and sensors; oscillators and feedback are declared as in a
`DeclaredModel`. Steps are of a fixed length: events are detected at the end of a step, not located in it.
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
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real

from gaitsweep.contract import Quantity, Rates, SteppedModel
from gaitsweep.dynamics.declarations import SingleEvent
from gaitsweep.dynamics.declared_model import Declared, Values
from gaitsweep.near_miss import suggestion
from gaitsweep.skeleton import Skeleton

if TYPE_CHECKING:
    from gaitsweep.dynamics.mjx.body import MjxBody, Numbers

BODY, SENSORS = "body", "sensors"  # fields of a state besides those that are declared


@dataclasses.dataclass(frozen=True)
class MjcfModel(Declared, SteppedModel):
    """A body of an MJCF with oscillators.

    1. A model gives `body_file`, `control` and `period`, and `rates` where it declares variables.
    2. It may give declarations, `keyframe`, and the optional members of a `DeclaredModel` that need no flow.
    3. The engine alone calls the members that are built from the body and the declarations.

    `state.body` has q, v and act; `sensor(state, NAME)` reads a sensor of the MJCF.

    Starts are the positions of slides and hinges, the place of a free joint, and their velocities, by the
    joints' names: `JOINT_0`, `JOINT_rate_0`; their defaults are those of a keyframe, or of the joints where
    the MJCF has none. A start has the keyframe's act, time, mpos and mquat too; its ctrl is `keyframe_ctrl`,
    for `control`. Signals are `q_0`, `q_1`, ..., MuJoCo's qpos, and those that are declared.

    Constants of the body (masses, lengths, gravity) are the MJCF's, and cannot be parameters.
    """

    body_file: ClassVar[str]  # the MJCF: a path from the folder of the model's module, or the XML itself
    keyframe: ClassVar[str] = ""  # the name of the keyframe of a start; the first one by default

    @classmethod
    def _other_fields(cls) -> list[str]:
        return [BODY, SENSORS]

    def _is_beyond(self, event: SingleEvent, params: Any, state: Any) -> Bool[Array, ""]:
        return event.height(self, params, state) > 0.0

    @abc.abstractmethod
    def control(self, params: Any, state: Any, /) -> Float[Array, " nu"]:
        """The controls (nu,) of the MJCF's actuators, in their order."""

    @property
    def mjx_body(self) -> MjxBody:
        """The compiled MJCF."""
        return _body(type(self))

    @property
    def keyframe_ctrl(self) -> Float[Array, " nu"]:
        """The controls (nu,) of the keyframe of a start; zeros where the MJCF has none."""
        m = self.mjx_body.mj_model
        number = _keyframe(m, self.keyframe)
        return jnp.zeros(m.nu) if number is None else jnp.asarray(m.key_ctrl[number])

    def rates(self, params: Any, state: Any, /) -> Rates:
        """Time derivatives of the declared variables, by name; a step moves them by one step of Euler."""
        return {}

    def sensor(self, state: Any, name: str) -> Float[Array, " ..."]:
        """Reading of a sensor of the MJCF at the beginning of the last step, a number or (n,); 0 before it.

        Raises:
            ValueError: the MJCF has no such sensor.
        """
        m = self.mjx_body.mj_model
        names = [m.sensor(i).name for i in range(m.nsensor)]
        if name not in names:
            raise ValueError(f"The MJCF has no sensor '{name}'{suggestion(name, names)}")
        i = names.index(name)
        first, size = int(m.sensor_adr[i]), int(m.sensor_dim[i])
        return state.sensors[first] if size == 1 else state.sensors[first : first + size]

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        joints = tuple(quantity for _, _, quantity in _coordinates(type(self)))
        return (*super().initial_conditions, *joints)

    @property
    def signals(self) -> tuple[Quantity, ...]:
        qpos = (Quantity(f"q_{i}", "1", f"qpos[{i}] of MuJoCo") for i in range(self.mjx_body.mj_model.nq))
        return (*super().signals, *qpos)

    def signal(self, params: Any, state: Any, /) -> dict[str, Real[Array, ""]]:
        qpos = {f"q_{i}": state.body.q[i] for i in range(self.mjx_body.mj_model.nq)}
        return {**super().signal(params, state), **qpos}

    def init(self, params: Any, start: Values, /) -> Any:
        body = self.mjx_body
        places = [jnp.asarray(addresses) for addresses in _places(type(self))]
        for which, i, quantity in _coordinates(type(self)):
            places[which] = places[which].at[i].set(start[quantity.name])
        sensors = jnp.zeros(body.mj_model.nsensordata)
        return self.State(**self._started(start), body=body.start(*places), sensors=sensors)

    def step(self, params: Any, state: Any, dt: Float[Array, ""], /) -> Any:
        return self.step_with({}, params, state, dt)

    def step_with(self, numbers: Numbers, params: Any, state: Any, dt: Float[Array, ""]) -> Any:
        """The state one step later, with some numbers of mjx.Model replaced."""
        controls = self.checked_control(params, state)
        moved, data = self.mjx_body.step(numbers, state.body, dt, ctrl=controls)
        rates = self.rates(params, state)
        changes = {name: getattr(state, name) + dt * rate for name, rate in rates.items()}
        after = state.replace(**changes, body=moved, sensors=data.sensordata)
        return self._stepped(params, state, after, jnp.zeros(()))

    def checked_control(self, params: Any, state: Any) -> Float[Array, " nu"]:
        """Values of `control`, (nu,).

        Raises:
            ValueError: it has another shape.
        """
        control = jnp.asarray(self.control(params, state), float)
        m = self.mjx_body.mj_model
        if control.shape != (m.nu,):
            names = ", ".join(m.actuator(i).name or f"actuator {i}" for i in range(m.nu)) or "none"
            raise ValueError(
                f"control returns the shape {control.shape}, but must return ({m.nu},), a number for each "
                f"actuator of the MJCF ({names})."
            )
        return control

    def events(self, params: Any, before: Any, after: Any, /) -> Bool[Array, " events"]:
        fired = []
        for event in self.single_events():
            ends = event.height(self, params, after) >= 0.0
            begins = event.height(self, params, before) < 0.0
            allowed = event.within(after) & event.holds(params, after)
            fired.append(allowed & (begins & ends if event.declared.rising else ends))
        return jnp.stack(fired) if fired else jnp.zeros((0,), bool)

    def jump(self, params: Any, state: Any, fired: Bool[Array, " events"], /) -> Any:
        before = state
        for event, flag in zip(self.single_events(), fired, strict=True):
            if event.jumps:
                after = event.jumped(self, params, state)
                state = jax.tree.map(lambda new, old, f=flag: jnp.where(f, new, old), after, state)
        return self._stepped(params, before, state)

    def section(self, params: Any, before: Any, fired: Bool[Array, " events"], /) -> Bool[Array, ""]:
        closed = [flag for event, flag in zip(self.single_events(), fired, strict=True) if event.is_section]
        return jnp.any(jnp.stack(closed)) if closed else jnp.zeros((), bool)

    def longest_step(self, params: Any, /) -> Float[Array, ""]:
        """The MJCF's timestep."""
        return jnp.asarray(self.mjx_body.mj_model.opt.timestep) + 0.0 * self.period(params)

    def mjcf(self, values: Mapping[str, float]) -> str:
        return _source(type(self))

    def skeleton(self, values: Mapping[str, float], signals: Mapping[str, np.ndarray]) -> Skeleton:
        """The geoms of the MJCF, and limbs if it has a site foot_1, ... for each signal contact_1, ..."""
        from gaitsweep.dynamics.mjx.drawing import skeleton

        feet = sum(name.startswith("contact_") for name in signals)
        return skeleton(self.mjx_body.mj_model, signals, feet)

    def caveats(self) -> list[str]:
        from gaitsweep.dynamics.mjx.against_c import at_first_use

        return at_first_use(self)

    @property
    def data_digest(self) -> str:
        """A digest of the compiled MJCF, with its meshes."""
        import mujoco

        model = self.mjx_body.mj_model
        buffer = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, buffer)
        return hashlib.sha256(buffer.tobytes()).hexdigest()


# MuJoCo and MJX are imported when a body is made, since that takes seconds


def _source(kind: type[MjcfModel]) -> str:
    """The XML of a model's body."""
    if kind.body_file.lstrip().startswith("<"):
        return kind.body_file
    return _path(kind).read_text(encoding="utf-8")


def _path(kind: type[MjcfModel]) -> Path:
    """The file of a model's body, from the folder of the class that names it."""
    owner = next(base for base in kind.__mro__ if "body_file" in vars(base))
    file = getattr(sys.modules.get(owner.__module__), "__file__", None)
    folder = Path() if file is None else Path(file).parent
    return folder / kind.body_file


def _body(kind: type[MjcfModel]) -> MjxBody:
    """The body of a model, compiled once for each content of its file.

    Raises:
        ValueError: MuJoCo refuses it, or MJX would ignore a part of it; the message says which.
        FileNotFoundError: there is no such file.
    """
    if kind.body_file.lstrip().startswith("<"):
        return _compiled(kind.body_file, None, kind.keyframe)
    path = _path(kind)
    return _compiled(str(path), path.stat().st_mtime_ns if path.is_file() else None, kind.keyframe)


@functools.lru_cache(maxsize=32)
def _compiled(source: str, _written: int | None, keyframe: str) -> MjxBody:
    from gaitsweep.dynamics.mjx.body import MjxBody, compiled

    model = compiled(source)
    return MjxBody(model, contact=True, keyframe=_keyframe(model, keyframe))


def _keyframe(m: Any, name: str) -> int | None:
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


def _places(kind: type[MjcfModel]) -> tuple[np.ndarray, np.ndarray]:
    """The qpos and qvel of the keyframe of a start, or of the joints where there is no keyframe."""
    m = _body(kind).mj_model
    number = _keyframe(m, kind.keyframe)
    if number is None:
        return np.array(m.qpos0), np.zeros(m.nv)
    return np.array(m.key_qpos[number]), np.array(m.key_qvel[number])


def _coordinates(kind: type[MjcfModel]) -> list[tuple[int, int, Quantity]]:
    """The starts of a body's joints: 0 for qpos or 1 for qvel, the place there, and the quantity."""
    import mujoco

    m = _body(kind).mj_model
    defaults = _places(kind)
    coordinates: list[tuple[int, int, Quantity]] = []

    def add(which: int, i: int, name: str, unit: str, meaning: str) -> None:
        coordinates.append((which, int(i), Quantity(name, unit, meaning, float(defaults[which][i]))))

    for j in range(m.njnt):
        name = re.sub(r"\W", "_", m.jnt(j).name or f"joint_{j + 1}")
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
