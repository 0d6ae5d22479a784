"""The recorder of runs that end at a fixed point or a periodic orbit of the return map."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.circular import wrapped_difference
from gaitsweep.contract import Model, Params, Status
from gaitsweep.engine.advance import CROSSING, TIME, Carry
from gaitsweep.engine.recorders.recorder import SPARE_CYCLES, Record, Recorder, Taken

# Crossings over which a settled state must be constant.
SETTLE_WINDOW = 10
# Largest change of a settled observable in a crossing, as a share of its scale.
TOLERANCE = 1.0e-3
# The smallest scale of an observable without a scale, in its unit, so that an observable at 0 settles.
LEAST_SCALE = 1.0e-9
# The longest period (crossings) of an attractor that is detected. The test is made at every crossing whose
# number is a multiple of it, over two spans of that length.
MOST_PERIOD = 8
# The first crossing of the test, after three of the longest periods.
FIRST_TEST = 3 * MOST_PERIOD
# Smallest ratio of the distance between an orbit's points to the remaining motion.
APART = 10.0
# Largest motion over all cycles of a row that counts as rest, as a share of the bound: event times have
# errors.
NO_MOTION = 1.0e-3
# The maximal proper divisors of each period: if one of them is a period, the larger one is not.
_WITHIN = {2: (1,), 3: (1,), 4: (2,), 5: (1,), 6: (2, 3), 7: (1,), 8: (4,)}


@dataclasses.dataclass(frozen=True)
class SettleRecorder(Recorder):
    """Ends a row at a fixed point of the return map, or at an orbit of period 2 to `MOST_PERIOD`.

    Settled with period 1: each observable differs from its values at the last `SETTLE_WINDOW` crossings by
    less than `SETTLE_WINDOW` times its `tolerance`, in units of its scale (see `bounds`). Settled with period
    p: see `_period`. `tolerance` is one for all observables, or one for each. `max_time` (s) is by default
    four nominal periods for each of `max_cycles`.
    """

    model: Model
    max_cycles: int = 150
    tolerance: float | tuple[float, ...] = TOLERANCE
    max_time: float | None = None
    readings = Recorder.readings_at_the_end

    @property
    def window(self) -> int:
        return SETTLE_WINDOW

    def bound(self, latest: jax.Array) -> jax.Array:
        """The largest change of each observable (n,) over the window, from the latest crossings (w, n)."""
        return bounds(self.model, self.tolerance, latest)

    def stop(self, params: Params) -> jax.Array:
        period = self.model.period(params)
        if self.max_time is not None:
            return jnp.full_like(period, self.max_time)
        return 4.0 * (self.max_cycles + SPARE_CYCLES) * period

    def begin(self, params: Params, carry: Carry) -> tuple[Record, jax.Array, jax.Array]:
        record, row, keep = super().begin(params, carry)
        # of the current span of crossings and of the one before it, for each period
        moves = jnp.zeros((2, MOST_PERIOD), record.last.dtype)
        return dataclasses.replace(record, moves=moves), row, keep

    def take(self, params: Params, carry: Carry, record: Record) -> Taken:
        crossed = carry.halt == CROSSING
        now = self.observables(params, carry.state)
        cycles = record.cycles + 1
        # a row with NaN in its window does not settle
        free = carry.t >= self.model.free_after(params)
        latest = jnp.concatenate([now[None, :], record.window])
        moved = jnp.abs(change(self.model, now[None, :] - record.window))
        bound = bounds(self.model, self.tolerance, latest)
        still = (cycles >= SETTLE_WINDOW) & jnp.all(moved < bound[None, :])
        moved = moved / bound[None, :]

        moves = jnp.maximum(record.moves[0], jnp.max(moved[:MOST_PERIOD], axis=1))
        tested = cycles % MOST_PERIOD == 0
        found = jnp.where(tested & (cycles >= FIRST_TEST), self._period(moves, record.moves[1]), 0)
        period = jnp.where(still, 1, found)
        # crossings at one instant are not cycles
        settled = (period > 0) & (carry.chain < SETTLE_WINDOW)
        given_up = cycles >= self.max_cycles
        ended = jnp.where(settled, Status.settled, jnp.where(given_up, Status.cycle_limit, Status.running))
        status = jnp.where(crossed, ended, jnp.where(carry.halt == TIME, Status.time_limit, Status.running))
        begun = jnp.stack([jnp.zeros_like(moves), moves])
        after = jnp.where(tested, begun, jnp.stack([moves, record.moves[1]]))
        taken = dataclasses.replace(
            record,
            status=status.astype(jnp.int32),
            cycles=jnp.where(crossed, cycles, record.cycles),
            last=jnp.where(crossed, now, record.last),
            window=jnp.where(free, jnp.where(crossed, latest[:-1], record.window), jnp.nan),
            moves=jnp.where(crossed, after, record.moves),
            period=jnp.where(crossed & settled, period, 0).astype(jnp.int32),
            slowest=jnp.where(crossed & given_up & ~settled, slowest(moved), -1).astype(jnp.int32),
        )
        carry = dataclasses.replace(carry, halt=jnp.zeros_like(carry.halt))
        return carry, taken, jnp.zeros((0,), record.last.dtype), jnp.asarray(False)

    def _period(self, newest: jax.Array, before: jax.Array) -> jax.Array:
        """The period, 2 to `MOST_PERIOD` crossings, of the periodic orbit that the state has reached; else 0.

        `newest` and `before` (p,) are the largest distances from the state p crossings earlier, in units of
        the bound of a settled state, over the last `MOST_PERIOD` crossings and as many before them. The
        period is p under three conditions: this distance, summed over the cycles of a whole row, is below the
        bound; it decays, and the remaining motion, extrapolated by a geometric series, is `APART` times
        shorter than the distance between the points of the orbit; and no divisor of p satisfies these. So
        neither a slowly converging spiral, whose remaining motion is that distance, nor a slow drift counts
        as periodic, unless it could not be distinguished from rest in any row.
        """
        eps = 64.0 * float(jnp.finfo(newest.dtype).eps) / min(_each(self.tolerance))
        found = jnp.zeros((), jnp.int32)
        for p in range(MOST_PERIOD, 1, -1):
            spans, in_all = MOST_PERIOD / p, self.max_cycles / p
            now, then = newest[p - 1], before[p - 1]
            way = newest[_WITHIN[p][0] - 1]
            for q in _WITHIN[p][1:]:
                way = jnp.minimum(way, newest[q - 1])
            slow = jnp.maximum(now, then) * in_all < 1.0
            # the geometric series now * (1 + r + r^2 + ...), r = now / then, times the periods of a span
            dies_away = APART * spans * now * then < way * (then - now)
            rests = now < max(NO_MOTION / in_all, eps)
            holds = slow & (APART * now < way) & (dies_away | rests)
            found = jnp.where(holds, p, found)
        return found

    def share(self, record: Record, t: np.ndarray, typical_cycles: float) -> np.ndarray:
        return np.minimum(np.asarray(record.cycles) / (typical_cycles or 0.4 * self.max_cycles), 0.95)


def tolerances(model: Model, given: float | Mapping[str, float]) -> float | tuple[float, ...]:
    """The tolerance of each observable in order, from one for all or from some by name."""
    if not isinstance(given, Mapping):
        return given
    return tuple(given.get(quantity.name, TOLERANCE) for quantity in model.observables)


def bounds(model: Model, tolerance: float | tuple[float, ...], latest: jax.Array) -> jax.Array:
    """The largest change of each observable (n,) of a settled state over the window, in its unit; above 0.

    It is `SETTLE_WINDOW` times its tolerance times its scale: 1 rad for angles, `Quantity.scale` if defined,
    else its largest magnitude at the `latest` crossings (w, n).
    """
    each = _each(tolerance)
    each = each * len(model.observables) if len(each) == 1 else each
    share = jnp.asarray([SETTLE_WINDOW * one for one in each], latest.dtype)
    scales = [1.0 if q.circular else q.scale for q in model.observables]
    given = jnp.asarray([0.0 if scale is None else scale for scale in scales], latest.dtype)
    if all(scale is not None for scale in scales):
        return share * given
    own = jnp.maximum(jnp.max(jnp.abs(latest), axis=0), LEAST_SCALE)
    return share * jnp.where(jnp.asarray([scale is None for scale in scales]), own, given)


def slowest(moved: jax.Array) -> jax.Array:
    """The number of the observable with the largest change (w, n), in units of its bound; -1 if unknown."""
    most = jnp.max(moved, axis=0)
    return jnp.where(jnp.any(jnp.isnan(most)), -1, jnp.argmax(most))


def change(model: Model, difference: jax.Array) -> jax.Array:
    """Differences of observables, with those of angles wrapped to [-pi, pi)."""
    circular = jnp.asarray([q.circular for q in model.observables])
    return jnp.where(circular[None, :], wrapped_difference(difference), difference)


def _each(tolerance: float | tuple[float, ...]) -> tuple[float, ...]:
    return tolerance if isinstance(tolerance, tuple) else (tolerance,)
