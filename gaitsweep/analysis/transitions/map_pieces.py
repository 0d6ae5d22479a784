"""Breaks in the data of a one-dimensional map: gaps without points, and jumps of the map.

A curve across a break would have values that no trajectory has, and false zeros of the drift. So a map is
smoothed, and searched for fixed points, on each piece separately.
"""

from __future__ import annotations

import numpy as np
import scipy
from jaxtyping import Bool, Float

_NEIGHBOURS = 12  # spacings on either side that tell how densely the points lie at a place
_WIDER = 4.0  # times as wide as those spacings, or
_STARTS_WIDER = (
    2.0  # as those of the rows' first points: a row leaves an unstable point, and none comes to it
)
_WIDEST = 2.0  # bandwidths: with a wider gap, no window has points on both sides
_A_JUMP = 3.0  # times the largest residual of the lines on both sides
_SURE = 6.0  # standard errors of the difference of these lines
_LEAST = 4.0  # points, by their shares, on either side
_STEP = (1.0 / 3.0, 2.0)  # of the lines' difference: what the two points in the middle differ by


def breaks(
    value: Float[np.ndarray, " pairs"],
    change: Float[np.ndarray, " pairs"],
    share: Float[np.ndarray, " pairs"],
    first: Bool[np.ndarray, " pairs"],
    bandwidth: float,
    step: float,
) -> Bool[np.ndarray, " gaps"]:
    """Whether there is a break after each of the points, sorted by their value, bool (n - 1,).

    A gap is wider than the spacing of the points around it: 4 times their spacing, twice the spacing of the
    rows' first points, or two bandwidths. Spacings below `step` are no gaps. At a jump, the
    lines through the points on both sides (4 at least, within a bandwidth) differ, between the two points in
    the middle, by 6 standard errors and by 3 times their largest residual.

    Args:
        value, change, share: the points as `Drift` has them, (n,), sorted by value.
        first: which of them is the first of its row, bool (n,).
        bandwidth: half the width of the smoothing window, in the unit of the value.
        step: the distance below which places count as one.
    """
    if len(value) < 2:
        return np.zeros(0, bool)
    return _gaps(value, first, bandwidth, step) | _jumps(value, change, share, bandwidth, step)


def _gaps(
    value: Float[np.ndarray, " pairs"], first: Bool[np.ndarray, " pairs"], bandwidth: float, step: float
) -> Bool[np.ndarray, " gaps"]:
    spacing = np.diff(value)
    suspect = np.flatnonzero(spacing > step)
    wide = np.zeros(len(spacing), bool)
    if not suspect.size:
        return wide
    # points of one place (rows that have come to rest) tell nothing of how densely the others lie
    places = value[np.r_[True, spacing > 0.1 * step]]
    between = np.diff(places)
    starts = np.unique(value[first])
    apart = np.diff(starts)
    for k in suspect:
        at = int(np.searchsorted(places, value[k], "right")) - 1
        around = np.r_[between[max(at - _NEIGHBOURS, 0) : at], between[at + 1 : at + 1 + _NEIGHBOURS]]
        usual = _WIDER * float(np.quantile(around, 0.9)) if around.size else 0.0
        middle = 0.5 * (value[k] + value[k + 1])
        start = int(np.searchsorted(starts, middle)) - 1
        if 0 <= start < len(apart):
            beside = np.r_[apart[max(start - 1, 0) : start], apart[start + 1 : start + 2]]
            usual = max(usual, _STARTS_WIDER * float(beside.max())) if beside.size else usual
        wide[k] = spacing[k] > min(max(usual, step), _WIDEST * bandwidth)
    return wide


def _jumps(
    value: Float[np.ndarray, " pairs"],
    change: Float[np.ndarray, " pairs"],
    share: Float[np.ndarray, " pairs"],
    bandwidth: float,
    step: float,
) -> Bool[np.ndarray, " gaps"]:
    found = np.zeros(len(value) - 1, bool)
    difference = np.abs(np.diff(change))
    # a jump is far larger than what the points around it differ by, from one to the next
    usual = scipy.ndimage.median_filter(difference, 2 * _NEIGHBOURS + 1, mode="nearest")
    largest = scipy.ndimage.maximum_filter1d(difference, 3, mode="nearest")
    for k in map(
        int, np.flatnonzero((difference > 3.0 * usual) & (difference >= largest) & (difference > 0.0))
    ):
        middle = 0.5 * float(value[k] + value[k + 1])
        below = _line(value, change, share, k, -1, middle, bandwidth, step)
        above = _line(value, change, share, k + 1, 1, middle, bandwidth, step)
        if below is None or above is None:
            continue
        left, left_error, left_residual = below
        right, right_error, right_residual = above
        leap = abs(right - left)
        error = float(np.hypot(left_error, right_error))
        found[k] = (
            leap > _SURE * error
            and leap > _A_JUMP * max(left_residual, right_residual)
            and _STEP[0] * leap < difference[k] < _STEP[1] * leap
        )
    return found


def _line(
    value: Float[np.ndarray, " pairs"],
    change: Float[np.ndarray, " pairs"],
    share: Float[np.ndarray, " pairs"],
    k: int,
    way: int,
    place: float,
    bandwidth: float,
    step: float,
) -> tuple[float, float, float] | None:
    """The line through point k and some beyond it, at a place: value, error, largest residual."""
    last = int(np.searchsorted(value, value[k] + way * bandwidth, "right" if way > 0 else "left"))
    mine = np.arange(k, last) if way > 0 else np.arange(k, last - 1, -1)
    x, y, weight = np.abs(value[mine] - place), change[mine], share[mine]
    enough = (np.cumsum(weight) >= _LEAST) & (x - x[:1] >= step) & (np.arange(len(x)) >= 3)
    if not enough.any():
        return None
    count = int(np.argmax(enough)) + 1
    x, y, weight = x[:count], y[:count], weight[:count]
    middle = np.average(x, weights=weight)
    spread = float(np.average((x - middle) ** 2, weights=weight))
    if spread <= 0.0:
        return None
    height = float(np.average(y, weights=weight))
    slope = float(np.average((x - middle) * (y - height), weights=weight)) / spread
    residual = y - height - slope * (x - middle)
    effective = float(weight.sum()) ** 2 / float((weight**2).sum())
    variance = float(np.average(residual**2, weights=weight)) * effective / max(effective - 2.0, 1.0)
    error = np.sqrt(variance / effective * (1.0 + middle**2 / spread))
    return height - slope * middle, float(error), float(np.abs(residual).max())
