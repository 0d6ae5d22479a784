"""The grid of starts in a table, and counts in windows that slide over it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int, Real

from gaitsweep.analysis.circular import is_circular
from gaitsweep.circular import TURN

_EQUAL = 1e-6  # largest relative difference between the steps of a grid


@dataclasses.dataclass(frozen=True)
class BasinGrid:
    """Outcomes on a grid of equal steps.

    `place` (n,): the index of each row in the flattened grid. `lengths`: cells along each axis. `steps`: the
    distance between neighbours along each, in its unit. `wraps`: whether the last cell of each axis is a
    neighbour of the first, as for an angle whose cells divide a full turn.
    """

    place: Int[np.ndarray, " rows"]
    lengths: tuple[int, ...]
    steps: tuple[float, ...]
    wraps: tuple[bool, ...]

    def windows(
        self, marked: Bool[np.ndarray, " rows"] | Int[np.ndarray, " rows"], cells: int
    ) -> Real[np.ndarray, " ..."]:
        """The number of marked (n,) rows in each window of `cells` a side, at every position in the grid."""
        counts = np.zeros(int(np.prod(self.lengths)), np.int64)
        counts[self.place] = marked
        counts = counts.reshape(self.lengths)
        for axis, wrap in enumerate(self.wraps):
            if wrap:
                counts = np.concatenate([counts, counts.take(range(cells - 1), axis)], axis)
            sums = np.cumsum(counts, axis)
            sums = np.concatenate([np.zeros_like(sums.take([0], axis)), sums], axis)
            size = sums.shape[axis]
            counts = sums.take(range(cells, size), axis) - sums.take(range(size - cells), axis)
        return counts

    def shares_nearby(self, marked: Bool[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
        """The share of marked (n,) rows among each cell and its neighbours, corners included, (n,)."""
        shape = tuple(
            length if wrap else length + 2 for length, wrap in zip(self.lengths, self.wraps, strict=True)
        )
        inner = tuple(slice(None) if wrap else slice(1, -1) for wrap in self.wraps)
        padded = BasinGrid(np.arange(int(np.prod(shape))), shape, self.steps, self.wraps)
        sums = []
        for values in (np.asarray(marked, np.int64), np.ones(self.place.size, np.int64)):
            cells = np.zeros(int(np.prod(self.lengths)), np.int64)
            cells[self.place] = values
            wide = np.zeros(shape, np.int64)
            wide[inner] = cells.reshape(self.lengths)
            around = padded.windows(wide.ravel(), 3)
            # where an axis wraps, the index of a window is its first cell, one before the middle
            for axis, wrap in enumerate(self.wraps):
                around = np.roll(around, 1, axis) if wrap else around
            sums.append(around.ravel()[self.place])
        return sums[0] / sums[1]

    def sizes(self) -> list[int]:
        """Distances in steps: 1, 2, 4, ... up to an eighth of the shortest axis."""
        return [2**octave for octave in range((min(self.lengths) // 8).bit_length())]


def find_grid(table: pd.DataFrame, axes: Sequence[str]) -> BasinGrid | None:
    """The grid of a table's rows, with exactly one row in each cell; None where they form no grid."""
    places: list[np.ndarray] = []
    lengths: list[int] = []
    steps: list[float] = []
    wraps: list[bool] = []
    for name in axes:
        values, place = np.unique(table[name].to_numpy(float), return_inverse=True)
        if values.size < 2 or not np.isfinite(values).all():
            return None
        gaps = np.diff(values)
        step = float(gaps.mean())
        if np.abs(gaps - step).max() > _EQUAL * step:
            return None
        places.append(place)
        lengths.append(values.size)
        steps.append(step)
        wraps.append(is_circular(table, name) and abs(values.size * step - TURN) < _EQUAL * step)
    if not axes or len(table) != int(np.prod(lengths)):
        return None
    place = np.ravel_multi_index(tuple(places), tuple(lengths))
    if np.unique(place).size != place.size:
        return None
    return BasinGrid(place, tuple(lengths), tuple(steps), tuple(wraps))
