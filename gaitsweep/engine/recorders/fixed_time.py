"""Runs that last for a given time: one row a start, read where it ends."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import Model, Params, Status
from gaitsweep.engine.advance import CROSSING, TIME, Carry
from gaitsweep.engine.recorders.recorder import Record, Recorder, Taken, counted

if TYPE_CHECKING:
    from gaitsweep.engine.sweep.block import BlockResult


@dataclasses.dataclass(frozen=True)
class FixedTimeRecorder(Recorder):
    """The state at `duration` (s), a record, and the last crossing before it, at which the gait is read."""

    model: Model
    duration: float
    readings = Recorder.readings_at_the_end

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(q.name for q in self.model.observables)

    def stop(self, params: Params) -> jax.Array:
        return jnp.full_like(self.model.period(params), self.duration)

    def take(self, params: Params, carry: Carry, record: Record) -> Taken:
        crossed, ends = carry.halt == CROSSING, carry.halt == TIME
        now = self.observables(params, carry.state)
        status = jnp.where(ends, Status.complete, Status.running)
        taken = dataclasses.replace(
            record,
            status=status.astype(jnp.int32),
            cycles=jnp.where(crossed, record.cycles + 1, record.cycles),
            last=jnp.where(crossed, now, record.last),
        )
        carry = dataclasses.replace(carry, halt=jnp.zeros_like(carry.halt))
        return carry, counted(taken, ends), now, ends

    def share(self, record: Record, t: np.ndarray, typical_cycles: float) -> np.ndarray:
        return t / self.duration


def end_values(block: BlockResult) -> np.ndarray:
    """The observables (n, k) of a block's rows at the given time; of others at their last crossing."""
    values = block.last.copy()
    values[block.owner - block.first] = block.samples.reshape(-1, values.shape[1])
    return values
