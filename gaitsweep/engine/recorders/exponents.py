"""Lyapunov exponents of a row's return map, their errors, and the status of a row by its exponents.

The exponents are the mean rates (1/s) at which neighbouring crossings of the section separate: lengths of
tangents, orthonormalised at each crossing (Benettin et al. 1980, Meccanica 15:9; Shimada and Nagashima 1979,
Prog. Theor. Phys. 61:1605). Crossings 1/4 to 1/2 into the row or later count, and those before them do not: a
span of crossings ends where their number is a power of two, and the last two spans are used. The standard
error is that of the means of 16 batches in a span.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaitsweep.contract import FixedStepDynamics, Model, Params, Quantity
from gaitsweep.engine.carry import Carry, Integer, Number, Observed, select
from gaitsweep.engine.recorders.bounds import SETTLE_WINDOW
from gaitsweep.engine.tangents import Tangent, from_section, on_section, orthonormalised
from gaitsweep.row_outcome import RowNumber
from gaitsweep.status import Status

# Batches in a span of crossings, and the first crossing at which one ends.
BATCHES = 16
FIRST_SPAN = 8
# Crossings before which no row is chaotic or quasi-periodic.
MIN_CROSSINGS = 64
# Standard errors by which the largest exponent of a chaotic row is positive.
ERRORS = 3.0
# The logarithm of the factor by which neighbours of a chaotic row separate over the spans at least. On a
# torus of a map that keeps areas they separate in proportion to the number of crossings: by less than 4.
SEPARATION = 7.0
# The largest logarithm of that factor of a quasi-periodic row.
NEUTRAL = 2.0
# The largest change, between the spans, of the mean logarithm of the steps of a quasi-periodic row from
# crossing to crossing, which become shorter while a row settles.
PERSISTENT = 0.1
# The distance within which a quasi-periodic row comes back to a point, as a share of the observables' scales.
RECURRENCE = 0.1
# The least such distance, multiplied by the number of crossings. On a circle that product is of the order of
# 1 for most ratios of frequencies. It vanishes on orbits of long periods, which no test of settling detects.
REPEATED = 0.1


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Exponents:
    """Sums over the last two spans of crossings, for k exponents and n observables.

    The first of two entries is that of the last complete span, the second that of the current one.

    Attributes:
        sums: the logarithms of the tangents' lengths (2, k).
        time: the durations (2,) (s).
        steps: the logarithms of the distances between crossings (2,).
        crossings: their number (2,).
        means: the mean of the rates of batches (2, k).
        squares: the sum of their squared deviations (2, k).
        batches: their number (2,).
        batch: the sums and the duration of the current batch (k + 1,).
        left: the crossings that the current batch lacks.
        length: the crossings of a batch.
        end: the crossing at which the current span ends.
        begin: the observables where a span began (2, n).
        nearest: the least distance from there since (2,), as a share of the scales.
        logs: the logarithms at the last crossings (w, k), the latest first.
    """

    sums: Float[Array, "2 exponents"]
    time: Float[Array, " 2"]
    steps: Float[Array, " 2"]
    crossings: Float[Array, " 2"]
    means: Float[Array, "2 exponents"]
    squares: Float[Array, "2 exponents"]
    batches: Float[Array, " 2"]
    batch: Float[Array, " numbers"]
    left: Integer
    length: Integer
    end: Integer
    begin: Float[Array, "2 observables"]
    nearest: Float[Array, " 2"]
    logs: Float[Array, "window exponents"]

    @classmethod
    def begun(cls, count: int, observed: Observed, window: int) -> Exponents:
        """The sums of a row at its start.

        Args:
            count: the number of exponents.
            observed: the observables of the start.
            window: the number of the latest crossings whose logarithms are kept.
        """
        dtype = observed.dtype
        one = jnp.ones((), jnp.int32)
        pair = jnp.zeros((2,), dtype)
        pairs = jnp.zeros((2, count), dtype)
        return cls(
            sums=pairs,
            time=pair,
            steps=pair,
            crossings=pair,
            means=pairs,
            squares=pairs,
            batches=pair,
            batch=jnp.zeros((count + 1,), dtype),
            left=one,
            length=one,
            end=FIRST_SPAN * one,
            begin=jnp.broadcast_to(observed, (2, observed.size)),
            nearest=jnp.full((2,), jnp.inf, dtype),
            logs=jnp.zeros((window, count), dtype),
        )

    def after(
        self,
        logs: list[Number],
        *,
        duration: Number,
        step: Number,
        shares: Observed,
        cycles: Integer,
        now: Observed,
    ) -> Exponents:
        """The sums after one more crossing.

        Args:
            logs: the logarithms of the lengths of the k tangents.
            duration: the time (s) since the crossing before.
            step: the distance from the crossing before.
            shares: (2,) the distances from `begin`, as a share of the scales.
            cycles: the number of this crossing.
            now: its observables.
        """
        log_step = jnp.log(jnp.maximum(step, jnp.finfo(step.dtype).tiny))
        grown = jnp.stack([*logs, duration])
        current = dataclasses.replace(
            self._with_batch(self.batch + grown),
            sums=self.sums.at[1].add(grown[:-1]),
            time=self.time.at[1].add(duration),
            steps=self.steps.at[1].add(log_step),
            crossings=self.crossings.at[1].add(1.0),
            nearest=jnp.minimum(self.nearest, shares),
            logs=jnp.concatenate([grown[None, :-1], self.logs[:-1]]),
        )
        return select(cycles >= self.end, current._next_span(cycles, now), current)

    def _with_batch(self, batch: Float[Array, " numbers"]) -> Exponents:
        """The sums with the current batch, which is complete where no crossing is left.

        Mean and squared deviations are updated by Welford's recurrence.
        """
        complete = self.left <= 1
        number = self.batches[1] + 1.0
        rates = batch[:-1] / batch[-1]
        deviation = rates - self.means[1]
        mean = self.means[1] + deviation / number
        squares = self.squares[1] + deviation * (rates - mean)
        return dataclasses.replace(
            self,
            means=jnp.where(complete, self.means.at[1].set(mean), self.means),
            squares=jnp.where(complete, self.squares.at[1].set(squares), self.squares),
            batches=jnp.where(complete, self.batches.at[1].set(number), self.batches),
            batch=jnp.where(complete, jnp.zeros_like(batch), batch),
            left=jnp.where(complete, self.length, self.left - 1),
        )

    def _next_span(self, cycles: Integer, now: Observed) -> Exponents:
        """The sums where a span begins, at the crossing number `cycles` with the observables `now`."""
        length = jnp.maximum(cycles // BATCHES, 1).astype(self.length.dtype)
        names = ("sums", "time", "steps", "crossings", "means", "squares", "batches")
        pairs = {name: getattr(self, name) for name in names}
        nearest = self.nearest[1]
        return dataclasses.replace(
            self,
            **{name: jnp.stack([pair[1], jnp.zeros_like(pair[1])]) for name, pair in pairs.items()},
            batch=jnp.zeros_like(self.batch),
            left=length,
            length=length,
            end=2 * self.end,
            begin=jnp.stack([self.begin[1], now]),
            nearest=jnp.stack([nearest, jnp.full_like(nearest, jnp.inf)]),
        )

    def rates(self) -> tuple[Float[Array, " exponents"], Float[Array, " exponents"]]:
        """The exponents (k,) in 1/s, and their standard errors (k,); NaN where no span is complete."""
        time = jnp.sum(self.time)
        complete = self.batches[0] >= BATCHES
        duration = jnp.where(complete, time, 1.0)
        variance = self.squares[0] / (BATCHES * (BATCHES - 1.0))
        # the current span is too short for an error of its own: its variance is inverse to its duration
        error = jnp.sqrt(variance * self.time[0] / duration)
        rate = jnp.sum(self.sums, axis=0) / duration
        return jnp.where(complete, rate, jnp.nan), jnp.where(complete, error, jnp.nan)

    def numbers(self, period: Integer, ago: Float[Array, " window"]) -> dict[str, Number]:
        """The exponents and their errors by name (`exponent_numbers`).

        Args:
            period: the crossings of the orbit on which the row has settled, 0 if it has not. On an orbit of
                several crossings, exponents are the means over as many of its last turns as the window has;
                at a fixed point those over the last `SETTLE_WINDOW` crossings, if their error is less than
                that of the spans.
            ago: (w,) the times (s) since the crossings before this one, the latest first.
        """
        rates, errors = self.rates()
        place = jnp.arange(len(ago))
        still = SETTLE_WINDOW  # those before them may be crossings of the way to the fixed point
        crossings_of_turns = jnp.where(period > 1, len(ago) // jnp.maximum(period, 1) * period, still)
        duration = jnp.sum(jnp.where(place == crossings_of_turns - 1, ago, 0.0))
        logs_of_turns = jnp.where((place < crossings_of_turns)[:, None], self.logs, 0.0)
        window_rates = jnp.sum(logs_of_turns, axis=0) / duration
        deviation = self.logs[:still] * (still / ago[still - 1]) - window_rates[None, :]
        window_errors = jnp.sqrt(jnp.sum(deviation**2, axis=0) / (still * (still - 1)))
        fixed = (period == 1) & ~(window_errors[0] > errors[0])
        rates = jnp.where((period > 1) | fixed, window_rates, rates)
        errors = jnp.where(period > 1, jnp.nan, jnp.where(fixed, window_errors, errors))
        named = {}
        for number, (rate, error) in enumerate(zip(rates, errors, strict=True), start=1):
            named[f"lyapunov_{number}"] = rate
            named[f"lyapunov_{number}_error"] = error
        return named

    def status(self, cycles: Integer, *, may_turn: bool) -> Integer:
        """`chaotic` or `quasi_periodic`, of a row that has not settled, or `cycle_limit`.

        1. Chaotic: the largest exponent is positive by `ERRORS` standard errors, and neighbours separate by a
           factor of e^`SEPARATION` at least.
        2. Quasi-periodic: neighbours neither separate nor approach (`NEUTRAL`), the steps from crossing to
           crossing do not become shorter (`PERSISTENT`), and the row comes back to where it was
           (`RECURRENCE`), but no nearer than on a torus (`REPEATED`). On a line there is no such motion.

        Args:
            cycles: the number of this crossing.
            may_turn: see the function `may_turn`.
        """
        rates, errors = self.rates()
        known = cycles >= MIN_CROSSINGS
        growth = rates[0] * jnp.sum(self.time)
        chaotic = (rates[0] > ERRORS * errors[0]) & (growth > SEPARATION)
        if not may_turn:
            return jnp.where(known & chaotic, Status.chaotic, Status.cycle_limit)
        means = self.steps / jnp.maximum(self.crossings, 1.0)
        # the current span counts once it has a quarter of the crossings of the last one
        compared = 4.0 * self.crossings[1] >= self.crossings[0]
        persistent = compared & (jnp.abs(means[1] - means[0]) < PERSISTENT)
        returned = self.nearest[0] < RECURRENCE
        repeated = self.nearest[0] * jnp.sum(self.crossings) < REPEATED
        torus = (jnp.abs(growth) < NEUTRAL) & persistent & returned & ~repeated
        status = jnp.where(known & torus, Status.quasi_periodic, Status.cycle_limit)
        return jnp.where(known & chaotic, Status.chaotic, status)


def may_turn(model: Model) -> bool:
    """Whether the section has a circle or a plane, on which crossings may turn without end."""
    chart = model.chart()
    coordinates = () if chart is None else chart.coordinates
    return len(coordinates) != 1 or coordinates[0].circular


def exponent_numbers(model: Model, count: int) -> tuple[RowNumber, ...]:
    """The numbers of a row with `count` exponents; those of a plain map are per application."""
    unit = "1" if isinstance(model, FixedStepDynamics) and model.is_return_map else "1/s"
    numbers: list[RowNumber] = []
    for i in range(1, count + 1):
        symbol = rf"\lambda_{i}"
        exponent = Quantity(f"lyapunov_{i}", unit, f"Lyapunov exponent {i}", symbol=symbol)
        error = Quantity(f"lyapunov_{i}_error", unit, f"standard error of Lyapunov exponent {i}")
        numbers += [RowNumber(q.name, np.float64, np.nan, q) for q in (exponent, error)]
    return tuple(numbers)


def separated(model: Model, params: Params, carry: Carry) -> tuple[list[Number], list[Tangent]]:
    """The logarithms of the lengths of a trajectory's tangents at a crossing, and orthonormal tangents.

    Args:
        model, params: the model and its parameters.
        carry: the trajectory just after the crossing.
    """
    lengths, units = orthonormalised(on_section(model, params, carry))
    tangents = from_section(model, params, carry.state, units)
    return [jnp.log(length) for length in lengths], tangents
