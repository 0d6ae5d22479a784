"""Recorders that wait for no gait: of the end after a time, of crossings, and of signals.

Signals are recorded at equal intervals: over a duration, or in windows of time beside crossings.
"""

from __future__ import annotations

import dataclasses
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

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


def end_values(rows: RowOutcome, which: int | slice = slice(None)) -> Float[np.ndarray, "rows ..."]:
    """The observables (n, k) of rows at their end; those of failed rows at their last crossing.

    Args:
        rows: the rows.
        which: the place of one observable, whose values (n,) are returned; by default all.
    """
    if np.all(rows.record_counts == 1):
        return rows.samples[:, which].astype(np.float64, copy=False)
    values = rows.last[:, which].copy()
    values[rows.place] = rows.samples[:, which]
    return values


# Largest number of jumps at one instant for an ordinary crossing.
FEW_JUMPS = 2
# Crossings of which gaits are read in one call.
GAIT_BATCH = 4096


@final
@dataclasses.dataclass(frozen=True)
class CrossingRecorder(Recorder):
    """Records the number, the time (s) and the observables of every crossing of the section.

    The start is crossing 0.

    Args:
        model: the model.
        crossings: the crossings to record, after which the row ends; None: it ends at `duration`.
        after_cycles: the crossings before the first one that is recorded.
        duration: the time (s) at which the row of a ramp ends.
        gaits: whether the gait is read at every crossing after the start.

    Raises:
        ValueError: rows end neither at a number of crossings nor at a time, or at both.
    """

    model: Model
    crossings: int | None = None
    after_cycles: int = 0
    duration: float | None = None
    gaits: bool = False

    def __post_init__(self) -> None:
        if (self.crossings is None) == (self.duration is None):
            raise ValueError("Rows of a CrossingRecorder end at a number of crossings or at a duration.")

    @property
    def names(self) -> tuple[str, ...]:
        return ("crossing", "t", *(f"{q.name}_n" for q in self.model.observables))

    def stop(self, params: Params) -> Number:
        period = self.model.period(params)
        if self.duration is not None:
            return jnp.full_like(period, self.duration)
        assert self.crossings is not None
        return 4.0 * (self.crossings + self.after_cycles + SPARE_CYCLES) * period

    def max_attempts(self, params: Params, dt: Number | float) -> Number:
        return attempts_until(self.stop(params), dt)

    def readings(self, rows: RowOutcome) -> Readings | None:
        if not self.gaits:
            return None
        samples = rows.samples
        return Readings(rows.place, samples[:, 1], samples[:, 2:], samples[:, 0] > 0.0, GAIT_BATCH)

    def begin(self, params: Params, carry: Carry) -> Beginning:
        record, _, _ = self.unsampled(params, carry)
        keep = jnp.asarray(self.after_cycles == 0)
        return Beginning(counted(record, keep), self._sample(carry, record), keep)

    def _sample(self, carry: Carry, record: LaneRecord) -> Float[Array, " width"]:
        """The numbers of the latest crossing."""
        head = jnp.stack([record.cycles.astype(record.last.dtype), carry.t])
        return jnp.concatenate([head, record.last])

    def record(self, params: Params, carry: Carry, record: LaneRecord) -> PollResult:
        last_cycle = None if self.crossings is None else self.after_cycles + self.crossings
        crossed = (carry.halt == Halt.CROSSING) & (record.filled < BUFFER)
        counts = crossed if last_cycle is None else crossed & (record.cycles < last_cycle)
        recorded = self.crossed(params, carry, record, counts)
        keep = counts & (recorded.cycles >= self.after_cycles)
        late = Status.complete if self.duration is not None else Status.time_limit
        status = jnp.where(carry.halt == Halt.TIME, late, Status.running)
        if last_cycle is not None:
            # crossings in a long chain of jumps may belong to a stall, which is known only once time advances
            decided = (crossed & (carry.chain <= FEW_JUMPS)) | (carry.chain == 0)
            status = jnp.where((recorded.cycles >= last_cycle) & decided, Status.complete, status)
        waits = (carry.halt == Halt.CROSSING) & ~crossed
        halt = jnp.where(waits, carry.halt, jnp.zeros_like(carry.halt))
        sample = self._sample(carry, recorded)
        recorded = dataclasses.replace(counted(recorded, keep), status=status.astype(jnp.int32))
        return PollResult(dataclasses.replace(carry, halt=halt), recorded, sample, keep)

    def progress(self, rows: RunningRows, typical: float) -> Float[np.ndarray, " rows"]:
        if self.duration is not None:
            return rows.t / self.duration
        assert self.crossings is not None
        return rows.cycles / (self.after_cycles + self.crossings)


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


