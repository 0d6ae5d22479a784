"""The smoothed drift of a one-dimensional map along a line or around the circle: its zeros and its ghosts.

The drift is smoothed on each piece of the data between gaps and jumps (`breaks`). It has a zero where the
curve changes between significant values of opposite sign, and the points on both sides confirm it.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Real

from gaitsweep.analysis.circular import unwrap_from
from gaitsweep.analysis.transitions.smoothing import Smooth, local_polynomial
from gaitsweep.angle_difference import TURN

Pairs = Float[np.ndarray, " pairs"]  # a number for each pair
RowOfPair = Real[np.ndarray, " pairs"]
PairFlags = Bool[np.ndarray, " pairs"]
NEAR = 0.01  # rad a crossing; a slower drift holds a row for long
SURE = 2.0  # standard errors from zero of a significant drift
_A_BANDWIDTH = 5  # points of the curve in a bandwidth
_AT_REST = 1e-4  # bandwidths a crossing; a slower row is at rest
_OUTSIDE = 0.02  # bandwidths; largest distance of a rest state outside the data
_NARROWER = (1.0, 0.5, 0.25, 0.125)  # bandwidths; narrower where the points deviate from the curve
_AT_A_PLACE = 4  # least weight of the points in a test of the fit at one position
_ASTRAY = (0.02, 4.0)  # largest mean deviation of points from the curve: bandwidths, standard errors
_TWOFOLD = 3.0  # least ratio of the distance between two branches of points to their widths
_A_BRANCH, _BRANCHES = 2, 8  # least number of points of each branch, and of both
_BRIDGED = (3.0, 0.5)  # largest residual at a zero on one side: standard errors, shares of the drift there
# Breaks in the data.
_NEIGHBOURS = 12  # spacings on either side that tell how densely the points lie at a place
_WIDER = 4.0  # times as wide as those spacings, or
# as those of the rows' first points: a row leaves an unstable point, and none comes to it
_STARTS_WIDER = 2.0
_WIDEST = 2.0  # bandwidths: with a wider gap, no window has points on both sides
_A_JUMP = 3.0  # times the largest residual of the lines on both sides
_SURE = 6.0  # standard errors of the difference of these lines
_LEAST = 4.0  # points, by their shares, on either side
_STEP = (1.0 / 3.0, 2.0)  # of the lines' difference: what the two points in the middle differ by


class Points(NamedTuple):
    """Pairs of a map, (n,) each: value, change, row and share."""

    value: Pairs
    change: Pairs
    row: RowOfPair
    share: Pairs


class Drift(NamedTuple):
    """One piece of a map: its points, sorted by value, and the curve through them.

    `begin` is the start of the turn if the curve closes around the circle; points near it are then present on
    both sides. `circular`: whether changes are angles.
    """

    points: Points
    bandwidth: float
    begin: float | None
    circular: bool
    smooth: Smooth

    def at(self, place: float) -> Smooth:
        """The curve at one position: by a parabola if the points show curvature, else by a line."""
        where = unwrap_from(np.array([place]), self.begin)
        best = None
        for width in self.bandwidth * np.array(_NARROWER):
            for degree in (2, 1):
                smooth = local_polynomial(*self.points, where, width, degree, width == self.bandwidth)
                if np.isfinite(smooth.value[0]):
                    break
            best = smooth if best is None or np.isfinite(smooth.value[0]) else best
            if not _astray(self.points, smooth, width, self.bandwidth)[0]:
                break
        assert best is not None
        return best


def drifts_of(value: Pairs, change: Pairs, row: RowOfPair, bandwidth: float, circular: bool) -> list[Drift]:
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
    step = bandwidth / _A_BANDWIDTH
    order = np.argsort(value, kind="stable")
    columns = (value, change, row, once_a_place(value, row, step))
    points = Points(*(values[order] for values in columns))
    first, n = (np.diff(row, prepend=np.nan) != 0)[order], len(value)
    value, change, _, share = points
    if not circular:
        ends = np.flatnonzero(breaks(value, change, share, first, bandwidth, step)) + 1
    else:
        # points near the ends of the turn also have neighbours on the other side
        low = int(np.searchsorted(value, value[-1] - 4.0 * bandwidth))
        high = int(np.searchsorted(value, value[0] + 4.0 * bandwidth, "right"))
        around = np.r_[np.arange(low, n) - n, np.arange(n), np.arange(high) + n]
        again = around % n
        turned = value[again] + TURN * (around // n)
        broken = breaks(turned, change[again], share[again], first[again], bandwidth, step)
        # the last of these n is between the last point and the first one, a turn later
        after = broken[n - low : n - low + n]
        # more than half a turn: not through zero
        after |= np.abs(np.diff(change, append=change[0])) > 0.5 * TURN
        if not after.any():
            return [_closed(points, bandwidth, step)]
        begin = int(np.flatnonzero(after)[-1]) + 1
        if begin < n:
            points = Points(*(np.roll(values, -begin) for values in points))
            points = points._replace(value=np.r_[value[begin:], value[:begin] + TURN])
        ends = np.flatnonzero(np.roll(after, -begin)[:-1]) + 1
    pieces = zip(*(np.split(values, ends) for values in points), strict=True)
    drifts = [_piece(Points(*values), bandwidth, step, circular) for values in pieces]
    return sorted(drifts, key=lambda piece: float(piece.points.value[0]))


def breaks(
    value: Pairs, change: Pairs, share: Pairs, first: PairFlags, bandwidth: float, step: float
) -> Bool[np.ndarray, " gaps"]:
    """Whether there is a break, a gap or a jump, after each of the points sorted by value, bool (n - 1,).

    A curve across a break would have values that no trajectory has, and false zeros of the drift.

    A gap is wider than the spacing of the points around it: 4 times their spacing, twice the spacing of the
    rows' first points, or two bandwidths. Spacings below `step` are not gaps. At a jump, the
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


