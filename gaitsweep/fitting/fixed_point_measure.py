"""The measure of a fixed point of the return map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from gaitsweep.analysis.continuation.newton import multipliers, newton
from gaitsweep.contract import Model
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.fitting.measure import FieldError, Measure, Measured, SetRows, unknown_name
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.schema.numbers import CountOrZero, Text

_MULTIPLIER, _UNSTABLE = "multiplier", "unstable"


class FixedPoint(Measure):
    """A fixed point of the return map near where a start leads: its multiplier, or an observable there.

    It is found by Newton's method, so it may be unstable; the map needs located events.
    """

    on_map: ClassVar[bool] = True
    reads_angles: ClassVar[bool] = True

    kind: Literal["fixed_point"] = Field(
        description="fixed_point: of the return map, by Newton's method: a multiplier or an observable"
    )
    of_: Text = Field(
        alias="of",
        description="multiplier (the largest modulus), unstable (how many exceed 1), or an observable",
    )
    settle: CountOrZero = Field(default=30, description="cycles before Newton's method begins")
    fix: list[Text] = Field(default=[], description="conserved quantities that stay as they are")

    def of_starts(self, mapping: BatchedReturnMap, values: SetRows, starts: SetRows, n: int) -> Measured:
        """Measure n sets, whose one condition has these parameters and starts (n,)."""
        points, reached = mapping.settled(starts, values, self.settle)
        fixed = newton(mapping, points, values, fix=self.fix)
        measured = np.full(n, np.nan)
        converged = np.flatnonzero(fixed.converged & (reached == ReturnStatus.crossed))
        if converged.size:
            images = fixed.images
            if self.of_ in images.observed:
                measured[converged] = np.asarray(images.observed[self.of_], float)[converged]
            else:
                names = [quantity.name for quantity in mapping.conserved]
                conserved = images.conserved_jacobian[converged][:, [names.index(name) for name in self.fix]]
                size = np.abs(multipliers(images.jacobian[converged], conserved))
                measured[converged] = size[:, 0] if self.of_ == _MULTIPLIER else (size > 1.0).sum(axis=1)
        why = np.where(np.isnan(measured), "no fixed point found", "")
        return Measured(measured, why)

    def unit(self, model: Model) -> str:
        return {q.name: q.unit for q in model.observables}.get(self.of_, "1")

    @property
    def own_run(self) -> RunKind | None:
        return None

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        lists = [name for name, values in self.at.items() if len(values) > 1]
        if lists:
            return "at", f"has a list of {lists[0]}, but a fixed point takes one number for each name."
        allowed = [_MULTIPLIER, _UNSTABLE, *(q.name for q in model.observables)]
        if self.of_ not in allowed:
            return "of", f"is {unknown_name(self.of_, allowed)}"
        chart = model.chart()
        names = [] if chart is None else [q.name for q in chart.conserved]
        unknown = [name for name in self.fix if name not in names]
        return ("fix", f"is {unknown_name(unknown[0], names)}") if unknown else None
