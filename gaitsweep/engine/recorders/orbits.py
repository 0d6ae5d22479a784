"""Periodic orbits of the return map, whose crossings have the same order in all rows that reach one."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int, Num

from gaitsweep.contract import Quantity
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.status import RECURRENT

# Largest difference of values that count as equal in the order of crossings, as a share of the largest
# extent of the orbit; an observable is relative to its scale, or to its magnitude.
SAME_VALUE = 0.01


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
    # a kernel's numbers are floats
    several = (flat["period"] > 1) | RECURRENT.among(flat["status"].astype(np.int32))
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
        size = quantity.scale or np.abs(values).max(axis=1, keepdims=True)
        columns.append(values / np.where(size > 0.0, size, 1.0))
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
