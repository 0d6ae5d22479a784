"""The return map of a model's section: from the state just after a crossing to that after the next one.

Its coordinates are those of the model's chart. A model without a chart uses all float variables of its state:
the same map in a larger space, with a multiplier 0 for each variable that the section or the flow determines.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaitsweep.contract import Chart, HybridModel, Params, Rates, State
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.leaves import extended
from gaitsweep.engine.numerics import Numerics, ResolvedNumerics
from gaitsweep.engine.poincare import map_derivatives
from gaitsweep.engine.poincare.map_derivatives import BATCH_SIZES, in_batches
from gaitsweep.engine.poincare.maps import Coordinates, Events, Points, Values
from gaitsweep.engine.poincare.model_map import ModelMap
from gaitsweep.engine.poincare.poincare_return import Returned, ReturnEngine, crossing, crossing_of
from gaitsweep.engine.solver.methods import fixed_step_scheme
from gaitsweep.engine.stored_traces import shapes_of
from gaitsweep.engine.tangents import chart_of

# Events of one guard between two crossings that have a time.
MAX_TIMED_EVENTS = 3
# The fields of a state that hold the record: the time (s), and for each guard the times of its first events
# and their number.
RECORD_FIELDS = ("event_clock", "event_times", "event_counts")

# The fraction of the step of a refined map.
REFINED = 0.5


class EventRecord(NamedTuple):
    """The events of one return.

    Attributes:
        times: the times (s) of the first events of each guard (MAX_TIMED_EVENTS, guards), NaN where there was
            none.
        counts: the number of events of each guard (guards,).
    """

    times: Float[Array, "timed guards"]
    counts: Int[Array, " guards"]


@dataclasses.dataclass(frozen=True)
class BatchedReturnMap(ModelMap):
    """The return map of a model, in JAX and for many points at once.

    Args:
        model: the model.
        settings: as of `ModelMap`.
        numerics: by default the recommendations of the model. With located events (tsit5, rk4, propagator6,
            propagator) the map has derivatives; in steps of fixed length it is a staircase of that step's
            size, and derivatives are refused.
        engine: kernel, xla, or auto: kernel where the model and the machine allow it.
    """

    numerics: Numerics | ResolvedNumerics = dataclasses.field(default_factory=Numerics)
    engine: ReturnEngine = "auto"

    @cached_property
    def integration(self) -> ResolvedNumerics:
        """The resolved numerics; those of a job's map are resolved already."""
        numerics = self.numerics
        return numerics if isinstance(numerics, ResolvedNumerics) else numerics.resolve(self.model)

    def refined(self, factor: float = REFINED) -> BatchedReturnMap | None:
        """The same map with a finer integration; None for a model whose step is the map.

        Args:
            factor: the factor on its steps; with half the step, tolerances are 32 times finer.
        """
        if self._is_step:
            return None
        return dataclasses.replace(self, numerics=self.integration.refined(factor))

    def _chart(self) -> Chart:
        return chart_of(self.model, shapes_of(self.model)[1])

    def state(self, params: Params, state: State) -> Returned:
        """The time (s) to the next crossing, the state just after it, and the `ReturnStatus`, in JAX."""
        return crossing_of(self.model, self.integration, self.engine)(params, state)

    @property
    def _is_step(self) -> bool:
        """Whether the map is the model's own step, which has no events within it."""
        steps = fixed_step_scheme(self.integration.method, self.model)
        return steps is not None and steps.is_return_map

    def events(self, points: Points, values: Values) -> list[Events]:
        if self._is_step:
            return [[] for _ in range(len(points))]
        # one size of batches, for which the program is compiled once
        parameters = self.complete(values, len(points))
        times, counts = in_batches(_recorder(self), points, parameters, BATCH_SIZES[-1:])
        declared = self.model.guard_names if isinstance(self.model, HybridModel) else ()
        names = declared or [f"guard {guard + 1}" for guard in range(counts.shape[1])]
        return [_in_order(*point, names) for point in zip(times, counts, strict=True)]


def _in_order(
    times: Float[np.ndarray, "timed guards"], counts: Int[np.ndarray, " guards"], names: Sequence[str]
) -> Events:
    """The events of one point in their order, from its `EventRecord` and the names of the guards."""
    events: Events = []
    for times_of_guard, count, name in zip(times.T, counts, names, strict=True):
        events += [(float(t), name) for t in times_of_guard if t >= 0.0]
        # later events of a guard have no time of their own: they get that of the last one that has
        untimed = max(int(count) - len(times_of_guard), 0)
        events += [(float(times_of_guard[-1]), name)] * untimed
    return sorted(events)


@cached_by_content(maxsize=16)
def _recorder(mapping: BatchedReturnMap) -> Callable[..., EventRecord]:
    """The function `(values, at, modes) -> EventRecord` of many points."""
    model = mapping.model
    assert isinstance(model, HybridModel)

    def of_point(values: Any, at: Coordinates, modes: State) -> EventRecord:
        params = mapping.params(values)
        state = mapping.chart.from_coordinates(params, at, modes)
        return _recorded_return(model, mapping.integration, mapping.engine)(params, state)

    return map_derivatives.over_points(of_point)


def _recorded_return(
    model: HybridModel, numerics: ResolvedNumerics, engine: ReturnEngine
) -> Callable[[Params, State], EventRecord]:
    """The function `(params, state) -> EventRecord` of the return from a state, in JAX.

    Args:
        model: the model.
        numerics: the method and its tolerances.
        engine: as for `crossing_of`.
    """

    def recorded(params: Params, state: State) -> EventRecord:
        guards = jax.eval_shape(model.guards, params, state).shape

        def flow(params: Params, state: State) -> Rates:
            return {**model.flow(params, state), RECORD_FIELDS[0]: jnp.ones(())}

        def jump(params: Params, before: State, fired: Bool[Array, " guards"]) -> State:
            clock, times, counts = (getattr(before, name) for name in RECORD_FIELDS)
            happened = model.occurred(params, before, fired)
            place = jnp.arange(MAX_TIMED_EVENTS)[:, None] == counts[None]
            times = jnp.where(happened[None] & place, clock, times)
            after = model.jump(params, before, fired)
            record = clock, times, counts + happened.astype(counts.dtype)
            return extended(after, RECORD_FIELDS, record)

        # The model itself, whose state has a clock and a record of events beside its variables. Its class
        # stays that of the model, whose members look at it; `vars` reaches the fields of a frozen instance.
        # Its content is that of the model, so its crossing must not be kept under it.
        recording = copy.copy(model)
        vars(recording).update(flow=flow, jump=jump)
        next_crossing = crossing(recording, numerics, engine)
        empty = jnp.zeros(()), jnp.zeros((MAX_TIMED_EVENTS, *guards)), jnp.zeros(guards, jnp.int32)
        _, end, _ = next_crossing(params, extended(state, RECORD_FIELDS, empty))
        _, times, counts = (getattr(end, name) for name in RECORD_FIELDS)
        happened = jnp.arange(MAX_TIMED_EVENTS)[:, None] < counts[None]
        return EventRecord(jnp.where(happened, times, jnp.nan), counts)

    return recorded
