"""The atlas of a map: all periodic orbits at one value of a parameter, their branches, and what these meet.

The orbits of a search are followed at once along the parameter. Where a branch has a flip, the branch of
twice the period is followed from there; where branches cross, the other one. What these meet is followed,
too, to a given depth. Branches that turn out to be one are joined, also if they are followed from other
points of the same orbits.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pandas as pd
from jaxtyping import Bool

from gaitsweep.analysis.atlas.branch import (
    ON_BRANCH,
    Branch,
    BranchStart,
    Record,
    branch_table,
    record_of,
)
from gaitsweep.analysis.atlas.order_changes import with_order_changes
from gaitsweep.analysis.atlas.periodic_orbits import Orbit, OrbitSearch, orbits_of, rows_of
from gaitsweep.analysis.atlas.plane_curves import plane_curves
from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps, BranchFollower
from gaitsweep.analysis.continuation.branch_points import CROSSINGS, FLAT, Way, beside
from gaitsweep.analysis.continuation.branch_table import in_terms_of_flow
from gaitsweep.analysis.continuation.critical_points import SecondParameter
from gaitsweep.analysis.continuation.newton import ConservedConstraints, newton
from gaitsweep.analysis.continuation.normal_forms import coefficient, doubled_direction
from gaitsweep.analysis.continuation.stable_ranges import MARKS
from gaitsweep.engine.poincare.maps import Map, Values

# Lengths of the step from a flip to the branch of twice the period, the next where one does not converge: the
# next flip of a cascade is close.
BESIDE_FLIP = (1e-3, 1e-4, 1e-2, 1e-5)


class BranchAtlas:
    """The branches of the periodic orbits of each row's map along one parameter.

    Args:
        mapping: the map.
        values: its other parameters, numbers or one for each row (n,).
        parameter: the continuation parameter.
        within: its range, two numbers.
        fix: conserved quantities that are held.
        steps: lengths and number of the steps; branches have points at its values `through`.
        most_branches: the largest number of branches of a row.
    """

    def __init__(
        self,
        mapping: Map,
        values: Values,
        *,
        parameter: str,
        within: Sequence[float],
        fix: Sequence[str] = (),
        steps: ArclengthSteps | None = None,
        most_branches: int = 200,
    ) -> None:
        self.mapping, self.parameter, self.within, self.fix = mapping, parameter, within, fix
        self.values = {name: v for name, v in values.items() if name != parameter}
        self.steps, self.most_branches = steps or ArclengthSteps(), most_branches
        self.branches: list[Branch] = []
        self._beyond: list[Branch] = []  # those beyond the largest number

    def left_out(self, row: int) -> int:
        """The number of branches of a row beyond the largest number."""
        return sum(branch.row == row for branch in self._beyond)

    def follow(self, search: OrbitSearch, at: float, depth: int) -> None:
        """Follow the orbits of a search at a value of the parameter, and what their branches meet.

        Args:
            search: the orbits.
            at: the value of the parameter there.
            depth: the largest number of bifurcations between a branch and an orbit.
        """
        starts = [self._start_of_orbit(orbit, at) for orbit in search.orbits]
        self._follow([start for start in starts if start is not None])
        for level in range(1, depth + 1):
            parents = [k for k, branch in enumerate(self.branches) if branch.depth == level - 1]
            self._follow(list(self._switched(parents, level)))
        self.branches = with_order_changes(self.branches)

    def _start_of_orbit(self, orbit: Orbit, at: float) -> BranchStart | None:
        """The start of the branch through an orbit; None if Newton's method does not find the orbit again."""
        mapping, row = self.mapping.iterated(orbit.period), np.array([orbit.row])
        values = rows_of(self.values, row)
        complete = mapping.complete({**values, self.parameter: at}, 1)
        fixed = newton(mapping, orbit.points[[0]], complete, fix=self.fix)
        if not fixed.converged[0]:
            return None
        others = {name: column for name, column in complete.items() if name != self.parameter}
        conserved = mapping.images(fixed.points, complete).conserved_values if self.fix else np.zeros((1, 0))
        constraints = ConservedConstraints.of(mapping, self.fix, conserved)
        problem = ContinuationProblem.of(
            mapping, self.parameter, self.within, others, constraints, fixed.points, fixed.images
        )
        first = problem.first(fixed.points, fixed.drift, np.array([at]), 1.0)
        possible = {-1: at > problem.low, 1: at < problem.high}
        directions = tuple(sign for sign, inside in possible.items() if inside)
        return BranchStart(orbit.row, orbit.period, 0, None, problem, first, directions, orbit.points)

    def _switched(self, parents: Iterable[int], depth: int) -> Iterator[BranchStart]:
        """The starts of the branches that begin at the bifurcations of other branches."""
        for number in parents:
            branch = self.branches[number]
            for place, record in enumerate(branch.records):
                asides, period, problem = branch.aside(place), branch.period, branch.problem
                if record["special"] == "flip" and not record["end"]:
                    period = 2 * period
                    problem = dataclasses.replace(problem, mapping=self.mapping.iterated(period))
                    doubled = _doubled(problem, branch.point(place))
                    asides = iter([] if doubled is None else [doubled])
                for first in asides:
                    if not problem.low <= first.parameter[0] <= problem.high:
                        continue
                    values = problem.values_at(first.parameter)
                    (orbit,) = orbits_of(self.mapping, first.points, values, period)
                    if orbit is not None and len(orbit) == period:
                        yield BranchStart(
                            branch.row, period, depth, (number, place), problem, first, (0,), orbit
                        )

    def _follow(self, starts: list[BranchStart]) -> None:
        """Follow branches from their first points, but for those that other branches pass."""
        new = sorted(self._unpassed(starts), key=lambda start: start.period)
        followed: list[tuple[BranchStart, Branch]] = []
        for period, group in itertools.groupby(new, key=lambda start: start.period):
            of_period = list(group)
            halves = self._halves(of_period, period)
            for start, halves_of_start in zip(of_period, halves, strict=True):
                branch = Branch.of_halves(halves_of_start)
                followed.append((start, self._without_image(start, branch)))
        for start, branch in followed:
            if not self._unpassed([start]):
                continue
            if sum(known.row == branch.row for known in self.branches) < self.most_branches:
                self.branches.append(branch)
            elif not any(self._passes(known, start) for known in self._beyond):
                self._beyond.append(branch)

    def _unpassed(self, starts: Iterable[BranchStart]) -> list[BranchStart]:
        """The starts that no branch passes; an orbit of the search gets a record on one that passes it."""
        unpassed = []
        for start in starts:
            passing = next((branch for branch in self.branches if self._passes(branch, start)), None)
            if passing is None:
                unpassed.append(start)
            elif start.begins is None and not passing.has_point(start.first):
                place = passing.place_of(start.orbit, float(start.first.parameter[0]))
                if place is not None:  # else it passes an image of the orbit alone
                    passing.insert(place, record_of(start.problem, start.first))
        return unpassed

    def _passes(self, branch: Branch, start: BranchStart) -> bool:
        """Whether a branch passes the orbit of a first point or an image of it."""
        if (branch.row, branch.period) != (start.row, start.period):
            return False
        at = float(start.first.parameter[0])
        if branch.place_of(start.orbit, at) is not None:
            return True
        values = start.problem.values_at(start.first.parameter)
        images = self.mapping.mirrored(start.orbit, values).values()
        return any(branch.place_of(image, at) is not None for image in images)

    def _without_image(self, start: BranchStart, branch: Branch) -> Branch:
        """A branch without its part beyond a pitchfork at which it turns and becomes its image."""
        flat = FLAT * (branch.problem.high - branch.problem.low)

        def turning(branch: Branch) -> list[int]:
            inner = list(enumerate(branch.records))[1:-1]
            crosses = [(k, record["at"]) for k, record in inner if record["special"] in CROSSINGS]
            return [k for k, at in crosses if abs(at.tangent[0, -1]) <= flat]

        if branch.records[-1]["end"] == "closed" and turning(branch):
            branch = branch.begun_at(turning(branch)[-1])
        for place in turning(branch):
            beyond = branch.records[place + 1]["at"]
            at, values = float(beyond.parameter[0]), branch.problem.values_at(beyond.parameter)
            (orbit,) = orbits_of(self.mapping, beyond.points, values, branch.period)
            images = {} if orbit is None else self.mapping.mirrored(orbit, values)
            before, after = branch.part(0, place + 1), branch.part(place, len(branch.records))
            if any(before.place_of(image, at) is not None for image in images.values()):
                away = branch.problem.mapping.distance(start.first.points.at, branch.at)
                branch.records[place]["end"] = "pitchfork"
                return before if int(np.argmin(away)) <= place else after
        return branch

    def _halves(self, starts: Sequence[BranchStart], period: int) -> list[list[Branch]]:
        """The halves of branches of orbits of one period: one for each direction of each start."""
        directed = [(k, sign) for k, start in enumerate(starts) for sign in start.directions]
        if not directed:
            return [[] for _ in starts]
        problem = ContinuationProblem.joined([starts[k].problem for k, _ in directed])
        first = BranchPoints.joined([_directed(starts[k].first, sign) for k, sign in directed])
        table = branch_table(problem, first)
        follower = BranchFollower(problem, first, np.arange(len(directed)), table, self.steps)
        follower.follow()
        crossings: dict[int, list[BranchPoints | None]] = {}
        for crossing in follower.crossings:
            crossings.setdefault(crossing.branch, []).append(crossing.aside)
        halves: list[list[Branch]] = [[] for _ in starts]
        for number, (k, _) in enumerate(directed):
            of_half = problem[np.array([number])]
            half = self._half(starts[k], of_half, table.records(number), crossings.get(number, []))
            halves[k].append(half)
        return halves

    def _half(
        self,
        start: BranchStart,
        problem: ContinuationProblem,
        records: list[Record],
        crossings: list[BranchPoints | None],
    ) -> Branch:
        """The half with these records from a start, up to the flip of its parent if it ends there.

        `crossings` are the points on the crossing branches at each of its branch points, in order.
        """
        asides: dict[int, BranchPoints] = {}
        waiting = iter(crossings)
        halved = self._halved(problem, records, start.period)
        branch = Branch(start.row, start.period, start.depth, start.begins, problem, records, asides)
        for place, record in enumerate(records):
            special = record["special"]
            if special in CROSSINGS and (aside := next(waiting, None)) is not None:
                asides[place] = aside
            if special in MARKS:
                record["coefficient"] = coefficient(problem, record["at"], special)
            if halved[place] and not halved[:place].all():  # it may begin very close to its parent's flip
                asides.pop(place, None)
                if special in MARKS:
                    record |= {"special": "flip", "end": "flip", "coefficient": float("nan")}
                    return branch.part(0, place + 1)
                # a leap over a corner of the map led to the branch of half the period
                records[place - 1]["end"] = "lost"
                return branch.part(0, place)
        return branch

    def _halved(
        self, problem: ContinuationProblem, records: list[Record], period: int
    ) -> Bool[np.ndarray, " records"]:
        """Mask of the records (n,) of a branch whose orbits have half its period."""
        if period % 2:
            return np.zeros(len(records), bool)
        points = BranchPoints.joined([record["at"] for record in records])
        half = self.mapping.iterated(period // 2)
        images = half.images(points.points, problem[np.zeros(len(records), int)].values_at(points.parameter))
        return images.sound & (self.mapping.distance(points.points.at, images.points.at) < ON_BRANCH)

    def follow_curves(self, second: str, within: Sequence[float]) -> pd.DataFrame:
        """Follow the bifurcations of all branches in the plane of the parameter and a second one.

        Args:
            second: the name of the second parameter; its value at the branches is that of `values`.
            within: its range, two numbers.

        Returns:
            One record a point: row, curve, kind (fold, flip, neimark_sacker, branch_point), period, point,
            both parameters, the map's observables, multiplier_re and multiplier_im (of the critical one),
            unstable (how many others are outside the unit circle), special (a bifurcation of codimension 2),
            end. Point 0 is on a branch, and points below 0 are behind it.
        """
        plane = SecondParameter(second, float(min(within)), float(max(within)))
        records = plane_curves(self.mapping, self.branches, self.within, plane, self.steps)
        return in_terms_of_flow(self.mapping, pd.DataFrame(records))


def _directed(first: BranchPoints, sign: int) -> BranchPoints:
    """A first point (1,) whose tangent has the `sign` in the parameter; 0: as it is."""
    flipped = sign * first.tangent[0, -1] < 0.0
    return dataclasses.replace(first, tangent=-first.tangent if flipped else first.tangent)


def _doubled(problem: ContinuationProblem, flip: BranchPoints) -> BranchPoints | None:
    """A point on the branch of twice the period beside a flip (1,), with the tangent away from it."""
    tangent = np.zeros_like(problem.weights[0])
    tangent[: flip.points.at.shape[1]] = doubled_direction(flip)
    asides = (beside(problem, flip, [Way(flip.points, tangent)], length) for length in BESIDE_FLIP)
    return next((aside for aside in asides if aside is not None), None)
