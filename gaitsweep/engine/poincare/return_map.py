"""The return map of a model's section: from the state just after a crossing to that after the next one.

Its coordinates are those of the model's chart. A model without a chart uses all float variables of its state:
the same map in a larger space, with a multiplier 0 for each variable that the section or the flow determines.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import Any

import jax
import numpy as np

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
        pieces = []
        for first in range(0, len(points), BATCH_SIZES[-1]):
            # one size of batches, for which the program is compiled once
            order = np.minimum(first + np.arange(BATCH_SIZES[-1]), len(points) - 1)
            batch = points[order]
            own = {name: column[order] for name, column in complete.items()}
            pieces.append(jax.tree.map(np.asarray, _recorder(self)(own, batch.at, batch.modes)))
        times, counts = (np.concatenate(leaves)[: len(points)] for leaves in zip(*pieces, strict=True))
        declared = self.model.guard_names if isinstance(self.model, HybridModel) else ()
        names = declared or [f"guard {guard + 1}" for guard in range(counts.shape[1])]
        events: list[Events] = []
        for own, of_guards in zip(times, counts, strict=True):
            timed = [(float(own[k, g]), names[g]) for g in range(len(names)) for k in range(len(own))]
            # later events of a guard have no time: they are listed after its last one that has
            more = np.maximum(of_guards - len(own), 0)
            untimed = [(float(own[-1, g]), names[g]) for g in range(len(names)) for _ in range(more[g])]
            events.append(sorted([event for event in timed if event[0] >= 0.0] + untimed))
        return events


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
