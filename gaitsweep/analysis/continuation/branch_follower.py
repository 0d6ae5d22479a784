"""Branches while they are followed: steps taken, halved, made longer, leaps over bends of the map, ends."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from gaitsweep.analysis.continuation.arclength import Places, Track
from gaitsweep.analysis.continuation.bifurcation_tests import (
    changes,
    kinds,
    leaving,
    located,
    multipliers_of,
    turning,
    turns,
)
from gaitsweep.analysis.continuation.branch_table import Book
from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.engine.poincare.maps import Points

# Cosine of the angle by which a branch may turn in a step, and corrections that make the next step longer.
STRAIGHT, FEW = 0.95, 6
LONGER, SHORTER = 1.4, 0.5
# A branch has closed where it passes its start by less than this share of a step, after so many points.
NEAR_HOME, AWAY = 0.75, 4
# Shares of the longest step that are tried where no step is short enough.
LEAPS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)


@dataclasses.dataclass(frozen=True)
class Steps:
    """Lengths of the first step, of the longest and of the shortest, and the most points of a branch.

    In a length the parameter counts as a share of its range, and coordinates in proportion to their size.
    `between` is called before each step; what it raises stops the continuation.
    """

    first: float = 0.02
    longest: float = 0.08
    shortest: float = 1e-4
    most: int = 300
    between: Callable[[], None] | None = None


class OnTheWay:
    """The branches of n rows, `names` (n,), from `places` on.

    Args:
        track: what they share.
        places: their first fixed points.
        names: their rows in the `book`, where their points are written.
        steps: how long steps are.
    """

    def __init__(self, track: Track, places: Places, names: np.ndarray, book: Book, steps: Steps) -> None:
        self.track, self.names, self.book, self.steps = track, names, book, steps
        self.home = self.places = places
        self.length = np.full(len(names), steps.first)
        self.going = np.ones(len(names), bool)
        book.write(names, track, places, [""] * len(names))

    def follow(self) -> None:
        """Follow each branch to its end."""
        while self.going.any():
            if self.steps.between is not None:
                self.steps.between()
            rows = np.flatnonzero(self.going)
            track, here = self.track[rows], self.places[rows]
            there, found = track.step(here, self.length[rows])
            straight = np.sum(track.weights * here.tangent * there.tangent, axis=1) > STRAIGHT
            taken = found & (straight | (self.length[rows] <= self.steps.shortest))
            self._refused(rows[~taken])
            if taken.any():
                self._taken(rows[taken], there[taken])

    def _end(self, rows: np.ndarray, why: str) -> None:
        self.book.end(self.names[rows], why)
        self.going[rows] = False

    def _refused(self, rows: np.ndarray) -> None:
        """Steps that were not found, or turned too far: half as long, or a leap where they are too short."""
        self.length[rows] *= SHORTER
        rows = rows[self.length[rows] < self.steps.shortest]
        if not rows.size:
            return
        track = self.track[rows]
        over, leapt = _leap(track, self.places[rows], self.steps.longest)
        good = np.flatnonzero(leapt)
        self.places = self.places.merged(rows[good], over[good])
        self.length[rows] = self.steps.first
        self.book.write(self.names[rows[good]], track[good], over[good], ["kink"] * good.size)
        self._end(rows[~leapt], "lost")

    def _taken(self, rows: np.ndarray, there: Places) -> None:
        """Steps that were found: what happened on them, and whether the branch ends."""
        track, here, names = self.track[rows], self.places[rows], self.names[rows]
        self._specials(track, here, there, self.length[rows], names)
        inside = (there.parameter >= track.low) & (there.parameter <= track.high)
        out = np.flatnonzero(~inside)
        if out.size:
            some, over = track[out], there[out]
            places, found = some.at(over, np.clip(over.parameter, track.low, track.high))
            good = np.flatnonzero(found)
            self.book.write(names[out[good]], some[good], places[good], [""] * good.size)
            self._end(rows[out], "range")
        kept = np.flatnonzero(inside)
        if not kept.size:
            return
        rows, names, there, track = rows[kept], names[kept], there[kept], track[kept]
        self.book.write(names, track, there, _jumps(here[kept], there))
        self.places = self.places.merged(rows, there)
        home = self.home[rows]
        closed = _distance(track, there, home) < NEAR_HOME * self.length[rows]
        closed &= np.sum(track.weights * there.tangent * home.tangent, axis=1) > 0.0
        closed &= self.book.counts(names) > AWAY
        self._end(rows[closed], "closed")
        self._end(rows[~closed & (self.book.counts(names) >= self.steps.most)], "most")
        easy = rows[there.corrections <= FEW]
        self.length[easy] = np.minimum(LONGER * self.length[easy], self.steps.longest)

    def _specials(
        self, track: Track, here: Places, there: Places, length: np.ndarray, names: np.ndarray
    ) -> None:
        """Write down what changes on the way from `here` to `there`."""
        turned = turning(track, here) * turning(track, there) < 0.0
        what = changes(multipliers_of(track, here), multipliers_of(track, there), turned)
        for kind, test, told in (("fold", turning, turns), ("crossing", leaving, kinds)):
            rows = np.flatnonzero(what == kind)
            if rows.size:
                some = track[rows]
                ends = test(some, here[rows]), test(some, there[rows])
                places, where = located(some, here[rows], length[rows], test, ends)
                good = np.flatnonzero(np.isfinite(where))
                found = places[good]
                self.book.write(names[rows[good]], some[good], found, told(some[good], found))


def _jumps(here: Places, there: Places) -> list[str]:
    """For each step "kink" where the parameter went against the tangents at both its ends, or nothing."""
    way = there.parameter - here.parameter
    against = (way * here.tangent[:, -1] < 0.0) & (way * there.tangent[:, -1] < 0.0)
    return np.where(against, "kink", "").tolist()


def _leap(track: Track, here: Places, longest: float) -> tuple[Places, np.ndarray]:
    """Places beyond a point at which the map bends or jumps, and whether any were found (n,).

    Where a trajectory grazes an event the map has no derivative, and may jump: no step is short enough to get
    there, but a longer one may get over it, across the branch or at a given value of the parameter.
    """
    best, found = here, np.zeros(len(here.parameter), bool)
    for share in LEAPS:
        for across in (True, False):
            rows = np.flatnonzero(~found)
            if not rows.size:
                return best, found
            mine, start = track[rows], here[rows]
            length = share * longest
            there, good = (
                mine.step(start, np.full(rows.size, length)) if across else _beyond(mine, start, length)
            )
            good = good & (np.sum(mine.weights * start.tangent * there.tangent, axis=1) > 0.0)
            good &= (there.parameter >= track.low) & (there.parameter <= track.high)
            good &= _distance(mine, start, there) < 2.0 * longest
            best = best.merged(rows[good], there[good])
            found[rows[good]] = True
    return best, found


def _beyond(track: Track, here: Places, length: float) -> tuple[Places, np.ndarray]:
    """Places found by damped steps at the parameter's value a `length` ahead, and whether they were found."""
    change = length * here.tangent
    parameter = here.parameter + change[:, -1]
    size = here.points.at.shape[1]
    starts = Points(here.points.at + change[:, :size], here.points.modes)
    fix = {track.mapping.conserved[k].name: track.held.values[:, i] for i, k in enumerate(track.held.which)}
    values = {**track.values, track.parameter: parameter}
    found = newton(track.mapping, starts, values, fix=fix, most=10)
    good = np.flatnonzero(found.converged)
    if not good.size:
        return here, found.converged
    sign = np.sign(here.tangent[good, -1])
    places = track[good].first(found.points[good], found.drift[good], parameter[good], sign)
    return here.merged(good, places), found.converged


def _distance(track: Track, a: Places, b: Places) -> np.ndarray:
    """The length of the straight way between places (n,)."""
    apart = np.zeros_like(track.weights)
    size = a.points.at.shape[1]
    apart[:, :size] = track.mapping.difference(a.points.at, b.points.at)
    apart[:, -1] = a.parameter - b.parameter
    return np.sqrt(np.sum(track.weights * apart**2, axis=1))
