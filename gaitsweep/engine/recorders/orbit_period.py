"""Periodic orbits of the return map: their period, and one order of their crossings for all rows."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Num

from gaitsweep.contract import Quantity
from gaitsweep.engine.carry import Integer
from gaitsweep.engine.recorders.bounds import MIN_SCALE, Crossings, per_observable
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.status import RECURRENT

# Smallest ratio of the distance between an orbit's points to the remaining motion.
ORBIT_SEPARATION = 10.0
# Largest motion over all cycles of a row that counts as rest, as a share of the bound: event times have
# errors.
NO_MOTION = 1.0e-3
# Largest difference of values that count as equal in the order of crossings, as a share of the largest
# extent of the orbit; an observable is relative to its scale, or to its magnitude, at least `MIN_SCALE`.
SAME_VALUE = 0.01


def orbit_period(
    newest: Float[Array, " lags"],
    before: Float[Array, " lags"],
    *,
    max_period: int,
    max_cycles: int,
    tolerance: float | tuple[float, ...],
) -> Integer:
    """The period, 2 to `max_period` crossings, of the periodic orbit that the state has reached; else 0.

    The period is p under three conditions:

    1. The distance from the state p crossings earlier, summed over the cycles of a whole row, is below the
       bound.
    2. It decays, and the remaining motion, extrapolated by a geometric series, is `ORBIT_SEPARATION`
       times shorter than the distance between the points of the orbit; or it cannot be distinguished from
       rest.
    3. No divisor of p satisfies these conditions.

    So neither a slowly converging spiral, whose remaining motion is that distance, nor a slow drift counts as
    periodic.

    Args:
        newest: the largest distances (max_period,) from the state 1, 2, ... crossings earlier, over the last
            `max_period` crossings, in units of the bound of a settled state.
        before: the same over as many crossings before them.
        max_period: the longest period that is detected (crossings).
        max_cycles: the crossings of a whole row.
        tolerance: one for all observables, or one for each, as a share of its scale.
    """
    eps = 64.0 * float(jnp.finfo(newest.dtype).eps) / min(per_observable(tolerance))
    period = jnp.zeros((), jnp.int32)
    for p in range(max_period, 1, -1):
        periods_per_span = max_period / p
        periods_per_row = max_cycles / p
        latest = newest[p - 1]
        earlier = before[p - 1]
        divisors = _maximal_divisors(p)
        spacing = newest[divisors[0] - 1]
        for q in divisors[1:]:
            spacing = jnp.minimum(spacing, newest[q - 1])
        slow = jnp.maximum(latest, earlier) * periods_per_row < 1.0
        # the geometric series latest * (1 + r + r^2 + ...), r = latest / earlier, times the periods of a
        # span
        remaining = ORBIT_SEPARATION * periods_per_span * latest * earlier
        decays = remaining < spacing * (earlier - latest)
        rests = latest < max(NO_MOTION / periods_per_row, eps)
        repeats = slow & (ORBIT_SEPARATION * latest < spacing) & (decays | rests)
        period = jnp.where(repeats, p, period)
    return period


def over_periods(moved: Crossings) -> Float[Array, "1 observables"]:
    """The largest changes (1, n) from earlier crossings, on an orbit of several from whole periods earlier.

    A row is on an orbit if these changes are `ORBIT_SEPARATION` times smaller than the others.

    Args:
        moved: the changes (w, n) from the state 1, 2, ... crossings earlier, in units of the bounds. The
            longest orbit has half as many crossings.
    """
    largest = chosen = jnp.max(moved, axis=0)
    for period in range(len(moved) // 2, 1, -1):
        of_period = jnp.max(moved[period - 1 :: period], axis=0)
        repeats = ORBIT_SEPARATION * jnp.max(of_period) < jnp.max(largest)
        chosen = jnp.where(repeats, of_period, chosen)
    return chosen[None, :]


def _maximal_divisors(p: int) -> list[int]:
    """The divisors of p by primes: if one of them is a period, p is not."""
    divisors = []
    for quotient in range(2, p + 1):
        is_prime = all(quotient % factor for factor in range(2, quotient))
        if p % quotient == 0 and is_prime:
            divisors.append(p // quotient)
    return divisors[::-1]


def with_orbits(numbers: Mapping[str, Num[np.ndarray, "rows ..."]]) -> dict[str, Num[np.ndarray, "rows ..."]]:
    """The numbers of ended rows with `orbit`, the crossings before the last one, the latest first.

    Rows that settled at one point have none: NaN. Other numbers of several crossings become rows of numbers,
    too.

    Args:
        numbers: numbers by name; `window` (n, crossings, observables + 2) has the latest crossing first, and
            other numbers of several crossings have the shape (n, crossings, observables).
    """
    if "window" not in numbers:
        return {**numbers}
    flat: dict[str, Num[np.ndarray, "rows ..."]] = {}
    for name, values in numbers.items():
        of_crossings = values.ndim == 3 and name != "window"
        flat[name] = values.reshape(len(values), -1) if of_crossings else values
    window = numbers["window"]
    others = window[:, 1:, :-2].reshape(len(window), -1)
    several = (flat["period"] > 1) | RECURRENT.among(flat["status"])
    return {**flat, "orbit": np.where(several[:, None], others, np.nan)}


def from_first_crossing(observables: Sequence[Quantity], rows: RowOutcome) -> RowOutcome:
    """The rows, with `last` at the `first_crossing` of an orbit and `orbit` at those after it.

    Args:
        observables: the observables of the model.
        rows: ended rows; without the number `orbit` they are unchanged.
    """
    if "orbit" not in rows.numbers:
        return rows
    periods = rows.numbers["period"]
    last = rows.last.copy()
    others = rows.numbers["orbit"].copy()
    k = len(observables)
    for p in np.unique(periods[periods > 1]).tolist():
        of_period = np.flatnonzero(periods == p)
        latest_first = np.concatenate([last[of_period], others[of_period, : (p - 1) * k]], axis=1)
        orbits = latest_first.reshape(of_period.size, p, k)[:, ::-1]
        order = (first_crossing(observables, orbits)[:, None] + np.arange(p)) % p
        ordered = np.take_along_axis(orbits, order[:, :, None], axis=1).reshape(of_period.size, p * k)
        last[of_period] = ordered[:, :k]
        others[of_period] = np.nan
        others[of_period, : (p - 1) * k] = ordered[:, k:]
    return dataclasses.replace(rows, numbers={**rows.numbers, "last": last, "orbit": others})


def first_crossing(
    observables: Sequence[Quantity], orbits: Float[np.ndarray, "rows crossings observables"]
) -> Int[np.ndarray, " rows"]:
    """The crossing (n,) of each orbit from which its values come first in the order of the observables.

    Angles are in the order of their cosines, then of their sines, which have no jump. Values that differ by
    less than `SAME_VALUE` are in the order of the next observable, so that rounding does not decide.

    Args:
        observables: the observables of the model.
        orbits: their values at the crossings of each orbit, in the order of time.
    """
    columns = []
    for i, quantity in enumerate(observables):
        values = np.nan_to_num(orbits[:, :, i])
        if quantity.circular:
            columns += [np.cos(values), np.sin(values)]
            continue
        # of an observable that the section keeps at 0, rounding would else be as large as another one
        size = quantity.scale or np.maximum(np.abs(values).max(axis=1, keepdims=True), MIN_SCALE)
        columns.append(values / size)
    equal = SAME_VALUE * np.max([np.ptp(column, axis=1) for column in columns], axis=0)
    n, p = orbits.shape[:2]
    place = np.zeros((n, p), np.int64)
    for column in columns:
        order = np.argsort(column, axis=1)
        steps = np.diff(np.take_along_axis(column, order, axis=1), axis=1) > equal[:, None]
        rank = np.zeros((n, p), np.int64)
        np.put_along_axis(rank, order[:, 1:], np.cumsum(steps, axis=1), axis=1)
        place = _ranks(p * place + rank)
    # the places of 2, 4, 8, ... successive crossings
    for doublings in range((p - 1).bit_length()):
        place = _ranks(p * place + np.roll(place, -(1 << doublings), axis=1))
    return np.argmin(place, axis=1)


def _ranks(keys: Int[np.ndarray, "rows crossings"]) -> Int[np.ndarray, "rows crossings"]:
    """The number of smaller keys in the same row, for each key."""
    return np.sum(keys[:, None, :] < keys[:, :, None], axis=2)
