"""The atlas of a map: all periodic orbits at one value of a parameter, their branches, and what these meet.

The orbits of a search are followed at once along the parameter. Where a branch has a flip, the branch of
twice the period is followed from there; where branches cross, the other one. What these meet is followed,
too, to a given depth. Branches that turn out to be one are joined, also if they are followed from other
points of the same orbits.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool

from gaitsweep.analysis.atlas.curves import BifurcationCurve, curve_through
from gaitsweep.analysis.atlas.event_orders import change_of_order, event_columns
from gaitsweep.analysis.atlas.order_curves import OrderChange
from gaitsweep.analysis.atlas.periodic_orbits import Orbit, OrbitSearch, orbits_of, polished, rows_of
from gaitsweep.analysis.continuation.arclength import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.bifurcation_tests import ahead
from gaitsweep.analysis.continuation.branch_points import CROSSINGS, FLAT, beside
from gaitsweep.analysis.continuation.continuation import ArclengthSteps, BranchFollower, BranchTable
from gaitsweep.analysis.continuation.flows import in_terms_of_flow
from gaitsweep.analysis.continuation.lockstep import in_lockstep
from gaitsweep.analysis.continuation.newton import ConservedConstraints, newton
from gaitsweep.analysis.continuation.normal_forms import coefficient, doubled_direction
from gaitsweep.analysis.continuation.stable_ranges import MARKS
from gaitsweep.engine.poincare.maps import Events, Map, Points, Values, sizes

# A point may lie beside the chord of a step by this share of its length, since a branch is bent.
BESIDE_CHORD = 0.3
# A point is on a branch if the branch passes it this closely, relative to its size.
ON_BRANCH = 1e-5
# Halvings of a step on which the order of events changes, and the most changes on one step.
BISECTIONS, MOST_CHANGES = 40, 8
# Distances beyond the end of a lost branch, relative to the coordinates, at which its events are read.
BEYOND_END = (1e-4, 1e-3, 1e-2)
# Lengths of the step from a flip to the branch of twice the period, the next where one does not converge: the
# next flip of a cascade is close.
BESIDE_FLIP = (1e-3, 1e-4, 1e-2, 1e-5)


@dataclasses.dataclass(frozen=True)
class Half:
    """A branch in one direction from its first point.

    `problem` has this branch alone; `records` are those of `BranchTable`, with their `BranchPoints` as `at`;
    `asides` the points on crossing branches by the place of the record where they cross.
    """

    problem: ContinuationProblem
    records: list[dict[str, Any]]
    asides: dict[int, BranchPoints]


@dataclasses.dataclass
class Branch:
    """A branch of periodic orbits of one row.

    Attributes:
        row: the row.
        period: the period of its orbits.
        depth: the number of bifurcations between it and an orbit of the search.
        begins: the branch and the record at whose bifurcation it begins; None: it leads through an orbit.
        problem: the continuation problem, of this branch alone.
        records: its points in order, as dictionaries; `at` has the `BranchPoints` of each.
        asides: points on crossing branches by the place of the record where they cross.
    """

    row: int
    period: int
    depth: int
    begins: tuple[int, int] | None
    problem: ContinuationProblem
    records: list[dict[str, Any]]
    asides: dict[int, BranchPoints]

    def __post_init__(self) -> None:
        points = [record["at"] for record in self.records]
        self.at = np.concatenate([point.points.at for point in points])
        self.parameter = np.concatenate([point.parameter for point in points])

    def place_of(self, points: Points, parameter: float) -> int | None:
        """The record after which it passes one of these points (n,) at a parameter's value, or None."""
        if len(self.records) < 2:
            return None
        size, mapping, weights = self.at.shape[1], self.problem.mapping, self.problem.weights[0]
        chords = np.concatenate(
            [mapping.difference(self.at[1:], self.at[:-1]), np.diff(self.parameter)[:, None]], axis=1
        )
        lengths = np.sqrt(chords[:, :size] ** 2 @ weights[:size] + weights[-1] * chords[:, -1] ** 2)
        for point in range(len(points)):
            away = np.concatenate(
                [
                    mapping.difference(points.at[point], self.at[:-1]),
                    (parameter - self.parameter[:-1])[:, None],
                ],
                axis=1,
            )
            scale = np.append(weights[:size], weights[-1])
            with np.errstate(divide="ignore", invalid="ignore"):
                share = np.nan_to_num((away * chords) @ scale / lengths**2)
            share = np.clip(share, 0.0, 1.0)
            beside_chord = np.sqrt(((away - share[:, None] * chords) ** 2) @ scale)
            for place in np.flatnonzero(beside_chord < BESIDE_CHORD * lengths + ON_BRANCH):
                if self._meets(int(place), points[[point]], parameter):
                    return int(place)
        return None

    def part(self, begin: int, end: int) -> Branch:
        """The records from `begin` to before `end`."""
        asides = {place - begin: aside for place, aside in self.asides.items() if begin <= place < end}
        return dataclasses.replace(self, records=self.records[begin:end], asides=asides)

    def begun_at(self, place: int) -> Branch:
        """The same closed branch, from another of its records on."""
        last = len(self.records) - 1
        records = [dict(record) for record in (*self.records[place:last], *self.records[: place + 1])]
        asides = {(k - place) % last: aside for k, aside in self.asides.items()}
        return dataclasses.replace(self, records=records, asides=asides)

    def insert(self, place: int, record: dict[str, Any]) -> None:
        """Insert a record after the one at a place."""
        self.records.insert(place + 1, record)
        self.asides = {k + (k > place): aside for k, aside in self.asides.items()}
        self.__post_init__()

    def _meets(self, place: int, point: Points, parameter: float) -> bool:
        """Whether the step after the record `place` passes a point (1,)."""
        ends = [self.records[place]["at"], self.records[place + 1]["at"]]
        size = point.at.shape[1]
        for end in ends:
            change = np.append(
                self.problem.mapping.difference(point.at, end.points.at)[0], parameter - end.parameter[0]
            )
            tangent = end.tangent[0]
            weights = self.problem.weights[0]
            length = weights[:size] * tangent[:size] @ change[:size]
            length += weights[-1] * tangent[-1] * change[-1]
            near, converged = self.problem.step(end, np.array([length]))
            apart = abs(near.parameter[0] - parameter) / (self.problem.high - self.problem.low)
            apart = max(apart, float(self.problem.mapping.distance(point.at, near.points.at)[0]))
            if converged[0] and apart < ON_BRANCH:
                return True
        return False


