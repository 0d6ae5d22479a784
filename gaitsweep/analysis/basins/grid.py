"""The grid of starts in a table, and counts in windows that slide over it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Bool, Float, Int, Real

from gaitsweep.angles import TURN, is_circular

_EQUAL = 1e-6  # largest distance of a value from its place in a grid, as a share of the step
_ROUNDED = 0.05  # the same of values that may be rounded to single precision


@dataclasses.dataclass(frozen=True)
class BasinGrid:
    """A grid of equal steps, with one row of a table in each cell.

    Attributes:
        place: the index of each row's cell in the flattened grid, (n,).
        lengths: cells along each axis.
        steps: the distance between neighbours along each axis, in its unit.
        wraps: whether the last cell of each axis is a neighbour of the first, as for an angle whose cells
            divide a full turn.
    """

    place: Int[np.ndarray, " rows"]
    lengths: tuple[int, ...]
    steps: tuple[float, ...]
    wraps: tuple[bool, ...]

    def windows(
        self, marked: Bool[np.ndarray, " rows"] | Int[np.ndarray, " rows"], cells: int
    ) -> Real[np.ndarray, " ..."]:
        """The number of marked (n,) rows in each window of `cells` a side, at every position in the grid."""
        counts = self.filled(np.asarray(marked, np.int64))
        for axis, wrap in enumerate(self.wraps):
            if wrap:
                counts = np.concatenate([counts, counts.take(range(cells - 1), axis)], axis)
            counts = np.lib.stride_tricks.sliding_window_view(counts, cells, axis).sum(axis=-1)
        return counts

    def shares_nearby(self, marked: Bool[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
        """The share of marked (n,) rows among each cell and its neighbours, corners included, (n,)."""
        sums = []
        for values in (np.asarray(marked, np.int64), np.ones(self.place.size, np.int64)):
            around = self.filled(values)
            for axis, wrap in enumerate(self.wraps):
                mode = "wrap" if wrap else "constant"
                around = scipy.ndimage.convolve1d(around, np.ones(3), axis, mode=mode)
            sums.append(around.ravel()[self.place])
        return sums[0] / sums[1]

    def filled(self, values: Int[np.ndarray, " rows"]) -> Int[np.ndarray, " ..."]:
        """The grid of the rows' values (n,)."""
        cells = np.empty(values.size, values.dtype)
        cells[self.place] = values
        return cells.reshape(self.lengths)

    def sizes(self) -> list[int]:
        """Distances in steps: 1, 2, 4, ... up to an eighth of the shortest axis."""
        return [2**octave for octave in range((min(self.lengths) // 8).bit_length())]


def find_grid(table: pd.DataFrame, axes: Sequence[str]) -> BasinGrid | None:
    """The grid of a table's rows, with exactly one row in each cell; None where they form no grid."""
    places: list[Int[np.ndarray, " rows"]] = []
    lengths, steps, wraps = [], [], []
    for name in axes:
        values, place = np.unique(table[name].to_numpy(float), return_inverse=True)
        if values.size < 2 or not np.isfinite(values).all():
            return None
        step = float(values[-1] - values[0]) / (values.size - 1)
        rounding = float(np.finfo(np.float32).eps * np.abs(values).max())
        tolerance = max(_EQUAL * step, min(rounding, _ROUNDED * step))
        if np.abs(values - np.linspace(values[0], values[-1], values.size)).max() > tolerance:
            return None
        places.append(place)
        lengths.append(values.size)
        steps.append(step)
        wraps.append(is_circular(table, name) and abs(values.size * step - TURN) < tolerance)
    if not axes or len(table) != int(np.prod(lengths)):
        return None
    place = np.ravel_multi_index(tuple(places), tuple(lengths))
    if np.unique(place).size != place.size:
        return None
    return BasinGrid(place, tuple(lengths), tuple(steps), tuple(wraps))
