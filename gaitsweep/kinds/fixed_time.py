"""Run kind `fixed_time`: follows each row for a given time and records its state at the end."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from gaitsweep.contract import Model
from gaitsweep.design import Design
from gaitsweep.engine.recorders.fixed_time import FixedTimeRecorder, end_values
from gaitsweep.kinds.columns import GAIT, OUTCOME, STALLED_BY, STATUS, Column, label_fields, observed_at_end
from gaitsweep.kinds.run_kind import Cost, RunKind
from gaitsweep.schema.numbers import Positive


class FixedTime(RunKind):
    """Follow each row for a given time and record its state at the end; one record per row.

    The gait is that of the last section crossing before the end.
    """

    compared: ClassVar = "ends"
    one_a_row: ClassVar[bool] = True

    kind: Literal["fixed_time"] = Field(
        init=False, description="fixed_time: simulate for a given time and record the state at its end"
    )
    duration: Positive = Field(description="simulated time, in s")

    def recorder(self, model: Model) -> FixedTimeRecorder:
        return FixedTimeRecorder(model, self.duration)

    def columns(self, model: Model) -> list[Column]:
        return [
            STATUS,
            Column("cycles"),
            Column("t_end", repeats=False),
            STALLED_BY,
            *observed_at_end(model, end_values),
            GAIT,
            OUTCOME,
            *label_fields(model),
        ]

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        attempts = self.duration / period * cycle
        return Cost(attempts, attempts)
