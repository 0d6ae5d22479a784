"""Run kind `staircase`: a parameter moves in steps along a path, and the end of each stair is recorded.

The parameter at each time is that of a `StepSchedule` (`engine/recorders/parameter_schedules.py`).
"""

from __future__ import annotations

import itertools
from typing import Literal

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float
from pydantic import Field

from gaitsweep.contract import Model
from gaitsweep.design import Design
from gaitsweep.engine.recorders.bounds import tolerances
from gaitsweep.engine.recorders.parameter_schedules import StepSchedule
from gaitsweep.engine.recorders.staircase import StepRecorder
from gaitsweep.kinds.columns import (
    CROSSING,
    GAIT,
    SLOWEST,
    STALLED_BY,
    STATUS,
    Column,
    Records,
    label_fields,
    observed_at_crossings,
    rests_at_crossings,
)
from gaitsweep.kinds.run_kind import Cost, RunKind, check_path
from gaitsweep.kinds.settle import check_tolerance, tolerance_field
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.numbers import Positive, PositiveOrEach, Real, Text

MOST_STAIRS = 10_000  # of a staircase


class Staircase(RunKind):
    """Move one parameter in stairs along a path, constant on each stair, and record the end of each."""

    kind: Literal["staircase"] = Field(
        init=False, description="staircase: move a parameter in stairs and record the end of each stair"
    )
    parameter: Text = Field(description="the model's parameter that moves")
    path: list[Real] = Field(
        min_length=2,
        max_length=1000,
        description="values between which the parameter moves, in order; each is one stair",
    )
    step: Positive = Field(
        description="largest distance between stairs, in the parameter's unit; the stairs of a pass are equal"
    )
    dwell: Positive = Field(description="time on each stair, in s")
    first_dwell: Positive | None = Field(
        default=None, description="time on the first stair, in s; by default as on the others"
    )
    tolerance: PositiveOrEach = tolerance_field("stair")

    def schedule(self) -> StepSchedule:
        return StepSchedule(tuple(self.path), self.step, self.dwell, self.first_dwell)

    def recorder(self, model: Model) -> StepRecorder:
        return StepRecorder(model, self.schedule(), tolerances(model, self.tolerance))

    def columns(self, model: Model) -> list[Column]:
        schedule = self.schedule()

        def stair(records: Records) -> Float[np.ndarray, " records"]:
            return np.where(records.recorded, records["stair"], 0.0).astype(np.float64)

        def value(records: Records) -> Float[np.ndarray, " records"]:
            values = np.asarray(schedule.value(jnp.asarray(stair(records))))
            return np.where(records.recorded, values, np.nan)

        return [
            Column("stair", lambda records: stair(records).astype(np.int64)),
            Column("pass", lambda records: schedule.passes(stair(records))),
            Column(self.parameter, value),
            Column("t"),
            CROSSING,
            Column("settled", lambda records: records["settled"] == 1.0),
            SLOWEST,
            STATUS,
            STALLED_BY,
            *observed_at_crossings(model),
            GAIT,
            *label_fields(model),
        ]

    def check(self, rows: Design, method: str) -> list[Diagnostic]:
        wrong = [*check_path(self.path), *check_tolerance(self.tolerance, rows.model)]
        stairs = 1.0 + sum(max(1.0, abs(b - a) / self.step) for a, b in itertools.pairwise(self.path))
        if stairs > MOST_STAIRS:
            text = f"is {self.step:g}, which gives {stairs:.6g} stairs; at most {MOST_STAIRS} are allowed."
            wrong.append(Diagnostic(("run", "step"), text))
        return wrong

    def rests(self, model: Model, records: pd.DataFrame) -> pd.DataFrame:
        return rests_at_crossings(model, records, records["settled"].to_numpy(bool))

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        schedule = self.schedule()
        attempts = schedule.duration / period * cycle + schedule.count
        return Cost(attempts, attempts, float(schedule.count))
