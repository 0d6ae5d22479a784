"""The recorder of all crossings of the section, for return maps and ramps."""

from __future__ import annotations

import dataclasses
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaitsweep.contract import Model, Params
from gaitsweep.engine.carry import Carry, Halt, Number
from gaitsweep.engine.recorders.recorder import (
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
)
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.status import Status

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
