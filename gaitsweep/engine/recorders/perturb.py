"""The recorder of rows that settle, are pushed once, and settle again."""

from __future__ import annotations

import dataclasses
import enum
import functools
import operator
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaitsweep.contract import Params
from gaitsweep.engine.carry import Carry, Flag, Halt, Integer, Number, Observed, restarted, select
from gaitsweep.engine.pushed_model import PushedModel
from gaitsweep.engine.recorders.bounds import change, comparable, widened
from gaitsweep.engine.recorders.orbit_period import from_first_crossing
from gaitsweep.engine.recorders.recorder import (
    Beginning,
    LaneRecord,
    PollResult,
    Readings,
    Recorder,
    ResultMemory,
    RunningRows,
    attempts_until,
    readings_at_the_end,
)
from gaitsweep.engine.recorders.settle import Memory, SettleRecorder
from gaitsweep.row_outcome import RowNumber, RowOutcome
from gaitsweep.status import Status

# Least size of an observable without a scale, in its unit; larger ones are scaled by their magnitude.
MIN_SIZE = 0.1
# The numbers of a row that was pushed, as the columns of a table have them.
MEASURED = ("t_push", "cycles_back", "time_back", "excursion", "phase_shift")
# Periods of the gait for which the event of a push is awaited.
AWAITED = 4.0
# A push at the section may move the state back behind it. The crossing that follows within this share of a
# cycle since the last one is that crossing again: no cycle has passed.
AGAIN = 0.05


class Stage(enum.IntEnum):
    """The stages of a row: it settles, waits for its push, is under a force or step, and settles again."""

    SETTLES = 0
    WAITS = 1
    ACTS = 2
    RETURNS = 3


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PushMemory(ResultMemory):
    """The memory of a row that is pushed.

    Attributes:
        settle: the memory of the recorder that settles it.
        crossings: the crossings that this recorder has polled.
        stage: one of `Stage`.
        gait: the observables (p, k) at the crossings of the gait that is left, the latest first; NaN beyond
            its period.
        times: the times (p,) of these crossings (s).
        period: the period of the gait (crossings).
        cycle: the mean time between two crossings of that gait (s).
        crossed: the time of the latest crossing (s).
        pushed: the time of the push (s).
        since: the section crossings after the push.
        outside: the last of these that was far from the gait, 0 if none.
        back: the time from the push to the crossing after that (s).
    """

    settle: Memory
    crossings: Integer
    stage: Integer
    gait: Float[Array, "period observables"]
    times: Float[Array, " period"]
    period: Integer
    cycle: Number
    crossed: Number
    pushed: Number
    since: Integer
    outside: Integer
    back: Number

    @property
    def results(self) -> dict[str, Array]:
        """Numbers of a row that has ended."""
        return {**self.settle.results, "before": self.gait}

    def is_in(self, *stages: Stage) -> Flag:
        """Whether the row is in one of these stages."""
        flags = [self.stage == stage for stage in stages]
        return functools.reduce(operator.or_, flags)


@dataclasses.dataclass(frozen=True)
class _Settling:
    """The result of a poll of the recorder that settles the row.

    Attributes:
        polled: the record that this recorder returns.
        ended: the status of the row by this recorder, `running` where it is not polled.
        settled: whether the row has settled.
        arrives: whether it has settled for the first time.
        period: the period of its gait (crossings).
    """

    polled: LaneRecord
    ended: Integer
    settled: Flag
    arrives: Flag
    period: Integer


@dataclasses.dataclass(frozen=True)
class _Push:
    """The push at a poll.

    Attributes:
        hits: whether it comes.
        given_up: whether it did not come in time.
        begins: whether it begins to act for some time.
        over: whether it stops acting.
        returns: whether the row begins to settle again.
        time: `PushMemory.pushed` after the poll.
        since: `PushMemory.since` after the poll.
        stage: `PushMemory.stage` after the poll.
    """

    hits: Flag
    given_up: Flag
    begins: Flag
    over: Flag
    returns: Flag
    time: Number
    since: Integer
    stage: Integer


@dataclasses.dataclass(frozen=True)
class _Departure:
    """The departure of a row from its gait after the push, up to its latest crossing.

    Attributes:
        nearest: the place in `PushMemory.gait` of the crossing that is nearest to the latest one.
        far: whether the latest crossing is further from that than the recorder allows.
        outside: `PushMemory.outside` after the poll.
        time_back: `PushMemory.back` after the poll.
        excursion: the largest distance of a crossing after the push from the gait, as in `within`.
    """

    nearest: Integer
    far: Flag
    outside: Integer
    time_back: Number
    excursion: Number


