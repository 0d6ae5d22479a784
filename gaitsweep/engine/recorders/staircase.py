"""The recorder of runs in which a parameter moves in steps."""

from __future__ import annotations

import dataclasses
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaitsweep.contract import HybridModel, Model, Params
from gaitsweep.engine.carry import Carry, Halt, Integer, Number, restarted, select
from gaitsweep.engine.recorders.bounds import (
    SETTLE_WINDOW,
    TOLERANCE,
    bounds,
    change,
    comparable,
    first_span,
    slowest,
    widened,
)
from gaitsweep.engine.recorders.parameter_schedules import StepSchedule
from gaitsweep.engine.recorders.recorder import (
    ATTEMPTS_PER_STEP,
    BUFFER,
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

_HEAD = ("stair", "crossing", "t", "settled", "slowest")  # the numbers of a sample before its observables
# The last crossing and those before it, in which a stair has to settle.
_WINDOW = SETTLE_WINDOW + 1
# Stairs whose gaits are read in one call: a fixed number, since XLA's last bits depend on it.
GAIT_BATCH = 1024


@final
@dataclasses.dataclass(frozen=True)
class StepRecorder(Recorder):
    """Records the end of each stair: its number, the crossings, t (s), settled, slowest, the observables.

    The observables are those at the last crossing. A stair is settled if each observable differs from its
    values at the last `SETTLE_WINDOW` crossings by less than its bound (`bounds`), and all of these crossings
    were on this stair; orbits of several crossings do not settle. Else `slowest` is the place of the
    observable that moved most, -1 if it is unknown. A drive over the same `stairs` moves the parameter; the
    state continues from stair to stair.

    Args:
        model: the model.
        stairs: the stairs.
        tolerance: one for all observables, or one for each, as a share of its scale.
    """

    model: Model
    stairs: StepSchedule
    tolerance: float | tuple[float, ...] = TOLERANCE

    @property
    def names(self) -> tuple[str, ...]:
        return (*_HEAD, *(f"{q.name}_n" for q in self.model.observables))

    def readings(self, rows: RowOutcome) -> Readings:
        samples = rows.samples
        observed = samples[:, len(_HEAD) :]
        times = self.stairs.middle(samples[:, 0])
        return Readings(rows.place, times, observed, _readable(samples), GAIT_BATCH)

    def stop(self, params: Params) -> Number:
        return jnp.full_like(self.model.period(params), self.stairs.first)

    def max_attempts(self, params: Params, dt: Number | float) -> Number:
        # a stair shorter than a step takes attempts of its own
        steps_of_others = (self.stairs.duration - self.stairs.first) / dt + 2 * self.stairs.count
        return attempts_until(self.stop(params), dt) + ATTEMPTS_PER_STEP * steps_of_others

    def begin(self, params: Params, carry: Carry) -> Beginning:
        record, sample, keep = self.unsampled(params, carry)
        memory = _emptied(record), first_span(self.model, record.last)
        return Beginning(dataclasses.replace(record, memory=memory), sample, keep)

    def record(self, params: Params, carry: Carry, record: LaneRecord) -> PollResult:
        crossed = carry.halt == Halt.CROSSING
        window, span = record.memory
        due = (carry.halt == Halt.TIME) & (record.filled < BUFFER)
        waits = (carry.halt == Halt.TIME) & ~due
        recorded = self.crossed(params, carry, record, crossed)
        cycles = recorded.cycles
        last = recorded.last
        widest = jnp.where(crossed, widened(span, self.model, last), span)
        next_window = jnp.where(_slot(cycles) & crossed, last, window)
        # crossings that a stair has not had yet are NaN, which is near no number
        missing = jnp.all(jnp.isnan(window), axis=1)[:, None]
        moved = jnp.abs(change(self.model, comparable(last)[None, :] - comparable(window)))
        moved = jnp.where(missing, jnp.nan, moved)
        bound = bounds(self.model, self.tolerance, comparable(window), span)[None, :]
        settled = jnp.all(moved < bound)
        slowest_place = jnp.where(settled, -1, slowest(moved / bound))
        head = (record.samples, cycles, carry.t, settled, slowest_place)
        sample = jnp.concatenate([jnp.stack([number.astype(last.dtype) for number in head]), last])

        recorded = counted(recorded, due)
        status = jnp.where(due & (recorded.samples >= self.stairs.count), Status.complete, Status.running)
        memory = jnp.where(due, _emptied(recorded), next_window), widest
        recorded = dataclasses.replace(recorded, status=status.astype(jnp.int32), memory=memory)
        halt = jnp.where(waits, Halt.TIME, Halt.GOING).astype(carry.halt.dtype)
        end = self.stairs.end(recorded.samples.astype(carry.t.dtype))
        stop = jnp.where(due, end, carry.stop)
        state = carry.state
        if isinstance(self.model, HybridModel):
            state = select(due, self.model.displaced(params, state), state)
        carry = dataclasses.replace(restarted(carry, due), state=state, stop=stop, halt=halt)
        return PollResult(carry, recorded, sample, due)

    def progress(self, rows: RunningRows, typical: float) -> Float[np.ndarray, " rows"]:
        return rows.t / self.stairs.duration


def _slot(cycles: Integer) -> Bool[Array, "window 1"]:
    """Mask of the place of a crossing in the window."""
    return (jnp.arange(_WINDOW) == cycles % _WINDOW)[:, None]


def _emptied(record: LaneRecord) -> Float[Array, "window observables"]:
    """The window where a stair begins: its crossing 0 is the last one before it."""
    return jnp.where(_slot(record.cycles), record.last, jnp.nan)


def _readable(samples: Float[np.ndarray, "records width"]) -> Bool[np.ndarray, " records"]:
    """Mask of a block's records (n, width), in the order of rows, that have a crossing on their stair."""
    stair = samples[:, 0]
    crossing = samples[:, 1]
    before = np.where(stair == 0, 0.0, np.roll(crossing, 1))
    return crossing > before
