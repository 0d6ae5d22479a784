"""The return map of a model's section: from the state just after a crossing to that after the next one.

Its coordinates are those of the model's chart. A model without a chart uses all float variables of its state:
the same map in a larger space, with a multiplier 0 for each variable that the section or the flow determines.
"""

from __future__ import annotations

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
from gaitsweep.contract import Chart, HybridModel, Model, Params, Quantity, State
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.fork import refuse_fork
from gaitsweep.engine.leaves import float_leaves, is_float, with_float_leaves
from gaitsweep.engine.numerics import Numerics, ResolvedNumerics
from gaitsweep.engine.poincare.event_record import EventRecord, recorded_return
from gaitsweep.engine.poincare.maps import (
    BATCH_SIZES,
    Coordinates,
    Events,
    FollowedMap,
    Image,
    Points,
    Values,
)
from gaitsweep.engine.poincare.poincare_return import Returned, ReturnStatus, crossing_of
from gaitsweep.engine.poincare.symmetry_group import group_of
from gaitsweep.engine.shapes import Integer
from gaitsweep.errors import ArgumentError
from gaitsweep.expression import functions_of, names_in, resolve

# The fraction of the step of a refined map.
REFINED = 0.5


@dataclasses.dataclass(frozen=True)
class AllVariables(Chart):
    """All float variables of a state as coordinates, for models without a chart; `names` are their names."""

    names: tuple[str, ...]

    @classmethod
    def of(cls, state: State) -> AllVariables:
        """The chart of states like this one."""
        names: list[str] = []
        for path, leaf in jax.tree_util.tree_leaves_with_path(state):
            if is_float(leaf):
                field = jax.tree_util.keystr(path, simple=True, separator="_")
                names += ["_".join([field, *(str(i + 1) for i in at)]) for at in np.ndindex(*np.shape(leaf))]
        return cls(tuple(names))

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return tuple(Quantity(name, "", f"{name} of the state") for name in self.names)

    def to_coordinates(self, params: Params, state: State) -> Coordinates:
        return jnp.concatenate([jnp.ravel(leaf).astype(jnp.float64) for leaf in float_leaves(state)])

    def from_coordinates(self, params: Params, at: Coordinates, modes: State) -> State:
        leaves = float_leaves(modes)
        cuts = np.cumsum([leaf.size for leaf in leaves])[:-1]
        pieces = jnp.split(at, cuts.tolist())
        shaped = [p.reshape(x.shape).astype(x.dtype) for p, x in zip(pieces, leaves, strict=True)]
        return with_float_leaves(modes, shaped)


