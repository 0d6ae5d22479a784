"""The recorder of signals at equal intervals of time."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import Model, Params, Status
from gaitsweep.engine.advance import CROSSING, FINISHED, GOING, TIME, Carry
from gaitsweep.engine.recorders.recorder import (
    ATTEMPTS_PER_STEP,
    BUFFER,
    SPARE_CYCLES,
    Record,
    Recorder,
    Taken,
    counted,
)


@dataclasses.dataclass(frozen=True)
class TraceRecorder(Recorder):
    """Records the signals every `every` seconds for `duration` seconds, after `after_cycles` crossings."""

    model: Model
    duration: float
    every: float
    after_cycles: int = 0

    @property
    def samples(self) -> int:
        return int(self.duration / self.every * (1.0 + 1e-12)) + 1

    @property
    def names(self) -> tuple[str, ...]:
        return ("t", *(q.name for q in self.model.signals))

    def stop(self, params: Params) -> jax.Array:
        """The time of the first sample (s), or the time limit of the first `after_cycles` crossings."""
        period = self.model.period(params)
        if self.after_cycles == 0:
            return jnp.zeros_like(period)
        return 4.0 * (self.after_cycles + SPARE_CYCLES) * period

    def max_attempts(self, params: Params, dt: jax.Array | float) -> jax.Array:
        # an interval shorter than a step needs an attempt of its own
        return super().max_attempts(params, dt) + ATTEMPTS_PER_STEP * (self.duration / dt + self.samples)

    def take(self, params: Params, carry: Carry, record: Record) -> Taken:
        crossed = carry.halt == CROSSING
        cycles = jnp.where(crossed, record.cycles + 1, record.cycles)
        begins = crossed & (cycles == self.after_cycles)
        waiting = cycles < self.after_cycles
        lost = waiting & (carry.halt == TIME)
        due = (begins | (~waiting & (carry.halt == TIME))) & (record.filled < BUFFER)
        signals = self.model.signal(params, carry.state)
        index = record.samples.astype(carry.t.dtype)
        row = jnp.stack([index * self.every, *(signals[q.name] for q in self.model.signals)])
        taken = dataclasses.replace(
            record,
            cycles=cycles,
            last=jnp.where(crossed, self.observables(params, carry.state), record.last),
        )
        taken = counted(taken, due)
        done = due & (taken.samples >= self.samples)
        status = jnp.where(lost, Status.time_limit, jnp.where(done, Status.complete, Status.running))
        waits = (carry.halt == TIME) & ~due & ~lost
        origin = jnp.where(begins, carry.t, carry.stop - index * self.every)
        stop = jnp.where(due, origin + (index + 1.0) * self.every, carry.stop)
        halt = jnp.where(waits, carry.halt, jnp.where(carry.halt == FINISHED, FINISHED, GOING))
        carry = dataclasses.replace(carry, stop=stop, halt=halt.astype(carry.halt.dtype))
        return carry, dataclasses.replace(taken, status=status.astype(jnp.int32)), row, due

    def share(self, record: Record, t: np.ndarray, typical_cycles: float) -> np.ndarray:
        return np.asarray(record.cycles + record.samples) / (self.after_cycles + self.samples)
