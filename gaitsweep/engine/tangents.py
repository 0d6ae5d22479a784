"""Tangents of a trajectory: derivatives of its state along some directions, through steps, events and jumps.

They are the derivatives of the same attempts that the trajectory makes, event times included, so that a jump
maps them by its saltation matrix, which is never formed: the derivative of the event's time is
`implicit_event_time` in event_location.py. At a crossing of the section they are read in the coordinates of
the model's chart, or of `AllVariables`: there they are the products of the return map's derivatives.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaitsweep.contract import Chart, Model, Params, Quantity, State
from gaitsweep.engine.advance import Advance
from gaitsweep.engine.carry import Carry, Number
from gaitsweep.engine.leaves import (
    float_leaves,
    is_float,
    names_of_numbers,
    split_like,
    vector,
    with_float_leaves,
)
from gaitsweep.engine.stored_traces import shapes_of

# Units in the last place by which rounding leaves a vector that depends on others beside them.
ROUNDING = 64.0
Directions = list[Float[Array, " coordinates"]]  # in the coordinates of the section


@dataclasses.dataclass(frozen=True)
class AllVariables(Chart):
    """All float variables of a state as coordinates; `names` are their names."""

    names: tuple[str, ...]

    @classmethod
    def of(cls, state: State) -> AllVariables:
        """The chart of states like this one."""
        floats = jax.tree.map(lambda leaf: leaf if is_float(leaf) else None, state)
        return cls(tuple(names_of_numbers(floats)))

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return tuple(Quantity(name, "", f"{name} of the state") for name in self.names)

    def to_coordinates(self, params: Params, state: State) -> Float[Array, " coordinates"]:
        return vector(float_leaves(state))

    def from_coordinates(self, params: Params, at: Float[Array, " coordinates"], modes: State) -> State:
        return with_float_leaves(modes, split_like(at, float_leaves(modes)))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Tangent:
    """The derivative of a trajectory along one direction.

    Attributes:
        state: that of the float leaves of its state.
        t: that of the time (s) at which it has the state, which events change.
        shift: that of `Carry.shift`.
    """

    state: list[Array]
    t: Number
    shift: Number


def with_tangents(attempt: Advance) -> Advance:
    """The attempt that also advances the tangents of a trajectory.

    Args:
        attempt: an attempt with the derivatives of event times (`advance(..., sensitivities=True)`).
    """

    def attempt_with_tangents(params: Params, carry: Carry) -> Carry:
        bare = dataclasses.replace(carry, tangents=())

        def advance(leaves: list[Array], t: Number, shift: Number) -> Any:
            state = with_float_leaves(bare.state, leaves)
            after = attempt(params, dataclasses.replace(bare, state=state, t=t, shift=shift))
            return (float_leaves(after.state), after.t, after.shift), after

        variables = (float_leaves(bare.state), bare.t, bare.shift)
        _, derivative, after = jax.linearize(advance, *variables, has_aux=True)
        tangents = [
            Tangent(*derivative(tangent.state, tangent.t, tangent.shift)) for tangent in carry.tangents
        ]
        return dataclasses.replace(after, tangents=tangents)

    return attempt_with_tangents


def chart_of(model: Model, state: State) -> Chart:
    """The coordinates of a model's section; without a chart of its own, all float variables of a state."""
    return model.chart() or AllVariables.of(state)


def coordinate_count(model: Model) -> int:
    """The number of coordinates of a model's section."""
    _, state = shapes_of(model)
    return len(chart_of(model, state).coordinates)


def first_directions(size: int, count: int) -> Directions:
    """Orthonormal random directions in a space of coordinates, the same in every process.

    Args:
        size: the number of coordinates.
        count: the number of directions.
    """
    drawn = np.random.default_rng(0).normal(size=(size, count))
    return [jnp.asarray(column) for column in np.linalg.qr(drawn)[0].T]


def from_section(model: Model, params: Params, state: State, directions: Directions) -> list[Tangent]:
    """The tangents of a trajectory that is at a crossing, along directions on the section.

    Args:
        model: the model.
        params: its parameters.
        state: the state just after the crossing.
        directions: in the coordinates of the section, (n,) each.
    """
    chart = chart_of(model, state)

    def leaves(at: Float[Array, " coordinates"]) -> list[Array]:
        return float_leaves(chart.from_coordinates(params, at, state))

    at = chart.to_coordinates(params, state)
    zero = jnp.zeros((), at.dtype)
    return [Tangent(jax.jvp(leaves, (at,), (along.astype(at.dtype),))[1], zero, zero) for along in directions]


def on_section(model: Model, params: Params, carry: Carry) -> Directions:
    """The tangents of a trajectory at a crossing in the coordinates of the section, (n,) each.

    Args:
        model: the model.
        params: its parameters.
        carry: the trajectory just after the crossing, with its tangents.
    """
    chart = chart_of(model, carry.state)

    def coordinates(leaves: list[Array]) -> Float[Array, " coordinates"]:
        return chart.to_coordinates(params, with_float_leaves(carry.state, leaves))

    at = float_leaves(carry.state)
    return [jax.jvp(coordinates, (at,), (along.state,))[1] for along in carry.tangents]


def orthonormalised(vectors: Directions) -> tuple[list[Number], Directions]:
    """Orthonormal vectors and their lengths before normalisation, by the modified Gram-Schmidt process.

    A vector that depends on those before it, up to rounding, has the length 0, and another direction.
    """
    lengths: list[Number] = []
    units: Directions = []
    spare = first_directions(vectors[0].size, len(vectors))
    for direction, other in zip(vectors, spare, strict=True):
        normal = direction
        for unit in units:
            normal = normal - jnp.sum(unit * normal) * unit
        size, length = jnp.sqrt(jnp.sum(direction * direction)), jnp.sqrt(jnp.sum(normal * normal))
        length = jnp.where(length <= ROUNDING * jnp.finfo(size.dtype).eps * size, 0.0, length)
        lengths.append(length)
        units.append(jnp.where(length > 0.0, normal / jnp.where(length > 0.0, length, 1.0), other))
    return lengths, units
