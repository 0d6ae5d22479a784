"""Maps of the states of a model: its parameters, starts and symmetries; a map adds the image of a state."""

from __future__ import annotations

import abc
import dataclasses
import graphlib
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaitsweep import near_miss
from gaitsweep.contract import Chart, Model, Params, Quantity, State
from gaitsweep.engine.carry import Integer, select
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.devices import refuse_fork
from gaitsweep.engine.poincare import map_derivatives
from gaitsweep.engine.poincare.map_derivatives import FollowedMap
from gaitsweep.engine.poincare.maps import (
    MIN_SCALE,
    Coordinates,
    Image,
    ManyCoordinates,
    Points,
    Values,
    column,
    group_of,
)
from gaitsweep.engine.poincare.poincare_return import Returned, ReturnStatus
from gaitsweep.errors import ArgumentError
from gaitsweep.expression import functions_of, in_order, names_used, resolve


@dataclasses.dataclass(frozen=True)
class ModelMap(FollowedMap):
    """A map of a model's states, in JAX and for many points at once.

    A map defines `_chart`, `state`, `events` and `refined`; the other members are built from them.

    Args:
        model: the model.
        settings: (name, number or formula) of the parameters that are not at their defaults.
        least: the least scale of each coordinate, (size,) or one for all; it decides no program.
    """

    model: Model
    settings: tuple[tuple[str, float | str], ...] = ()
    least: Float[np.ndarray, " coordinates"] | float = dataclasses.field(
        default=MIN_SCALE, kw_only=True, compare=False
    )

    @cached_property
    def chart(self) -> Chart:
        """The coordinates of a state."""
        return self._chart()

    @abc.abstractmethod
    def _chart(self) -> Chart:
        """The coordinates of a state, made once."""

    @abc.abstractmethod
    def state(self, params: Params, state: State) -> Returned:
        """The time (s) to the image of a state, the image, and the `ReturnStatus`, in JAX.

        Args:
            params: the parameters of the model.
            state: the state.
        """

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return self.chart.coordinates

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        return self.chart.conserved

    def sizes(self, at: ManyCoordinates) -> ManyCoordinates:
        return self.least + np.abs(at)

    @property
    def durations(self) -> tuple[str, ...]:
        return ("time",)

    def params(self, values: Values) -> Params:
        """The model's parameters: values, then settings, then defaults; formulas are evaluated."""
        return self.model.params(self.resolved(values))

    def resolved(self, values: Values) -> dict[str, Any]:
        """All parameters by name: values, then settings, then defaults; formulas are evaluated."""
        known: dict[str, Any] = {name: jnp.asarray(value) for name, value in values.items()}
        settings = {name: self._written[name] for name in self._order if name not in known}
        return resolve(settings, known, functions_of(jnp))

    def complete(self, values: Values, n: int) -> dict[str, Float[np.ndarray, " points"]]:
        self._refuse_unknown(values, self.model.parameters, "parameter")
        numbers = {name: value for name, value in self._written.items() if not isinstance(value, str)}
        return {name: column(name, value, n) for name, value in {**numbers, **values}.items()}

    def follow(self, values: Values, at: Coordinates, modes: State) -> Image:
        params = self.params(values)
        return self.ended(params, *self.state(params, self.chart.from_coordinates(params, at, modes)))

    def ended(self, params: Params, t: Float[Array, ""], state: State, status: Integer) -> Image:
        """The image of a point from the time (s), the state and the `ReturnStatus` of `state`, in JAX."""
        crossed = status == ReturnStatus.crossed
        status = jnp.where(crossed & ~self.chart.covers(params, state), ReturnStatus.elsewhere, status)
        status = jnp.where(crossed & self.model.failed(params, state), ReturnStatus.fell, status)
        observed = {**self.model.observe(params, state), "time": t}
        return self.chart.to_coordinates(params, state), state, status, observed

    def conserved_values(self, values: Values, at: Coordinates) -> Float[Array, " conserved"]:
        return self.chart.conserved_values(self.params(values), at)

    def mirrored(self, points: Points, values: Values) -> dict[str, Points]:
        complete = self.complete(values, len(points))
        images = _mirrors(self)(complete, points.at, points.modes) if self.model.symmetries() else {}
        return {name: Points(*jax.tree.map(np.asarray, image)) for name, image in images.items()}

    def settled(
        self, starts: Mapping[str, Any], values: Values, cycles: int
    ) -> tuple[Points, Int[np.ndarray, " points"]]:
        """The points that starts of the model reach after `cycles` images.

        Args:
            starts: initial conditions (n,) by name; the others have their defaults, numbers or formulas.
            values: parameters by name, numbers or (n,).
            cycles: applications of the map, 0 or more; a trajectory that fails stays at its last state.

        Returns:
            The points, and their `ReturnStatus` (n,).

        Raises:
            ArgumentError: a name is no parameter, or no start value, of the model; a start value without a
                default is missing; columns have different lengths.
        """
        refuse_fork()
        self._refuse_unknown(starts, self.model.initial_conditions, "start value")
        n = max([np.size(column) for column in (*values.values(), *starts.values())], default=1)
        starts_of_points, formulas = {}, {}
        for quantity in self.model.initial_conditions:
            start = starts.get(quantity.name, quantity.default)
            if start is None:
                raise ArgumentError(f"{quantity.name} of {self.model.name} has no default: set it in starts.")
            if isinstance(start, str):
                formulas[quantity.name] = start
            else:
                starts_of_points[quantity.name] = column(quantity.name, start, n)
        if formulas:
            known = {name: np.asarray(value) for name, value in self.resolved(values).items()}
            known = resolve(in_order(formulas), {**known, **starts_of_points})
            starts_of_points |= {name: column(name, known[name], n) for name in formulas}
        complete = self.complete(values, n)
        state, status = _settler(self, cycles)(complete, starts_of_points)
        at = jax.jit(jax.vmap(lambda v, s: self.chart.to_coordinates(self.params(v), s)))(complete, state)
        return Points(np.asarray(at), jax.tree.map(np.asarray, state)), np.asarray(status)

    def covers(self, points: Points, values: Values) -> Bool[np.ndarray, " points"]:
        """Whether the chart covers the states of points that `settled` returned, (n,).

        Args:
            points: the points.
            values: parameters by name, numbers or (n,).
        """
        complete = self.complete(values, len(points))
        covered = jax.vmap(lambda v, state: self.chart.covers(self.params(v), state))
        return np.asarray(jax.jit(covered)(complete, points.modes))

    @cached_property
    def _written(self) -> dict[str, float | str]:
        """The settings, and the defaults of the other parameters: numbers or formulas."""
        settings = dict(self.settings)
        self._refuse_unknown(settings, self.model.parameters, "parameter")
        written: dict[str, Any] = {**{q.name: q.default for q in self.model.parameters}, **settings}
        missing = [name for name, value in written.items() if value is None]
        if missing:
            raise ArgumentError(f"{missing[0]} of {self.model.name} has no default: set it in settings.")
        return written

    def _refuse_unknown(self, names: Iterable[str], known: Iterable[Quantity], kind: str) -> None:
        """Raise ArgumentError for a name that is not one of the model's quantities of a kind."""
        known_names = [q.name for q in known]
        for name in names:
            if name not in known_names:
                near = near_miss.suggestion(name, known_names)
                raise ArgumentError(f"{name} is not a {kind} of {self.model.name}{near}")

    @cached_property
    def _order(self) -> tuple[str, ...]:
        """The parameters, each after those that its formula uses."""
        uses = {name: sorted(names_used(text)) for name, text in self._written.items()}
        for names in uses.values():
            self._refuse_unknown(names, self.model.parameters, "parameter")
        try:
            return tuple(graphlib.TopologicalSorter(uses).static_order())
        except graphlib.CycleError as circle:
            raise ArgumentError(f"{' -> '.join(circle.args[1])}: these formulas use one another.") from None