# The number of the crossing in a record that is a sample of a window.
NO_CROSSING = -1.0


@final
@dataclasses.dataclass(frozen=True)
class WindowsRecorder(Recorder):
    """Records every crossing with its observables, and the signals inside windows of equal length.

    The row ends with the last sample of the last window. A record is a crossing or a sample, whose `crossing`
    is `NO_CROSSING`.

    Args:
        model: the model.
        every: the time between two samples of a window (s).
        samples: the number of samples in a window, which ends before the next one begins.
        first: the beginning of the first window (s).
        second: the beginning of the second window (s).
        spacing: the time from the beginning of the second window to that of the third one, and so on (s).
        more: the number of windows after the first.
    """

    model: Model
    every: float
    samples: int
    first: float = 0.0
    second: float = 0.0
    spacing: float = 0.0
    more: int = 0

    @property
    def total(self) -> int:
        """Samples of all windows."""
        return self.samples * (1 + self.more)

    @property
    def duration(self) -> float:
        """The time of the last sample, s."""
        last = self.first if self.more == 0 else self.second + (self.more - 1) * self.spacing
        return last + (self.samples - 1) * self.every

    @property
    def names(self) -> tuple[str, ...]:
        observed = (f"{q.name}_n" for q in self.model.observables)
        return ("crossing", "t", *observed, *(q.name for q in self.model.signals))

    def time(self, sample: Float[Array, " *samples"]) -> Float[Array, " *samples"]:
        """The time (s) of a sample, by its number over all windows in floating point."""
        window = jnp.floor((sample + 0.5) / self.samples)
        inside = (sample - window * self.samples) * self.every
        return jnp.where(window < 0.5, self.first, self.second + (window - 1.0) * self.spacing) + inside

    def stop(self, params: Params) -> Number:
        """The time of the first sample, s."""
        return jnp.full_like(self.model.period(params), self.first)

    def max_attempts(self, params: Params, dt: Number | float) -> Number:
        # an interval shorter than a step needs an attempt of its own
        first = attempts_until(self.stop(params), dt)
        return first + ATTEMPTS_PER_STEP * (self.duration / dt + self.total)

    def begin(self, params: Params, carry: Carry) -> Beginning:
        record, _, _ = self.unsampled(params, carry)
        head = jnp.stack([record.cycles.astype(record.last.dtype), carry.t])
        first = jnp.concatenate([head, record.last, jnp.zeros(len(self.model.signals), record.last.dtype)])
        keep = jnp.asarray(True)
        return Beginning(counted(record, keep), first, keep)

    def record(self, params: Params, carry: Carry, record: LaneRecord) -> PollResult:
        room = record.filled < BUFFER
        crossed = (carry.halt == Halt.CROSSING) & room
        timed = (carry.halt == Halt.TIME) & room
        # every crossing has a record, the start among them
        index = (record.samples - record.cycles - 1).astype(carry.t.dtype)
        recorded = counted(self.crossed(params, carry, record, crossed), crossed | timed)
        last = recorded.last
        signals = self.model.signal(params, carry.state)
        number = jnp.where(crossed, recorded.cycles.astype(last.dtype), NO_CROSSING)
        # a scheme whose steps cannot be shortened gives the state at the end of the step nearest to that time
        t = jnp.where(timed, self.time(index), carry.t)
        numbers = [jnp.stack([number, t]), last]
        if self.model.signals:
            numbers.append(jnp.stack([signals[q.name] for q in self.model.signals]))
        sample = jnp.concatenate(numbers)
        done = timed & (index >= self.total - 1.0)
        status = jnp.where(done, Status.complete, Status.running)
        stop = jnp.where(timed, self.time(index + 1.0), carry.stop)
        waits = ((carry.halt == Halt.CROSSING) | (carry.halt == Halt.TIME)) & ~crossed & ~timed
        halt = jnp.where(waits, carry.halt, jnp.zeros_like(carry.halt))
        carry = dataclasses.replace(carry, stop=stop, halt=halt.astype(carry.halt.dtype))
        recorded = dataclasses.replace(recorded, status=status.astype(jnp.int32))
        return PollResult(carry, recorded, sample, crossed | timed)

    def readings(self, rows: RowOutcome) -> Readings:
        return readings_at_the_end(rows)

    def progress(self, rows: RunningRows, typical: float) -> Float[np.ndarray, " rows"]:
        return rows.t / self.duration if self.duration > 0.0 else np.ones_like(rows.t)
