"""A map whose fixed points are the stationary points of a model's flow x' = f(x).

One linearly implicit step g(x) = x + h (1 - h J / 2)^-1 f(x), J = Df, leaves a point where it is exactly if
f = 0 there. Its derivative at such a point is the Cayley transform of J: an eigenvalue lambda becomes the
multiplier (2 + h lambda) / (2 - h lambda), which is outside the unit circle where lambda has a positive real
part, 1 where lambda = 0, and -1 for no lambda. So all that is known of fixed points applies to stationary
points. The step h is shorter than 2 / |lambda|, so that no multiplier is infinite.

Source of the transform: Garratt, Moore and Spence 1991, Int. Ser. Numer. Math. 97:129.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from gaitsweep import near_miss
from gaitsweep.contract import Chart, HybridModel, Params, Quantity, State
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.leaves import element_names, split_like, vector
from gaitsweep.engine.poincare.maps import MIN_SCALE, Coordinates, Events, Points, Values
from gaitsweep.engine.poincare.model_map import ModelMap
from gaitsweep.engine.poincare.poincare_return import Returned, ReturnStatus
from gaitsweep.engine.stored_traces import shapes_of
from gaitsweep.errors import ArgumentError

# Bound of h |lambda| / 2.
MAX_HALF_STEP = 0.75
# Displacements of a start, relative to the sizes of its variables, with which the flow is checked.
DISPLACEMENT = 0.1


@dataclasses.dataclass(frozen=True)
class FlowVariables(Chart):
    """The variables that a flow moves; those that are no coordinates keep their values.

    Args:
        model: the model.
        fields: the fields of a state that the flow moves.
        places: the places of the coordinates among all numbers of these fields.
        quantities: the coordinates.
    """

    model: HybridModel
    fields: tuple[str, ...]
    places: tuple[int, ...]
    quantities: tuple[Quantity, ...]

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return self.quantities

    def to_coordinates(self, params: Params, state: State) -> Coordinates:
        return vector([getattr(state, name) for name in self.fields])[jnp.array(self.places)]

    def from_coordinates(self, params: Params, at: Coordinates, modes: State) -> State:
        old = [jnp.asarray(getattr(modes, name)) for name in self.fields]
        numbers = vector(old).at[jnp.array(self.places)].set(at)
        return dataclasses.replace(modes, **dict(zip(self.fields, split_like(numbers, old), strict=True)))

    def rates(self, params: Params, state: State) -> Coordinates:
        """The rates (n,) of the coordinates."""
        rates = self.model.flow(params, state)
        shapes = {name: jnp.shape(getattr(state, name)) for name in self.fields}
        full = [jnp.broadcast_to(rates[name], shape) for name, shape in shapes.items()]
        return vector(full)[jnp.array(self.places)]


@dataclasses.dataclass(frozen=True)
class StationaryMap(ModelMap):
    """The map whose fixed points are the stationary points of a hybrid model's flow, in the modes of a point.

    A point is not defined (`ReturnStatus.elsewhere`) where an event that would change the motion is past. The
    observable `time` is the step h (s).

    Args:
        model: the model.
        settings: as of `ModelMap`.
        without: variables that need not rest: they keep the values of the start.
    """

    without: tuple[str, ...] = ()

    def refined(self) -> None:
        return None

    def events(self, points: Points, values: Values) -> list[Events]:
        return [[] for _ in range(len(points))]

    def _chart(self) -> Chart:
        return self.flow

    @cached_property
    def flow(self) -> FlowVariables:
        """The variables that the flow moves, and their rates.

        Raises:
            ArgumentError: the model has no flow, or `without` has a name that is no variable of it, or all.
        """
        model = self.model
        if not isinstance(model, HybridModel):
            raise ArgumentError(f"{model.name} moves in steps: it has no flow, so no stationary points.")
        params, shapes = shapes_of(model)
        rates = jax.eval_shape(model.flow, params, shapes)
        fields = tuple(field.name for field in dataclasses.fields(shapes) if field.name in rates)
        known = {q.name: q for q in (*model.signals, *model.observables)}
        names = [name for field in fields for name in element_names(field, getattr(shapes, field).shape)]
        for name in self.without:
            if name not in names:
                near = near_miss.suggestion(name, names)
                raise ArgumentError(f"{name} is no variable of the flow of {model.name}{near}")
        places = tuple(place for place, name in enumerate(names) if name not in self.without)
        if not places:
            raise ArgumentError(
                f"without leaves out all variables of the flow of {model.name}: {', '.join(names)}."
            )
        coordinates = [names[place] for place in places]
        quantities = [known.get(name, Quantity(name, "", f"{name} of the state")) for name in coordinates]
        return FlowVariables(model, fields, places, tuple(quantities))

    def rates(self, values: Values, at: Coordinates, modes: State) -> Coordinates:
        """The rates (n,) of the coordinates at one point, in JAX.

        Args:
            values: parameters by name, one scalar each.
            at: the coordinates (n,) of the point.
            modes: a state with its discrete modes.
        """
        params = self.params(values)
        return self.flow.rates(params, self.flow.from_coordinates(params, at, modes))

    def state(self, params: Params, state: State) -> Returned:
        flow = self.flow
        at = flow.to_coordinates(params, state)

        def rates(at: Coordinates) -> Coordinates:
            return flow.rates(params, flow.from_coordinates(params, at, state))

        f = rates(at)
        jacobian = jax.jacfwd(rates)(at)
        scale = jnp.sqrt(MIN_SCALE**2 + at**2)
        # a bound of the largest |lambda|^2
        squared_norm = jnp.sum((jacobian * scale[None] / scale[:, None]) ** 2)
        frequency = 2.0 * jnp.pi / self.model.period(params)
        step = 2.0 * MAX_HALF_STEP / jnp.sqrt(frequency**2 + squared_norm)
        moved = at + step * jnp.linalg.solve(jnp.eye(at.size) - 0.5 * step * jacobian, f)
        status = jnp.where(self._is_past(params, state), ReturnStatus.elsewhere, ReturnStatus.crossed)
        sound = jnp.all(jnp.isfinite(moved)) & jnp.isfinite(step)
        status = jnp.where(sound, status, ReturnStatus.lost).astype(jnp.int32)
        return step, flow.from_coordinates(params, moved, state), status

    def _is_past(self, params: Params, state: State) -> Bool[Array, ""]:
        """Whether a state is beyond an event whose jump changes its variables or their rates."""
        flow = self.flow
        params = jax.lax.stop_gradient(params)
        state = jax.lax.stop_gradient(state)
        past = flow.model.guards(params, state) > 0.0
        if not past.size:
            return jnp.zeros((), bool)

        def changes(fired: Bool[Array, " guards"]) -> Bool[Array, ""]:
            after = flow.model.jump(params, state, fired)
            moved = flow.to_coordinates(params, after) != flow.to_coordinates(params, state)
            return jnp.any(moved | (flow.rates(params, after) != flow.rates(params, state)))

        return jnp.any(past & jax.vmap(changes)(jnp.eye(past.size, dtype=bool)))

    def refusal(self, points: Points, values: Values) -> str | None:
        """The reason why no point near the first of some points is an isolated stationary point, or None.

        Args:
            points: the points.
            values: parameters by name, numbers or (n,).
        """
        at = points.at[0]
        relative = np.random.default_rng(0).uniform(-DISPLACEMENT, DISPLACEMENT, (2, at.size))
        displacements = relative * (MIN_SCALE + np.abs(at))
        parameters = {name: column[0] for name, column in self.complete(values, len(points)).items()}
        near = [linearised_flow(self)(parameters, at + shift, points[0].modes) for shift in displacements]
        rates = np.stack([flow_rates for flow_rates, _ in near])
        jacobians = np.stack([jacobian for _, jacobian in near])
        for k, quantity in enumerate(self.coordinates):
            variable = f"{quantity.name} of {self.model.name}"
            leave_out = "name it in `without`."
            if rates[:, k].all() and not jacobians[:, k].any():
                rate = f"{rates[0, k]:g} {quantity.unit or '1'}/s"
                return f"{variable} always changes by {rate}, so it is never at rest: {leave_out}"
            if not jacobians[:, :, k].any():
                return f"No rate depends on {variable}, so no point of rest is isolated: {leave_out}"
        return None


@cached_by_content(maxsize=16)
def linearised_flow(mapping: StationaryMap) -> Callable[..., Any]:
    """The function `(values, at, modes) -> (rates, their Jacobian)` of one point."""

    def linearised(values: Any, at: Coordinates, modes: State) -> Any:
        jacobian = jax.jacfwd(lambda x: mapping.rates(values, x, modes))(at)
        return mapping.rates(values, at, modes), jacobian

    return jax.jit(linearised)


@cached_by_content(maxsize=16)
def flow_derivatives(mapping: StationaryMap) -> Callable[..., Any]:
    """The second and third derivatives of a flow along directions.

    Returns:
        The function `(values, at, modes, u, v, w) -> (D^2 f u v, D^3 f u v w)` of one point and of n triples
        of directions u, v, w, (n, size) each.
    """

    def along(values: Any, at: Coordinates, modes: State, u: Any, v: Any, w: Any) -> Any:
        def first(x: Coordinates) -> Coordinates:
            return jax.jvp(lambda x: mapping.rates(values, x, modes), (x,), (u,))[1]

        def second(x: Coordinates) -> Coordinates:
            return jax.jvp(first, (x,), (v,))[1]

        return jax.jvp(second, (at,), (w,))

    return jax.jit(jax.vmap(along, in_axes=(None, None, None, 0, 0, 0)))


def eigenvalues(
    multipliers: Complex[np.ndarray, " *points"], step: Float[np.ndarray, " *points"] | float
) -> Complex[np.ndarray, " *points"]:
    """The eigenvalues (1/s) of a flow from the multipliers of its `StationaryMap`.

    Args:
        multipliers: the multipliers.
        step: the step h of the map (s), its observable `time`.
    """
    return 2.0 / step * (multipliers - 1.0) / (multipliers + 1.0)
