"""The smoothed drift of a one-dimensional map along a line or around the circle: its zeros and its ghosts."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from scipy.signal import find_peaks

from gaitsweep.analysis.circular import TURN, on_line
from gaitsweep.analysis.smoothing import Smooth, local_polynomial

NEAR = 0.01  # rad a crossing: a slower drift is one that holds a row for long
SURE = 2.0  # standard errors by which a drift differs from zero
_A_BANDWIDTH = 5  # places of the curve in a bandwidth
_OUTSIDE = 0.1  # bandwidths that a fixed point may lie outside the data: rows end at it, from one side


class Drift(NamedTuple):
    """Pairs of a map as points (value, change, row and share of each), and the smooth curve through them.

    `begin` is where the turn begins if the curve closes around the circle; then the points near it stand on
    both sides.
    """

    value: np.ndarray
    change: np.ndarray
    row: np.ndarray
    share: np.ndarray
    bandwidth: float
    begin: float | None
    smooth: Smooth

    @classmethod
    def of(
        cls, value: np.ndarray, change: np.ndarray, row: np.ndarray, bandwidth: float, circular: bool
    ) -> Drift:
        """Smooth the change over the value by local lines.

        The curve reaches half a bandwidth beyond the data, since a state that rows reach from one side only
        lies at their end. Around the circle, where the data leave no gap of two bandwidths, it closes.

        Args:
            value, change: (n,); angles on one turn, in rad.
            row: which row each pair is of, (n,).
            bandwidth: half the width of the window, in the unit of the value.
            circular: whether the value is an angle.
        """
        step = bandwidth / _A_BANDWIDTH
        share = once_a_place(value, row, step)
        low, high = float(value.min()), float(value.max())
        gaps = np.diff(np.unique(value), append=low + TURN)
        if not circular or gaps.max() >= 2.0 * bandwidth:
            at = np.arange(low - 0.5 * bandwidth, high + 0.5 * bandwidth + step, step)
            smooth = local_polynomial(value, change, row, share, at, bandwidth)
            return cls(value, change, row, share, bandwidth, None, smooth)
        around = np.concatenate([value - TURN, value, value + TURN])
        near = (around > low - 2.0 * bandwidth) & (around < low + TURN + 2.0 * bandwidth)
        value = around[near]
        change, row, share = (np.tile(each, 3)[near] for each in (change, row, share))
        count = int(np.ceil(TURN / step))
        at = low + TURN * np.arange(count) / count
        smooth = local_polynomial(value, change, row, share, at, bandwidth)
        # begin where the sign is surest, so that no zero lies across the ends
        sure = np.abs(smooth.value) / np.maximum(smooth.value_error, 1e-300)
        way = np.arange(count + 1) + int(np.argmax(np.nan_to_num(sure)))
        smooth = Smooth(*(each[way % count] for each in smooth))
        smooth = smooth._replace(at=smooth.at + TURN * (way // count))
        return cls(value, change, row, share, bandwidth, low, smooth)

    def inside(self, place: float) -> bool:
        """Whether a place lies among the data, or hardly outside."""
        margin = _OUTSIDE * self.bandwidth
        return self.begin is not None or bool(self.value.min() - margin <= place <= self.value.max() + margin)

    def at(self, place: float) -> Smooth:
        """The curve at one place: by a parabola where the points show that it bends, else by a line."""
        where = np.array([place])
        where = where if self.begin is None else on_line(where, self.begin)
        for degree in (2, 1):
            points = (self.value, self.change, self.row, self.share)
            smooth = local_polynomial(*points, where, self.bandwidth, degree)
            if np.isfinite(smooth.value[0]):
                break
        return smooth


def once_a_place(value: np.ndarray, row: np.ndarray, step: float) -> np.ndarray:
    """How much each pair adds to what is known of the map: each row once for each place, (n,).

    Where a row lingers, its values only jitter or alternate, and change by -1 or -2 times what they are off
    by: its many pairs tell where it lingers, but must not be taken for a curve of that slope.
    """
    share = np.empty(len(value))
    order = np.lexsort((value, row))
    ends = np.flatnonzero(np.diff(row[order], prepend=np.nan, append=np.nan))
    for begin, end in itertools.pairwise(ends):
        mine = order[begin:end]
        here = value[mine]
        near = np.searchsorted(here, here + step, "right") - np.searchsorted(here, here - step, "left")
        share[mine] = 1.0 / near
    return share


class Zero(NamedTuple):
    """A zero of the drift: where, the curve there, and whether the drift falls through it as the value rises.

    `within` is half the distance between the sure places on either side of it.
    """

    place: float
    smooth: Smooth
    falls: bool
    within: float


def zeros_of(drift: Drift) -> list[Zero]:
    """Where the drift goes from one sure sign to the other.

    Noise makes several zeros of one: the middle one is taken of those between two sure places through which
    the drift goes the right way.
    """
    at, value, error = drift.smooth.at, drift.smooth.value, drift.smooth.value_error
    sure = np.flatnonzero(np.isfinite(value) & (np.abs(value) > SURE * error))
    found = []
    for i, j in itertools.pairwise(sure):
        if value[i] * value[j] > 0 or not np.isfinite(value[i : j + 1]).all():
            continue
        sides = value[i : j + 1] > 0
        turns = i + np.flatnonzero((sides[:-1] == sides[0]) & (sides[1:] != sides[0]))
        k = int(turns[len(turns) // 2])
        place = float(at[k] - value[k] * (at[k + 1] - at[k]) / (value[k + 1] - value[k]))
        smooth = drift.at(place)
        nearer = place - float(smooth.value[0] / smooth.slope[0])
        if abs(nearer - place) < drift.bandwidth / _A_BANDWIDTH:
            place, smooth = nearer, drift.at(nearer)
        if drift.inside(place) and np.isfinite(smooth.slope[0]):
            found.append(Zero(place, smooth, bool(value[i] > 0), float(at[j] - at[i]) / 2))
    return found


def ghosts_of(drift: Drift, near: float) -> list[tuple[float, float, float]]:
    """Places, drifts and their standard errors where the size of the drift has a minimum of at most `near`.

    A minimum is one where the drift is larger by two standard errors on both sides of it.
    """
    at, value, error = drift.smooth.at, drift.smooth.value, drift.smooth.value_error
    found = []
    for sign in (1.0, -1.0):
        peaks, known = find_peaks(np.where(np.isfinite(value), -sign * value, -np.inf), prominence=0.0)
        for k, height in zip(peaks, known["prominences"], strict=True):
            within = 0.0 < sign * value[k] <= near and height > SURE * error[k] and drift.inside(float(at[k]))
            if within and np.isfinite(value[[k - 1, k + 1]]).all():
                bend = value[k + 1] - 2.0 * value[k] + value[k - 1]
                aside = 0.5 * (value[k - 1] - value[k + 1]) / bend if bend else 0.0
                place = float(at[k] + aside * (at[k + 1] - at[k]))
                there = drift.at(place)
                found.append((place, float(there.value[0]), float(there.value_error[0])))
    return sorted(found)
