"""Run kinds that record the section crossings of each row: `return_map`, and `ramp` as a parameter moves.

The parameter at each time is that of a `RampSchedule` (`engine/recorders/parameter_schedules.py`).
"""

from __future__ import annotations

from typing import ClassVar, Literal

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float
from pydantic import Field

from gaitsweep.contract import Model
from gaitsweep.design import Design
from gaitsweep.engine.recorders.crossings import CrossingRecorder
from gaitsweep.engine.recorders.parameter_schedules import RampSchedule
from gaitsweep.kinds.columns import (
    CROSSING,
    GAIT,
    STALLED_BY,
    STATUS,
    Column,
    Records,
    observed_at_crossings,
    rests_at_crossings,
)
from gaitsweep.kinds.run_kind import Cost, RunKind
from gaitsweep.schema.numbers import Count, CountOrZero, Flag, NotNegative, Positive, Real, Text


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

    def rests(self, model: Model, records: pd.DataFrame) -> pd.DataFrame:
        return rests_at_crossings(model, records, records["crossing"].notna().to_numpy(bool))

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        crossings = self.schedule().duration / period
        return Cost(crossings * cycle, crossings * cycle, max(crossings, 1.0))


def moving_columns(parameter: str, schedule: RampSchedule, *, repeats: bool) -> list[Column]:
    """The pass and the value of a parameter that moves, at the time `t` of each record."""

    def value(records: Records) -> Float[np.ndarray, " records"]:
        t = records["t"]
        return np.where(np.isnan(t), np.nan, np.asarray(schedule.at(jnp.asarray(np.nan_to_num(t)))))

    return [
        Column("pass", lambda records: schedule.passes(np.nan_to_num(records["t"]))),
        Column(parameter, value, repeats=repeats),
    ]
