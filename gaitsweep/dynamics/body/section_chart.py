"""Coordinates of a located body on its section, without its place and heading on the ground."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaitsweep.contract import Chart, Quantity
from gaitsweep.dynamics.declarations import Variable
from gaitsweep.dynamics.tree import tilt_and_heading, tilted

if TYPE_CHECKING:
    from gaitsweep.dynamics.body.body_model import BodyModel

_CORRECTIONS = 3  # Newton steps onto the section, from states that are close to it
_FREE = (
    ("up_x", "1", "vertical component of the body's x axis"),
    ("up_y", "1", "vertical component of the body's y axis"),
    ("height", "m", "height of the free body"),
    ("v_ahead", "m/s", "velocity along the heading"),
    ("v_across", "m/s", "velocity to the left of the heading"),
    ("v_up", "m/s", "velocity upwards"),
    ("w_x", "rad/s", "angular velocity about the body's x axis"),
    ("w_y", "rad/s", "angular velocity about the body's y axis"),
    ("w_z", "rad/s", "angular velocity about the body's z axis"),
)


@dataclasses.dataclass(frozen=True)
class BodyChart(Chart):
    """Positions and velocities of joints, and the declared variables.

    Slides of the root along the ground are left out, and so are place and heading of a free root. States are
    moved onto the section's surface along its normal, if the section is one event without a jump.
    """

    model: BodyModel

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        free = (Quantity(*words) for words in _FREE) if self.model.body.is_free else ()
        joints = self._joints()
        return (
            *free,
            *(Quantity(name, unit, f"position of {name}") for name, unit, at, _ in joints if at is not None),
            *(Quantity(f"{name}_rate", f"{unit}/s", f"velocity of {name}") for name, unit, *_ in joints),
            *(q for name, variable in self._variables() for q in variable.quantities(self.model, name)),
        )

    def to_coordinates(self, params: Any, state: Any, /) -> Float[Array, " coordinates"]:
        q = state.q
        v = state.v
        joints = self._joints()
        pieces = []
        if self.model.body.is_free:
            up, heading = tilt_and_heading(q[3:7])
            pieces += [up, q[2:3], v[:2] @ heading, v[2:6]]
        pieces += [q[at : at + 1] for _, _, at, _ in joints if at is not None]
        pieces += [v[dof : dof + 1] for *_, dof in joints]
        pieces += [jnp.ravel(variable.read(getattr(state, name))) for name, variable in self._variables()]
        return jnp.concatenate(pieces)

    def from_coordinates(self, params: Any, at: Float[Array, " coordinates"], modes: Any, /) -> Any:
        q = list(modes.q)
        v = list(modes.v)
        numbers = iter(at)
        if self.model.body.is_free:
            up = jnp.stack([next(numbers), next(numbers)])
            q[:7] = [jnp.zeros(()), jnp.zeros(()), next(numbers), *tilted(up)]
            v[:6] = [next(numbers) for _ in range(6)]
        joints = self._joints()
        for *_, place, _ in joints:
            if place is not None:
                q[place] = next(numbers)
        for *_, dof in joints:
            v[dof] = next(numbers)
        fields: dict[str, Any] = {}
        for name, variable in self._variables():
            numbers_of_variable = jnp.stack([next(numbers) for _ in range(variable.size(self.model))])
            value = numbers_of_variable.reshape(variable.shape(self.model))
            if variable.quantity.circular:
                # coordinates are angles from 0 to 2 pi, but a phase that waits for its event may be beyond
                own = getattr(modes, name)
                value = value + (own - variable.read(own))
            fields[name] = value
        state = modes.replace(q=jnp.stack(q), v=jnp.stack(v), **fields)
        state = self.model.complete(params, self._onto_section(params, state))
        return self.model.begun_on_section(params, state)

    def covers(self, params: Any, state: Any, /) -> Bool[Array, ""]:
        # on a slope the heading matters
        level = params.body["slope"] == 0.0
        return level if self.model.body.is_free else jnp.ones((), bool)

    def _onto_section(self, params: Any, state: Any) -> Any:
        sections = [event for event in self.model.single_events() if event.is_section]
        if len(sections) != 1 or sections[0].jumps:
            return state

        def height(q: Array, v: Array) -> Float[Array, ""]:
            return sections[0].height(self.model, params, state.replace(q=q, v=v))

        q = state.q
        v = state.v
        for _ in range(_CORRECTIONS):
            above, (by_q, by_v) = jax.value_and_grad(height, (0, 1))(q, v)
            square = by_q @ by_q + by_v @ by_v
            share = above / jnp.where(square > 0.0, square, 1.0)
            q, v = q - share * by_q, v - share * by_v
        return state.replace(q=q, v=v)

    def _joints(self) -> list[tuple[str, str, int | None, int]]:
        """Name, unit, place in q (None: left out) and place in v of each hinge and slide."""
        return self.model.body.joints

    def _variables(self) -> list[tuple[str, Variable]]:
        return [(n, variable) for n, variable in self.model.section_variables() if n not in ("q", "v")]