@dataclasses.dataclass(frozen=True)
class BatchedReturnMap(FollowedMap):
    """The return map of a model, in JAX and for many points at once.

    Args:
        model: the model.
        settings: (name, number or formula) of the parameters that are not at their defaults.
        numerics: by default the recommendations of the model. With located events (tsit5, rk4, propagator6,
            propagator) the map has derivatives; in steps of fixed length it is a staircase of that step's
            size, and derivatives are refused.
        engine: kernel, xla, or auto: kernel where the model and the machine allow it.
    """

    model: Model
    settings: tuple[tuple[str, float | str], ...] = ()
    numerics: Numerics | ResolvedNumerics = dataclasses.field(default_factory=Numerics)
    engine: str = "auto"

    @cached_property
    def integration(self) -> ResolvedNumerics:
        """The resolved numerics; those of a job's map are resolved already."""
        numerics = self.numerics
        return numerics if isinstance(numerics, ResolvedNumerics) else numerics.resolve(self.model)

    def refined(self, factor: float = REFINED) -> BatchedReturnMap:
        """The same map with a factor on its steps: half of them, or tolerances 32 times finer."""
        return dataclasses.replace(self, numerics=self.integration.refined(factor))

    @property
    def durations(self) -> tuple[str, ...]:
        return ("time",)

    @cached_property
    def chart(self) -> Chart:
        """The model's chart, or all float variables of a state."""
        return self.model.chart() or AllVariables.of(self._shape)

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return self.chart.coordinates

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        return self.chart.conserved

    def params(self, values: Values) -> Params:
        """The model's parameters: values, then settings, then defaults; formulas are evaluated."""
        return self.model.params(self.resolved(values))

    def resolved(self, values: Values) -> dict[str, Any]:
        """All parameters by name: values, then settings, then defaults; formulas are evaluated."""
        known: dict[str, Any] = {name: jnp.asarray(value) for name, value in values.items()}
        settings = {name: self._written[name] for name in self._order if name not in known}
        return resolve(settings, known, functions_of(jnp))

    def complete(self, values: Values, n: int) -> dict[str, Float[np.ndarray, " points"]]:
        self._refuse_unknown(values)
        numbers = {name: text for name, text in self._written.items() if not isinstance(text, str)}
        return {
            name: np.broadcast_to(np.asarray(value, np.float64), (n,)).copy()
            for name, value in {**numbers, **values}.items()
        }

    def state(self, params: Params, state: State) -> Returned:
        """The time (s) to the next crossing, the state just after it, and the `ReturnStatus`, in JAX."""
        return crossing_of(self.model, self.integration, self.engine)(params, state)

    def follow(self, values: Values, at: Coordinates, modes: State) -> Image:
        params = self.params(values)
        t, state, status = self.state(params, self.chart.from_coordinates(params, at, modes))
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
        images = {name: jax.tree.map(np.asarray, image) for name, image in images.items()}
        return {
            name: Points(np.asarray(at), jax.tree.map(np.asarray, modes))
            for name, (at, modes) in images.items()
        }

    def events(self, points: Points, values: Values) -> list[Events]:
        complete, pieces = self.complete(values, len(points)), []
        for first in range(0, len(points), BATCH_SIZES[-1]):
            # one size of batches, for which the program is compiled once
            order = np.minimum(first + np.arange(BATCH_SIZES[-1]), len(points) - 1)
            batch, own = points[order], {name: column[order] for name, column in complete.items()}
            pieces.append(jax.tree.map(np.asarray, _recorder(self)(own, batch.at, batch.modes)))
        times, counts = (np.concatenate(leaves)[: len(points)] for leaves in zip(*pieces, strict=True))
        given = self.model.guard_names if isinstance(self.model, HybridModel) else ()
        names = given or [f"guard {guard + 1}" for guard in range(counts.shape[1])]
        events: list[Events] = []
        for own, of_guards in zip(times, counts, strict=True):
            timed = [(float(own[k, g]), names[g]) for g in range(len(names)) for k in range(len(own))]
            untimed = [(float("inf"), names[g]) for g in np.flatnonzero(of_guards > len(own))]
            events.append(sorted([event for event in timed if event[0] >= 0.0] + untimed))
        return events

    def settled(
        self, starts: Mapping[str, Any], values: Values, cycles: int
    ) -> tuple[Points, Int[np.ndarray, " points"]]:
        """The points that starts of the model reach after `cycles` crossings, and the `ReturnStatus` of each.

        Args:
            starts: initial conditions (n,) by name; the others have their defaults.
            values: parameters by name, numbers or (n,).
            cycles: crossings, 0 or more; a trajectory that fails stays at its last state.

        Returns:
            The points, and their `ReturnStatus` (n,).
        """
        refuse_fork()
        n = max([np.size(v) for v in (*starts.values(), *values.values())], default=1)
        starts_of_points = {
            q.name: np.broadcast_to(np.asarray(starts.get(q.name, q.default), np.float64), (n,))
            for q in self.model.initial_conditions
        }
        complete = self.complete(values, n)
        state, status = _settler(self, cycles)(complete, starts_of_points)
        at = jax.jit(jax.vmap(lambda v, s: self.chart.to_coordinates(self.params(v), s)))(complete, state)
        return Points(np.asarray(at), jax.tree.map(np.asarray, state)), np.asarray(status)

    def covers(self, points: Points, values: Values) -> Bool[np.ndarray, " points"]:
        """Whether the states of points, which `settled` returned, are on the section as its chart has it."""
        complete = self.complete(values, len(points))
        on_section = jax.vmap(lambda v, state: self.chart.covers(self.params(v), state))
        return np.asarray(jax.jit(on_section)(complete, points.modes))

    @cached_property
    def _written(self) -> dict[str, float | str]:
        """The settings, and the defaults of the other parameters: numbers or formulas."""
        settings = dict(self.settings)
        self._refuse_unknown(settings)
        written: dict[str, Any] = {**{q.name: q.default for q in self.model.parameters}, **settings}
        missing = [name for name, value in written.items() if value is None]
        if missing:
            raise ArgumentError(f"{missing[0]} of {self.model.name} has no default: set it in settings.")
        return written

    def _refuse_unknown(self, names: Iterable[str]) -> None:
        known = [q.name for q in self.model.parameters]
        for name in names:
            if name not in known:
                near = near_miss.suggestion(name, known)
                raise ArgumentError(f"{name} is not a parameter of {self.model.name}{near}")

    @cached_property
    def _order(self) -> tuple[str, ...]:
        """The parameters, each after those that its formula uses."""
        uses = {name: sorted(names_in(text)) for name, text in self._written.items()}
        return tuple(graphlib.TopologicalSorter(uses).static_order())

    @cached_property
    def _shape(self) -> State:
        """The shapes of a state."""
        starts = {q.name: jax.ShapeDtypeStruct((), jnp.float64) for q in self.model.initial_conditions}
        values = {name: jax.ShapeDtypeStruct((), jnp.float64) for name in self.complete({}, 1)}
        return jax.eval_shape(lambda v, s: self.model.init(self.params(v), s), values, starts)


