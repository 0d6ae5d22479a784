"""A model of a body in an MJCF and declared oscillators that control its actuators, stepped by MJX.

The body is MuJoCo's, with its contacts, actuators and sensors; oscillators and feedback are declared as in a
`DeclaredModel`. Steps are of a fixed length: events are detected at the end of a step, not located in it.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaitsweep.contract import Quantity, SteppedModel
from gaitsweep.dynamics.declarations import SingleEvent
from gaitsweep.dynamics.declared import Declared, Values
from gaitsweep.dynamics.mjcf.source import OfMjcf, compiled_content, content_key, keyframe_number
from gaitsweep.near_miss import suggestion

if TYPE_CHECKING:
    from gaitsweep.dynamics.mjx.body import MjxBody, Numbers

BODY, SENSORS = "body", "sensors"  # fields of a state besides those that are declared


@dataclasses.dataclass(frozen=True)
class MjcfModel(OfMjcf, Declared, SteppedModel):
    """A body of an MJCF with oscillators, stepped by MJX.

    1. A model gives `body_file`, `control` and `period`, and `rates` where it declares variables.
    2. It may give declarations, `keyframe`, and the optional members of a `DeclaredModel` that need no flow.
    3. The engine alone calls the members that are built from the body and the declarations.

    `state.body` has q, v and act; `sensor(state, NAME)` reads a sensor of the MJCF.

    Starts and signals are those of `OfMjcf`. A start has the keyframe's act, time, mpos and mquat too; its
    ctrl is `keyframe_ctrl`, for `control`. A step moves declared variables by one step of Euler.

    Constants of the body (masses, lengths, gravity) are the MJCF's, and cannot be parameters: those of a
    `BodyModel` can.
    """

    @classmethod
    def _other_fields(cls) -> list[str]:
        return [BODY, SENSORS]

    def _is_beyond(self, event: SingleEvent, params: Any, state: Any) -> Bool[Array, ""]:
        return event.height(self, params, state) > 0.0

    @property
    def mjx_body(self) -> MjxBody:
        """The compiled MJCF."""
        return _body(type(self))

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        _ = self.mjx_body  # refuses what MJX lacks before anything is traced
        return super().initial_conditions

    def positions(self, state: Any) -> Float[Array, " nq"]:
        return state.body.q

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

    def init(self, params: Any, start: Values, /) -> Any:
        body = self.mjx_body
        sensors = jnp.zeros(body.mj_model.nsensordata)
        return self.State(**self._started(start), body=body.start(*self.started_at(start)), sensors=sensors)

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

    @property
    def caveats_notice(self) -> str:
        from gaitsweep.dynamics.mjx.against_c import compared_before

        if compared_before(self):
            return ""
        return (
            "The MJCF is compared with MuJoCo C, once for each MJCF: this compiles for about a minute, and "
            "the steps of the run compile as long."
        )

    def caveats(self) -> list[str]:
        from gaitsweep.dynamics.mjx.against_c import at_first_use

        return at_first_use(self)


def _body(kind: type[MjcfModel]) -> MjxBody:
    """The body of a model, compiled once for each content of its file.

    Raises:
        ValueError: MuJoCo refuses it, or MJX would ignore a part of it; the message says which.
        FileNotFoundError: there is no such file.
    """
    return _compiled(*content_key(kind), kind.keyframe)


@functools.lru_cache(maxsize=32)
def _compiled(source: str, written: int | None, keyframe: str) -> MjxBody:
    from gaitsweep.dynamics.mjx.body import MjxBody

    model = compiled_content(source, written)
    return MjxBody(model, contact=True, keyframe=keyframe_number(model, keyframe))
