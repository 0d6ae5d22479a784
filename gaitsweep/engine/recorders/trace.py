"""The recorder of signals at equal intervals of time."""

from __future__ import annotations

import dataclasses
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaitsweep.contract import Model, Params
from gaitsweep.engine.carry import Carry, Halt, Number
from gaitsweep.engine.recorders.recorder import (
    ATTEMPTS_PER_STEP,
    BUFFER,
    SPARE_CYCLES,
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

# A duration may be shorter than its whole number of intervals by this share of itself.
ROUNDING = 1e-12


@final
@dataclasses.dataclass(frozen=True)
class TraceRecorder(Recorder):
    """Records the signals at equal intervals of time.

    Args:
        model: the model.
        duration: the time from the first sample to the last one (s).
        every: the time between two samples (s).
        after_cycles: the crossings of the section before the first sample.
    """

    model: Model
    duration: float
    every: float
    after_cycles: int = 0

    @property
    def samples(self) -> int:
        """The number of samples; rounding of the duration loses none."""
        return int(self.duration / self.every * (1.0 + ROUNDING)) + 1

    @property
    def names(self) -> tuple[str, ...]:
        return ("t", *(q.name for q in self.model.signals))

    def stop(self, params: Params) -> Number:
        """The time of the first sample (s), or the time limit of the first `after_cycles` crossings."""
        period = self.model.period(params)
        if self.after_cycles == 0:
            return jnp.zeros_like(period)
        return 4.0 * (self.after_cycles + SPARE_CYCLES) * period

    def max_attempts(self, params: Params, dt: Number | float) -> Number:
        # an interval shorter than a step needs an attempt of its own
        first = attempts_until(self.stop(params), dt)
        return first + ATTEMPTS_PER_STEP * (self.duration / dt + self.samples)

    def begin(self, params: Params, carry: Carry) -> Beginning:
        return self.unsampled(params, carry)

    def record(self, params: Params, carry: Carry, record: LaneRecord) -> PollResult:
        crossed = carry.halt == Halt.CROSSING
        cycles = jnp.where(crossed, record.cycles + 1, record.cycles)
        begins = crossed & (cycles == self.after_cycles)
        waiting = cycles < self.after_cycles
        timed = carry.halt == Halt.TIME
        # the time limit came before the cycle at which the recording begins
        lost = waiting & timed
        due = (begins | (~waiting & timed)) & (record.filled < BUFFER)
        signals = self.model.signal(params, carry.state)
        index = record.samples.astype(carry.t.dtype)
        sample = jnp.stack([index * self.every, *(signals[q.name] for q in self.model.signals)])
        recorded = counted(self.crossed(params, carry, record, crossed), due)
        done = due & (recorded.samples >= self.samples)
        status = jnp.where(done, Status.complete, Status.running)
        status = jnp.where(lost, Status.time_limit, status)
        # a sample is due, but the buffer is full: the lane stays halted until it has been read
        waits = timed & ~due & ~lost
        origin = jnp.where(begins, carry.t, carry.stop - index * self.every)
        stop = jnp.where(due, origin + (index + 1.0) * self.every, carry.stop)
        halt = jnp.where(carry.halt == Halt.FINISHED, Halt.FINISHED, Halt.GOING)
        halt = jnp.where(waits, carry.halt, halt)
        carry = dataclasses.replace(carry, stop=stop, halt=halt.astype(carry.halt.dtype))
        recorded = dataclasses.replace(recorded, status=status.astype(jnp.int32))
        return PollResult(carry, recorded, sample, due)

    def readings(self, rows: RowOutcome) -> Readings:
        return readings_at_the_end(rows)

    def progress(self, rows: RunningRows, typical: float) -> Float[np.ndarray, " rows"]:
        return (rows.cycles + rows.samples) / (self.after_cycles + self.samples)
