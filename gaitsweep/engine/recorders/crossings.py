"""The recorder of all crossings of the section, for return maps and ramps."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import Model, Params, Status
from gaitsweep.engine.advance import CROSSING, TIME, Carry
from gaitsweep.engine.recorders.recorder import (
    BUFFER,
    SPARE_CYCLES,
    Readings,
    Record,
    Recorder,
    Taken,
    counted,
)

if TYPE_CHECKING:
    from gaitsweep.engine.sweep.block import Block

# Largest number of jumps at one instant for an ordinary crossing.
FEW_JUMPS = 2
# Crossings of which gaits are read in one call.
BATCH = 4096


@dataclasses.dataclass(frozen=True)
class CrossingRecorder(Recorder):
    """Records the number, t (s) and observables of every crossing of the section; the start is crossing 0.

    A row ends after `crossings` crossings beyond the first `after_cycles`, or at `duration` (s) for a ramp.
    With `gaits` the gait is read at every crossing after the start.
    """

    model: Model
    crossings: int | None = None
    after_cycles: int = 0
    duration: float | None = None
    gaits: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        return ("crossing", "t", *(f"{q.name}_n" for q in self.model.observables))

    def stop(self, params: Params) -> jax.Array:
        period = self.model.period(params)
        if self.duration is not None:
            return jnp.full_like(period, self.duration)
        return 4.0 * ((self.crossings or 0) + self.after_cycles + SPARE_CYCLES) * period

    def readings(self, block: Block) -> Readings | None:
        if not self.gaits:
            return None
        rows, samples = block.kept()
        samples = samples.reshape(-1, self.width)
        return Readings(rows, samples[:, 1], samples[:, 2:], samples[:, 0] > 0.0, BATCH)

    def begin(self, params: Params, carry: Carry) -> tuple[Record, jax.Array, jax.Array]:
        record, _, _ = super().begin(params, carry)
        keep = jnp.asarray(self.after_cycles == 0)
        return counted(record, keep), self._row(carry, record), keep

    def _row(self, carry: Carry, record: Record) -> jax.Array:
        head = jnp.stack([record.cycles.astype(record.last.dtype), carry.t])
        return jnp.concatenate([head, record.last])

    def take(self, params: Params, carry: Carry, record: Record) -> Taken:
        most = None if self.crossings is None else self.after_cycles + self.crossings
        crossed = (carry.halt == CROSSING) & (record.filled < BUFFER)
        counts = crossed if most is None else crossed & (record.cycles < most)
        taken = dataclasses.replace(
            record,
            cycles=jnp.where(counts, record.cycles + 1, record.cycles),
            last=jnp.where(counts, self.observables(params, carry.state), record.last),
        )
        keep = counts & (taken.cycles >= self.after_cycles)
        late = Status.complete if self.duration is not None else Status.time_limit
        status = jnp.where(carry.halt == TIME, late, Status.running)
        if most is not None:
            # crossings in a long chain of jumps may belong to a stall, which is known only once time advances
            told = (crossed & (carry.chain <= FEW_JUMPS)) | (carry.chain == 0)
            status = jnp.where((taken.cycles >= most) & told, Status.complete, status)
        waits = (carry.halt == CROSSING) & ~crossed
        halt = jnp.where(waits, carry.halt, jnp.zeros_like(carry.halt))
        row = self._row(carry, taken)
        taken = dataclasses.replace(counted(taken, keep), status=status.astype(jnp.int32))
        return dataclasses.replace(carry, halt=halt), taken, row, keep

    def share(self, record: Record, t: np.ndarray, typical_cycles: float) -> np.ndarray:
        if self.crossings is None:
            return t / (self.duration or 1.0)
        return np.asarray(record.cycles) / (self.after_cycles + self.crossings)
