"""Local regression of scattered points, and the gaps and jumps across which they are not smoothed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int, Real

PerPoint = Float[np.ndarray, " points"]  # a number for each point
PointFlags = Bool[np.ndarray, " points"]
_NEIGHBOURS = 12  # spacings on either side that tell how densely the points lie at a place
_GAP_RATIO = 4.0  # least ratio of a gap to those spacings, or
# to those of the rows' first points: a row leaves an unstable point, and none comes to it
_GAP_RATIO_OF_STARTS = 2.0
_WIDEST_GAP = 2.0  # bandwidths: with a wider gap, no window has points on both sides
_JUMP_OVER_RESIDUAL = 3.0  # least ratio of a jump to the largest residual of the lines on both sides
_JUMP_OVER_ERROR = 6.0  # least ratio of a jump to the standard error of the difference of these lines
_LEAST_WEIGHT = 4.0  # points, by their shares, in a line on either side
# least and largest difference of the two points in the middle, as shares of the lines' difference
_SHARE_OF_LEAP = (1.0 / 3.0, 2.0)


class MapPairs(NamedTuple):
    """Pairs of a map, (n,) each: its value, the change to the next one, the row, and the weight."""

    value: PerPoint
    change: PerPoint
    row: Real[np.ndarray, " points"]
    share: PerPoint

    def chosen(self, which: PointFlags | Int[np.ndarray, " chosen"]) -> MapPairs:
        """Some of the pairs, by a mask (n,) or by their indices."""
        return MapPairs(*(values[which] for values in self))


def breaks(points: MapPairs, first: PointFlags, bandwidth: float, step: float) -> Bool[np.ndarray, " gaps"]:
    """Whether there is a break, a gap or a jump, after each of the points sorted by value, bool (n - 1,).

    A curve across a break would have values that no trajectory has, and false zeros of the drift.

    A gap is wider than the spacing of the points around it: 4 times their spacing, twice the spacing of the
    rows' first points, or two bandwidths. Spacings below `step` are not gaps. At a jump, the
    lines through the points on both sides (4 at least, within a bandwidth) differ, between the two points in
    the middle, by 6 standard errors and by 3 times their largest residual.

    Args:
        points: the points, sorted by value.
        first: which of them is the first of its row, bool (n,).
        bandwidth: half the width of the smoothing window, in the unit of the value.
        step: the distance below which places count as one.
    """
    if len(points.value) < 2:
        return np.zeros(0, bool)
    return _gaps(points.value, first, bandwidth, step) | _jumps(points, bandwidth, step)


def _gaps(value: PerPoint, first: PointFlags, bandwidth: float, step: float) -> Bool[np.ndarray, " gaps"]:
    """Whether there is a gap after each point, as for `breaks`."""
    spacing = np.diff(value)
    suspect = np.flatnonzero(spacing > step)
    wide = np.zeros(len(spacing), bool)
    if not suspect.size:
        return wide
    # points of one place (rows that have come to rest) tell nothing of how densely the others lie
    places = value[np.r_[True, spacing > 0.1 * step]]
    between = np.diff(places)
    starts = np.unique(value[first])
    between_starts = np.diff(starts)
    for k in suspect:
        at = int(np.searchsorted(places, value[k], "right")) - 1
        around = np.r_[between[max(at - _NEIGHBOURS, 0) : at], between[at + 1 : at + 1 + _NEIGHBOURS]]
        usual = _GAP_RATIO * float(np.quantile(around, 0.9)) if around.size else 0.0
        middle = 0.5 * (value[k] + value[k + 1])
        start = int(np.searchsorted(starts, middle)) - 1
        if 0 <= start < len(between_starts):
            neighbours = np.r_[
                between_starts[max(start - 1, 0) : start], between_starts[start + 1 : start + 2]
            ]
            usual = max(usual, _GAP_RATIO_OF_STARTS * float(neighbours.max())) if neighbours.size else usual
        wide[k] = spacing[k] > min(max(usual, step), _WIDEST_GAP * bandwidth)
    return wide


def _jumps(points: MapPairs, bandwidth: float, step: float) -> Bool[np.ndarray, " gaps"]:
    """Whether there is a jump after each point, as for `breaks`."""
    value = points.value
    jumps = np.zeros(len(value) - 1, bool)
    difference = np.abs(np.diff(points.change))
    # a jump is far larger than what the points around it differ by, from one to the next
    usual = scipy.ndimage.median_filter(difference, 2 * _NEIGHBOURS + 1, mode="nearest")
    largest = scipy.ndimage.maximum_filter1d(difference, 3, mode="nearest")
    suspect = (difference > 3.0 * usual) & (difference >= largest) & (difference > 0.0)
    for k in np.flatnonzero(suspect).tolist():
        middle = 0.5 * float(value[k] + value[k + 1])
        below = _line(points, k, -1, middle, bandwidth, step)
        above = _line(points, k + 1, 1, middle, bandwidth, step)
        if below is None or above is None:
            continue
        leap = abs(above.value - below.value)
        error = float(np.hypot(below.error, above.error))
        jumps[k] = (
            leap > _JUMP_OVER_ERROR * error
            and leap > _JUMP_OVER_RESIDUAL * max(below.residual, above.residual)
            and _SHARE_OF_LEAP[0] * leap < difference[k] < _SHARE_OF_LEAP[1] * leap
        )
    return jumps


class _Line(NamedTuple):
    """The value of a line through points at a place, its standard error, and the points' largest residual."""

    value: float
    error: float
    residual: float


