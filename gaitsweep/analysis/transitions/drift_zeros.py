"""Zeros of a smoothed drift, the fixed points of the map, and ghosts, minima of its size without a zero.

At a zero the curve changes between significant values of opposite sign, and the points on both sides confirm
it.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Int

from gaitsweep.analysis.transitions.breaks import PointFlags
from gaitsweep.analysis.transitions.drift import AT_REST, POINTS_PER_BANDWIDTH, Drift
from gaitsweep.analysis.transitions.smoothing import PerPoint, Smooth, local_polynomial
from gaitsweep.angles import unwrap_from

NEAR = 0.01  # rad a crossing; a slower drift holds a row for long
SURE = 2.0  # standard errors from zero of a significant drift
_OUTSIDE = 0.02  # bandwidths; largest distance of a rest state outside the data
# least value at a zero of the line through the points of one side, if the curve bridges a jump there:
_BRIDGED_ERRORS = 3.0  # standard errors
_BRIDGED_SHARE = 0.5  # shares of the mean drift on that side
_ERROR_SHARE = 0.5  # largest standard error of these lines that shows that there is no jump, in such shares
_NEAR_ZERO_SHARE = 0.5  # largest of the least drift beside a zero with too few points for lines, likewise


class Zero(NamedTuple):
    """A zero of the drift: its position with its error, the curve there, and whether the drift falls there.

    `error` is the standard error of the position, at most half the distance between the significant values on
    its two sides.
    """

    place: float
    error: float
    smooth: Smooth
    falls: bool


def zeros_of(drift: Drift) -> list[Zero]:
    """The zeros of the drift between significant values of opposite sign, and rest states at ends of a piece.

    Noise may split a zero into several: the middle one with the right direction is used. Zeros that the
    points do not confirm (`_confirmed`) are left out.
    """
    at, value = drift.smooth.at, drift.smooth.value
    zeros = []
    for i, j in itertools.pairwise(_significant(drift)):
        if value[i] * value[j] > 0 or not np.isfinite(value[i : j + 1]).all():
            continue
        sides = value[i : j + 1] > 0
        turns = i + np.flatnonzero((sides[:-1] == sides[0]) & (sides[1:] != sides[0]))
        k = int(turns[len(turns) // 2])
        place = float(at[k] - value[k] * (at[k + 1] - at[k]) / (value[k + 1] - value[k]))
        smooth = drift.at(place)
        nearer = place - float(smooth.value[0] / smooth.slope[0])
        if abs(nearer - place) < drift.bandwidth / POINTS_PER_BANDWIDTH:
            place, smooth = nearer, drift.at(nearer)
        falls = bool(value[i] > 0)
        if np.isfinite(smooth.slope[0]) and _confirmed(drift, place, falls):
            zeros.append(_zero(place, smooth, falls, float(at[j] - at[i]) / 2))
    return [*_rest_at_ends(drift, zeros), *zeros]


def _significant(drift: Drift) -> Int[np.ndarray, " positions"]:
    """The indices of values that are significant, and larger than the drift of rows at rest.

    The drift of rows at rest is that of rounding, which may be larger than its standard error.
    """
    _, value, _, error, *_ = drift.smooth
    least = np.maximum(SURE * error, AT_REST * drift.bandwidth)
    return np.flatnonzero(np.isfinite(value) & (np.abs(value) > least))


def _zero(place: float, smooth: Smooth, falls: bool, most: float) -> Zero:
    """The zero at a place, whose error is at most `most`."""
    error = float(smooth.value_error[0]) / max(abs(float(smooth.slope[0])), 1e-12)
    return Zero(place, min(error, most), smooth, falls)


def _rest_at_ends(drift: Drift, between: list[Zero]) -> list[Zero]:
    """States that rows reach from one side only: the end of a piece where its rows are at rest."""
    at, value = drift.smooth.at, drift.smooth.value
    sure = _significant(drift)
    if drift.begin is not None or not sure.size:
        return []
    zeros = []
    for end, inner, outward in ((0, sure[0], -1.0), (-1, sure[-1], 1.0)):
        place = float(drift.points.value[end])
        if abs(drift.points.change[end]) > AT_REST * drift.bandwidth:
            continue
        smooth = drift.at(place)
        beyond = outward * -float(smooth.value[0] / smooth.slope[0])
        nearest = min((abs(place - zero.place) for zero in between), default=np.inf)
        if abs(beyond) <= _OUTSIDE * drift.bandwidth < nearest:
            falls = bool(outward * value[inner] > 0)
            zeros.append(_zero(place, smooth, falls, abs(float(at[inner]) - place)))
    return zeros


def _confirmed(drift: Drift, place: float, falls: bool) -> bool:
    """Whether the points confirm a zero: their changes pass through zero and differ in sign on its sides.

    Lines through the points of one side alone, within a bandwidth or a part of it, tell a curve through zero
    from one that bridges a jump: there both leave the zero on the side where their points are.
    """
    value, change, _, share = drift.points
    away = value - float(unwrap_from(np.array([place]), drift.begin)[0])
    sign = 1.0 if falls else -1.0
    reach = 2.0 * drift.bandwidth
    left, right = (away < 0.0) & (away >= -reach), (away > 0.0) & (away <= reach)
    still = AT_REST * drift.bandwidth
    if not (sign * change[left] > -still).any() or not (-sign * change[right] > -still).any():
        return False
    if drift.circular:
        near = np.abs(away) <= drift.bandwidth
        if np.sum(share[near] * np.cos(change[near])) <= 0.0:
            return False  # it goes through half a turn, where the changes' sign turns too
    bridged = False
    for width in drift.bandwidth * np.array([1.0, 0.5, 0.25]):
        inside = np.abs(away) <= width
        below, above = (_remains(drift, side & inside, away, width) for side in (left, right))
        if below is None or above is None:
            if width == drift.bandwidth:  # too few for lines: then some of them lie near the diagonal
                sizes = np.abs(change[np.abs(away) <= reach])
                return bool(sizes.min() < _NEAR_ZERO_SHARE * sizes.mean())
            break
        bridges = all(
            side_sign * remain.value > max(_BRIDGED_ERRORS * remain.error, _BRIDGED_SHARE * remain.size)
            for side_sign, remain in ((sign, below), (-sign, above))
        )
        if not bridges and below.error + above.error < _ERROR_SHARE * (below.size + above.size):
            return True
        bridged |= bridges
    return not bridged


class _Remainder(NamedTuple):
    """Value at a zero of the line through the points of one side, its error, and the points' mean size."""

    value: float
    error: float
    size: float


