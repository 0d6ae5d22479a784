"""Zeros of the smoothed drift of a map, which are its fixed points, and minima without a zero, its ghosts.

The drift has a zero where its curve changes between significant values of opposite sign, and the points on
both sides confirm it.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
import scipy

from gaitsweep.analysis.transitions.breaks import PairFlags, Pairs
from gaitsweep.analysis.transitions.drift import POINTS_PER_BANDWIDTH, Drift
from gaitsweep.analysis.transitions.smoothing import Smooth, local_polynomial
from gaitsweep.angles import unwrap_from

NEAR = 0.01  # rad a crossing; a slower drift holds a row for long
SURE = 2.0  # standard errors from zero of a significant drift
_AT_REST = 1e-4  # bandwidths a crossing; a slower row is at rest
_OUTSIDE = 0.02  # bandwidths; largest distance of a rest state outside the data
# least value at a zero of the line through the points of one side, if the curve bridges a jump there:
_BRIDGED_ERRORS = 3.0  # standard errors
_BRIDGED_SHARE = 0.5  # shares of the mean drift on that side


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
        if abs(nearer - place) < drift.bandwidth / POINTS_PER_BANDWIDTH:
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
    for end, inner, outward in ((0, sure[0], -1.0), (-1, sure[-1], 1.0)):
        place = float(drift.points.value[end])
        if abs(drift.points.change[end]) > _AT_REST * drift.bandwidth:
            continue
        smooth = drift.at(place)
        beyond = outward * -float(smooth.value[0] / smooth.slope[0])
        nearest = min((abs(place - zero.place) for zero in between), default=np.inf)
        if abs(beyond) <= _OUTSIDE * drift.bandwidth < nearest:
            falls = bool(outward * value[inner] > 0)
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
    bridged = False
    for width in drift.bandwidth * np.array([1.0, 0.5, 0.25]):
        remains = [_remains(drift, side & (np.abs(away) <= width), away, width) for side in (left, right)]
        if None in remains:
            if width == drift.bandwidth:  # too few for lines: then some of them lie near the diagonal
                sizes = np.abs(change[np.abs(away) <= reach])
                return bool(sizes.min() < _BRIDGED_SHARE * sizes.mean())
            break
        (below, below_error, below_size), (above, above_error, above_size) = remains  # pyright: ignore
        lasts = sign * below > max(_BRIDGED_ERRORS * below_error, _BRIDGED_SHARE * below_size)
        lasts &= -sign * above > max(_BRIDGED_ERRORS * above_error, _BRIDGED_SHARE * above_size)
        if not lasts and below_error + above_error < _BRIDGED_SHARE * (below_size + above_size):
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

    A minimum is one where the drift is larger by two standard errors of the difference on both sides of it.
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
                ghosts.append((place, float(smooth.value[0]), float(smooth.value_error[0])))
    return sorted(ghosts)
