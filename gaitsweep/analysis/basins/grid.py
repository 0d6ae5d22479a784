"""A grid of starts found in a table's columns, and what windows that slide over it hold."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.analysis.circular import TURN, is_circular

_EQUAL = 1e-6  # of a step: steps of a grid differ by no more


@dataclasses.dataclass(frozen=True)
class BasinGrid:
    """Outcomes on a grid of equal steps.

    `place` (n,): where each row lies in the flattened grid. `lengths`: cells along each axis. `steps`: the
    distance between neighbours along each, in its unit. `wraps`: whether its last cell and its first are
    neighbours, as on an angle whose cells share out a turn.
    """

    place: np.ndarray
    lengths: tuple[int, ...]
    steps: tuple[float, ...]
    wraps: tuple[bool, ...]

    def windows(self, marked: np.ndarray, cells: int) -> np.ndarray:
        """How many rows marked (n,) lie in each window of `cells` a side, at every place that it can have."""
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

    def shares_nearby(self, marked: np.ndarray) -> np.ndarray:
        """The share of rows marked (n,) among each cell and its neighbours, corners included, (n,)."""
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
            # where an axis closes, a window is named by its first cell, one before the middle
            for axis, wrap in enumerate(self.wraps):
                around = np.roll(around, 1, axis) if wrap else around
            sums.append(around.ravel()[self.place])
        return sums[0] / sums[1]

    def sizes(self) -> list[int]:
        """Distances in steps: an eighth of the shortest axis, and that halved up to four times, ascending.

        Distances of a step or two miss what lies between the starts where a boundary is fractal, so a fine
        grid leaves them out.
        """
        largest = max(min(self.lengths) // 8, 1)
        return sorted({max(largest >> halvings, 1) for halvings in range(5)})


def find_grid(table: pd.DataFrame, axes: Sequence[str]) -> BasinGrid | None:
    """The grid that a table's rows lie on, one row a cell and every cell there; None where they do not."""
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
