"""Pairs of trajectories on both sides of a basin's edge, brought together and followed, many at once."""

from __future__ import annotations

import jax
import numpy as np

from gaitsweep.analysis.continuation.newton import sizes
from gaitsweep.analysis.edges.attractor_mappers import UNDECIDED, Decide, Nearest, advanced, ended, fates
from gaitsweep.analysis.edges.edge_recurrence import Recurrence
from gaitsweep.analysis.edges.edge_search import Limits, Outcome
from gaitsweep.engine.poincare.maps import Map, Points
from gaitsweep.engine.poincare.poincare_return import ReturnStatus

# Attractors nearer to each other than this, as a share of each coordinate's size, are the same.
SAME = 1e-3
# By which share of a part the line is cut off its even parts: half-way between mirror images a trajectory may
# stay on the edge for ever.
UNEVEN = 0.0557


class Tracking:
    """Where the searches of n pairs are: both points, `one` and `other`, and what is known of each pair."""

    def __init__(
        self,
        mapping: Map,
        one: Points,
        other: Points,
        values: dict[str, np.ndarray],
        decide: Decide | None,
        limits: Limits,
    ) -> None:
        n = len(one)
        self.mapping, self.one, self.other, self.values, self.limits = mapping, one, other, values, limits
        self.going = np.ones(n, bool)
        self.outcome = np.full(n, Outcome.wandering)
        self.labels = np.full((n, 2), UNDECIDED)
        self.met = np.full(n, UNDECIDED)
        self.edge = self._begun = self._between(np.arange(n))
        self.residual, self.growth = np.full(n, np.nan), np.full(n, np.nan)
        self.period, self.rounds = np.ones(n, int), np.zeros(n, int)
        self.bisections, self.evaluations = np.zeros(n, int), np.zeros(n, int)
        self.decide = self._at_their_ends() if decide is None else self._decided(decide)

    def round(self) -> None:
        """Bring all pairs together that are still going, then follow them until they are apart."""
        self._narrow()
        self._follow()

    def _at_their_ends(self) -> Decide:
        """What decides where only the starts are known: which of their two attractors is nearer."""
        n = len(self.one)
        points, rows = _joined(self.one, self.other), np.tile(np.arange(n), 2)
        ends, going = points.at.copy(), np.arange(2 * n)
        for _ in range(self.limits.settle):
            if not going.size:
                break
            images = advanced(self.mapping, points, self._of(rows[going]))
            np.add.at(self.evaluations, rows[going], 1)
            for place in np.flatnonzero(~images.sound):
                self._end(int(rows[going][place]), -1 - images.status[place])
            points, going = images.points[images.sound], going[images.sound]
            ends[going] = points.at
        ends = ends.reshape(2, n, -1).swapaxes(0, 1)
        distance = self._distance(ends[:, 1], ends[:, 0])
        self.labels = np.where(self.going[:, None], np.array([0, 1]), UNDECIDED)
        self._stop(np.flatnonzero(self.going & (distance <= SAME)), Outcome.same)
        return Nearest(self.mapping, ends)

    def _decided(self, decide: Decide) -> Decide:
        """Tell which attractors the starts come to, and whether an edge lies between them."""
        n = len(self.one)
        rows = np.tile(np.arange(n), 2)
        found = self._fates(_joined(self.one, self.other), rows, decide)
        self.labels = found.reshape(2, n).T
        for label in self.labels.T:
            for row in np.flatnonzero(self.going & (label < 0)):
                self._end(int(row), label[row])
        self._stop(np.flatnonzero(self.going & (self.labels[:, 0] == self.labels[:, 1])), Outcome.same)
        return decide

    def _narrow(self) -> None:
        while True:
            width = self._distance(self.other.at, self.one.at)
            rows = np.flatnonzero(self.going & (width > self.limits.narrow))
            if not rows.size:
                break
            self._divide(rows)

    def _divide(self, rows: np.ndarray) -> None:
        """Try points between, and go on with two neighbours of which one comes to each attractor."""
        cuts = self.limits.cuts
        share = (np.arange(1, cuts + 1) - UNEVEN) / (cuts + 1)
        tried = self._between(np.repeat(rows, cuts), np.tile(share, rows.size))
        labels = np.zeros((rows.size, cuts + 2), int)
        labels[:, 0], labels[:, -1] = self.labels[rows].T
        labels[:, 1:-1] = self._fates(tried, np.repeat(rows, cuts), self.decide).reshape(rows.size, cuts)
        self.bisections[rows] += 1
        passes = (labels[:, :-1] == labels[:, :1]) & (labels[:, 1:] == labels[:, -1:])
        first = np.argmax(passes, axis=1)
        for place in np.flatnonzero(~np.any(passes, axis=1)):
            strange = 1 + int(np.argmax(labels[place, 1:-1] != labels[place, 0]))
            came = tried[[place * cuts + strange - 1]]
            self.edge = self.edge.merged(rows[[place]], came)
            self._end(int(rows[place]), labels[place, strange])
        here = np.any(passes, axis=1)
        lower, upper = here & (first > 0), here & (first < cuts)
        at = np.arange(rows.size) * cuts + first
        self.one = self.one.merged(rows[lower], tried[at[lower] - 1])
        self.other = self.other.merged(rows[upper], tried[at[upper]])

    def _follow(self) -> None:
        """Follow both points, and the one between them, until the two are apart; tell what the edge is."""
        limits, rows = self.limits, np.flatnonzero(self.going)
        if not rows.size:
            return
        n = len(self.one)
        begun = middle = self._between(np.arange(n))
        width, taken = self._distance(self.other.at, self.one.at), np.zeros(n, int)
        calm_width, calm_from = width.copy(), taken.copy()
        course = Recurrence(self._distance, begun, limits.longest)
        for _ in range(limits.most):
            near = self._distance(self.other.at, self.one.at) <= limits.apart
            on = np.flatnonzero(self.going & near)
            if not on.size:
                break
            lanes = np.tile(on, 3)
            points = _joined(_joined(self.one[on], self.other[on]), middle[on])
            images = advanced(self.mapping, points, self._of(lanes))
            np.add.at(self.evaluations, lanes, 1)
            taken[on] += 1
            one, other, between = (images.points[np.arange(on.size) + k * on.size] for k in range(3))
            self.one, self.other = self.one.merged(on, one), self.other.merged(on, other)
            middle = middle.merged(on, between)
            for place in np.flatnonzero(~images.sound):
                self._end(int(lanes[place]), -1 - images.status[place])
            calmer = course.add(on, middle)
            calm_width[calmer] = self._distance(self.other.at, self.one.at)[calmer]
            calm_from[calmer] = taken[calmer]
        begins_calm = calm_from < taken
        calm_width, calm_from = np.where(begins_calm, (calm_width, calm_from), (width, np.zeros(n)))
        distance = self._distance(self.other.at, self.one.at)
        with np.errstate(divide="ignore", invalid="ignore"):
            growth = (distance / calm_width) ** (1.0 / np.maximum(taken - calm_from, 1.0))
        self.growth[rows] = growth[rows]
        self._conclude(rows, begun, course, distance <= width, taken == 1)

    def _conclude(
        self, rows: np.ndarray, begun: Points, course: Recurrence, together: np.ndarray, at_once: np.ndarray
    ) -> None:
        """Tell which edges stay where they are.

        Args:
            rows: that were followed.
            begun: n points where the trajectories between began.
            course: how near they came to where they had been.
            together: whether the two are no farther apart than they were, (n,).
            at_once: whether they were apart after one cycle, (n,).
        """
        stayed = self._distance(begun.at, self._begun.at) <= self.limits.still
        self._begun = self._begun.merged(rows, begun[rows])
        self.edge, self.residual[rows] = self.edge.merged(rows, begun[rows]), course.gaps[rows, 0]
        self.rounds[rows] += 1
        self._stop(rows[self.going[rows] & together[rows]], Outcome.together)
        for k in range(self.limits.longest):
            found = rows[self.going[rows] & (course.gaps[rows, k] <= self.limits.still)]
            self.edge = self.edge.merged(found, course.states[k][found])
            self.residual[found], self.period[found] = course.gaps[found, k], k + 1
            self._stop(found, Outcome.fixed if k == 0 else Outcome.periodic)
        # a jump takes the two apart at once, and the line between them leads over it again
        jumps = self.going & at_once & stayed & (self.rounds > 1)
        self._stop(rows[jumps[rows]], Outcome.jump)

    def _fates(self, points: Points, rows: np.ndarray, decide: Decide) -> np.ndarray:
        labels, cycles = fates(self.mapping, points, self.values, rows, decide, self.limits.most)
        np.add.at(self.evaluations, rows, cycles)
        return labels

    def _between(self, rows: np.ndarray, share: np.ndarray | None = None) -> Points:
        """Points on the lines between the two, half-way or at `share`, with the modes of the nearer one."""
        share = np.full(rows.size, 0.5) if share is None else share
        one, other = self.one[rows], self.other[rows]
        at = one.at + share[:, None] * self.mapping.difference(other.at, one.at)
        nearer = share > 0.5
        like = jax.tree.map(
            lambda a, b: np.where(nearer.reshape(-1, *[1] * (np.ndim(a) - 1)), b, a), one.modes, other.modes
        )
        return Points(at, like)

    def _distance(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            away = np.abs(self.mapping.difference(a, b)) / sizes(b)
        return np.nan_to_num(np.max(away, axis=1), nan=np.inf)

    def _of(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        return {name: each[rows] for name, each in self.values.items()}

    def _end(self, row: int, label: int) -> None:
        """End a pair of which a trajectory has this label, which is of neither of its attractors."""
        if not self.going[row]:
            return
        self.met[row] = label
        if label >= 0:
            outcome = Outcome.third
        elif label == UNDECIDED:
            outcome = Outcome.undecided
        else:
            outcome = Outcome.fell if ended(label) == ReturnStatus.fell else Outcome.lost
        self._stop(np.array([row]), outcome)

    def _stop(self, rows: np.ndarray, outcome: Outcome) -> None:
        self.outcome[rows], self.going[rows] = outcome, False


def _joined(some: Points, others: Points) -> Points:
    return jax.tree.map(lambda a, b: np.concatenate([np.asarray(a), np.asarray(b)]), some, others)
