"""The recorder of rows that settle, are pushed once, and settle again."""

from __future__ import annotations

import dataclasses
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaitsweep.contract import Params, Status
from gaitsweep.engine.carry import Carry, Halt, select
from gaitsweep.engine.pushed_model import PushedModel, restarted
from gaitsweep.engine.recorders.bounds import change, comparable
from gaitsweep.engine.recorders.orbits import from_first_crossing
from gaitsweep.engine.recorders.recorder import (
    Beginning,
    LaneRecord,
    PollResult,
    Readings,
    Recorder,
    RunningRows,
    attempts_until,
    readings_at_the_end,
)
from gaitsweep.engine.recorders.settle import Memory, SettleRecorder
from gaitsweep.engine.shapes import Integer, Number, Observed
from gaitsweep.row_outcome import RowNumber, RowOutcome

# Least size of an observable without a scale, in its unit; larger ones are scaled by their magnitude.
FLOOR = 0.1
# The numbers of a row that was pushed, as the columns of a table have them.
MEASURED = ("t_push", "cycles_back", "time_back", "excursion", "phase_shift")
# Periods of the gait for which the event of a push is awaited.
AWAITED = 4.0


class Stage:
    """The stages of a row: it settles, waits for its push, is under a force or step, and settles again."""

    SETTLES, WAITS, ACTS, RETURNS = range(4)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PushMemory:
    """The memory of a row that is pushed.

    `settle` is that of the recorder that settles it, and `crossings` counts those that it has seen. `stage`
    is one of `Stage`. `gait` (p, k) are the observables at the crossings of the gait that is left, the latest
    first, `times` (p,) s when they were, NaN beyond its `period`. `pushed` is the time (s) of the push;
    `since` counts section crossings after it, `outside` is the last of these that was far from the gait, and
    `back` the time (s) from the push to the one after that.
    """

    settle: Memory
    crossings: Integer
    stage: Integer
    gait: Float[Array, "period observables"]
    times: Float[Array, " period"]
    period: Integer
    pushed: Number
    since: Integer
    outside: Integer
    back: Number

    @property
    def results(self) -> dict[str, Array]:
        """Numbers of a row that has ended."""
        return {**self.settle.results, "before": self.gait}


