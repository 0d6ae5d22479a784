"""Periodic orbits of the return map: the order of their crossings, which is the same for all rows on one."""

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

    They are in the recorder's `window` (n, crossings, observables + 2), the last one first. Rows that settled
    at one point have none. Other numbers of several crossings (n, crossings, observables) become rows of
    numbers, too.
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
    """The rows, with `last` at the `first_crossing` of an orbit and `orbit` at those after it."""
    if "orbit" not in rows.numbers:
        return rows
    periods = rows.numbers["period"]
    last = rows.last.copy()
    others = rows.numbers["orbit"].copy()
    k = len(observables)
    for p in np.unique(periods[periods > 1]).tolist():
        on = np.flatnonzero(periods == p)
        # in the order of time
        orbits = np.concatenate([last[on], others[on, : (p - 1) * k]], axis=1).reshape(on.size, p, k)[:, ::-1]
        order = (first_crossing(observables, orbits)[:, None] + np.arange(p)) % p
        orbits = np.take_along_axis(orbits, order[:, :, None], axis=1).reshape(on.size, p * k)
        last[on] = orbits[:, :k]
        others[on] = np.nan
        others[on, : (p - 1) * k] = orbits[:, k:]
    return dataclasses.replace(rows, numbers={**rows.numbers, "last": last, "orbit": others})


def first_crossing(
    observables: Sequence[Quantity], orbits: Float[np.ndarray, "rows crossings observables"]
) -> Int[np.ndarray, " rows"]:
    """The crossing (n,) of each orbit from which its values come first in the order of the observables.

    Angles are in the order of their cosines, then of their sines, which have no jump. Values that differ by
    less than `SAME_VALUE` are in the order of the next observable, so that rounding does not decide.
    """
    columns = []
    for i, quantity in enumerate(observables):
        x = np.nan_to_num(orbits[:, :, i])
        size = quantity.scale or np.abs(x).max(axis=1, keepdims=True)
        columns += [np.cos(x), np.sin(x)] if quantity.circular else [x / np.where(size > 0.0, size, 1.0)]
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
    for length in (1 << np.arange((p - 1).bit_length())).tolist():
        place = _ranks(p * place + np.roll(place, -length, axis=1))
    return np.argmin(place, axis=1)


def _ranks(keys: Int[np.ndarray, "rows crossings"]) -> Int[np.ndarray, "rows crossings"]:
    """The number of smaller keys in the same row, for each key."""
    return np.sum(keys[:, None, :] < keys[:, :, None], axis=2)
