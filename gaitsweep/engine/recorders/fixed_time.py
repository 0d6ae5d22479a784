"""The recorder of runs that last for a given time."""

from __future__ import annotations

import dataclasses
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaitsweep.contract import Model, Params
from gaitsweep.engine.carry import Carry, Halt, Number
from gaitsweep.engine.recorders.recorder import (
    Beginning,
    LaneRecord,
    PollResult,
    Readings,
    Recorder,
    RunningRows,
    attempts_until,
    counted,
    readings_at_the_end,
)
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.status import Status


@final
@dataclasses.dataclass(frozen=True)
class FixedTimeRecorder(Recorder):
    """Records the observables at the end of a row; its gait is read at the last crossing before.

    Args:
        model: the model.
        duration: the time at which the row ends (s).
    """

    model: Model
    duration: float

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(q.name for q in self.model.observables)

    def stop(self, params: Params) -> Number:
        return jnp.full_like(self.model.period(params), self.duration)

    def max_attempts(self, params: Params, dt: Number | float) -> Number:
        return attempts_until(self.stop(params), dt)

    def begin(self, params: Params, carry: Carry) -> Beginning:
        return self.unsampled(params, carry)

    def record(self, params: Params, carry: Carry, record: LaneRecord) -> PollResult:
        crossed = carry.halt == Halt.CROSSING
        ends = carry.halt == Halt.TIME
        now = self.observables(params, carry.state)
        status = jnp.where(ends, Status.complete, Status.running)
        recorded = counted(self.crossed(params, carry, record, crossed), ends)
        recorded = dataclasses.replace(recorded, status=status.astype(jnp.int32))
        carry = dataclasses.replace(carry, halt=jnp.zeros_like(carry.halt))
        return PollResult(carry, recorded, now, ends)

    def readings(self, rows: RowOutcome) -> Readings:
        return readings_at_the_end(rows)

    def progress(self, rows: RunningRows, typical: float) -> Float[np.ndarray, " rows"]:
        return rows.t / self.duration


def end_values(rows: RowOutcome) -> Float[np.ndarray, "rows observables"]:
    """The observables (n, k) of rows at their end; those of failed rows at their last crossing."""
    values = rows.last.copy()
    values[rows.place] = rows.samples
    return values