@final
@dataclasses.dataclass(frozen=True)
class PerturbRecorder(Recorder):
    """Settles a row, pushes it once, and settles it again; one result for each row.

    `settle` decides when a row has settled; its limits hold before and after the push. A row is back at its
    gait where each observable is within a share `within` of its size (`sizes`) of its value at a crossing of
    the gait. The phase shift compares the last crossing with that which the row would have had without push.
    """

    model: PushedModel  # pyright: ignore[reportIncompatibleVariableOverride]
    settle: SettleRecorder
    within: float

    @property
    def numbers(self) -> tuple[RowNumber, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (
            *self.settle.numbers,
            RowNumber("before", np.float64, np.nan, crossings=1),
            RowNumber("period_before", np.int8),
            RowNumber("stage", np.int8),
            RowNumber("recovered", np.int8, compared=True),
            *(RowNumber(name, np.float64, np.nan) for name in MEASURED),
        )

    @property
    def names(self) -> tuple[str, ...]:
        return ()

    def stop(self, params: Params) -> Number:
        return self.settle.stop(params)

    def max_attempts(self, params: Params, dt: Number | float) -> Number:
        longest = (2.0 + AWAITED) * self.settle.stop(params) + params.duration
        return attempts_until(longest, dt)

    def begin(self, params: Params, carry: Carry) -> Beginning:
        record, sample, keep = self.settle.begin(params, carry)
        # this recorder's own numbers
        record = dataclasses.replace(record, numbers=self.unsampled(params, carry)[0].numbers)
        none, unknown = jnp.zeros((), jnp.int32), jnp.full((), jnp.nan, record.last.dtype)
        longest = self.settle.max_period
        memory = PushMemory(
            settle=record.memory,
            crossings=none,
            stage=none + Stage.SETTLES,
            gait=jnp.full((longest, record.last.size), jnp.nan, record.last.dtype),
            times=jnp.full((longest,), jnp.nan, record.last.dtype),
            period=none,
            pushed=unknown,
            since=none,
            outside=none,
            back=jnp.zeros_like(unknown),
        )
        return dataclasses.replace(record, memory=memory), sample, keep

    def record(self, params: Params, carry: Carry, record: LaneRecord) -> PollResult:
        model, memory = self.model, record.memory
        due = carry.state.push_due
        # an event at which the push comes halts the row as a crossing of the section does
        crossed = (carry.halt == Halt.CROSSING) & (~due | carry.state.push_crossed)
        timed = carry.halt == Halt.TIME
        settling, waiting = memory.stage == Stage.SETTLES, memory.stage == Stage.WAITS
        acting, returning = memory.stage == Stage.ACTS, memory.stage == Stage.RETURNS

        # the row settles, before the push or after it
        tested = settling | returning
        inner = dataclasses.replace(record, cycles=memory.crossings, memory=memory.settle)
        times_before = memory.settle.window[:, -2]
        seen_halt = jnp.where((carry.halt == Halt.CROSSING) & ~crossed, Halt.GOING, carry.halt)
        polled = self.settle.record(params, dataclasses.replace(carry, halt=seen_halt), inner).record
        polled = select(tested, polled, inner)
        ended = jnp.where(tested, polled.status, Status.running)
        settled = ended == Status.settled
        arrives = settling & settled
        period = polled.numbers["period"]

        # the gait that the push will leave
        length = self.settle.max_period
        on_gait = jnp.arange(length) < period
        gait = jnp.where(on_gait[:, None], polled.memory.window[:length, :-2], jnp.nan)
        gait = jnp.where(arrives, gait, memory.gait)
        times = jnp.where(on_gait, polled.memory.window[:length, -2], jnp.nan)
        times = jnp.where(arrives, times, memory.times)
        left = jnp.where(arrives, period, memory.period)
        duration = carry.t - _at(times_before, left - 1)

        # the push itself
        hits = waiting & (timed if model.event is None else due & (carry.halt == Halt.CROSSING))
        given_up = waiting & timed & ~hits
        lasts = model.forced or model.stepped is not None
        begins = hits & jnp.asarray(lasts)
        pushed_at = jnp.where(hits, carry.t, memory.pushed)
        since = jnp.where(crossed & (acting | returning), memory.since + 1, memory.since)
        over = acting & timed if model.forced else acting & crossed & (since >= params.cycles)
        returns = over | (hits & ~begins)
        stage = jnp.where(arrives, Stage.WAITS, memory.stage)
        stage = jnp.where(begins, Stage.ACTS, jnp.where(returns, Stage.RETURNS, stage))

        # the distance from the gait
        now = jnp.where(crossed, self.observables(params, carry.state), record.last)
        distances = self._distances(now, gait)
        nearest, distance = jnp.argmin(distances), jnp.min(distances)
        counts = crossed & (acting | returning)
        far = ~(distance <= self.within)
        outside = jnp.where(counts & far, since, memory.outside)
        comes_back = counts & ~far & (outside > 0) & (outside == since - 1)
        time_back = jnp.where(comes_back, carry.t - pushed_at, memory.back)
        numbers = record.numbers
        excursion = jnp.where(counts, jnp.fmax(numbers["excursion"], distance), numbers["excursion"])

        # a row that has settled again
        final = returning & settled
        recovered = final & ~far
        ahead = (_at(times, nearest) - carry.t) / duration
        # NaN where the gait has more crossings than there were since the push
        ahead = jnp.where(memory.crossings >= left, ahead - jnp.round(ahead), jnp.nan)
        status = jnp.where(arrives, Status.running, ended)
        status = jnp.where(given_up, Status.time_limit, status)
        back = {
            "cycles_back": jnp.where(outside > 0, outside + 1, 0).astype(ahead.dtype),
            "time_back": time_back,
            "phase_shift": ahead,
        }

        state = dataclasses.replace(
            carry.state, push_crossed=carry.state.push_crossed & (carry.halt != Halt.CROSSING)
        )
        if model.event is not None:
            state = model.awaiting(state, arrives)
        state = model.released(model.pushed(params, state, hits), over)
        restarts = hits | over
        limit = self.settle.stop(params)
        wait = (params.phase if model.event is None else AWAITED) * duration
        stop = jnp.where(arrives, carry.t + wait, carry.stop)
        stop = jnp.where(begins, carry.t + (params.duration if model.forced else limit), stop)
        stop = jnp.where(returns, carry.t + limit, stop)
        expired = acting & timed & ~over
        status = jnp.where(expired, Status.time_limit, status)
        fresh = self._fresh(params, dataclasses.replace(carry, state=state), polled, now)
        moved = dataclasses.replace(
            restarted(carry, restarts), state=state, stop=stop, halt=jnp.zeros_like(carry.halt)
        )
        recorded = dataclasses.replace(
            record,
            status=status.astype(jnp.int32),
            cycles=jnp.where(crossed, record.cycles + 1, record.cycles),
            last=jnp.where(crossed, now, polled.last),
            memory=PushMemory(
                settle=select(returns, fresh, polled.memory),
                crossings=jnp.where(returns, 0, polled.cycles).astype(jnp.int32),
                stage=stage.astype(jnp.int32),
                gait=gait,
                times=times,
                period=left.astype(jnp.int32),
                pushed=pushed_at,
                since=since.astype(jnp.int32),
                outside=outside.astype(jnp.int32),
                back=time_back,
            ),
            numbers={
                **numbers,
                **{name: jnp.where(recovered, value, jnp.nan) for name, value in back.items()},
                "period": jnp.where(final, period, 0).astype(jnp.int32),
                "slowest": polled.numbers["slowest"],
                "period_before": left.astype(jnp.int32),
                "stage": stage.astype(jnp.int32),
                "recovered": recovered.astype(jnp.int32),
                "t_push": pushed_at,
                "excursion": excursion,
            },
        )
        return PollResult(moved, recorded, jnp.zeros((0,), record.last.dtype), jnp.asarray(False))

    def _fresh(self, params: Params, carry: Carry, record: LaneRecord, now: Observed) -> Memory:
        """The memory of the settling recorder where a row begins to settle again."""
        begun = self.settle.begin(params, carry)[0].memory
        seen = jnp.broadcast_to(now, begun.window[:, :-2].shape)
        # rates are compared with the largest of the whole row, and spans of rest begin now
        rest = begun.rest + jnp.stack([carry.t, 0.0 * carry.t, 0.0 * carry.t]).astype(begun.rest.dtype)
        window = jnp.concatenate([seen, begun.window[:, -2:]], axis=1)
        return dataclasses.replace(
            begun, window=window, span=record.memory.span, fastest=record.memory.fastest, rest=rest
        )

    def _distances(self, now: Observed, gait: Float[Array, "period observables"]) -> Float[Array, " period"]:
        """The distance (p,) of observables from each crossing of a gait, infinite where it has none."""
        model = self.model
        given = [1.0 if q.circular else q.scale for q in model.observables]
        known = jnp.asarray([np.nan if scale is None else scale for scale in given], now.dtype)
        size = jnp.where(jnp.isnan(known), FLOOR + jnp.abs(comparable(gait)), known[None, :])
        missing = jnp.all(jnp.isnan(gait), axis=1)  # crossings that the gait has not
        moved = jnp.abs(change(model, comparable(now)[None, :] - comparable(gait)))
        return jnp.where(missing, jnp.inf, jnp.max(moved / size, axis=1))

    def readings(self, rows: RowOutcome) -> Readings:
        left, k = rows.numbers["before"], len(self.model.observables)
        orbits = {"period": rows.numbers["period_before"], "last": left[:, :k], "orbit": left[:, k:]}
        before = from_first_crossing(
            self.model.observables, dataclasses.replace(rows, numbers={**rows.numbers, **orbits})
        )
        known = rows.numbers["period_before"] > 0
        earlier = Readings(np.arange(rows.row.size), rows.t_end, before.last, known)
        return dataclasses.replace(readings_at_the_end(rows), earlier=earlier)

    def share(self, rows: RunningRows, typical: float) -> Float[np.ndarray, " rows"]:
        return np.minimum(rows.cycles / (typical or 2.0 * self.settle.max_cycles), 0.95)


def _at(values: Float[Array, " n"], place: Integer) -> Number:
    """The value at a place, which changes along a trajectory."""
    return jnp.sum(
        jnp.where(jnp.arange(values.size) == place, jnp.where(jnp.isnan(values), 0.0, values), 0.0)
    )
