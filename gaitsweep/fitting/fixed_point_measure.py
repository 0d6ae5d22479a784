"""Measure of a fixed point of the return map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from gaitsweep.analysis.continuation.floquet_multipliers import multipliers
from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.contract import Model
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.fitting.measure import Measure, Measured, SetRows
from gaitsweep.fitting.measure_fields import FieldError, unknown_name
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.schema.numbers import CountOrZero, Text

# Values of the field `of` beside the names of observables.
_MULTIPLIER = "multiplier"
_UNSTABLE = "unstable"


class FixedPoint(Measure):
    """Multiplier of a fixed point of the return map, or an observable there.

    Newton's method begins at the point that a start reaches after `settle` cycles, so the fixed point may be
    unstable; the map needs located events.
    """

    on_map: ClassVar[bool] = True
    angle_field: ClassVar[str | None] = "of_"

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
        """Measure n sets at their one condition.

        Args:
            mapping: the return map.
            values: parameters (n,) by name.
            starts: start values (n,) by name.
            n: the number of sets.
        """
        points, statuses = mapping.settled(starts, values, self.settle)
        fixed_points = newton(mapping, points, values, fix=self.fix)
        measured = np.full(n, np.nan)
        converged = np.flatnonzero(fixed_points.converged & (statuses == ReturnStatus.crossed))
        if converged.size:
            images = fixed_points.images
            if self.of_ in images.observed:
                measured[converged] = np.asarray(images.observed[self.of_], float)[converged]
            else:
                names = [quantity.name for quantity in mapping.conserved]
                fixed = [names.index(name) for name in self.fix]
                conserved = images.conserved_jacobian[converged][:, fixed]
                moduli = np.abs(multipliers(images.jacobian[converged], conserved))
                is_largest = self.of_ == _MULTIPLIER
                measured[converged] = moduli[:, 0] if is_largest else (moduli > 1.0).sum(axis=1)
        why = np.where(np.isnan(measured), "no fixed point found", "")
        return Measured(measured, why)

    def unit(self, model: Model) -> str:
        return {quantity.name: quantity.unit for quantity in model.observables}.get(self.of_, "1")

    @property
    def own_run(self) -> RunKind | None:
        return None

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        lists = [name for name, values in self.at.items() if len(values) > 1]
        if lists:
            return "at", f"has a list of {lists[0]}, but a fixed point takes one number for each name."
        allowed = [_MULTIPLIER, _UNSTABLE, *(quantity.name for quantity in model.observables)]
        if self.of_ not in allowed:
            return "of", f"is {unknown_name(self.of_, allowed)}"
        chart = model.chart()
        conserved = [] if chart is None else [quantity.name for quantity in chart.conserved]
        for name in self.fix:
            if name not in conserved:
                return "fix", f"is {unknown_name(name, conserved)}"
        return None
