"""Runs that last for a given time: one row a start, read where it ends."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import Model, Params, Status
from gaitsweep.engine.advance import CROSSING, TIME, Carry
from gaitsweep.engine.recorders.recorder import Record, Recorder, Taken


@dataclasses.dataclass(frozen=True)
class FixedTimeRecorder(Recorder):
    """The last crossing before `duration` (s), for models that do not come to rest on the section."""

    model: Model
    duration: float
    readings = Recorder.readings_at_the_end

    def stop(self, params: Params) -> jax.Array:
        return jnp.full_like(self.model.period(params), self.duration)

    def take(self, params: Params, carry: Carry, record: Record) -> Taken:
        crossed = carry.halt == CROSSING
        status = jnp.where(carry.halt == TIME, Status.complete, Status.running)
        taken = dataclasses.replace(
            record,
            status=status.astype(jnp.int32),
            cycles=jnp.where(crossed, record.cycles + 1, record.cycles),
            last=jnp.where(crossed, self.observables(params, carry.state), record.last),
        )
        carry = dataclasses.replace(carry, halt=jnp.zeros_like(carry.halt))
        return carry, taken, jnp.zeros((0,), record.last.dtype), jnp.asarray(False)

    def share(self, record: Record, t: np.ndarray, typical_cycles: float) -> np.ndarray:
        return t / self.duration