def _line(points: MapPairs, k: int, way: int, place: float, bandwidth: float, step: float) -> _Line | None:
    """The line through point k and some above it (`way` 1) or below (-1); None if they are too few."""
    value = points.value
    last = int(np.searchsorted(value, value[k] + way * bandwidth, "right" if way > 0 else "left"))
    near = points.chosen(np.arange(k, last) if way > 0 else np.arange(k, last - 1, -1))
    x, y, weight = np.abs(near.value - place), near.change, near.share
    enough = (np.cumsum(weight) >= _LEAST_WEIGHT) & (x - x[:1] >= step) & (np.arange(len(x)) >= 3)
    if not enough.any():
        return None
    count = int(np.argmax(enough)) + 1
    x, y, weight = x[:count], y[:count], weight[:count]
    (slope, height), covariance = np.polyfit(x, y, 1, w=np.sqrt(weight), cov="unscaled")
    residual = y - height - slope * x
    effective = float(weight.sum()) ** 2 / float((weight**2).sum())
    variance = float(weight @ residual**2) / max(effective - 2.0, 1.0)
    error = float(np.sqrt(variance * covariance[1, 1]))
    return _Line(float(height), error, float(np.abs(residual).max()))


LEAST = (3.0, 6.0)  # least weight of the points in the window of a line and of a parabola
SPREAD = 0.02  # least variance of these points, in squared bandwidths; 0.2 if evenly spread
WIDER = (1.0, 1.5, 2.25)  # bandwidths tried for a line where points are few
_WORST = 1e9  # largest condition number of a fit
_BENT = 3.0  # least curvature of a parabola, in standard errors
LEAST_ROWS = 12  # least number of rows for errors clustered by row, which are too small with fewer


class _Fit(NamedTuple):
    """A local fit at one position: value and slope with their standard errors; NaN without a fit."""

    value: float = float("nan")
    slope: float = float("nan")
    value_error: float = float("nan")
    slope_error: float = float("nan")


class Smooth(NamedTuple):
    """The curve at k positions, (k,) each: value and slope with standard errors, points in the window.

    All but the number of points are NaN where there are too few points.
    """

    at: Float[np.ndarray, " positions"]
    value: Float[np.ndarray, " positions"]
    slope: Float[np.ndarray, " positions"]
    value_error: Float[np.ndarray, " positions"]
    slope_error: Float[np.ndarray, " positions"]
    points: Int[np.ndarray, " positions"]