@cached_by_content(maxsize=16)
def _mirrors(mapping: ModelMap) -> Callable[..., Any]:
    """The function `(values, at, modes) -> {symmetry: (at, state)}` of many points."""
    model = mapping.model
    first = {name: column[0] for name, column in mapping.complete({}, 1).items()}
    # `group_of` replaces the variables of the state, so a start by a formula need not be evaluated
    numbers = {quantity.name: quantity.default for quantity in model.initial_conditions}
    defaults = {k: jnp.asarray(x if isinstance(x, int | float) else 0.0, float) for k, x in numbers.items()}
    params = mapping.params(first)
    state = model.init(params, defaults)
    symmetries = group_of(
        model.symmetries(), params, state, lambda image: mapping.chart.to_coordinates(params, image)
    )

    def of_point(values: Any, at: Coordinates, modes: State) -> dict[str, Any]:
        params = mapping.params(values)
        state = mapping.chart.from_coordinates(params, at, modes)
        images = {}
        for name, image in symmetries.items():
            # the image under a symmetry need not be on a section
            _, crossed, status = mapping.state(params, image(params, state))
            coordinates = mapping.chart.to_coordinates(params, crossed)
            images[name] = jnp.where(status == ReturnStatus.crossed, coordinates, jnp.nan), crossed
        return images

    return map_derivatives.over_points(of_point)


@cached_by_content(maxsize=16)
def _settler(mapping: ModelMap, cycles: int) -> Callable[..., Any]:
    """The function `(values, starts) -> (state, status)` of many points, after `cycles` images."""

    def settle(values: Any, starts: Any) -> tuple[State, Integer]:
        params = mapping.params(values)
        # a loop requires constant dtypes, so none may be weak
        state = mapping.model.init(params, starts)
        start = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.result_type(leaf)), state)

        def apply(_: Any, progress: tuple[State, Integer]) -> tuple[State, Integer]:
            state, status = progress
            _, image, status_of_image = mapping.state(params, state)
            goes_on = status == ReturnStatus.crossed
            is_defined = goes_on & (status_of_image == ReturnStatus.crossed)
            status_after = jnp.where(goes_on, status_of_image, status).astype(jnp.int32)
            return select(is_defined, image, state), status_after

        crossed = jnp.asarray(ReturnStatus.crossed, jnp.int32)
        return jax.lax.fori_loop(0, cycles, apply, (start, crossed))

    return map_derivatives.over_points(settle)
