"""Runs that end when the section's state stops moving: one row a start."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import Model, Params, Status
from gaitsweep.engine.advance import CROSSING, TIME, Carry
from gaitsweep.engine.record import SPARE_CYCLES, Record, Recorder

# Crossings over which a settled state must not move.
SETTLE_WINDOW = 10


@dataclasses.dataclass(frozen=True)
class Settle(Recorder):
    """Until the section's state stops moving.

    Settled: no observable, wrapped, is farther from its value at any of the last `SETTLE_WINDOW` crossings
    than `SETTLE_WINDOW` times `tolerance` (rad a cycle); orbits of several cycles do not settle. `max_time`
    (s) defaults to four nominal periods for each cycle allowed.
    """

    labelled: ClassVar[bool] = True

    model: Model
    max_cycles: int = 150
    tolerance: float = 1.0e-3
    max_time: float | None = None

    @property
    def window(self) -> int:
        return SETTLE_WINDOW

    def stop(self, params: Params) -> jax.Array:
        period = self.model.period(params)
        if self.max_time is not None:
            return jnp.full_like(period, self.max_time)
        return 4.0 * (self.max_cycles + SPARE_CYCLES) * period

    def take(
        self, params: Params, carry: Carry, record: Record
    ) -> tuple[Carry, Record, jax.Array, jax.Array]:
        crossed = carry.halt == CROSSING
        now = self.observables(params, carry.state)
        cycles = record.cycles + 1
        slot = jnp.arange(SETTLE_WINDOW) == cycles % SETTLE_WINDOW
        # with NaN in its window a row does not settle
        free = carry.t >= self.model.free_after(params)
        moved = jnp.max(jnp.abs(change(self.model, now[None, :] - record.window)))
        still = (cycles >= SETTLE_WINDOW) & (moved < SETTLE_WINDOW * self.tolerance)
        # crossings without time between them are no cycles
        settled = still & (carry.chain < SETTLE_WINDOW)
        ended = jnp.where(
            settled,
            Status.settled,
            jnp.where(cycles >= self.max_cycles, Status.cycle_limit, Status.running),
        )
        status = jnp.where(crossed, ended, jnp.where(carry.halt == TIME, Status.time_limit, Status.running))
        taken = dataclasses.replace(
            record,
            status=status.astype(jnp.int32),
            cycles=jnp.where(crossed, cycles, record.cycles),
            last=jnp.where(crossed, now, record.last),
            window=jnp.where(free, jnp.where(slot[:, None] & crossed, now, record.window), jnp.nan),
        )
        carry = dataclasses.replace(carry, halt=jnp.zeros_like(carry.halt))
        return carry, taken, jnp.zeros((0,), record.last.dtype), jnp.asarray(False)

    def share(self, record: Record, t: np.ndarray, typical_cycles: float) -> np.ndarray:
        return np.minimum(np.asarray(record.cycles) / (typical_cycles or 0.4 * self.max_cycles), 0.95)


def change(model: Model, difference: jax.Array) -> jax.Array:
    """Differences of observables, those of angles wrapped to [-pi, pi)."""
    circular = jnp.asarray([q.circular for q in model.observables])
    wrapped = jnp.mod(difference + jnp.pi, 2.0 * jnp.pi) - jnp.pi
    return jnp.where(circular[None, :], wrapped, difference)
