"""Coordinates of a section: variables of a model by declaration, or joints of a body in an MJCF."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaitsweep.contract import Chart, Quantity
from gaitsweep.dynamics.declarations import Reading, Variable
from gaitsweep.dynamics.event_declarations import Surfaces
from gaitsweep.dynamics.tree import is_upright, tilt_and_heading, tilted

if TYPE_CHECKING:
    from gaitsweep.dynamics.body.body_model import BodyModel

NamedVariables = Sequence[tuple[str, Variable]]
_CORRECTIONS = 3  # Newton steps onto the section, from states that are close to it
_CLOSE = 0.02  # share of the nominal period from the section within which a state is moved onto it
_UNCHANGED = 1e-9  # change, for a metre or radian, below which a number does not depend on where a body is
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
class SectionCoordinates(Chart):
    """The chart of `section_coordinates`, the variables themselves; of all variables where there are none.

    Args:
        model: a `DeclaredModel`, or a map without events (`map_model`).
    """

    model: Any

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return _quantities(self.model, self.model.section_variables())

    def to_coordinates(self, params: Any, state: Any, /) -> Float[Array, " coordinates"]:
        return jnp.concatenate(_numbers(self.model.section_variables(), state))

    def from_coordinates(self, params: Any, at: Float[Array, " coordinates"], modes: Any, /) -> Any:
        fields = _fields(self.model, self.model.section_variables(), at, modes)
        state = modes.replace(**fields)
        # `complete` fixes what the section does if there are `section_coordinates`; a map has no events
        if self.model.declarations.events and not self.model.section_coordinates:
            state = _onto_section(self.model, params, state)
        return self.model.begun_on_section(params, self.model.complete(params, state))

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        return tuple(q for name, energy in self._energies() for q in energy.quantities(self.model, name))

    def conserved_values(
        self, params: Any, at: Float[Array, " coordinates"], /
    ) -> Float[Array, " conserved"]:
        if not (energies := self._energies()):
            return jnp.zeros((0,))
        # the modes of a state on the section are those of a start; NaN: variables that the section decides
        starts = {
            q.name: jnp.asarray(q.default if isinstance(q.default, int | float) else math.nan, jnp.float64)
            for q in self.model.initial_conditions
        }
        state = self.from_coordinates(params, at, self.model.init(params, starts))
        return jnp.stack([energy.function(self.model, params, state) for _, energy in energies])

    def _energies(self) -> list[tuple[str, Reading]]:
        """The conserved energies of the model, by name."""
        readings = self.model.declarations.of_kind(Reading).items()
        return [(name, reading) for name, reading in readings if reading.is_conserved]


@dataclasses.dataclass(frozen=True)
class BodyCoordinates(Chart):
    """Positions and velocities of the joints of a body, and the declared variables.

    Slides of the root along the ground are left out, and so are place and heading of a free root.
    """

    model: BodyModel

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        free = (Quantity(*words) for words in _FREE) if self.model.body.is_free else ()
        joints = self.model.body.joints
        return (
            *free,
            *(Quantity(j.name, j.unit, f"position of {j.name}") for j in joints if not j.along_ground),
            *(Quantity(f"{j.name}_rate", f"{j.unit}/s", f"velocity of {j.name}") for j in joints),
            *_quantities(self.model, self._variables()),
        )

    def to_coordinates(self, params: Any, state: Any, /) -> Float[Array, " coordinates"]:
        q = state.q
        v = state.v
        joints = self.model.body.joints
        pieces = []
        if self.model.body.is_free:
            up, heading = tilt_and_heading(q[3:7])
            pieces += [up, q[2:3], v[:2] @ heading, v[2:6]]
        pieces += [q[joint.in_q : joint.in_q + 1] for joint in joints if not joint.along_ground]
        pieces += [v[joint.in_v : joint.in_v + 1] for joint in joints]
        return jnp.concatenate([*pieces, *_numbers(self._variables(), state)])

    def from_coordinates(self, params: Any, at: Float[Array, " coordinates"], modes: Any, /) -> Any:
        q = list(modes.q)
        v = list(modes.v)
        first = 0  # coordinate that is not read yet
        if self.model.body.is_free:
            q[:7] = [jnp.zeros(()), jnp.zeros(()), at[2], *tilted(at[:2])]
            v[:6] = at[3:9]
            first = len(_FREE)
        joints = self.model.body.joints
        for joint in joints:
            if not joint.along_ground:
                q[joint.in_q] = at[first]
                first += 1
        for joint in joints:
            v[joint.in_v] = at[first]
            first += 1
        fields = _fields(self.model, self._variables(), at[first:], modes)
        state = modes.replace(q=jnp.stack(q), v=jnp.stack(v), **fields)
        state = self.model.complete(params, _onto_section(self.model, params, state))
        return self.model.begun_on_section(params, state)

    def covers(self, params: Any, state: Any, /) -> Bool[Array, ""]:
        body = self.model.body
        covered = ~self._place_matters(params, state)
        if not body.is_free:
            return covered
        # on a slope the heading matters, and the tilt of an overturned body is that of an upright one, too
        level = (params.body["slope"] == 0.0) & body.is_on_level_planes
        return covered & level & is_upright(state.q[3:7])

    def _place_matters(self, params: Any, state: Any) -> Bool[Array, ""]:
        """Whether controls, events, rates of variables or springs change with what is left out."""
        body = self.model.body
        slides = [joint for joint in body.joints if joint.along_ground]
        matters = [params.body[f"{slide.name}_stiffness"] != 0.0 for slide in slides]

        def deciding(q: Float[Array, " nq"], v: Float[Array, " nv"]) -> Any:
            at = state.replace(q=q, v=v)
            control = self.model.checked_control(params, at)
            numbers = control, self.model.guards(params, at), self.model.rates(params, at)
            return jax.tree.map(lambda number: jnp.asarray(number, jnp.float64), numbers)

        q, v = state.q, state.v
        still_q, still_v = jnp.zeros_like(q), jnp.zeros_like(v)
        places = (*(range(2) if body.is_free else ()), *(slide.in_q for slide in slides))
        ways = [(still_q.at[place].set(1.0), still_v) for place in places]
        if body.is_free:  # a turn about the vertical, of the orientation and of the velocity in the world
            turned = 0.5 * jnp.stack([-q[6], -q[5], q[4], q[3]])
            ways.append((still_q.at[3:7].set(turned), still_v.at[:2].set(jnp.stack([-v[1], v[0]]))))
        for way in ways:
            _, changes = jax.jvp(deciding, (q, v), way)
            matters += [jnp.any(jnp.abs(change) > _UNCHANGED) for change in jax.tree.leaves(changes)]
        return jnp.any(jnp.stack(matters)) if matters else jnp.zeros((), bool)

    def _variables(self) -> NamedVariables:
        """The declared variables of the section besides positions and velocities."""
        return [(name, var) for name, var in self.model.section_variables() if name not in ("q", "v")]


def _onto_section(model: Any, params: Any, state: Any) -> Any:
    """A state close to the section moved along the normal onto its surface, by Newton's method.

    A displaced state below that surface would cross it again at once, which is not the return next to that of
    the state itself. A state farther away is a start, whose return is its first crossing: it stays where it
    is. So do all states if several events close cycles, or if the jump of the one that does leaves its
    surface, as one does that sets a phase back.
    """
    sections = [event for event in model.single_events() if event.is_section]
    if len(sections) != 1:
        return state
    section = sections[0]

    def height(at: Mapping[str, Array]) -> Float[Array, ""]:
        return section.height(model, params, state.replace(**at))

    surfaces = Surfaces(model, params, state)
    seen = surfaces.of(section)
    reach = _CLOSE * jnp.abs(model.period(params) * surfaces.rate(section))
    moves = jnp.abs(seen.height) <= reach + seen.rounding
    at = {name: getattr(state, name) for name, _ in model.section_variables()}
    for _ in range(_CORRECTIONS):
        above, normal = jax.value_and_grad(height)(at)
        square = sum(jnp.sum(slope * slope) for slope in normal.values())
        share = above / jnp.where(square > 0.0, square, 1.0)
        at = {name: value - share * normal[name] for name, value in at.items()}
    moved = state.replace(**at)
    if section.jumps:
        surface = Surfaces(model, params, moved).of(section)
        after = section.height(model, params, section.jumped(model, params, moved))
        moves &= jnp.abs(after) <= jnp.abs(surface.height) + surface.rounding
    return jax.tree.map(lambda new, old: jnp.where(moves, new, old), moved, state)


def _quantities(model: Any, variables: NamedVariables) -> tuple[Quantity, ...]:
    """The coordinates of variables."""
    return tuple(quantity for name, variable in variables for quantity in variable.quantities(model, name))


def _numbers(variables: NamedVariables, state: Any) -> list[Float[Array, " numbers"]]:
    """The coordinates of each variable at a state."""
    return [jnp.ravel(variable.read(getattr(state, name))) for name, variable in variables]


def _fields(
    model: Any, variables: NamedVariables, at: Float[Array, " coordinates"], modes: Any
) -> Mapping[str, Array]:
    """The variables at their coordinates, by name; `modes` is a state with the same modes."""
    fields = {}
    first = 0
    for name, variable in variables:
        last = first + variable.size(model)
        value = at[first:last].reshape(variable.shape(model))
        if variable.quantity.circular:
            # coordinates are angles from 0 to 2 pi, but a phase that waits for its event may be beyond
            own = getattr(modes, name)
            value = value + (own - variable.read(own))
        fields[name] = value
        first = last
    return fields