@cached_by_content(maxsize=16)
def _mirrors(mapping: BatchedReturnMap) -> Callable[..., Any]:
    """The function `(values, at, modes) -> {symmetry: (at, state)}` of many points."""
    model = mapping.model
    first = {name: column[0] for name, column in mapping.complete({}, 1).items()}
    defaults = {q.name: jnp.asarray(q.default or 0.0, float) for q in model.initial_conditions}
    params = mapping.params(first)
    state = model.init(params, defaults)
    symmetries = group_of(
        model.symmetries(), params, state, lambda image: mapping.chart.to_coordinates(params, image)
    )

    def one(values: Any, at: Coordinates, modes: State) -> dict[str, Any]:
        params = mapping.params(values)
        state = mapping.chart.from_coordinates(params, at, modes)
        images = {}
        for name, image in symmetries.items():
            # the image need not be on the section
            _, crossed, status = mapping.state(params, image(params, state))
            coordinates = mapping.chart.to_coordinates(params, crossed)
            images[name] = jnp.where(status == ReturnStatus.crossed, coordinates, jnp.nan), crossed
        return images

    return jax.jit(jax.vmap(one))


@cached_by_content(maxsize=16)
def _recorder(mapping: BatchedReturnMap) -> Callable[..., EventRecord]:
    """The function `(values, at, modes) -> EventRecord` of many points."""
    model = mapping.model
    assert isinstance(model, HybridModel)

    def one(values: Any, at: Coordinates, modes: State) -> EventRecord:
        params = mapping.params(values)
        state = mapping.chart.from_coordinates(params, at, modes)
        return recorded_return(model, mapping.integration, mapping.engine)(params, state)

    return jax.jit(jax.vmap(one))


@cached_by_content(maxsize=16)
def _settler(mapping: BatchedReturnMap, cycles: int) -> Callable[..., Any]:
    """The function `(values, starts) -> (state, status)` of many points, after `cycles` crossings."""

    def one(values: Any, starts: Any) -> tuple[State, Integer]:
        params = mapping.params(values)
        # a loop requires constant dtypes, so none may be weak
        begun = jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(x)), mapping.model.init(params, starts))

        def turn(_: Any, loop: tuple[State, Integer]) -> tuple[State, Integer]:
            state, status = loop
            _, moved, status_after = mapping.state(params, state)
            going = (status == ReturnStatus.crossed) & (status_after == ReturnStatus.crossed)
            last = jax.tree.map(lambda a, b: jnp.where(going, a, b), moved, state)
            return last, jnp.where(status == ReturnStatus.crossed, status_after, status).astype(jnp.int32)

        crossed = jnp.asarray(ReturnStatus.crossed, jnp.int32)
        return jax.lax.fori_loop(0, cycles, turn, (begun, crossed))

    return jax.jit(jax.vmap(one))
