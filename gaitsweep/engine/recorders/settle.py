"""The recorder of runs that end at a fixed point or a periodic orbit of the return map, or of the flow."""

from __future__ import annotations

import dataclasses
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaitsweep.contract import HybridModel, Model, Params
from gaitsweep.engine.carry import Carry, Flag, Halt, Integer, Number, Observed, select, unlikely
from gaitsweep.engine.recorders.bounds import (
    ROUNDING,
    SETTLE_WINDOW,
    TOLERANCE,
    Span,
    bounds,
    change,
    comparable,
    first_span,
    slowest,
    widened,
)
from gaitsweep.engine.recorders.exponents import Exponents, exponent_numbers, may_turn, separated
from gaitsweep.engine.recorders.orbit_period import NO_MOTION, orbit_period, over_periods
from gaitsweep.engine.recorders.recorder import (
    SPARE_CYCLES,
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
from gaitsweep.engine.tangents import Tangent
from gaitsweep.row_outcome import RowNumber, RowOutcome
from gaitsweep.status import Status

# The crossings at which a row ends that has not settled, by default.
MAX_CYCLES = 150
# The longest period (crossings) of an attractor that is detected, by default. The test is made at every
# crossing whose number is a multiple of it, over two spans of that length.
MAX_PERIOD = 8
# The first crossing of the test, in longest periods.
FIRST_TEST = 3
# Longest periods for which a detected orbit has to be detected again: as many as the test looks at.
CONFIRMED_FOR = 2
# A state leaves an unstable fixed point if its latest change is this many times the smallest in the window.
LEAVING = 2.0
# Crossings in each of three successive spans whose lengths in time are extrapolated as a geometric series.
CROSSINGS_PER_SPAN = 3
# Crossings accumulate if the limit of these lengths is less than this share of the present one,
ACCUMULATED = 0.1
# and the lengths shrink by more than this share of themselves.
STEADY = 1.0e-3
# They have accumulated if the present length is less than this share of the mean over the row.
NEGLIGIBLE = 1.0e-4
# A row is at rest if all rates of its flow, each as a share of the largest that it had, are below this share
REST = 1.0e-6
# at all polls in two successive spans of so many nominal periods, and not larger in the second one.
REST_PERIODS = 10.0
# A rate is rounding if it changes a variable in a period by less than this (in its unit, or as a share).
MIN_RATE = 1.0e-12


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Memory(ResultMemory):
    """The memory of a row.

    Attributes:
        window: the last `SETTLE_WINDOW` crossings (w, n + 2), or `max_period` if that is more: their
            observables, their time (s) and their distance from the crossing before, in units of the bound.
        moves: the largest distances (2, p) from the state 1, ..., p crossings earlier, over the current span
            of crossings and the one before it.
        span: the least and largest values (2, n) of the observables, without those of the start
            (`first_span`).
        calm: successive crossings at which the state stood still.
        orbit: the period of the orbit that the last tests showed, and the crossing of the first of these
            tests; both 0 if none.
        fastest: the largest rates (m,) of the flow.
        rest: the beginning of the current span of rest (s), its largest rate, and that of the span before it,
            -1 if there was none.
        exponents: the sums of Lyapunov exponents; () if they are not followed.
    """

    window: Float[Array, "window numbers"]
    moves: Float[Array, "2 lags"]
    span: Span
    calm: Integer
    orbit: Int[Array, " 2"]
    fastest: Float[Array, " rates"]
    rest: Float[Array, " 3"]
    exponents: Exponents | tuple[()]

    @property
    def results(self) -> dict[str, Array]:
        """Numbers of a row that has ended, which `with_orbits` reads."""
        return {"window": self.window}


@dataclasses.dataclass(frozen=True)
class _Crossing:
    """The present state as one more crossing, which counts only if the trajectory is at one.

    It is compared with the w crossings before it.

    Attributes:
        observed: its observables (n,).
        now: the same for comparison (`comparable`).
        cycles: its number.
        free: whether the gait is no longer constrained from outside.
        span: as of `Memory`.
        latest: the observables (w + 1, n) at this and the last crossings.
        moves: the absolute changes (w, n) since each of those before.
        moved: the same in units of the bound.
        distances: the largest of these (w,).
        still: whether all are within the bound.
        calm: as of `Memory`.
        leaves: whether the state is about to leave a fixed point.
    """

    observed: Observed
    now: Observed
    cycles: Integer
    free: Flag
    span: Span
    latest: Float[Array, "latest observables"]
    moves: Float[Array, "window observables"]
    moved: Float[Array, "window observables"]
    distances: Float[Array, " window"]
    still: Flag
    calm: Integer
    leaves: Flag

    def next_window(self, carry: Carry, memory: Memory) -> Float[Array, "window numbers"]:
        """`Memory.window` with this crossing."""
        head = jnp.stack([carry.t.astype(self.now.dtype), self.distances[0]])
        first = jnp.concatenate([self.observed, head])
        return jnp.concatenate([first[None, :], memory.window[:-1]])


@dataclasses.dataclass(frozen=True)
class _OrbitTest:
    """The test whether a row has reached an attractor of the return map.

    Attributes:
        period: the period of the attractor (crossings), 0 if none.
        tested: whether the test for orbits is made at this crossing.
        moves: the largest distances (p,) of the current span, as of `Memory`.
        orbit: as of `Memory`.
    """

    period: Integer
    tested: Flag
    moves: Float[Array, " lags"]
    orbit: Int[Array, " 2"]

    def next_moves(self, memory: Memory) -> Float[Array, "2 lags"]:
        """`Memory.moves` after this crossing: a new span begins where the test has been made."""
        next_span = jnp.stack([jnp.zeros_like(self.moves), self.moves])
        return jnp.where(self.tested, next_span, memory.moves.at[0].set(self.moves))


@dataclasses.dataclass(frozen=True)
class _Rest:
    """The test whether a row is at rest.

    Attributes:
        fastest: `Memory.fastest` after the poll.
        span: `Memory.rest` after the poll.
        rests: whether the row is at rest.
    """

    fastest: Float[Array, " rates"]
    span: Float[Array, " 3"]
    rests: Flag


@dataclasses.dataclass(frozen=True)
class _Growth:
    """The growth of a row's tangents, if Lyapunov exponents are followed.

    Attributes:
        tangents: the tangents after this poll, orthonormal at a crossing.
        exponents: as of `Memory`.
        at_cycle_limit: the status of a row that has not settled at the limit of its cycles.
        at_time_limit: the same at the limit of its time.
        numbers: the exponents and their errors by name.
    """

    tangents: list[Tangent]
    exponents: Exponents | tuple[()]
    at_cycle_limit: Integer
    at_time_limit: Integer
    numbers: dict[str, Number]


@final
@dataclasses.dataclass(frozen=True)
class SettleRecorder(Recorder):
    """Ends a row at a fixed point of the return map, at an orbit of period 2 to `max_period`, or at rest.

    1. Settled with period 1: each observable stayed within its bound (`bounds`) of its values at the last
       `SETTLE_WINDOW` crossings. A state that is about to leave (`LEAVING`) has to stay for as many more
       crossings. Crossings that accumulate do not settle.
    2. Settled with period p: `orbit_period` finds an orbit, again for `CONFIRMED_FOR` of the longest periods.
    3. At rest: all rates of the flow vanish (`REST`).

    Args:
        model: the model.
        max_cycles: the crossings at which a row ends that has not settled.
        tolerance: one for all observables, or one for each, as a share of its scale.
        max_time: the time at which a row ends (s); by default four nominal periods for each of `max_cycles`
            and of `SPARE_CYCLES` more.
        max_period: the longest period that is detected (crossings).
        exponents: the number of Lyapunov exponents; with them, rows may end as chaotic or quasi-periodic
            (`Exponents.status`).
    """

    model: Model
    max_cycles: int = MAX_CYCLES
    tolerance: float | tuple[float, ...] = TOLERANCE
    max_time: float | None = None
    max_period: int = MAX_PERIOD
    exponents: int = 0

    @property
    def numbers(self) -> tuple[RowNumber, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        orbit = RowNumber("orbit", np.float64, np.nan, crossings=self._window - 1)
        return (*Recorder.numbers, orbit, *exponent_numbers(self.model, self.exponents))

    @property
    def _window(self) -> int:
        """The crossings that the memory of a row holds."""
        return max(SETTLE_WINDOW, self.max_period)

    @property
    def names(self) -> tuple[str, ...]:
        return ()

    def stop(self, params: Params) -> Number:
        period = self.model.period(params)
        if self.max_time is not None:
            return jnp.full_like(period, self.max_time)
        return 4.0 * (self.max_cycles + SPARE_CYCLES) * period

    def max_attempts(self, params: Params, dt: Number | float) -> Number:
        return attempts_until(self.stop(params), dt)

    def begin(self, params: Params, carry: Carry) -> Beginning:
        record, sample, keep = self.unsampled(params, carry)
        last = record.last
        dtype = last.dtype
        length = self._window
        observed = jnp.broadcast_to(last, (length, *last.shape))
        zero = jnp.zeros((), jnp.int32)
        memory = Memory(
            window=jnp.concatenate([observed, jnp.zeros((length, 2), dtype)], axis=1),
            moves=jnp.zeros((2, self.max_period), dtype),
            span=first_span(self.model, last),
            calm=zero,
            orbit=jnp.stack([zero, zero]),
            fastest=jnp.zeros_like(self._rates(params, carry)[0]),
            rest=jnp.asarray([0.0, 0.0, -1.0], dtype),
            exponents=Exponents.begun(self.exponents, last, length) if self.exponents else (),
        )
        return Beginning(dataclasses.replace(record, memory=memory), sample, keep)

    def record(self, params: Params, carry: Carry, record: LaneRecord) -> PollResult:
        memory: Memory = record.memory
        crossed = unlikely(carry.halt == Halt.CROSSING)
        crossing = self._compared(params, carry, record)
        test = self._tested(carry, memory, crossing)
        growth = self._growth(params, carry, record, crossing, test.period, crossed)
        rest = self._rest(params, carry, memory)
        # crossings at one instant are not cycles
        settled = (test.period > 0) & (carry.chain < SETTLE_WINDOW)
        given_up = crossing.cycles >= self.max_cycles
        at_rest = rest.rests & crossing.free & ~crossed
        at_crossing = jnp.where(given_up, growth.at_cycle_limit, Status.running)
        at_crossing = jnp.where(settled, Status.settled, at_crossing)
        at_time = jnp.where(carry.halt == Halt.TIME, growth.at_time_limit, Status.running)
        status = jnp.where(crossed, at_crossing, jnp.where(at_rest, Status.at_rest, at_time))
        most = slowest(over_periods(crossing.moved[:SETTLE_WINDOW]))
        slowest_place = jnp.where(crossed & given_up & ~settled, most, -1)
        # rows that fail have no exponents
        exponents = {
            name: jnp.where(status == Status.running, jnp.nan, number)
            for name, number in growth.numbers.items()
        }
        recorded = dataclasses.replace(
            record,
            status=status.astype(jnp.int32),
            cycles=jnp.where(crossed, crossing.cycles, record.cycles),
            last=jnp.where(crossed | at_rest, crossing.observed, record.last),
            memory=_memory_after(carry, memory, crossing, test, rest, growth, crossed),
            numbers={
                **record.numbers,
                **exponents,
                "period": jnp.where(crossed & settled, test.period, 0).astype(jnp.int32),
                "slowest": slowest_place.astype(jnp.int32),
            },
        )
        carry = dataclasses.replace(carry, tangents=growth.tangents, halt=jnp.zeros_like(carry.halt))
        return PollResult(carry, recorded, jnp.zeros((0,), record.last.dtype), jnp.asarray(False))

    def _compared(self, params: Params, carry: Carry, record: LaneRecord) -> _Crossing:
        """The present state as one more crossing, compared with those before it."""
        memory = record.memory
        observed = self.observables(params, carry.state)
        now = comparable(observed)
        before = comparable(memory.window[:, :-2])
        times = memory.window[:, -2]
        steps = memory.window[:, -1]
        cycles = record.cycles + 1
        # a row with NaN for the times in its window does not settle
        free = carry.t >= self.model.free_after(params)
        span = widened(memory.span, self.model, now)
        moves = jnp.abs(change(self.model, now[None, :] - before))
        moves = jnp.where(jnp.isnan(times)[:, None], jnp.nan, moves)
        latest = jnp.concatenate([now[None, :], before[:SETTLE_WINDOW]])
        # one division for each observable
        in_bounds = 1.0 / bounds(self.model, self.tolerance, latest, span)
        moved = jnp.maximum(moves - ROUNDING, 0.0) * in_bounds[None, :]
        still = (cycles >= SETTLE_WINDOW) & jnp.all(moved[:SETTLE_WINDOW] < 1.0)
        calm = jnp.where(still, memory.calm + 1, 0)
        distances = jnp.max(moved, axis=1)
        leaves = (distances[0] > LEAVING * jnp.min(steps[: SETTLE_WINDOW - 1])) & (distances[0] > NO_MOTION)
        return _Crossing(
            observed=observed,
            now=now,
            cycles=cycles,
            free=free,
            span=span,
            latest=latest,
            moves=moves,
            moved=moved,
            distances=distances,
            still=still,
            calm=calm,
            leaves=leaves,
        )

    def _tested(self, carry: Carry, memory: Memory, crossing: _Crossing) -> _OrbitTest:
        """The test whether a row has settled at a fixed point, or on a periodic orbit."""
        cycles = crossing.cycles
        still = crossing.still
        times = memory.window[:, -2]
        stays = ~crossing.leaves | (crossing.calm > SETTLE_WINDOW)
        fixed = still & stays & ~_accumulate(cycles, carry.t, times)
        moves = jnp.maximum(memory.moves[0], crossing.distances[: self.max_period])
        tested = cycles % self.max_period == 0
        period_of_orbit = orbit_period(
            moves,
            memory.moves[1],
            max_period=self.max_period,
            max_cycles=self.max_cycles,
            tolerance=self.tolerance,
        )
        repeats = jnp.where(cycles >= FIRST_TEST * self.max_period, period_of_orbit, 0)
        begun = jnp.where(repeats == memory.orbit[0], memory.orbit[1], cycles)
        is_orbit = tested & (repeats > 0) & ~still
        lasted = is_orbit & (cycles - begun >= CONFIRMED_FOR * self.max_period)
        orbit = jnp.where(tested, jnp.stack([repeats, begun]), memory.orbit)
        period = jnp.where(fixed, 1, jnp.where(lasted, repeats, 0))
        return _OrbitTest(period, tested, moves, orbit)

    def _growth(
        self,
        params: Params,
        carry: Carry,
        record: LaneRecord,
        crossing: _Crossing,
        period: Integer,
        crossed: Flag,
    ) -> _Growth:
        """The growth of tangents up to this crossing; `period` is that of the attractor, 0 if none."""
        memory: Memory = record.memory
        exponents = memory.exponents
        at_cycle_limit = jnp.asarray(Status.cycle_limit)
        at_time_limit = jnp.asarray(Status.time_limit)
        if not isinstance(exponents, Exponents):
            return _Growth(carry.tangents, exponents, at_cycle_limit, at_time_limit, {})
        scales = bounds(self.model, 1.0 / SETTLE_WINDOW, crossing.latest, crossing.span)
        away = jnp.abs(change(self.model, crossing.now[None, :] - exponents.begin)) / scales[None, :]
        logs, tangents = separated(self.model, params, carry)
        later = exponents.after(
            logs,
            duration=carry.t - memory.window[0, -2],
            step=jnp.max(crossing.moves[0] / scales),
            shares=jnp.max(away, axis=1),
            cycles=crossing.cycles,
            now=crossing.now,
        )
        exponents = select(crossed, later, exponents)
        cycles = jnp.where(crossed, crossing.cycles, record.cycles)
        at_cycle_limit = exponents.status(cycles, may_turn=may_turn(self.model))
        at_time_limit = jnp.where(at_cycle_limit == Status.cycle_limit, at_time_limit, at_cycle_limit)
        return _Growth(
            tangents=select(crossed, tangents, carry.tangents),
            exponents=exponents,
            at_cycle_limit=at_cycle_limit,
            at_time_limit=at_time_limit,
            numbers=exponents.numbers(period, carry.t - memory.window[:, -2]),
        )

    def _rates(self, params: Params, carry: Carry) -> tuple[Float[Array, " rates"], Float[Array, " rates"]]:
        """The absolute rates (m,) of the flow and the magnitudes of its variables; none without a flow."""
        rates = {}
        if isinstance(self.model, HybridModel) and self.model.locates_events:
            rates = self.model.flow(params, carry.state)
        all_rates = [jnp.zeros((0,), carry.t.dtype)]
        all_values = [jnp.zeros((0,), carry.t.dtype)]
        for name, rate in rates.items():
            values = getattr(carry.state, name)
            all_values.append(jnp.ravel(values))
            all_rates.append(jnp.ravel(jnp.broadcast_to(rate, values.shape)))
        return jnp.abs(jnp.concatenate(all_rates)), jnp.abs(jnp.concatenate(all_values))

    def _rest(self, params: Params, carry: Carry, memory: Memory) -> _Rest:
        """The test whether all rates of the flow have vanished."""
        rates, sizes = self._rates(params, carry)
        if rates.size == 0:
            return _Rest(memory.fastest, memory.rest, jnp.asarray(False))
        period = self.model.period(params)
        fastest = jnp.where(rates > memory.fastest, rates, memory.fastest)
        moves = rates * period > MIN_RATE * jnp.maximum(sizes, 1.0)
        share = jnp.max(jnp.where(moves, rates / jnp.where(moves, fastest, 1.0), 0.0))
        slow = (share < REST) & ~unlikely(carry.halt == Halt.CROSSING)
        begun = memory.rest[0]
        largest = jnp.maximum(memory.rest[1], share)
        largest_before = memory.rest[2]
        is_over = carry.t - begun >= REST_PERIODS * period
        rests = slow & is_over & (largest <= largest_before)
        next_span = jnp.stack([carry.t, 0.0 * largest, largest])
        same_span = jnp.stack([begun, largest, largest_before])
        continued = jnp.where(is_over, next_span, same_span)
        no_span = jnp.stack([carry.t, 0.0 * largest, 0.0 * largest - 1.0])
        return _Rest(fastest, jnp.where(slow, continued, no_span), rests)

    def readings(self, rows: RowOutcome) -> Readings:
        return readings_at_the_end(rows)

    def progress(self, rows: RunningRows, typical: float) -> Float[np.ndarray, " rows"]:
        return np.minimum(rows.cycles / (typical or self.max_cycles), 0.95)


def _memory_after(
    carry: Carry,
    memory: Memory,
    crossing: _Crossing,
    test: _OrbitTest,
    rest: _Rest,
    growth: _Growth,
    crossed: Flag,
) -> Memory:
    """The memory of a row after a poll, at a crossing or between two."""
    window = jnp.where(crossing.free, crossing.next_window(carry, memory), jnp.nan)
    return Memory(
        window=jnp.where(crossed, window, memory.window),
        moves=jnp.where(crossed, test.next_moves(memory), memory.moves),
        span=jnp.where(crossed, crossing.span, memory.span),
        calm=jnp.where(crossed, crossing.calm, memory.calm).astype(jnp.int32),
        orbit=jnp.where(crossed, test.orbit, memory.orbit).astype(jnp.int32),
        fastest=rest.fastest,
        rest=rest.span.astype(crossing.now.dtype),
        exponents=growth.exponents,
    )


def _accumulate(cycles: Integer, t: Number, times: Float[Array, " window"]) -> Flag:
    """Whether the time between crossings tends to 0: the latest is at `t`, those before at `times` (w,).

    The lengths a > b > c of three successive spans tend to c - (b - c)^2 / ((a - b) - (b - c)).
    """
    span = CROSSINGS_PER_SPAN
    newest = t - times[span - 1]
    first = times[span - 1] - times[2 * span - 1] - newest
    second = times[2 * span - 1] - times[3 * span - 1] - newest - first
    shrinks = (first > STEADY * newest) & (second > 0.0)
    accumulated = newest * cycles < NEGLIGIBLE * span * t
    return accumulated | shrinks & (first * first > (1.0 - ACCUMULATED) * newest * (second - first))
