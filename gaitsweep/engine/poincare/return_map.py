"""The return map of a model's section: from the state just after a crossing to that after the next one.

Its coordinates are those of the model's chart. A model without a chart uses all float variables of its state:
the same map in a larger space, with a multiplier 0 for each variable that the section or the flow determines.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from gaitsweep.contract import Chart, HybridModel, Params, State
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.leaves import AllVariables
from gaitsweep.engine.numerics import Numerics, ResolvedNumerics
from gaitsweep.engine.poincare.event_record import EventRecord, recorded_return
from gaitsweep.engine.poincare.maps import BATCH_SIZES, Coordinates, Events, Points, Values
from gaitsweep.engine.poincare.model_map import ModelMap
from gaitsweep.engine.poincare.poincare_return import Returned, crossing_of
from gaitsweep.engine.solver import fixed_step_scheme

# The fraction of the step of a refined map.
REFINED = 0.5


@dataclasses.dataclass(frozen=True)
class BatchedReturnMap(ModelMap):
    """The return map of a model, in JAX and for many points at once.

    Args:
        model, settings: as of `ModelMap`.
        numerics: by default the recommendations of the model. With located events (tsit5, rk4, propagator6,
            propagator) the map has derivatives; in steps of fixed length it is a staircase of that step's
            size, and derivatives are refused.
        engine: kernel, xla, or auto: kernel where the model and the machine allow it.
    """

    numerics: Numerics | ResolvedNumerics = dataclasses.field(default_factory=Numerics)
    engine: str = "auto"

    @cached_property
    def integration(self) -> ResolvedNumerics:
        """The resolved numerics; those of a job's map are resolved already."""
        numerics = self.numerics
        return numerics if isinstance(numerics, ResolvedNumerics) else numerics.resolve(self.model)

    def refined(self, factor: float = REFINED) -> BatchedReturnMap | None:
        """The same map with a factor on its steps: half of them, or tolerances 32 times finer."""
        if self._is_step:
            return None
        return dataclasses.replace(self, numerics=self.integration.refined(factor))

    def _chart(self) -> Chart:
        return self.model.chart() or AllVariables.of(self._shape)

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
        complete = self.complete(values, len(points))
        batches: list[EventRecord] = []
        for first in range(0, len(points), BATCH_SIZES[-1]):
            # one size of batches, for which the program is compiled once
            order = np.minimum(first + np.arange(BATCH_SIZES[-1]), len(points) - 1)
            batch = points[order]
            parameters = {name: column[order] for name, column in complete.items()}
            record = _recorder(self)(parameters, batch.at, batch.modes)
            batches.append(jax.tree.map(np.asarray, record))
        times = np.concatenate([batch_times for batch_times, _ in batches])[: len(points)]
        counts = np.concatenate([batch_counts for _, batch_counts in batches])[: len(points)]
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
        # later events of a guard have no time: they are listed after its last one that has
        events += [(float(times_of_guard[-1]), name)] * max(int(count) - len(times_of_guard), 0)
    return sorted(events)


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
