"""Run kind `return_map`: successive crossings of the section of each row."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gaitsweep.contract import Model
from gaitsweep.design import Design
from gaitsweep.engine.recorders.crossings import CrossingRecorder
from gaitsweep.kinds.columns import CROSSING, STALLED_BY, STATUS, Column, observed_at_crossings
from gaitsweep.kinds.run_kind import Cost, RunKind
from gaitsweep.schema.numbers import Count, CountOrZero


class ReturnMap(RunKind):
    """Record the state of each row at successive section crossings."""

    kind: Literal["return_map"] = Field(
        init=False, description="return_map: record the state at successive section crossings"
    )
    crossings: Count = Field(
        description="number of section crossings to record after crossing 0, with which the record begins"
    )
    after_cycles: CountOrZero = Field(default=0, description="section crossings before the recording begins")

    def recorder(self, model: Model) -> CrossingRecorder:
        return CrossingRecorder(model, self.crossings, self.after_cycles)

    def columns(self, model: Model) -> list[Column]:
        return [CROSSING, Column("t", repeats=False), STATUS, STALLED_BY, *observed_at_crossings(model)]

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        attempts = float(self.after_cycles + self.crossings) * cycle
        return Cost(attempts, attempts, max(float(self.crossings), 1.0))