def _gaps(value: Pairs, first: PairFlags, bandwidth: float, step: float) -> Bool[np.ndarray, " gaps"]:
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
        usual = _WIDER * float(np.quantile(around, 0.9)) if around.size else 0.0
        middle = 0.5 * (value[k] + value[k + 1])
        start = int(np.searchsorted(starts, middle)) - 1
        if 0 <= start < len(between_starts):
            neighbours = np.r_[
                between_starts[max(start - 1, 0) : start], between_starts[start + 1 : start + 2]
            ]
            usual = max(usual, _STARTS_WIDER * float(neighbours.max())) if neighbours.size else usual
        wide[k] = spacing[k] > min(max(usual, step), _WIDEST * bandwidth)
    return wide


def _jumps(
    value: Pairs, change: Pairs, share: Pairs, bandwidth: float, step: float
) -> Bool[np.ndarray, " gaps"]:
    """Whether there is a jump after each point, as for `breaks`."""
    jumps = np.zeros(len(value) - 1, bool)
    difference = np.abs(np.diff(change))
    # a jump is far larger than what the points around it differ by, from one to the next
    usual = scipy.ndimage.median_filter(difference, 2 * _NEIGHBOURS + 1, mode="nearest")
    largest = scipy.ndimage.maximum_filter1d(difference, 3, mode="nearest")
    suspect = (difference > 3.0 * usual) & (difference >= largest) & (difference > 0.0)
    for k in np.flatnonzero(suspect).tolist():
        middle = 0.5 * float(value[k] + value[k + 1])
        below = _line(value, change, share, k, -1, middle, bandwidth, step)
        above = _line(value, change, share, k + 1, 1, middle, bandwidth, step)
        if below is None or above is None:
            continue
        left, left_error, left_residual = below
        right, right_error, right_residual = above
        leap = abs(right - left)
        error = float(np.hypot(left_error, right_error))
        jumps[k] = (
            leap > _SURE * error
            and leap > _A_JUMP * max(left_residual, right_residual)
            and _STEP[0] * leap < difference[k] < _STEP[1] * leap
        )
    return jumps


