"""A model of a body in an MJCF and declared oscillators that control its actuators, stepped by MuJoCo.

The body is MuJoCo's, with its contacts, actuators and sensors; oscillators and feedback are declared as in a
`DeclaredModel`. Steps are of a fixed length: events are detected at the end of a step, not located in it.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import functools
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaitsweep.contract import Quantity, SteppedModel
from gaitsweep.dynamics.declared import Declared, Values
from gaitsweep.dynamics.event_declarations import SingleEvent
from gaitsweep.dynamics.mjcf import (
    OfMjcf,
    Stamps,
    compiled_content,
    compiled_mjcf,
    content_key,
    joint_number,
    keyframe_number,
)
from gaitsweep.near_miss import suggestion

if TYPE_CHECKING:
    from gaitsweep.dynamics.mjx.c_body import CBody
    from gaitsweep.dynamics.mjx.mjx_body import MjxBody, Numbers

# Fields of a state besides those that are declared.
BODY = "body"
SENSORS = "sensors"


@dataclasses.dataclass(frozen=True)
class MjcfModel(OfMjcf, Declared, SteppedModel):
    """A body of an MJCF with oscillators, stepped by MuJoCo: in C on CPUs, by MJX on GPUs.

    1. A model gives `body_file`, `control` and `period`, and `rates` where it declares variables.
    2. It may give declarations, `keyframe`, and the optional members of a `DeclaredModel` that need no flow.
    3. The engine alone calls the members that are built from the body and the declarations.

    `state.body` has q, v and act; `sensor(state, NAME)` reads a sensor of the MJCF.

    Starts and signals are those of `OfMjcf`. A start has the keyframe's act, time, mpos and mquat too; its
    ctrl is `keyframe_ctrl`, for `control`. A step moves declared variables by one step of Euler.

    Constants of the body (masses, lengths, gravity) are the MJCF's, and cannot be parameters: those of a
    `BodyModel` can.
    """

    contacts_bounce: ClassVar[bool] = True

    # auto: mujoco on CPUs, where it compiles in seconds and steps faster, and mjx on GPUs
    dynamics: str = dataclasses.field(
        default="auto", kw_only=True, metadata={"allowed": ("auto", "mujoco", "mjx"), "later": True}
    )

    @classmethod
    def _other_fields(cls) -> list[str]:
        return [BODY, SENSORS]

    def _is_beyond(self, event: SingleEvent, params: Any, state: Any) -> Bool[Array, ""]:
        return event.height(self, params, state) > 0.0

    @property
    def mjx_body(self) -> MjxBody:
        """The compiled MJCF, for MJX."""
        return _mjx_body(*content_key(type(self)), type(self).keyframe)

    @property
    def steps_in_c(self) -> bool:
        """Whether MuJoCo C steps the body, not MJX."""
        if self.dynamics == "auto":
            return jax.default_backend() == "cpu"
        return self.dynamics == "mujoco"

    @property
    def stepped_body(self) -> MjxBody | CBody:
        """The compiled MJCF, for C or MJX."""
        if self.steps_in_c:
            return _c_body(*content_key(type(self)), type(self).keyframe)
        return self.mjx_body

    @property
    def data_digest(self) -> str:
        """A digest of the compiled MJCF, and of what steps it."""
        return super().data_digest + (f"mujoco {version('mujoco')}" if self.steps_in_c else "")

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        _ = self.stepped_body  # refuses what MJX lacks before anything is traced
        return super().initial_conditions

    def length_factor(self, params: Any, joint: str) -> float:
        """The factor (1) of the lengths of the body that a joint moves: lengths are the MJCF's."""
        return 1.0

    def place_of_body(self, params: Any, joint: str) -> Float[Array, " 3"]:
        """The place (3,) m of the body that a joint moves in its parent: that of the MJCF."""
        m = compiled_mjcf(type(self))
        return jnp.asarray(m.body_pos[m.jnt_bodyid[joint_number(m, joint)]])

    def actuator_gear(self, params: Any, actuator: int) -> float:
        """The gear (1) of an actuator, by its number: that of the MJCF."""
        return float(compiled_mjcf(type(self)).actuator_gear[actuator, 0])

    def actuator_gain(self, params: Any, actuator: int) -> float:
        """The gain (1) of a motor, by its number: that of the MJCF."""
        return float(compiled_mjcf(type(self)).actuator_gainprm[actuator, 0])

    def load(self, params: Any, state: Any, geom: str) -> Float[Array, ""]:
        """The force (N) of the ground on a geom at the beginning of the last step, by a touch sensor.

        The sensor has the geom's name, or is the only one at a site on its body.

        Raises:
            ValueError: the MJCF has no such geom or sensor, or several sensors on the body.
        """
        m = compiled_mjcf(type(self))
        bodies = {m.geom(i).name: int(m.geom_bodyid[i]) for i in range(m.ngeom)}
        if geom not in bodies:
            raise ValueError(f"The MJCF has no geom '{geom}'{suggestion(geom, bodies)}")
        import mujoco

        sensors = [
            int(i)
            for i in np.flatnonzero(m.sensor_type == mujoco.mjtSensor.mjSENS_TOUCH)
            if m.site_bodyid[m.sensor_objid[i]] == bodies[geom]
        ]
        sensors = [i for i in sensors if m.sensor(i).name == geom] or sensors
        if len(sensors) != 1:
            raise ValueError(
                f"The load of geom '{geom}' is read from a <touch> sensor of its name, or from the only one "
                f"at a site on its body, but that has {len(sensors)} of other names."
            )
        return state.sensors[int(m.sensor_adr[sensors[0]])]

    def touches(self, state: Any, geom: str) -> Bool[Array, ""]:
        """Whether the ground pushed on a geom at the beginning of the last step, by its touch sensor."""
        return self.load(None, state, geom) > 0.0

    def sensor(self, state: Any, name: str) -> Float[Array, " ..."]:
        """Reading of a sensor of the MJCF at the beginning of the last step, a number or (n,); 0 before it.

        Raises:
            ValueError: the MJCF has no such sensor.
        """
        m = compiled_mjcf(type(self))
        names = [m.sensor(i).name for i in range(m.nsensor)]
        if name not in names:
            raise ValueError(f"The MJCF has no sensor '{name}'{suggestion(name, names)}")
        i = names.index(name)
        first = int(m.sensor_adr[i])
        size = int(m.sensor_dim[i])
        return state.sensors[first] if size == 1 else state.sensors[first : first + size]

    def init(self, params: Any, start: Values, /) -> Any:
        body = self.stepped_body
        sensors = jnp.zeros(body.mj_model.nsensordata)
        fields = {**self._started(start), BODY: body.start(*self.started_at(start)), SENSORS: sensors}
        return self.complete(params, self.State(**fields))

    def step(self, params: Any, state: Any, dt: Float[Array, ""], /) -> Any:
        return self.step_with({}, params, state, dt)

    def step_with(self, numbers: Numbers, params: Any, state: Any, dt: Float[Array, ""]) -> Any:
        """The state one step later, with some numbers of mjx.Model replaced."""
        controls = self.checked_control(params, state)
        moved, data = self.stepped_body.step(numbers, state.body, dt, ctrl=controls)
        rates = self.rates(params, state)
        changes = {name: getattr(state, name) + dt * rate for name, rate in rates.items()}
        after = state.replace(**changes, body=moved, sensors=data.sensordata)
        return self._stepped(params, state, after, jnp.zeros(()))

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
        return jnp.asarray(compiled_mjcf(type(self)).opt.timestep) + 0.0 * self.period(params)

    @property
    def caveats_notice(self) -> str:
        from gaitsweep.dynamics.mjx.against_c import compared_before

        if self.steps_in_c or compared_before(self):
            return ""
        return (
            "The MJCF is compared with MuJoCo C, once for each MJCF: this compiles for about a minute, and "
            "the steps of the run compile as long."
        )

    def caveats(self) -> list[str]:
        from gaitsweep.dynamics.mjx.against_c import at_first_use

        return [] if self.steps_in_c else at_first_use(self)


@functools.lru_cache(maxsize=32)
def _c_body(source: str, stamps: Stamps, keyframe: str) -> CBody:
    """The body for C, made once for each content of its files."""
    from gaitsweep.dynamics.mjx.c_body import CBody

    model = compiled_content(source, stamps)
    return CBody(model, keyframe_number(model, keyframe))


@functools.lru_cache(maxsize=32)
def _mjx_body(source: str, stamps: Stamps, keyframe: str) -> MjxBody:
    """The body for MJX, made once for each content of its files.

    Raises:
        ValueError: MJX would ignore a part of it; the message says which.
    """
    from gaitsweep.dynamics.mjx.mjx_body import MjxBody

    model = compiled_content(source, stamps)
    return MjxBody(model, contact=True, keyframe=keyframe_number(model, keyframe))
