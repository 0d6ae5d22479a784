"""Run kind `trace`: the signals of each row at equal intervals of time."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from gaitsweep.contract import Model
from gaitsweep.design import Design
from gaitsweep.engine.recorders.parameter_schedules import RampSchedule
from gaitsweep.engine.recorders.trace import TraceRecorder
from gaitsweep.kinds.columns import GAIT, STALLED_BY, STATUS, Column, signals
from gaitsweep.kinds.crossings import moving_columns
from gaitsweep.kinds.run_kind import Cost, RunKind
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.numbers import CountOrZero, NotNegative, Positive, Real, Text

MOST_SAMPLES = 10_000_000  # of a row's trace
_MOVING = ("parameter", "path", "rate", "initial_dwell")  # fields of a moving parameter


class Trace(RunKind):
    """Record the signals of each row at equal intervals of time; a parameter may move meanwhile."""

    idle_without: ClassVar = {"parameter": _MOVING}

    kind: Literal["trace"] = Field(init=False, description="trace: record a time series of each row")
    duration: Positive = Field(description="length of the recording, in s")
    every: Positive = Field(description="interval between samples, in s")
    after_cycles: CountOrZero = Field(
        default=0, description="section crossings before the recording begins, at which t = 0"
    )
    parameter: Text | None = Field(default=None, description="the model's parameter that moves meanwhile")
    path: list[Real] | None = Field(
        default=None,
        min_length=2,
        max_length=1000,
        description="values between which the parameter moves, in order",
    )
    rate: Positive | None = Field(default=None, description="speed of the parameter, in its unit per second")
    initial_dwell: NotNegative = Field(
        default=0.0, description="time at the first value before the parameter moves, in s"
    )

    def recorder(self, model: Model) -> TraceRecorder:
        return TraceRecorder(model, self.duration, self.every, self.after_cycles)

    def schedule(self) -> RampSchedule | None:
        if self.parameter is None or self.path is None or self.rate is None:
            return None
        return RampSchedule(tuple(self.path), self.rate, self.initial_dwell)

    def columns(self, model: Model) -> list[Column]:
        schedule = self.schedule()
        moving = [] if schedule is None else moving_columns(str(self.parameter), schedule, repeats=True)
        return [*moving, Column("t"), *signals(model), GAIT, STATUS, STALLED_BY]

    def check(self, rows: Design, method: str) -> list[Diagnostic]:
        if self.every > self.duration:
            text = f"is {self.every:g} s, but must be at most run.duration, {self.duration:g} s."
            return [Diagnostic(("run", "every"), text)]
        if self.duration / self.every > MOST_SAMPLES:
            samples = f"{self.duration / self.every:.3g} samples per row"
            return [Diagnostic(("run", "every"), f"gives {samples}; at most {MOST_SAMPLES} are allowed.")]
        if self.parameter is None:
            text = "has no effect without run.parameter: name the parameter that moves."
            written = [name for name in _MOVING if name in self.model_fields_set and getattr(self, name)]
            return [Diagnostic(("run", name), text) for name in written]
        for name in ("path", "rate"):
            if getattr(self, name) is None:
                return [Diagnostic(("run", name), f"is missing, but run.parameter is {self.parameter}.")]
        if self.after_cycles:
            text = f"is {self.after_cycles}, but {self.parameter} moves from the start of a row: "
            return [Diagnostic(("run", "after_cycles"), f"{text}use run.initial_dwell instead.")]
        return []

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        samples = self.recorder(rows.model).samples
        attempts = (self.after_cycles + self.duration / period) * cycle + samples
        return Cost(attempts, attempts, float(samples))