def _line(
    value: Pairs, change: Pairs, share: Pairs, k: int, way: int, place: float, bandwidth: float, step: float
) -> tuple[float, float, float] | None:
    """The line through point k and some beyond it, at a place: value, error, largest residual."""
    last = int(np.searchsorted(value, value[k] + way * bandwidth, "right" if way > 0 else "left"))
    pairs = np.arange(k, last) if way > 0 else np.arange(k, last - 1, -1)
    x, y, weight = np.abs(value[pairs] - place), change[pairs], share[pairs]
    enough = (np.cumsum(weight) >= _LEAST) & (x - x[:1] >= step) & (np.arange(len(x)) >= 3)
    if not enough.any():
        return None
    count = int(np.argmax(enough)) + 1
    x, y, weight = x[:count], y[:count], weight[:count]
    (slope, height), covariance = np.polyfit(x, y, 1, w=np.sqrt(weight), cov="unscaled")
    residual = y - height - slope * x
    effective = float(weight.sum()) ** 2 / float((weight**2).sum())
    variance = float(weight @ residual**2) / max(effective - 2.0, 1.0)
    return float(height), float(np.sqrt(variance * covariance[1, 1])), float(np.abs(residual).max())


def _piece(points: Points, bandwidth: float, step: float, circular: bool) -> Drift:
    """A piece with ends: its curve extends from its first point to its last."""
    low, high = float(points.value[0]), float(points.value[-1])
    at = np.arange(low, high, step)
    at = np.append(at, high) if high > low else np.array([low])
    return Drift(points, bandwidth, None, circular, _followed(points, at, bandwidth))