@final
@dataclasses.dataclass(frozen=True)
class PerturbRecorder(Recorder):
    """Settles a row, pushes it once, and settles it again.

    The phase shift compares the last crossing with that which the row would have had without push.

    Args:
        model: the model with the push.
        settle: decides when a row has settled; its limits hold before and after the push.
        within: the largest distance of a crossing from one of the gait that counts as back: the largest
            difference of an observable, in rad or as a share of its scale, without one of `MIN_SIZE` and its
            magnitude.
    """

    model: PushedModel  # pyright: ignore[reportIncompatibleVariableOverride]
    settle: SettleRecorder
    within: float

    @property
    def numbers(self) -> tuple[RowNumber, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (
            *self.settle.numbers,
            RowNumber("before", np.float64, np.nan, crossings=self.settle.max_period),
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
        zero = jnp.zeros((), jnp.int32)
        unknown = jnp.full((), jnp.nan, record.last.dtype)
        longest = self.settle.max_period
        settle: Memory = record.memory
        if self.model.resumes:
            # a row that begins where it had settled has no range: observables without a scale have at least
            # the size of their values, and not that of their last changes
            values = comparable(record.last)
            span = widened(widened(settle.span, self.model, values), self.model, 0.0 * values)
            settle = dataclasses.replace(settle, span=span)
        memory = PushMemory(
            settle=settle,
            crossings=zero,
            stage=zero + Stage.SETTLES,
            gait=jnp.full((longest, record.last.size), jnp.nan, record.last.dtype),
            times=jnp.full((longest,), jnp.nan, record.last.dtype),
            period=zero,
            cycle=unknown,
            crossed=unknown,
            pushed=unknown,
            since=zero,
            outside=zero,
            back=jnp.zeros_like(unknown),
        )
        return Beginning(dataclasses.replace(record, memory=memory), sample, keep)

    def record(self, params: Params, carry: Carry, record: LaneRecord) -> PollResult:
        memory: PushMemory = record.memory
        # an event at which the push comes halts the row as a crossing of the section does
        due = carry.state.push_due
        crossed = (carry.halt == Halt.CROSSING) & (~due | carry.state.push_crossed)
        is_first = memory.is_in(Stage.ACTS, Stage.RETURNS) & (memory.since == 0)
        crossed = crossed & ~(is_first & (carry.t - memory.crossed < AGAIN * memory.cycle))
        timed = carry.halt == Halt.TIME
        settling = self._settling(params, carry, record, crossed)
        memory = self._with_gait(memory, settling)
        push = self._push(params, carry, memory, settling, crossed=crossed, timed=timed)
        latest = jnp.where(crossed, self.observables(params, carry.state), record.last)
        departure = self._departure(carry, record, memory, push, crossed, latest)
        # the period (s) of the gait at a poll at which the row has settled; elsewhere it is not used
        duration = carry.t - _entry_at(memory.settle.window[:, -2], memory.period - 1)
        next_carry = self._carry_after(params, carry, settling, push, duration)
        pushed_carry = dataclasses.replace(carry, state=next_carry.state)
        fresh = self._fresh(params, pushed_carry, settling.polled, latest)
        recorded = dataclasses.replace(
            record,
            status=_status(memory, settling, push, timed).astype(jnp.int32),
            cycles=jnp.where(crossed, record.cycles + 1, record.cycles),
            last=jnp.where(crossed, latest, settling.polled.last),
            memory=_memory_after(carry, memory, settling, push, departure, fresh, crossed, duration),
            numbers={
                **record.numbers,
                **_numbers_of_return(carry, memory, settling, departure, duration),
                "slowest": settling.polled.numbers["slowest"],
                "period_before": memory.period.astype(jnp.int32),
                "stage": push.stage.astype(jnp.int32),
                "t_push": push.time,
                "excursion": departure.excursion,
            },
        )
        return PollResult(next_carry, recorded, jnp.zeros((0,), record.last.dtype), jnp.asarray(False))

    def _settling(self, params: Params, carry: Carry, record: LaneRecord, crossed: Flag) -> _Settling:
        """Poll the recorder that settles the row, before the push or after it."""
        memory: PushMemory = record.memory
        tested = memory.is_in(Stage.SETTLES, Stage.RETURNS)
        inner = dataclasses.replace(record, cycles=memory.crossings, memory=memory.settle)
        # a halt for the push is no crossing
        halt = jnp.where((carry.halt == Halt.CROSSING) & ~crossed, Halt.GOING, carry.halt)
        polled = self.settle.record(params, dataclasses.replace(carry, halt=halt), inner).record
        polled = select(tested, polled, inner)
        ended = jnp.where(tested, polled.status, Status.running)
        settled = ended == Status.settled
        arrives = memory.is_in(Stage.SETTLES) & settled
        return _Settling(polled, ended, settled, arrives, polled.numbers["period"])

    def _with_gait(self, memory: PushMemory, settling: _Settling) -> PushMemory:
        """The memory with the gait that the push leaves: that on which the row settles now or had settled."""
        length = self.settle.max_period
        window = settling.polled.memory.window[:length]
        on_gait = jnp.arange(length) < settling.period
        observed = jnp.where(on_gait[:, None], window[:, :-2], jnp.nan)
        observed = jnp.where(settling.arrives, observed, memory.gait)
        times = jnp.where(on_gait, window[:, -2], jnp.nan)
        times = jnp.where(settling.arrives, times, memory.times)
        period = jnp.where(settling.arrives, settling.period, memory.period)
        return dataclasses.replace(memory, gait=observed, times=times, period=period.astype(jnp.int32))

    def _push(
        self,
        params: Params,
        carry: Carry,
        memory: PushMemory,
        settling: _Settling,
        *,
        crossed: Flag,
        timed: Flag,
    ) -> _Push:
        """The push itself: whether it comes or ends now, and the stage after this poll."""
        model = self.model
        comes = timed
        if model.event is not None:
            comes = carry.state.push_due & (carry.halt == Halt.CROSSING)
        waiting = memory.is_in(Stage.WAITS)
        hits = waiting & comes
        begins = hits & jnp.asarray(model.forced or model.stepped is not None)
        since = jnp.where(crossed & memory.is_in(Stage.ACTS, Stage.RETURNS), memory.since + 1, memory.since)
        lasted = timed if model.forced else crossed & (since >= params.cycles)
        over = memory.is_in(Stage.ACTS) & lasted
        returns = over | (hits & ~begins)
        stage = jnp.where(settling.arrives, Stage.WAITS, memory.stage)
        return _Push(
            hits=hits,
            given_up=waiting & timed & ~hits,
            begins=begins,
            over=over,
            returns=returns,
            time=jnp.where(hits, carry.t, memory.pushed),
            since=since,
            stage=jnp.where(begins, Stage.ACTS, jnp.where(returns, Stage.RETURNS, stage)),
        )

    def _departure(
        self,
        carry: Carry,
        record: LaneRecord,
        memory: PushMemory,
        push: _Push,
        crossed: Flag,
        latest: Observed,
    ) -> _Departure:
        """The departure from the gait, to which crossings after the push count.

        Args:
            carry: the trajectory.
            record: the record before this poll.
            memory: the memory with the gait that the push leaves.
            push: the push at this poll.
            crossed: whether the row is at a crossing of the section.
            latest: the observables at the latest crossing.
        """
        distances = self._distances(latest, memory.gait, memory.period)
        nearest = jnp.argmin(distances)
        distance = jnp.min(distances)
        counts = crossed & memory.is_in(Stage.ACTS, Stage.RETURNS)
        far = ~(distance <= self.within)
        outside = jnp.where(counts & far, push.since, memory.outside)
        comes_back = counts & ~far & (outside > 0) & (outside == push.since - 1)
        time_back = jnp.where(comes_back, carry.t - push.time, memory.back)
        largest = record.numbers["excursion"]
        excursion = jnp.where(counts, jnp.fmax(largest, distance), largest)
        return _Departure(nearest, far, outside, time_back, excursion)

    def _carry_after(
        self, params: Params, carry: Carry, settling: _Settling, push: _Push, duration: Number
    ) -> Carry:
        """The trajectory after a poll, with the push switched on or off and its next stop.

        Args:
            params: the parameters of the row.
            carry: the trajectory.
            settling: the poll of the recorder that settles the row.
            push: the push at this poll.
            duration: the period (s) of the gait of a row that has settled at this poll.
        """
        model = self.model
        crossed_before = carry.state.push_crossed & (carry.halt != Halt.CROSSING)
        state = dataclasses.replace(carry.state, push_crossed=crossed_before)
        if model.event is not None:
            state = model.awaiting(state, settling.arrives)
        state = model.released(params, model.pushed(params, state, push.hits), push.over)
        limit = self.settle.stop(params)
        wait = (params.phase if model.event is None else AWAITED) * duration
        stop = jnp.where(settling.arrives, carry.t + wait, carry.stop)
        stop = jnp.where(push.begins, carry.t + (params.duration if model.forced else limit), stop)
        return dataclasses.replace(
            restarted(carry, push.hits | push.over),
            state=state,
            stop=jnp.where(push.returns, carry.t + limit, stop),
            halt=jnp.zeros_like(carry.halt),
        )

    def _fresh(self, params: Params, carry: Carry, record: LaneRecord, now: Observed) -> Memory:
        """The memory of the settling recorder where a row begins to settle again."""
        begun = self.settle.begin(params, carry)[0].memory
        observed = jnp.broadcast_to(now, begun.window[:, :-2].shape)
        # rates are compared with the largest of the whole row, and spans of rest begin now
        since = jnp.stack([carry.t, 0.0 * carry.t, 0.0 * carry.t])
        return dataclasses.replace(
            begun,
            window=jnp.concatenate([observed, begun.window[:, -2:]], axis=1),
            span=record.memory.span,
            fastest=record.memory.fastest,
            rest=begun.rest + since.astype(begun.rest.dtype),
        )

    def _distances(
        self, now: Observed, gait: Float[Array, "crossings observables"], period: Integer
    ) -> Float[Array, " crossings"]:
        """The distance (p,) of observables from each crossing of a gait, infinite beyond its `period`."""
        model = self.model
        declared = [1.0 if q.circular else q.scale for q in model.observables]
        scales = jnp.asarray([np.nan if scale is None else scale for scale in declared], now.dtype)
        size = jnp.where(jnp.isnan(scales), MIN_SIZE + jnp.abs(comparable(gait)), scales[None, :])
        missing = jnp.arange(len(gait)) >= period
        moved = jnp.abs(change(model, comparable(now)[None, :] - comparable(gait)))
        return jnp.where(missing, jnp.inf, jnp.max(moved / size, axis=1))

    def readings(self, rows: RowOutcome) -> Readings:
        period = rows.numbers["period_before"]
        crossings = rows.numbers["before"]
        k = len(self.model.observables)
        orbits = {"period": period, "last": crossings[:, :k], "orbit": crossings[:, k:]}
        before = dataclasses.replace(rows, numbers={**rows.numbers, **orbits})
        last = from_first_crossing(self.model.observables, before).last
        earlier = Readings(np.arange(rows.row.size), rows.t_end, last, readable=period > 0)
        return dataclasses.replace(readings_at_the_end(rows), earlier=earlier)

    def progress(self, rows: RunningRows, typical: float) -> Float[np.ndarray, " rows"]:
        return np.minimum(rows.cycles / (typical or 2.0 * self.settle.max_cycles), 0.95)


def _status(memory: PushMemory, settling: _Settling, push: _Push, timed: Flag) -> Integer:
    """The status of a row after a poll; `memory` is that before it, `timed`: it has halted at a time."""
    status = jnp.where(settling.arrives, Status.running, settling.ended)
    expired = memory.is_in(Stage.ACTS) & timed & ~push.over
    return jnp.where(push.given_up | expired, Status.time_limit, status)


def _numbers_of_return(
    carry: Carry,
    memory: PushMemory,
    settling: _Settling,
    departure: _Departure,
    duration: Number,
) -> dict[str, Array]:
    """The numbers of a row that has settled again, by name.

    Args:
        carry: the trajectory.
        memory: the memory before this poll, with the gait that the push leaves.
        settling: the poll of the recorder that settles the row.
        departure: the departure of the row from that gait.
        duration: the period (s) of the gait of a row that has settled at this poll.
    """
    settled_again = memory.is_in(Stage.RETURNS) & settling.settled
    recovered = settled_again & ~departure.far
    ahead = (_entry_at(memory.times, departure.nearest) - carry.t) / duration
    # NaN where the gait has more crossings than there were since the push
    phase_shift = jnp.where(memory.crossings >= memory.period, ahead - jnp.round(ahead), jnp.nan)
    cycles_back = jnp.where(departure.outside > 0, departure.outside + 1, 0).astype(phase_shift.dtype)
    return {
        "cycles_back": jnp.where(recovered, cycles_back, jnp.nan),
        "time_back": jnp.where(recovered, departure.time_back, jnp.nan),
        "phase_shift": jnp.where(recovered, phase_shift, jnp.nan),
        "period": jnp.where(settled_again, settling.period, 0).astype(jnp.int32),
        "recovered": recovered.astype(jnp.int32),
    }


def _memory_after(
    carry: Carry,
    memory: PushMemory,
    settling: _Settling,
    push: _Push,
    departure: _Departure,
    fresh: Memory,
    crossed: Flag,
    duration: Number,
) -> PushMemory:
    """The memory of a row after a poll; `fresh` is that of a row that begins to settle again."""
    cycle = jnp.where(settling.arrives, duration / memory.period, memory.cycle)
    crossed_at = jnp.where(crossed, carry.t, memory.crossed)
    return dataclasses.replace(
        memory,
        settle=select(push.returns, fresh, settling.polled.memory),
        crossings=jnp.where(push.returns, 0, settling.polled.cycles).astype(jnp.int32),
        stage=push.stage.astype(jnp.int32),
        cycle=cycle,
        crossed=crossed_at,
        pushed=push.time,
        since=push.since.astype(jnp.int32),
        outside=departure.outside.astype(jnp.int32),
        back=departure.time_back,
    )


def _entry_at(values: Float[Array, " n"], place: Integer) -> Number:
    """The entry at a traced index; 0 where it is NaN."""
    at_place = jnp.arange(values.size) == place
    return jnp.sum(jnp.where(at_place, jnp.where(jnp.isnan(values), 0.0, values), 0.0))