def local_polynomial(
    points: MapPairs,
    at: Float[np.ndarray, " positions"],
    bandwidth: float,
    degree: int = 1,
    widen: bool = True,
) -> Smooth:
    """Fit the change over the value around each position, with weights that fall to zero at `bandwidth`.

    The weights are Epanechnikov's, 1 - (distance/bandwidth)^2. If the points within a bandwidth are too few
    or coincide, a line is fitted to those within 1.5 or 2.25 bandwidths, if that helps. The errors are
    heteroscedastic (jackknifed residuals in a sandwich estimator), with correlated errors within rows. They
    do not contain the bias of a line by curvature: bandwidth^2/10 times the second derivative for the value
    amid the data, and about half a bandwidth times it for the slope at their end. A parabola has no such
    bias.

    Args:
        points: the points; their shares count in the test for enough points alone.
        at: the positions, (k,).
        bandwidth: half the width of the window, in the unit of the value.
        degree: 1, a line, or 2, a parabola, fitted only if its curvature is three standard errors from zero.
        widen: whether the window of a line may be widened where points are few.
    """
    x, y, row, share = points.chosen(np.argsort(points.value, kind="stable"))
    widths = bandwidth * np.array(WIDER if degree == 1 and widen else WIDER[:1])
    lines = []
    for place in at:
        line = (*_Fit(), 0)
        for width in widths:
            low, high = np.searchsorted(x, place - width, "left"), np.searchsorted(x, place + width, "right")
            near = slice(low, high)
            fit = _fit((x[near] - place) / width, y[near], row[near], share[near], degree)
            line = (fit.value, fit.slope / width, fit.value_error, fit.slope_error / width, high - low)
            if np.isfinite(fit.value):
                break
        lines.append(line)
    value, slope, value_error, slope_error, counts = np.array(lines, float).reshape(-1, 5).T
    return Smooth(np.asarray(at, float), value, slope, value_error, slope_error, counts.astype(int))


def _enough(distance: PerPoint, weight: PerPoint, least: float) -> bool:
    """Whether the points have the weight `least`, and do not coincide."""
    if len(distance) < 4 or weight.sum() < least:
        return False
    middle = np.average(distance, weights=weight)
    return float(np.average((distance - middle) ** 2, weights=weight)) >= SPREAD


def _fit(
    distance: PerPoint, y: PerPoint, row: Real[np.ndarray, " points"], share: PerPoint, degree: int
) -> _Fit:
    """The value, slope and their standard errors at distance 0, for bandwidth 1."""
    weight = 1.0 - distance**2
    if not _enough(distance, weight * share, LEAST[degree - 1]):
        return _Fit()
    design = distance[:, None] ** np.arange(degree + 1)
    normal = design.T @ (weight[:, None] * design)
    # columns of equal length: then the condition number detects points that coincide
    scale = np.sqrt(np.diag(normal))
    if np.linalg.cond(normal / np.outer(scale, scale)) > _WORST:
        return _Fit()  # all points coincide, as of settled rows: no slope
    inverse = np.linalg.inv(normal)
    fit = inverse @ (design.T @ (weight * y))
    leverage = weight * np.einsum("ij,jk,ik->i", design, inverse, design)
    residual = (y - design @ fit) / np.maximum(1.0 - leverage, 0.1)
    scores = (weight * residual)[:, None] * design
    rows, member = np.unique(row, return_inverse=True)
    if len(rows) >= LEAST_ROWS:
        scores = np.stack([np.bincount(member, column) for column in scores.T], axis=1)
        scores *= np.sqrt(len(rows) / (len(rows) - 1))
    spread = inverse @ (scores.T @ scores) @ inverse
    errors = np.sqrt(np.maximum(np.diag(spread), 0.0))
    if degree == 2 and abs(fit[2]) < _BENT * errors[2]:
        return _Fit()
    return _Fit(*map(float, (*fit[:2], *errors[:2])))