def _closed(points: Points, bandwidth: float, step: float) -> Drift:
    """The single piece of a map whose data cover the circle."""
    low = float(points.value[0])
    around = np.concatenate([points.value - TURN, points.value, points.value + TURN])
    near = (around > low - 2.0 * bandwidth) & (around < low + TURN + 2.0 * bandwidth)
    points = Points(*(np.tile(values, 3)[near] for values in points))._replace(value=around[near])
    count = int(np.ceil(TURN / step))
    smooth = _followed(points, low + TURN * np.arange(count) / count, bandwidth)
    # begin at the most significant sign, so that no zero is at the ends
    sure = np.abs(smooth.value) / np.maximum(smooth.value_error, 1e-300)
    way = np.arange(count + 1) + int(np.argmax(np.nan_to_num(sure)))
    smooth = Smooth(*(values[way % count] for values in smooth))
    smooth = smooth._replace(at=smooth.at + TURN * (way // count))
    return Drift(points, bandwidth, low, True, smooth)


def _followed(points: Points, at: Float[np.ndarray, " positions"], bandwidth: float) -> Smooth:
    """The curve through sorted points, in narrower windows where they bend; NaN where none fits."""
    smooth = local_polynomial(*points, at, bandwidth)
    smooth.value[_twofold(points, smooth, bandwidth)] = np.nan
    wrong = np.flatnonzero(_astray(points, smooth, bandwidth, bandwidth))
    for width in bandwidth * np.array(_NARROWER[1:]):
        closer = local_polynomial(*points, at[wrong], width, widen=False)
        for values, better in zip(smooth, closer, strict=True):
            values[wrong] = better
        wrong = wrong[_astray(points, closer, width, bandwidth, unknown=True)]
    smooth.value[wrong] = np.nan
    return smooth


def _astray(
    points: Points, smooth: Smooth, width: float, bandwidth: float, unknown: bool = False
) -> Bool[np.ndarray, " positions"]:
    """Whether the points' mean deviation exceeds their scatter, bool (k,); `unknown` if they are few."""
    value, change, _, share = points
    wrong = np.full(len(smooth.at), unknown)
    near = width / _A_BANDWIDTH
    low, high = np.searchsorted(value, smooth.at - near), np.searchsorted(value, smooth.at + near, "right")
    for k in np.flatnonzero(np.isfinite(smooth.value) & (high - low >= _AT_A_PLACE)):
        window = slice(low[k], high[k])
        weight = share[window]
        if weight.sum() < _AT_A_PLACE:
            continue
        residual = change[window] - smooth.value[k] - smooth.slope[k] * (value[window] - smooth.at[k])
        mean = float(np.average(residual, weights=weight))
        effective = float(weight.sum()) ** 2 / float((weight**2).sum())
        error = np.sqrt(np.average((residual - mean) ** 2, weights=weight) / (effective - 1.0))
        much, many = _ASTRAY
        off = abs(mean) / np.hypot(1.0, 1.0 + smooth.slope[k])  # distance normal to the map
        wrong[k] = off > much * bandwidth and abs(mean) > (0.5 * many if unknown else many) * error
    return wrong


def _twofold(points: Points, smooth: Smooth, bandwidth: float) -> Bool[np.ndarray, " positions"]:
    """Whether the points lie on two branches, bool (k,), as of a state with another dimension."""
    value, change, *_ = points
    low = np.searchsorted(value, smooth.at - bandwidth)
    high = np.searchsorted(value, smooth.at + bandwidth, "right")
    twofold = np.zeros(len(smooth.at), bool)
    for k in np.flatnonzero(np.isfinite(smooth.value) & (high - low >= _BRANCHES)):
        window = slice(low[k], high[k])
        residual = _beside_own_branch(value[window] - smooth.at[k], change[window] - smooth.value[k])
        order = np.argsort(residual)
        residual, at = residual[order], value[window][order]
        between = np.diff(residual[_A_BRANCH - 1 : len(residual) - _A_BRANCH + 1])
        split = int(np.argmax(between)) + _A_BRANCH
        if between.max() <= _TWOFOLD * max(np.ptp(residual[:split]), np.ptp(residual[split:])):
            continue
        one, other = at[:split], at[split:]
        begin, end = max(one.min(), other.min()), min(one.max(), other.max())
        both = [np.count_nonzero((branch >= begin) & (branch <= end)) for branch in (one, other)]
        twofold[k] = min(both) >= _A_BRANCH
    return twofold


def _beside_own_branch(away: Pairs, above: Pairs) -> Pairs:
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


def once_a_place(value: Pairs, row: RowOfPair, step: float) -> Pairs:
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
    ends = np.flatnonzero(np.diff(visit[order], prepend=np.nan, append=np.nan))
    for begin, end in itertools.pairwise(ends):
        members = order[begin:end]
        places = value[members]
        last, first = np.searchsorted(places, places + step, "right"), np.searchsorted(places, places - step)
        share[members] = 1.0 / (last - first)
    return share


class Zero(NamedTuple):
    """A zero of the drift: its position, the curve there, and whether the drift falls with the value.

    `within` is half the distance between the significant values on its two sides.
    """

    place: float
    smooth: Smooth
    falls: bool
    within: float


def zeros_of(drift: Drift) -> list[Zero]:
    """The zeros of the drift between significant values of opposite sign, and rest states at ends of a piece.

    Noise may split a zero into several: the middle one with the right direction is used. Zeros that the
    points do not confirm (`_confirmed`) are left out.
    """
    at, value, error = drift.smooth.at, drift.smooth.value, drift.smooth.value_error
    sure = np.flatnonzero(np.isfinite(value) & (np.abs(value) > SURE * error))
    zeros = []
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
        falls = bool(value[i] > 0)
        if np.isfinite(smooth.slope[0]) and _confirmed(drift, place, falls):
            zeros.append(Zero(place, smooth, falls, float(at[j] - at[i]) / 2))
    return [*_rest_at_ends(drift, zeros), *zeros]


def _rest_at_ends(drift: Drift, between: list[Zero]) -> list[Zero]:
    """States that rows reach from one side only: the end of a piece where its rows are at rest."""
    at, value, error = drift.smooth.at, drift.smooth.value, drift.smooth.value_error
    sure = np.flatnonzero(np.isfinite(value) & (np.abs(value) > SURE * error))
    if drift.begin is not None or not sure.size:
        return []
    zeros = []
    for end, inner, way in ((0, sure[0], -1.0), (-1, sure[-1], 1.0)):
        place = float(drift.points.value[end])
        if abs(drift.points.change[end]) > _AT_REST * drift.bandwidth:
            continue
        smooth = drift.at(place)
        beyond = way * -float(smooth.value[0] / smooth.slope[0])
        nearest = min((abs(place - zero.place) for zero in between), default=np.inf)
        if abs(beyond) <= _OUTSIDE * drift.bandwidth < nearest:
            falls = bool(way * value[inner] > 0)
            zeros.append(Zero(place, smooth, falls, abs(float(at[inner]) - place)))
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
    still = _AT_REST * drift.bandwidth
    if not (sign * change[left] > -still).any() or not (-sign * change[right] > -still).any():
        return False
    if drift.circular:
        near = np.abs(away) <= drift.bandwidth
        if np.sum(share[near] * np.cos(change[near])) <= 0.0:
            return False  # it goes through half a turn, where the changes' sign turns too
    many, much = _BRIDGED
    bridged = False
    for width in drift.bandwidth * np.array([1.0, 0.5, 0.25]):
        remains = [_remains(drift, side & (np.abs(away) <= width), away, width) for side in (left, right)]
        if None in remains:
            if width == drift.bandwidth:  # too few for lines: then some of them lie near the diagonal
                sizes = np.abs(change[np.abs(away) <= reach])
                return bool(sizes.min() < much * sizes.mean())
            break
        (one, one_error, one_size), (other, other_error, other_size) = remains  # pyright: ignore
        lasts = sign * one > many * one_error and sign * one > much * one_size
        lasts = lasts and -sign * other > many * other_error and -sign * other > much * other_size
        if not lasts and one_error + other_error < much * (one_size + other_size):
            return True
        bridged |= lasts
    return not bridged


def _remains(drift: Drift, near: PairFlags, away: Pairs, width: float) -> tuple[float, float, float] | None:
    """Value at a zero of the line through the points of one side, its error, and their mean size."""
    if not near.any():
        return None
    _, change, row, share = (values[near] for values in drift.points)
    smooth = local_polynomial(away[near], change, row, share, np.zeros(1), width)
    if not np.isfinite(smooth.value[0]):
        return None
    size = float(np.average(np.abs(change), weights=share))
    return float(smooth.value[0]), float(smooth.value_error[0]), size


def ghosts_of(drift: Drift, near: float) -> list[tuple[float, float, float]]:
    """Places, drifts and their standard errors where the size of the drift has a minimum of at most `near`.

    A minimum is one where the drift is larger by two standard errors on both sides of it.
    """
    at, value, error = drift.smooth.at, drift.smooth.value, drift.smooth.value_error
    ghosts = []
    for sign in (1.0, -1.0):
        height_of = np.where(np.isfinite(value), -sign * value, -np.inf)
        peaks, properties = scipy.signal.find_peaks(height_of, prominence=0.0)
        for k, height in zip(peaks, properties["prominences"], strict=True):
            within = 0.0 < sign * value[k] <= near and height > SURE * error[k]
            if within and np.isfinite(value[[k - 1, k + 1]]).all():
                bend = value[k + 1] - 2.0 * value[k] + value[k - 1]
                aside = 0.5 * (value[k - 1] - value[k + 1]) / bend if bend else 0.0
                place = float(at[k] + aside * (at[k + 1] - at[k]))
                smooth = drift.at(place)
                ghosts.append((place, float(smooth.value[0]), float(smooth.value_error[0])))
    return sorted(ghosts)