def _remains(drift: Drift, near: PointFlags, away: PerPoint, width: float) -> _Remainder | None:
    """The remainder of the points `near` a zero, all on one side; None if they are too few for a line."""
    if not near.any():
        return None
    _, change, row, share = (values[near] for values in drift.points)
    smooth = local_polynomial(away[near], change, row, share, np.zeros(1), width)
    if not np.isfinite(smooth.value[0]):
        return None
    size = float(np.average(np.abs(change), weights=share))
    return _Remainder(float(smooth.value[0]), float(smooth.value_error[0]), size)


class Ghost(NamedTuple):
    """A minimum of the size of the drift: its position, and the drift there with its standard error."""

    place: float
    drift: float
    error: float


def ghosts_of(drift: Drift, near: float) -> list[Ghost]:
    """The ghosts of at most the drift `near`, in the order of their positions.

    The drift is larger by two standard errors of the difference on both sides of a ghost.
    """
    at, value, error = drift.smooth.at, drift.smooth.value, drift.smooth.value_error
    ghosts = []
    # next to missing values every minimum would be deep, so each finite stretch is searched by itself
    edges = np.flatnonzero(np.diff(np.isfinite(value), prepend=False, append=False))
    for sign, (first, end) in itertools.product((1.0, -1.0), edges.reshape(-1, 2)):
        peaks, properties = scipy.signal.find_peaks(-sign * value[first:end], prominence=0.0)
        bases = (first + properties[f"{side}_bases"] for side in ("left", "right"))
        for k, left, right in zip(first + peaks, *bases, strict=True):
            # in standard errors of the difference
            surplus = sign * (value - value[k]) / np.hypot(error, error[k])
            rises = min(surplus[left : k + 1].max(), surplus[k : right + 1].max())
            if 0.0 < sign * value[k] <= near and rises > SURE:
                bend = value[k + 1] - 2.0 * value[k] + value[k - 1]
                aside = 0.5 * (value[k - 1] - value[k + 1]) / bend if bend else 0.0
                place = float(at[k] + aside * (at[k + 1] - at[k]))
                smooth = drift.at(place)
                ghosts.append(Ghost(place, float(smooth.value[0]), float(smooth.value_error[0])))
    return sorted(ghosts)
