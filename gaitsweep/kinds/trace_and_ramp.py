"""Run kinds that record each row for a given time or number of crossings, without waiting for its gait.

`fixed_time` records the end of a row, `return_map` section crossings, `ramp` crossings as a parameter moves,
and `trace` signals at equal intervals of time. The parameter at each time is that of a `RampSchedule`
(`engine/recorders/parameter_schedules.py`).
"""

from __future__ import annotations

from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float
from pydantic import Field

from gaitsweep.contract import Model
from gaitsweep.design import Design
from gaitsweep.dynamics.declared_model import surfaces_of
from gaitsweep.engine.recorders.parameter_schedules import RampSchedule
from gaitsweep.engine.recorders.recordings import (
    CrossingRecorder,
    FixedTimeRecorder,
    TraceRecorder,
    end_values,
)
from gaitsweep.engine.stored_traces import dependences, shapes_of
from gaitsweep.kinds.columns import (
    CROSSING,
    GAIT,
    OUTCOME,
    STALLED_BY,
    STATUS,
    Column,
    Records,
    label_fields,
    observed_at_crossings,
    observed_at_end,
    rests_at_crossings,
    signals,
)
from gaitsweep.kinds.run_kind import Cost, RunKind, check_path
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.numbers import Count, CountOrZero, Flag, NotNegative, Positive, Real, Text


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


class Ramp(RunKind):
    """Move one parameter slowly along a path and record every section crossing."""

    idle_without: ClassVar = {"gaits": ("gaits",)}

    kind: Literal["ramp"] = Field(
        init=False, description="ramp: move a parameter slowly and record every section crossing"
    )
    parameter: Text = Field(description="the model's parameter that moves")
    path: list[Real] = Field(
        min_length=2, max_length=1000, description="values between which the parameter moves, in order"
    )
    rate: Positive = Field(description="speed of the parameter, in its unit per second")
    initial_dwell: NotNegative = Field(
        default=0.0, description="time at the first value before the parameter moves, in s"
    )
    gaits: Flag = Field(default=False, description="whether to classify the gait at every crossing")

    def schedule(self) -> RampSchedule:
        return RampSchedule(tuple(self.path), self.rate, self.initial_dwell)

    def recorder(self, model: Model) -> CrossingRecorder:
        return CrossingRecorder(model, duration=self.schedule().duration, gaits=self.gaits)

    def columns(self, model: Model) -> list[Column]:
        moving = moving_columns(self.parameter, self.schedule(), repeats=False)
        observed = [*observed_at_crossings(model), *([GAIT] if self.gaits else [])]
        return [CROSSING, *moving, Column("t", repeats=False), STATUS, STALLED_BY, *observed]

    def check(self, rows: Design, method: str) -> list[Diagnostic]:
        return check_path(self.path) + _check_surface(rows, self.parameter)

    def rests(self, model: Model, records: pd.DataFrame) -> pd.DataFrame:
        return rests_at_crossings(model, records, records["crossing"].notna().to_numpy(bool))

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        crossings = self.schedule().duration / period
        return Cost(crossings * cycle, crossings * cycle, max(crossings, 1.0))


def _check_surface(rows: Design, parameter: str) -> list[Diagnostic]:
    """A diagnostic if the height over a surface of sliding depends on a moving parameter.

    Sliding states do not follow a surface that moves with it.
    """
    model = rows.model
    if not (surfaces := surfaces_of(model)):
        return []
    ((name, surface),) = surfaces.items()
    state = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes_of(model)[1])
    numbers = {q.name: jax.ShapeDtypeStruct((), jnp.float64) for q in model.parameters}
    (used,) = dependences(lambda values: [surface.height(model.params(values), state)], numbers)
    if used.isdisjoint((parameter, *rows.following(parameter))):
        return []
    text = (
        f"is {parameter}, on which the height over the surface of {name} depends, but sliding states do not "
        "follow a surface that moves: "
    )
    return [Diagnostic(("run", "parameter"), f"{text}use run.kind: staircase.")]


def moving_columns(parameter: str, schedule: RampSchedule, *, repeats: bool) -> list[Column]:
    """The pass and the value of a parameter that moves, at the time `t` of each record."""

    def value(records: Records) -> Float[np.ndarray, " records"]:
        t = records["t"]
        return np.where(np.isnan(t), np.nan, schedule.at(np.nan_to_num(t)))

    return [
        Column("pass", lambda records: schedule.passes(np.nan_to_num(records["t"]))),
        Column(parameter, value, repeats=repeats),
    ]


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
        missing = [name for name in ("path", "rate") if getattr(self, name) is None]
        if missing:
            text = f"is missing, but run.parameter is {self.parameter}."
            return [Diagnostic(("run", name), text) for name in missing]
        if self.after_cycles:
            text = f"is {self.after_cycles}, but {self.parameter} moves from the start of a row: "
            return [Diagnostic(("run", "after_cycles"), f"{text}use run.initial_dwell instead.")]
        return check_path(self.turns) + _check_surface(rows, self.parameter)

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        samples = self.recorder(rows.model).samples
        attempts = (self.after_cycles + self.duration / period) * cycle + samples
        return Cost(attempts, attempts, float(samples))
