"""The smoothed drift of a one-dimensional map along a line or around the circle, and its zeros.

The drift is smoothed on each piece of the data between gaps and jumps. Its zeros are the fixed points of the
map; ghosts are minima of its size without a zero. At a zero the curve changes between significant values of
opposite sign, and the points on both sides confirm it.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int, Real

from gaitsweep.analysis.transitions.smoothing import (
    MapPairs,
    PerPoint,
    PointFlags,
    Smooth,
    breaks,
    local_polynomial,
)
from gaitsweep.angles import TURN, unwrap_from

RowOfPoint = Real[np.ndarray, " points"]
POINTS_PER_BANDWIDTH = 5  # points of the curve in a bandwidth
_NARROWER = (1.0, 0.5, 0.25, 0.125)  # bandwidths; narrower where the points deviate from the curve
_LEAST_WEIGHT = 4  # least weight of the points in a test of the fit at one position
# largest mean deviation of points from the curve
_ASTRAY_BANDWIDTHS, _ASTRAY_ERRORS = 0.02, 4.0
_BRANCH_DISTANCE = 3.0  # least ratio of the distance between two branches of points to their widths
_LEAST_OF_A_BRANCH, _LEAST_OF_BOTH = 2, 8  # least number of points of each branch, and of both
AT_REST = 1e-4  # bandwidths a crossing; a slower row is at rest


class Drift(NamedTuple):
    """One piece of a map: its points, sorted by value, and the curve through them.

    `begin` is the start of the turn if the curve closes around the circle; points near it are then present on
    both sides. `circular`: whether changes are angles.
    """

    points: MapPairs
    bandwidth: float
    begin: float | None
    circular: bool
    smooth: Smooth

    def at(self, place: float) -> Smooth:
        """The curve at one position: by a parabola if the points show curvature, else by a line."""
        position = unwrap_from(np.array([place]), self.begin)
        best = None
        for width in self.bandwidth * np.array(_NARROWER):
            for degree in (2, 1):
                smooth = local_polynomial(self.points, position, width, degree, width == self.bandwidth)
                if np.isfinite(smooth.value[0]):
                    break
            best = smooth if best is None or np.isfinite(smooth.value[0]) else best
            if not _astray(self.points, smooth, width, self.bandwidth)[0]:
                break
        assert best is not None
        return best


def drifts_of(
    value: PerPoint, change: PerPoint, row: RowOfPoint, bandwidth: float, circular: bool
) -> list[Drift]:
    """Smooth the change over the value by local lines, on each piece of the data.

    The curve closes around the circle if the data have no break.

    Args:
        value, change: (n,), each row's in their order; angles on one turn, in rad.
        row: the row of each pair, (n,).
        bandwidth: half the width of the window, in the unit of the value.
        circular: whether the value is an angle.

    Returns:
        The pieces, ascending; those of an angle may extend beyond the end of the turn.
    """
    step = bandwidth / POINTS_PER_BANDWIDTH
    order = np.argsort(value, kind="stable")
    points = MapPairs(value, change, row, once_a_place(value, row, step)).chosen(order)
    first = (np.diff(row, prepend=np.nan) != 0)[order]
    if not circular:
        broken = breaks(points, first, bandwidth, step)
    else:
        broken = _breaks_around(points, first, bandwidth, step)
        if not broken.any():
            return [_closed(points, bandwidth, step)]
        # the pieces begin behind the last break
        begin = int(np.flatnonzero(broken)[-1]) + 1
        if begin < len(value):
            turned = np.r_[points.value[begin:], points.value[:begin] + TURN]
            points = MapPairs(*(np.roll(values, -begin) for values in points))._replace(value=turned)
        broken = np.roll(broken, -begin)[:-1]
    begins = np.flatnonzero(broken) + 1
    pieces = zip(*(np.split(values, begins) for values in points), strict=True)
    drifts = [_piece(MapPairs(*values), bandwidth, step, circular) for values in pieces]
    return sorted(drifts, key=lambda piece: float(piece.points.value[0]))


def _breaks_around(
    points: MapPairs, first: Bool[np.ndarray, " points"], bandwidth: float, step: float
) -> Bool[np.ndarray, " points"]:
    """Whether there is a break after each of the points (n,) on a circle, as `breaks` tells it.

    The last one is between the last point and the first, a turn later.
    """
    value, n = points.value, len(points.value)
    # points near the ends of the turn also have neighbours on the other side
    low = int(np.searchsorted(value, value[-1] - 4.0 * bandwidth))
    high = int(np.searchsorted(value, value[0] + 4.0 * bandwidth, "right"))
    around = np.r_[np.arange(low, n) - n, np.arange(n), np.arange(high) + n]
    index = around % n
    turned = points.chosen(index)._replace(value=value[index] + TURN * (around // n))
    broken = breaks(turned, first[index], bandwidth, step)
    # more than half a turn: not through zero
    leaps = np.abs(np.diff(points.change, append=points.change[0])) > 0.5 * TURN
    return broken[n - low : n - low + n] | leaps


def _piece(points: MapPairs, bandwidth: float, step: float, circular: bool) -> Drift:
    """A piece with ends: its curve extends from its first point to its last."""
    low, high = float(points.value[0]), float(points.value[-1])
    at = np.arange(low, high, step)
    at = np.append(at, high) if high > low else np.array([low])
    return Drift(points, bandwidth, None, circular, _followed(points, at, bandwidth))


def _closed(points: MapPairs, bandwidth: float, step: float) -> Drift:
    """The single piece of a map whose data cover the circle."""
    low = float(points.value[0])
    around = np.concatenate([points.value - TURN, points.value, points.value + TURN])
    near = (around > low - 2.0 * bandwidth) & (around < low + TURN + 2.0 * bandwidth)
    points = MapPairs(*(np.tile(values, 3)[near] for values in points))._replace(value=around[near])
    count = int(np.ceil(TURN / step))
    smooth = _followed(points, low + TURN * np.arange(count) / count, bandwidth)
    # begin at the most significant sign, so that no zero is at the ends
    sure = np.abs(smooth.value) / np.maximum(smooth.value_error, AT_REST * bandwidth)
    around_once = np.arange(count + 1) + int(np.argmax(np.nan_to_num(sure)))
    smooth = Smooth(*(values[around_once % count] for values in smooth))
    smooth = smooth._replace(at=smooth.at + TURN * (around_once // count))
    return Drift(points, bandwidth, low, True, smooth)


def _followed(points: MapPairs, at: Float[np.ndarray, " positions"], bandwidth: float) -> Smooth:
    """The curve through sorted points, in narrower windows where they bend; NaN where none fits."""
    smooth = local_polynomial(points, at, bandwidth)
    smooth.value[_twofold(points, smooth, bandwidth)] = np.nan
    wrong = np.flatnonzero(_astray(points, smooth, bandwidth, bandwidth))
    for width in bandwidth * np.array(_NARROWER[1:]):
        closer = local_polynomial(points, at[wrong], width, widen=False)
        for values, better in zip(smooth, closer, strict=True):
            values[wrong] = better
        wrong = wrong[_astray(points, closer, width, bandwidth, strict=True)]
    smooth.value[wrong] = np.nan
    return smooth


def _astray(
    points: MapPairs, smooth: Smooth, width: float, bandwidth: float, strict: bool = False
) -> Bool[np.ndarray, " positions"]:
    """Whether the points' mean deviation exceeds their scatter, bool (k,).

    `strict`: at half as many standard errors, and also where there are too few points for the test.
    """
    value, change, _, share = points
    wrong = np.full(len(smooth.at), strict)
    near = width / POINTS_PER_BANDWIDTH
    low, high = np.searchsorted(value, smooth.at - near), np.searchsorted(value, smooth.at + near, "right")
    for k in np.flatnonzero(np.isfinite(smooth.value) & (high - low >= _LEAST_WEIGHT)):
        window = slice(low[k], high[k])
        weight = share[window]
        if weight.sum() < _LEAST_WEIGHT:
            continue
        residual = change[window] - smooth.value[k] - smooth.slope[k] * (value[window] - smooth.at[k])
        mean = float(np.average(residual, weights=weight))
        effective = float(weight.sum()) ** 2 / float((weight**2).sum())
        error = np.sqrt(np.average((residual - mean) ** 2, weights=weight) / (effective - 1.0))
        off = abs(mean) / np.hypot(1.0, 1.0 + smooth.slope[k])  # distance normal to the map
        errors = 0.5 * _ASTRAY_ERRORS if strict else _ASTRAY_ERRORS
        wrong[k] = off > _ASTRAY_BANDWIDTHS * bandwidth and abs(mean) > errors * error
    return wrong


def _twofold(points: MapPairs, smooth: Smooth, bandwidth: float) -> Bool[np.ndarray, " positions"]:
    """Whether the points lie on two branches, bool (k,), as of a state with another dimension."""
    value, change, *_ = points
    low = np.searchsorted(value, smooth.at - bandwidth)
    high = np.searchsorted(value, smooth.at + bandwidth, "right")
    twofold = np.zeros(len(smooth.at), bool)
    for k in np.flatnonzero(np.isfinite(smooth.value) & (high - low >= _LEAST_OF_BOTH)):
        window = slice(low[k], high[k])
        residual = _beside_own_branch(value[window] - smooth.at[k], change[window] - smooth.value[k])
        order = np.argsort(residual)
        residual, at = residual[order], value[window][order]
        between = np.diff(residual[_LEAST_OF_A_BRANCH - 1 : len(residual) - _LEAST_OF_A_BRANCH + 1])
        split = int(np.argmax(between)) + _LEAST_OF_A_BRANCH
        if between.max() <= _BRANCH_DISTANCE * max(np.ptp(residual[:split]), np.ptp(residual[split:])):
            continue
        below, above = at[:split], at[split:]
        begin, end = max(below.min(), above.min()), min(below.max(), above.max())
        overlapping = [np.count_nonzero((branch >= begin) & (branch <= end)) for branch in (below, above)]
        twofold[k] = min(overlapping) >= _LEAST_OF_A_BRANCH
    return twofold


def _beside_own_branch(away: PerPoint, above: PerPoint) -> PerPoint:
    """The changes without the common slope of those above a curve and those below it."""
    tilt = 0.0
    for _ in range(3):
        level = above - tilt * away
        up = level > 0.5 * (level.max() + level.min())
        x, y = away.copy(), above.copy()
        for side in (up, ~up):
            if side.any():
                x[side] -= x[side].mean()
                y[side] -= y[side].mean()
        tilt = float(x @ y) / max(float(x @ x), 1e-300)
    return above - tilt * away


def once_a_place(value: PerPoint, row: RowOfPoint, step: float) -> PerPoint:
    """The weight (n,) of each pair: each visit of a row to a position has the weight one.

    Where a row stays, its values fluctuate or alternate, with changes of -1 or -2 times their deviation:
    these many pairs show the position, but must not count as a curve of that slope. A row that returns, as a
    chaotic one does, makes another visit.

    Args:
        value, row: of the pairs, (n,), in order within each row.
        step: the distance below which positions are equal.
    """
    leaves = (np.diff(row, prepend=np.nan) != 0) | (np.abs(np.diff(value, prepend=np.nan)) > step)
    visit = np.cumsum(leaves)
    share = np.empty(len(value))
    order = np.lexsort((value, visit))
    bounds = np.flatnonzero(np.diff(visit[order], prepend=np.nan, append=np.nan))
    for begin, end in itertools.pairwise(bounds):
        members = order[begin:end]
        values = value[members]
        last, first = np.searchsorted(values, values + step, "right"), np.searchsorted(values, values - step)
        share[members] = 1.0 / (last - first)
    return share


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
    points = drift.points.chosen(near)._replace(value=away[near])
    smooth = local_polynomial(points, np.zeros(1), width)
    if not np.isfinite(smooth.value[0]):
        return None
    size = float(np.average(np.abs(points.change), weights=points.share))
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