@dataclasses.dataclass(frozen=True)
class Beginning:
    """The first point of a branch that is to be followed.

    `directions` are the signs of the parameter's first change, or (0,) along the tangent of `first`.
    """

    row: int
    period: int
    depth: int
    begins: tuple[int, int] | None
    problem: ContinuationProblem
    first: BranchPoints
    directions: tuple[int, ...]
    orbit: Points


class Atlas:
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
        beginnings = [self._of_orbit(orbit, at) for orbit in search.orbits]
        self._follow([beginning for beginning in beginnings if beginning is not None])
        first = 0
        for level in range(1, depth + 1):
            parents, first = range(first, len(self.branches)), len(self.branches)
            self._follow(list(self._switched(parents, level)))

    def _of_orbit(self, orbit: Orbit, at: float) -> Beginning | None:
        mapping, row = self.mapping.iterated(orbit.period), np.array([orbit.row])
        values = rows_of(self.values, row)
        complete = mapping.complete({**values, self.parameter: at}, 1)
        fixed = newton(mapping, orbit.points[[0]], complete, fix=self.fix)
        if not fixed.converged[0]:
            return None
        others = {name: column for name, column in complete.items() if name != self.parameter}
        constraints = ConservedConstraints.of(mapping, self.fix, fixed.images.conserved_values)
        problem = ContinuationProblem.of(
            mapping, self.parameter, self.within, others, constraints, fixed.points.at
        )
        first = problem.first(fixed.points, fixed.drift, np.array([at]), 1.0)
        ways = tuple(sign for sign in (-1, 1) if (at > problem.low if sign < 0 else at < problem.high))
        return Beginning(orbit.row, orbit.period, 0, None, problem, first, ways, orbit.points)

    def _switched(self, parents: Iterable[int], depth: int) -> Iterable[Beginning]:
        """The branches that begin at the bifurcations of other branches."""
        for number in parents:
            branch = self.branches[number]
            for place, record in enumerate(branch.records):
                asides, period, problem = branch.asides.get(place), branch.period, branch.problem
                if record["special"] == "flip" and not record["end"]:
                    period = 2 * period
                    problem = dataclasses.replace(problem, mapping=self.mapping.iterated(period))
                    asides = _doubled(problem, record["at"])
                firsts = [] if asides is None else [asides[[k]] for k in range(len(asides.parameter))]
                for first in firsts:
                    if not problem.low <= first.parameter[0] <= problem.high:
                        continue
                    values = {**problem.values, self.parameter: first.parameter}
                    (orbit,) = orbits_of(self.mapping, first.points, values, period)
                    if orbit is not None and len(orbit) == period:
                        yield Beginning(
                            branch.row, period, depth, (number, place), problem, first, (0,), orbit
                        )

    def _follow(self, beginnings: list[Beginning]) -> None:
        """Follow branches from their first points, but for those that other branches pass."""
        new = [beginning for beginning in beginnings if not self._is_passed(beginning)]
        followed: list[tuple[Beginning, Branch]] = []
        order = sorted(range(len(new)), key=lambda k: new[k].period)
        for period, group in itertools.groupby(order, key=lambda k: new[k].period):
            of_period = [new[k] for k in group]
            halves = self._halves(of_period, period)
            for beginning, pieces in zip(of_period, halves, strict=True):
                followed.append((beginning, self._without_image(beginning, _branch(beginning, pieces))))
        for beginning, branch in followed:
            if self._is_passed(beginning):
                continue
            if sum(other.row == branch.row for other in self.branches) < self.most_branches:
                self.branches.append(branch)
            elif not self._is_passed(beginning, self._beyond):
                self._beyond.append(branch)

    def _without_image(self, beginning: Beginning, branch: Branch) -> Branch:
        """A branch without its part beyond a pitchfork at which it turns and becomes its image."""
        flat = FLAT * (branch.problem.high - branch.problem.low)

        def turning(branch: Branch) -> list[int]:
            turns = (abs(record["at"].tangent[0, -1]) <= flat for record in branch.records)
            crosses = (record["special"] in CROSSINGS for record in branch.records)
            both = enumerate(zip(turns, crosses, strict=True))
            return [k for k, (turned, crossed) in both if turned and crossed and 0 < k < len(branch.at) - 1]

        if branch.records[-1]["end"] == "closed" and turning(branch):
            branch = branch.begun_at(turning(branch)[-1])
        turned = len(branch.records) - 1
        for place in turning(branch):
            beyond = branch.records[place + 1]["at"]
            at, orbit = float(beyond.parameter[0]), self._orbit(branch, beyond)
            values = {**branch.problem.values, self.parameter: beyond.parameter}
            images = {} if orbit is None else self.mapping.mirrored(orbit, values)
            before, after = branch.part(0, place + 1), branch.part(place, turned + 1)
            if any(before.place_of(image, at) is not None for image in images.values()):
                away = branch.problem.mapping.distance(beginning.first.points.at, branch.at)
                kept = before if int(np.argmin(away)) <= place else after
                kept.records[-1 if kept is before else 0]["end"] = "pitchfork"
                return kept
        return branch

    def _is_passed(self, beginning: Beginning, branches: Sequence[Branch] | None = None) -> bool:
        """Whether one of all or of some branches passes a first point, or its image under a symmetry.

        A branch that passes an orbit of the search then has a point there.
        """
        at = float(beginning.first.parameter[0])
        values = {**beginning.problem.values, self.parameter: beginning.first.parameter}
        images = self.mapping.mirrored(beginning.orbit, values).values()
        for branch in self.branches if branches is None else branches:
            if (branch.row, branch.period) != (beginning.row, beginning.period):
                continue
            place = branch.place_of(beginning.orbit, at)
            if place is not None:
                if beginning.begins is None:
                    branch.insert(place, self._record(beginning.problem, beginning.first))
                return True
            if any(branch.place_of(image, at) is not None for image in images):
                return True
        return False

    def _record(self, problem: ContinuationProblem, at: BranchPoints) -> dict[str, Any]:
        """The record of one point of a branch."""
        table = _table(problem, at)
        table.write(np.zeros(1, int), problem, at, [""])
        return table.records(0)[0]

    def _halves(self, beginnings: Sequence[Beginning], period: int) -> list[list[Half]]:
        """The halves of branches of orbits of one period: of each beginning one in each of its directions."""
        of = [(k, sign) for k, beginning in enumerate(beginnings) for sign in beginning.directions]
        if not of:
            return [[] for _ in beginnings]
        problem = ContinuationProblem.joined([beginnings[k].problem for k, _ in of])
        first = BranchPoints.joined([_directed(beginnings[k].first, sign) for k, sign in of])
        names = np.arange(len(of))
        table = _table(problem, first)
        follower = BranchFollower(problem, first, names, table, self.steps)
        follower.follow()
        crossings: dict[int, list[tuple[BranchPoints, BranchPoints | None]]] = {}
        for name, here, aside in follower.crossings:
            crossings.setdefault(name, []).append((here, aside))
        halves: list[list[Half]] = [[] for _ in beginnings]
        for name, (k, _) in enumerate(of):
            own = problem[np.array([name])]
            records, asides = self._of_half(own, table.records(name), crossings.get(name, []), period)
            halves[k].append(Half(own, records, asides))
        return halves

    def _of_half(
        self,
        problem: ContinuationProblem,
        records: list[dict[str, Any]],
        crossings: list[tuple[BranchPoints, BranchPoints | None]],
        period: int,
    ) -> tuple[list[dict[str, Any]], dict[int, BranchPoints]]:
        """The records of a half up to the flip of its parent, if it ends there, and the crossing branches."""
        asides: dict[int, BranchPoints] = {}
        waiting = list(crossings)
        halved = self._halved(problem, records, period)
        for place, record in enumerate(records):
            special = record["special"]
            if special in CROSSINGS and waiting:
                _, aside = waiting.pop(0)
                if aside is not None:
                    asides[place] = aside
            if special in MARKS:
                record["coefficient"] = coefficient(problem, record["at"], special)
            if halved[place] and not halved[:place].all():  # it may begin very close to its parent's flip
                asides.pop(place, None)
                if special in MARKS:
                    record |= {"special": "flip", "end": "flip", "coefficient": float("nan")}
                    return records[: place + 1], asides
                # a leap over a corner of the map led to the branch of half the period
                records[place - 1]["end"] = "lost"
                return records[:place], asides
        return records, asides

    def _halved(
        self, problem: ContinuationProblem, records: list[dict[str, Any]], period: int
    ) -> Bool[np.ndarray, " records"]:
        """Which records (n,) of a branch have orbits of half its period."""
        if period % 2:
            return np.zeros(len(records), bool)
        points = BranchPoints.joined([record["at"] for record in records])
        values = problem[np.zeros(len(records), int)].values
        half = self.mapping.iterated(period // 2)
        images = half.images(points.points, {**values, self.parameter: points.parameter})
        return images.sound & (self.mapping.distance(points.points.at, images.points.at) < ON_BRANCH)

    def follow_curves(
        self, second: str, within: Sequence[float], steps: ArclengthSteps | None = None
    ) -> pd.DataFrame:
        """Follow the bifurcations of all branches in the plane of the parameter and a second one.

        Args:
            second: the name of the second parameter; its value at the branches is that of `values`.
            within: its range, two numbers.
            steps: lengths and number of the steps.

        Returns:
            One record a point: row, curve, kind (fold, flip, neimark_sacker, branch_point), period, point,
            both parameters, the map's observables, multiplier_re and multiplier_im (of the critical one),
            unstable (how many others are outside the unit circle), special (a bifurcation of codimension 2),
            end. Point 0 is on a branch, and points below 0 are behind it.
        """
        low, high = float(min(within)), float(max(within))
        candidates = [
            (branch, record)
            for branch in self.branches
            for record in branch.records
            if record["special"] in MARKS and record["special"] != "corner" and not record["end"]
        ]
        followed = in_lockstep(
            [
                curve_through(
                    branch.problem,
                    record["at"],
                    record["special"],
                    (second, low, high, float(np.ravel(branch.problem.values[second])[0])),
                    steps or ArclengthSteps(),
                )
                for branch, record in candidates
            ]
        )
        curves: list[BifurcationCurve] = []
        for (branch, record), curve in zip(candidates, followed, strict=True):
            orbit = None if curve is None else self._orbit(branch, record["at"])
            if curve is None or orbit is None:
                continue
            place, kind = float(record["at"].parameter[0]), record["special"]
            values = {**branch.problem.values, self.parameter: record["at"].parameter}
            images = [orbit, *self.mapping.mirrored(orbit, values).values()]
            if not any(known.passes(branch.row, kind, image, place) for known in curves for image in images):
                curves.append(dataclasses.replace(curve, row=branch.row, period=branch.period))
        records = []
        rows = [curve.row for curve in curves]
        for place, curve in enumerate(curves):
            head = {"row": curve.row, "curve": rows[:place].count(curve.row), "kind": curve.equations.kind}
            head["period"] = curve.period
            records += [{**head, **apart(record, head)} for record in curve.records()]
        records += self._order_curves(second, (low, high), Counter(rows))
        return in_terms_of_flow(self.mapping, pd.DataFrame(records))

    def _order_curves(
        self, second: str, within: tuple[float, float], numbers: Counter[int]
    ) -> Iterator[dict[str, Any]]:
        """The records of the curves on which the order of events changes, after the `numbers` of others."""
        known: list[tuple[int, int, float, Points]] = []
        places = [(branch, record) for branch in self.branches for record in branch.records]
        for branch, record in places:
            if record["special"] != "order_change":
                continue
            at, problem = record["at"], branch.problem
            place, orbit = float(at.parameter[0]), self._orbit(branch, at)
            values = {**problem.values, self.parameter: at.parameter}
            images = [] if orbit is None else [orbit, *self.mapping.mirrored(orbit, values).values()]
            if any(
                (row, period) == (branch.row, branch.period)
                and abs(there - place) < ON_BRANCH * (problem.high - problem.low)
                and min(np.min(self.mapping.distance(image.at, point.at)) for image in images) < ON_BRANCH
                for row, period, there, point in known
            ):
                continue
            known.append((branch.row, branch.period, place, at.points))
            names = [self.mapping.conserved[k].name for k in problem.held.which]
            mapping, here = self.mapping.iterated(branch.period), float(np.ravel(problem.values[second])[0])
            change = OrderChange(
                mapping=mapping,
                parameter=self.parameter,
                second=second,
                within=(self.within, within),
                values={name: value for name, value in problem.values.items() if name != second},
                fix=dict(zip(names, problem.held.values.T, strict=True)),
                point=at.points,
                here=(place, here),
                events=mapping.events(at.points, values)[0],
                change=record["change"],
            )
            head = {"row": branch.row, "kind": "order_change", "period": branch.period}
            head |= {"curve": numbers[branch.row], "change": record["change"]}
            curve = change.curve()
            numbers[branch.row] += bool(curve)
            yield from ({**head, **apart(point, head)} for point in curve)

    def _orbit(self, branch: Branch, at: BranchPoints) -> Points | None:
        """The points of the orbit at one point of a branch."""
        values = {**branch.problem.values, self.parameter: at.parameter}
        return orbits_of(self.mapping, at.points, values, branch.period)[0]

    def table(self, search: OrbitSearch, at: float) -> pd.DataFrame:
        """One record a point of a branch.

        Args:
            search: the search whose orbits were followed.
            at: the value of the parameter there.

        Returns:
            row, branch, period, depth, begins (the branch at whose bifurcation it begins; -1: it leads
            through an orbit of the search), and the columns of `continuation`, with `coefficient`, the normal
            form's; missing (`OrbitSearch.missing`), and where the parameter is `at`: found (how many searches
            found the orbit; 0: its branch alone leads there; -1 at other points), reached, error and symmetry
            of an `Orbit`; `event_columns`, and change (what changes in the order of events at a corner).
        """
        records: list[dict[str, Any]] = []
        numbers, events = self._numbers(), self._events()
        for branch, orders in zip(self.branches, events, strict=True):
            self._mark_changes(branch, orders)
        listed: dict[int, list[Points]] = {}  # the gaits of each row that have a record, with their images
        for branch, number, orders in zip(self.branches, numbers, events, strict=True):
            begins = -1 if branch.begins is None else numbers[branch.begins[0]]
            missing = search.missing(branch.row)
            for place, record in enumerate(branch.records):
                head = {"row": branch.row, "branch": number, "point": place, "period": branch.period}
                head |= {"depth": branch.depth, "begins": begins, "coefficient": float("nan"), "found": -1}
                head |= {"reached": float("nan"), "error": float("nan"), "missing": missing, "symmetry": ""}
                head |= {"change": "", **event_columns(orders[place])}
                rest = apart({k: v for k, v in record.items() if k not in ("row", "point", "at")}, head)
                if record[self.parameter] == at and not record["special"]:
                    rest |= self._gait(search, branch, record["at"], listed.setdefault(branch.row, []))
                records.append({**head, **rest})
        return in_terms_of_flow(self.mapping, pd.DataFrame(records))

    def _events(self) -> list[list[Events]]:
        """The events of the gait at each point of each branch."""
        events: list[list[Events]] = [[] for _ in self.branches]
        for period in {branch.period for branch in self.branches}:
            places = [k for k, branch in enumerate(self.branches) if branch.period == period]
            branches = [self.branches[k] for k in places]
            points = [(branch.problem, record["at"]) for branch in branches for record in branch.records]
            problem = ContinuationProblem.joined([problem for problem, _ in points])
            at = BranchPoints.joined([at for _, at in points])
            values = {**problem.values, self.parameter: at.parameter}
            found = iter(self.mapping.iterated(period).events(at.points, values))
            for k in places:
                events[k] = [next(found) for _ in self.branches[k].records]
        return events

    def _mark_changes(self, branch: Branch, events: list[Events]) -> None:
        """Add a record to a branch where its order of events changes, and that record's events."""
        for place, inner in ((0, 1), (-1, -2)):
            if branch.records[place]["end"] == "lost" and len(events) > 1:
                branch.records[place]["change"] = self._change_beyond(branch, place, inner, events[place])
        for place in range(len(events) - 1, 0, -1):
            change = change_of_order(events[place - 1], events[place])
            if not change:
                continue
            before, after = branch.records[place - 1], branch.records[place]
            corner = next((record for record in (before, after) if record["special"] == "corner"), None)
            if corner is not None:
                corner["change"] = change
                continue
            # several changes may lie on one step
            begin, own, target = before["at"], events[place - 1], events[place]
            for added in range(MOST_CHANGES):
                if not change_of_order(own, target):
                    break
                located = self._last_before(branch, begin, after["at"], own)
                if located is None:
                    after["change"] = change_of_order(own, target)
                    break
                (at, last), (begin, own) = located
                change = {"special": "order_change", "change": change_of_order(last, own)}
                branch.insert(place - 1 + added, self._record(branch.problem, at) | change)
                events.insert(place + added, last)

    def _change_beyond(self, branch: Branch, place: int, inner: int, events: Events) -> str:
        """The change in the order of events just beyond an end at which a branch is lost, if anything.

        The points beyond it lie on the line through the record `place` at the end and the record `inner`.
        """
        end, before = branch.records[place]["at"], branch.records[inner]["at"]
        problem, mapping = branch.problem, self.mapping.iterated(branch.period)
        ahead_of_end = problem.mapping.difference(end.points.at, before.points.at)
        length = np.linalg.norm(ahead_of_end / sizes(end.points.at))
        for step in BEYOND_END:
            share = step / length if length > 0.0 else 0.0
            points = Points(end.points.at + share * ahead_of_end, end.points.modes)
            parameter = end.parameter + share * (end.parameter - before.parameter)
            beyond = mapping.events(points, {**problem.values, self.parameter: parameter})[0]
            if beyond and (change := change_of_order(events, beyond)):
                return change
        return ""

    def _last_before(
        self, branch: Branch, begin: BranchPoints, end: BranchPoints, events: Events
    ) -> tuple[tuple[BranchPoints, Events], tuple[BranchPoints, Events]] | None:
        """The last point (1,) of a step with the order of events of its first, and the first point beyond it.

        Each has its events; None if no point beyond it was found.
        """
        mapping, problem = self.mapping.iterated(branch.period), branch.problem
        low, high = 0.0, float(ahead(problem, begin, end))
        last, beyond = (begin, events), None
        for _ in range(BISECTIONS):
            length = 0.5 * (low + high)
            near, converged = problem.step(begin, np.array([length]))
            own: Events = []
            if converged[0]:
                own = mapping.events(near.points, {**problem.values, self.parameter: near.parameter})[0]
            if own and not change_of_order(events, own):
                low, last = length, (near, own)
            else:
                high, beyond = length, (near, own) if own else None
        return None if beyond is None else (last, beyond)

    def _numbers(self) -> list[int]:
        """The number of each branch among those of its row."""
        rows = [branch.row for branch in self.branches]
        return [rows[:place].count(row) for place, row in enumerate(rows)]

    def _gait(
        self, search: OrbitSearch, branch: Branch, at: BranchPoints, listed: list[Points]
    ) -> dict[str, Any]:
        """Facts about the orbit at a point of a branch; none if it or an image of it is `listed`."""
        if any(np.min(self.mapping.distance(gait.at, at.points.at)) < ON_BRANCH for gait in listed):
            return {}
        values = {**branch.problem.values, self.parameter: at.parameter}
        images = self.mapping.mirrored(at.points, values).values()
        own = np.concatenate([at.points.at, *(image.at for image in images)])
        near = [np.min(self.mapping.distance(orbit.points.at[:, None], own)) for orbit in search.orbits]
        known = [
            (distance, orbit)
            for distance, orbit in zip(near, search.orbits, strict=True)
            if (orbit.row, orbit.period) == (branch.row, branch.period) and distance < ON_BRANCH
        ]
        if known:
            away, orbit = min(known, key=lambda pair: pair[0])
        else:
            row = np.array([branch.row])
            (orbit,) = polished(self.mapping, at.points, row, values, branch.period, self.fix)
            if orbit is None:
                return {"found": 0}
            away = np.min(self.mapping.distance(orbit.points.at, at.points.at))
        listed += [orbit.points, *self.mapping.mirrored(orbit.points, values).values()]
        return {
            "found": orbit.hits,
            "reached": orbit.reached,
            "error": max(orbit.error, float(away)),
            "symmetry": ", ".join(orbit.symmetry),
        }


def apart(record: dict[str, Any], head: dict[str, Any]) -> dict[str, Any]:
    """A record whose observables with the name of a column of `head` end in _n, as in a job's table."""
    own = ("coefficient", "change")  # which the record itself may have
    return {f"{k}_n" if k in head and k not in own else k: v for k, v in record.items()}


def _table(problem: ContinuationProblem, first: BranchPoints) -> BranchTable:
    """The table of branches (n,) from their first points, with the `BranchPoints` of each record."""
    n, observed = len(first.parameter), list(first.images.observed)
    return BranchTable(problem.mapping, problem.parameter, {}, observed, n, problem.held, with_points=True)


def _directed(first: BranchPoints, sign: int) -> BranchPoints:
    """A first point (1,) whose tangent has the `sign` in the parameter; 0: as it is."""
    flipped = sign * first.tangent[0, -1] < 0.0
    return dataclasses.replace(first, tangent=-first.tangent if flipped else first.tangent)


def _doubled(problem: ContinuationProblem, flip: BranchPoints) -> BranchPoints | None:
    """A point on the branch of twice the period beside a flip (1,), with the tangent away from it."""
    scale = np.zeros_like(problem.weights[0])
    size = flip.points.at.shape[1]
    scale[:size] = doubled_direction(flip)
    for length in BESIDE_FLIP:
        aside = beside(problem, flip, [(flip.points, scale)], length)
        if aside is not None:
            return aside
    return None


def _branch(beginning: Beginning, halves: list[Half]) -> Branch:
    """The branch of one or two halves: the first one is reversed."""
    # a closed branch is followed as a whole in either direction
    if len(halves) == 2 and halves[1].records[-1]["end"] == "closed":
        halves = halves[1:]
    if len(halves) == 2:
        back, ahead = halves
        last = len(back.records) - 1
        reversed_records = [dict(record) for record in back.records[:0:-1]]
        # a kink marks the step that leads to its record
        for k in range(len(reversed_records) - 1, -1, -1):
            if reversed_records[k]["special"] == "kink":
                reversed_records[k]["special"] = ""
                after = reversed_records[k + 1] if k + 1 < len(reversed_records) else ahead.records[0]
                after["special"] = after["special"] or "kink"
        asides = {last - place: aside for place, aside in back.asides.items()}
        asides |= {last + place: aside for place, aside in ahead.asides.items()}
        records = [*reversed_records, *ahead.records]
    else:
        asides, records = halves[0].asides, halves[0].records
    problem = halves[0].problem
    return Branch(
        beginning.row, beginning.period, beginning.depth, beginning.begins, problem, records, asides
    )
