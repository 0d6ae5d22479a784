"""Coordinates of the section of a model by declaration: some of its variables."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from gaitsweep.contract import Chart, Quantity
from gaitsweep.dynamics.declarations import Reading


@dataclasses.dataclass(frozen=True)
class SectionCoordinates(Chart):
    """The chart of `section_coordinates`, the variables themselves; of all variables where there are none.

    Args:
        model: a `DeclaredModel`, or a map without events (`map_model`).
    """

    model: Any

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return tuple(
            q
            for name, variable in self.model.section_variables()
            for q in variable.quantities(self.model, name)
        )

    def to_coordinates(self, params: Any, state: Any, /) -> Float[Array, " coordinates"]:
        return jnp.concatenate(
            [
                jnp.ravel(variable.read(getattr(state, name)))
                for name, variable in self.model.section_variables()
            ]
        )

    def from_coordinates(self, params: Any, at: Float[Array, " coordinates"], modes: Any, /) -> Any:
        fields = {}
        first = 0
        for name, variable in self.model.section_variables():
            last = first + variable.size(self.model)
            value = at[first:last].reshape(variable.shape(self.model))
            if variable.quantity.circular:
                # coordinates are angles from 0 to 2 pi, but a phase that waits for its event may be beyond
                own = getattr(modes, name)
                value = value + (own - variable.read(own))
            fields[name] = value
            first = last
        state = self.model.complete(params, modes.replace(**fields))
        return self.model.begun_on_section(params, state)

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        return tuple(q for name, energy in self._energies() for q in energy.quantities(self.model, name))

    def conserved_values(
        self, params: Any, at: Float[Array, " coordinates"], /
    ) -> Float[Array, " conserved"]:
        if not (energies := self._energies()):
            return jnp.zeros((0,))
        # the modes of a state on the section are those of a start
        starts = {q.name: jnp.asarray(q.default, jnp.float64) for q in self.model.initial_conditions}
        state = self.from_coordinates(params, at, self.model.init(params, starts))
        return jnp.stack([energy.function(self.model, params, state) for _, energy in energies])

    def _energies(self) -> list[tuple[str, Reading]]:
        declared = self.model.declarations.items()
        return [
            (name, reading)
            for name, reading in declared
            if isinstance(reading, Reading) and reading.is_conserved
        ]
