"""Where along a branch something changes: folds, flips, and where other multipliers cross the unit circle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gaitsweep.analysis.continuation.arclength import Places, Track
from gaitsweep.analysis.continuation.floquet import multipliers

# Share of its size at a step's ends to which what changes sign is brought down.
NEAR = 1e-7
# Share of the step to which the place is narrowed down where the map bends, and nothing goes through zero.
NARROW = 1e-6
MOST_TRIALS = 40
# How fast the parameter, as a share of its range, may still change along a branch at a fold.
FLAT = 1e-3
# A multiplier whose imaginary part is below this share of its size counts as real.
REAL = 1e-6

Test = Callable[[Track, Places], np.ndarray]


def multipliers_of(track: Track, places: Places) -> np.ndarray:
    """The multipliers (n, size - k) at places of branches, those along what is held left out."""
    return multipliers(places.images.jacobian, places.images.conserved_jacobian[:, track.held.which])


def turning(track: Track, places: Places) -> np.ndarray:
    """How fast the parameter changes along the branches, (n,): zero at a fold."""
    return places.tangent[:, -1]


def leaving(track: Track, places: Places) -> np.ndarray:
    """How far the multiplier nearest to the unit circle is outside of it, (n,)."""
    outside = np.abs(multipliers_of(track, places)) - 1.0
    nearest = np.argmin(np.abs(outside), axis=1)
    return outside[np.arange(len(outside)), nearest]


def changes(before: np.ndarray, after: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """What happened on a step of each branch: "fold", "crossing", or "".

    Args:
        before, after: multipliers at the step's ends, (n, m).
        turned: whether the parameter turned back, (n,).
    """
    count = [np.sum(np.abs(each) > 1.0, axis=1) for each in (before, after)]
    return np.where(turned, "fold", np.where(count[0] != count[1], "crossing", ""))


def located(
    track: Track, before: Places, length: np.ndarray, test: Test, ends: tuple[np.ndarray, np.ndarray]
) -> tuple[Places, np.ndarray]:
    """Where a test changes its sign on a step of each branch, and how far along (n,); NaN where not found.

    Args:
        track, before, length: the branches, where their steps begin, and their lengths (n,).
        test: what changes its sign; `ends` what it is at both ends of the steps, (n,) each.
    """
    low, high = np.zeros_like(length), length.copy()
    below, above = (each.copy() for each in ends)
    target = NEAR * np.maximum(np.abs(below), np.abs(above))
    best, where = before, np.full(len(length), np.nan)
    going = below * above < 0.0
    for _ in range(MOST_TRIALS):
        rows = np.flatnonzero(going)
        if not rows.size:
            break
        at = low[rows] + (high[rows] - low[rows]) * below[rows] / (below[rows] - above[rows])
        places, found = track[rows].step(before[rows], at)
        value = np.where(found, test(track[rows], places), np.nan)
        best = best.merged(rows[found], places[found])
        where[rows[found]] = at[found]
        same = value * below[rows] > 0.0
        # Illinois: the end that stays counts half
        low[rows[same]], below[rows[same]] = at[same], value[same]
        above[rows[same]] *= 0.5
        other = ~same & found
        high[rows[other]], above[rows[other]] = at[other], value[other]
        below[rows[other]] *= 0.5
        narrow = high[rows] - low[rows] < NARROW * length[rows]
        going[rows] = found & (np.abs(value) > target[rows]) & ~narrow
    return best, where


def turns(track: Track, places: Places) -> list[str]:
    """What each place is where the parameter turns back: "fold", or "corner" where the map bends."""
    smooth = np.abs(turning(track, places)) < FLAT * (track.high - track.low)
    return np.where(smooth, "fold", "corner").tolist()


def kinds(track: Track, places: Places) -> list[str]:
    """What kind of crossing of the unit circle is at each of these places."""
    found = multipliers_of(track, places)
    names = []
    for each in found:
        nearest = each[np.argmin(np.abs(np.abs(each) - 1.0))]
        if abs(nearest.imag) > REAL * abs(nearest):
            names.append("neimark_sacker")
        else:
            names.append("flip" if nearest.real < 0.0 else "branch_point")
    return names
