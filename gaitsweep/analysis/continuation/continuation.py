"""Pseudo-arclength continuation of fixed points, stable and unstable, over a parameter.

Many branches are followed at once to their ends, each with its own other parameters and its own step lengths;
bifurcations are located, and jumps of the map are crossed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Complex, Float, Int

from gaitsweep.analysis.continuation.arclength import BranchPoints, ContinuationProblem, Converged, PerBranch
from gaitsweep.analysis.continuation.bifurcation_tests import (
    TESTS,
    TOGETHER,
    Special,
    ahead,
    bifurcations,
    hides_two_zeros,
    multipliers_of,
    test_values,
)
from gaitsweep.analysis.continuation.branch_points import CROSSINGS, IMPERFECT, branch_point
from gaitsweep.analysis.continuation.flows import in_terms_of_flow
from gaitsweep.analysis.continuation.newton import ConservedConstraints, NewtonOutcome, newton
from gaitsweep.analysis.continuation.normal_forms import coefficient, critical_multiplier
from gaitsweep.engine.poincare.maps import Map, Points, Values
from gaitsweep.engine.poincare.stationary_map import StationaryMap, eigenvalues
from gaitsweep.errors import ArgumentError

# Least cosine of the angle by which a branch turns in a step; most corrections of a step after which the next
# one is longer; factors of longer and shorter steps.
STRAIGHT, FEW = 0.95, 6
LONGER, SHORTER = 1.4, 0.5
# A branch is closed where it passes its start within this share of a step, after more than so many points.
NEAR_HOME, AWAY = 0.75, 4
# A branch that no shortest step leads on ends at a branch point that is within so many of these steps.
AT_END = 4.0
# Largest share of its way that a branch counts as done while it is followed.
NEARLY = 0.95
# Shares of the longest step that are tried to jump over a discontinuity, where no short step converges.
JUMPS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)
# Columns of each point of a branch, beside its parameters, observables and drifts.
_OF_POINT = (
    *("multiplier", "multiplier_re", "multiplier_im", "unstable", "stable"),
    *("special", "corrections", "end"),
)


@dataclasses.dataclass(frozen=True)
class ArclengthSteps:
    """Lengths of the first, the longest and the shortest arclength step, and the most points of a branch.

    In a length, the parameter is a share of its range, and coordinates are relative to their magnitudes.
    Each branch has a point at every value of the parameter in `through` that it passes.
    `on_progress` is called before each step with the number of points of each branch (n,), and the share of
    the parameter's range along which it was followed (n,), 1 at its end; an exception that it raises stops
    the continuation.
    """

    first: float = 0.02
    longest: float = 0.08
    shortest: float = 1e-4
    most: int = 300
    on_progress: Callable[[Any, Any], None] = lambda points, shares: None
    through: tuple[float, ...] = ()


def continuation(
    mapping: Map,
    starts: Points,
    values: Values,
    *,
    parameter: str,
    within: Sequence[float],
    begin: Any = None,
    towards: int = 1,
    fix: Sequence[str] | Mapping[str, object] = (),
    steps: ArclengthSteps | None = None,
    shown: Sequence[str] | None = None,
    with_points: bool = False,
    crossing: bool = False,
) -> pd.DataFrame:
    """Follow the branches of fixed points through n starts.

    Args:
        mapping: a return map, or any other.
        starts: points near fixed points.
        values: other parameters, numbers or one for each start (n,).
        parameter: the name of the continuation parameter.
        within: its range, two numbers.
        begin: its values at the starts, a number or (n,); by default the end of the range from which
            `towards` leads away.
        towards: 1 or -1, the direction of the parameter in which a branch starts.
        fix: conserved quantities to constrain, as for `newton`.
        steps: lengths and number of the steps.
        shown: names of the values in the table beside the parameter; by default all.
        with_points: whether each record has its `BranchPoints` (of one point) as `at`.
        crossing: whether the branches that cross at branch points are followed, too, in both directions. Then
            `branch` numbers the branches of a row, 0 through its start, and `point` leaves out one number
            before each other.

    Returns:
        One record a point: row (of the start), point, parameter and other values, the map's observables,
        drift_NAME of each constrained quantity, multiplier (the largest modulus; multiplier_re and
        multiplier_im are its parts), unstable (the number of multipliers outside the unit circle, without
        those that cross it at this point), stable, special, corrections, end.
        `special` is fold, flip, neimark_sacker, transcritical, supercritical_pitchfork (the branch that turns
        exists where one more multiplier of the other is outside the unit circle), subcritical_pitchfork
        (where one fewer is), or branch_point (where two branches cross in another way, or several multipliers
        are 1 at once). Where the map has a corner along the branch, its halves on both sides decide: a
        pitchfork if they are on one side of the parameter, transcritical if on two, else branch_point.
        corner: a fold at a corner of the map, where no multiplier is 1; kink: a step over a corner or a jump
        of the map; or empty.
        A branch that ends as lost, or has a kink, is followed again on the refined map (half the time step),
        and the result of that is returned: so neither is an artefact of the time step alone.
        `end` is the reason why the branch ends: range, closed, most, lost (no step converges, or the map is
        not defined beyond), not_found (with `crossing`: half a branch that crosses here was not found; this
        is its only point), or a `NewtonOutcome` where no fixed point was found at the start; or empty.

        Stationary points (a `StationaryMap`) have columns and names of flows instead, as of
        `in_terms_of_flow`, with `coefficient`, that of the normal form (`normal_forms`).

    Raises:
        ValueError: the map does not have a name that is given, or the range has no width.
    """
    if not max(within) > min(within):
        raise ArgumentError(f"within is {list(within)}, but must be a range of two different numbers.")

    def followed(mapping: Map, starts: Points, values: Values, begin: Any, fix: Any) -> pd.DataFrame:
        n = len(starts)
        at = np.broadcast_to(np.asarray(begin, np.float64), (n,)).copy()
        held_values = mapping.complete({**values, parameter: at}, n)
        others = {name: column for name, column in held_values.items() if name != parameter}
        fixed = newton(mapping, starts, held_values, fix=fix)
        constraints = ConservedConstraints.of(mapping, fix, fixed.images.conserved_values)
        ready = np.flatnonzero(fixed.converged)
        problem = ContinuationProblem.of(mapping, parameter, within, others, constraints, fixed.points.at)[
            ready
        ]
        columns = {name: np.asarray(values[name]) for name in (values if shown is None else shown)}
        table = BranchTable(
            mapping, parameter, columns, list(fixed.images.observed), n, constraints, with_points, crossing
        )
        for row in np.flatnonzero(~fixed.converged):
            table.failed(int(row), float(at[row]), NewtonOutcome(int(fixed.outcome[row])).name)
        if ready.size:
            branch_points = problem.first(
                fixed.points[ready], fixed.drift[ready], at[ready], float(np.sign(towards))
            )
            follower = BranchFollower(problem, branch_points, ready, table, steps or ArclengthSteps())
            follower.follow()
            across = follower.crossing() if crossing else None
            if across is not None:
                across.follow()
        return table.table()

    if begin is None:
        begin = min(within) if towards > 0 else max(within)
    branches = followed(mapping, starts, values, begin, fix)
    refined = mapping.refined()
    if branches.empty or refined is None:
        return branches
    doubtful = branches.loc[(branches["end"] == "lost") | (branches["special"] == "kink"), "row"].unique()
    if not doubtful.size:
        return branches
    n = len(starts)

    def only(value: Any) -> Any:
        return np.broadcast_to(np.asarray(value, np.float64), (n,))[doubtful]

    again = followed(
        refined,
        starts[doubtful],
        {name: only(value) for name, value in values.items()},
        only(begin),
        {name: only(value) for name, value in fix.items()} if isinstance(fix, Mapping) else fix,
    )
    again["row"] = doubtful[np.asarray(again["row"])]
    sure = branches[~branches["row"].isin(doubtful)]
    both = again if sure.empty else pd.concat([sure, again])
    return both.iloc[np.argsort(np.asarray(both["row"]), kind="stable")].reset_index(drop=True)


class BranchTable:
    """Collects one record for each point of n branches.

    Args:
        mapping, parameter: the map and the continuation parameter.
        values: other parameters shown in the records, a number or one for each branch (n,).
        observed: the names of the map's observables.
        n: number of branches.
        constraints: the conserved quantities that are constrained.
        with_points: each record has its `BranchPoints` of one point as `at`.
        crossing: records have the number of their `branch`, since a row may have several.
    """

    def __init__(
        self,
        mapping: Map,
        parameter: str,
        values: dict[str, Float[np.ndarray, " ..."]],
        observed: Sequence[str],
        n: int,
        constraints: ConservedConstraints,
        with_points: bool = False,
        crossing: bool = False,
    ) -> None:
        self._mapping, self.parameter, self._with_points = mapping, parameter, with_points
        self._values = {k: np.broadcast_to(v, (n,)) for k, v in values.items() if k != parameter}
        self._observed, self._held = list(observed), [mapping.conserved[k].name for k in constraints.which]
        self._records: list[list[dict[str, Any]]] = [[] for _ in range(n)]
        self._crossing, self._rows, self._branches, self._next = crossing, [*range(n)], [0] * n, [1] * n

    def added(self, name: int) -> int:
        """The name of a further branch of the row that the branch `name` belongs to."""
        row = self._rows[name]
        self._rows.append(row)
        self._branches.append(self._next[row])
        self._next[row] += 1
        self._records.append([])
        return len(self._records) - 1

    def counts(self, rows: Int[np.ndarray, " rows"]) -> Int[np.ndarray, " rows"]:
        return np.array([len(self._records[row]) for row in rows])

    def records(self, name: int) -> list[dict[str, Any]]:
        """The records of one branch."""
        return self._records[name]

    def end(self, rows: Int[np.ndarray, " rows"], why: str) -> None:
        for row in rows:
            self._records[row][-1]["end"] = why

    def failed(self, row: int, parameter: float, why: str) -> None:
        self._records[row].append({**self._head(row, parameter), "end": why})

    def _head(self, name: int, parameter: float) -> dict[str, Any]:
        row, branch = self._rows[name], {"branch": self._branches[name]} if self._crossing else {}
        others = {other: column[row] for other, column in self._values.items()}
        return {"row": row, "point": len(self._records[name]), **branch, self.parameter: parameter, **others}

    def write(
        self,
        rows: Int[np.ndarray, " rows"],
        problem: ContinuationProblem,
        branch_points: BranchPoints,
        special: Sequence[str],
        *,
        tolerance: float = 0.0,
    ) -> None:
        """Add a record for each of n branches; multipliers outside by `tolerance` count as unstable."""
        if not len(rows):
            return
        factors = multipliers_of(problem, branch_points)
        for k, row in enumerate(rows):
            unstable = int(np.sum(np.abs(factors[k]) > 1.0 + tolerance))
            self._records[row].append(
                {
                    **self._head(int(row), float(branch_points.parameter[k])),
                    **{name: float(column[k]) for name, column in branch_points.images.observed.items()},
                    **{f"drift_{name}": branch_points.drift[k, i] for i, name in enumerate(self._held)},
                    "multiplier": float(np.abs(factors[k, 0])),
                    "multiplier_re": float(factors[k, 0].real),
                    "multiplier_im": float(factors[k, 0].imag),
                    "unstable": unstable,
                    "stable": unstable == 0,
                    "special": special[k],
                    "corrections": int(branch_points.corrections[k]),
                    "end": "",
                    **({"at": branch_points[[k]]} if self._with_points else {}),
                    **_of_flow(problem[np.array([k])], branch_points[[k]], factors[k], special[k]),
                }
            )

    def table(self) -> pd.DataFrame:
        """All records; the columns are the same where no branch has a fixed point."""
        branch = ["branch"] if self._crossing else []
        head = ("row", "point", *branch, self.parameter, *self._values, *self._observed)
        drifts = (f"drift_{name}" for name in self._held)
        columns = [*head, *drifts, *_OF_POINT, *(["at"] if self._with_points else [])]
        columns += ["coefficient", "hopf_frequency"] if isinstance(self._mapping, StationaryMap) else []
        table = pd.DataFrame([record for branch in self._records for record in branch], columns=columns)
        table = in_terms_of_flow(self._mapping, table)
        if not self._crossing:
            return table
        table = table.sort_values(["row", "branch", "point"], kind="stable", ignore_index=True)
        # one number is left out before each further branch
        table["point"] = table.groupby("row").cumcount() + table["branch"]
        return table


def _of_flow(
    problem: ContinuationProblem,
    at: BranchPoints,
    factors: Complex[np.ndarray, " multipliers"],
    special: str,
) -> dict[str, float]:
    """Columns of one stationary point (1,): the normal form's coefficient, and a Hopf point's frequency."""
    if not isinstance(problem.mapping, StationaryMap):
        return {}
    record = {"coefficient": coefficient(problem, at, special), "hopf_frequency": float("nan")}
    if special == "neimark_sacker":
        pair = np.array([critical_multiplier(factors, special)])
        record["hopf_frequency"] = float(np.imag(eigenvalues(pair, at.images.observed["time"]))[0])
    return record


class BranchFollower:
    """Follows n branches from their first fixed points to their ends.

    Args:
        problem: the continuation problem.
        branch_points: the first fixed point of each branch.
        names: (n,) the row of each branch in the table.
        table: the table that collects the points.
        steps: the step lengths.

    `crossings` has, for each branch point, the place of its branch, the point (1,), and points on the halves
    of the branch that crosses, if any.
    """

    def __init__(
        self,
        problem: ContinuationProblem,
        branch_points: BranchPoints,
        names: Int[np.ndarray, " branches"],
        table: BranchTable,
        steps: ArclengthSteps,
    ) -> None:
        self.problem, self.names, self.table, self.steps = problem, names, table, steps
        self.home = self.branch_points = branch_points
        self.length = np.full(len(names), steps.first)
        self.going = np.ones(len(names), bool)
        # the test functions at the beginning of the last step of each branch, and its length
        self.tests_before = np.full((len(names), len(TESTS)), np.nan)
        self.length_before = np.ones(len(names))
        self.crossings: list[tuple[int, BranchPoints, BranchPoints | None]] = []
        table.write(names, problem, branch_points, [""] * len(names))

    def follow(self) -> None:
        """Follow each branch to its end."""
        while self.going.any():
            moved = np.abs(self.branch_points.parameter - self.home.parameter)
            shares = np.minimum(moved / (self.problem.high - self.problem.low), NEARLY)
            self.steps.on_progress(self.table.counts(self.names), np.where(self.going, shares, 1.0))
            rows = np.flatnonzero(self.going)
            problem, before = self.problem[rows], self.branch_points[rows]
            after, converged = problem.step(before, self.length[rows])
            straight = np.sum(problem.weights * before.tangent * after.tangent, axis=1) > STRAIGHT
            accepted = converged & (straight | (self.length[rows] <= self.steps.shortest))
            specials = self._specials(rows, before, after, accepted)
            accepted = np.array([special is not None for special in specials], bool)
            self._reject(rows[~accepted])
            if accepted.any():
                their_specials = [special for special in specials if special is not None]
                self._accept(rows[accepted], after[accepted], their_specials)

    def _specials(
        self,
        rows: Int[np.ndarray, " rows"],
        before: BranchPoints,
        after: BranchPoints,
        accepted: Bool[np.ndarray, " rows"],
    ) -> list[list[Special] | None]:
        """The bifurcations on each of some steps; None where it is not `accepted`, or has to be shorter.

        Where a step cannot be shortened, several multipliers cross at one place: it is a branch point.
        """
        specials: list[list[Special] | None] = [None] * rows.size
        on = np.flatnonzero(accepted)
        if not on.size:
            return specials
        first, last = (test_values(self.problem[rows[on]], points[on]) for points in (before, after))
        length = self.length[rows]
        shortest = length * SHORTER < self.steps.shortest
        hidden = hides_two_zeros(
            self.tests_before[rows[on]], first, last, self.length_before[rows[on]], length[on]
        )
        searched = np.flatnonzero(~hidden | shortest[on])
        on, first, last = on[searched], first[searched], last[searched]
        located = bifurcations(self.problem[rows[on]], before[on], after[on], length[on], first, last)
        for k, own, values in zip(on, located, first, strict=True):
            if own is None and shortest[k]:
                own = [Special("branch_point", float(length[k]), after[[k]])]
            specials[k] = own
            if own is not None:
                self.tests_before[rows[k]], self.length_before[rows[k]] = values, length[k]
        return specials

    def crossing(self) -> BranchFollower | None:
        """A follower of both halves of each branch that crosses at a branch point; None if there is none.

        A half that was not found has the branch point as its only point.
        """
        of, names, asides = [], [], []
        for row, here, aside in self.crossings:
            halves = 0 if aside is None else len(aside.parameter)
            of += [row] * halves
            names += [self.table.added(int(self.names[row])) for _ in range(halves)]
            asides += [] if aside is None else [aside]
            for _ in range(2 - halves):
                name = np.array([self.table.added(int(self.names[row]))])
                self.table.write(name, self.problem[np.array([row])], here, [""], tolerance=TOGETHER)
                self.table.end(name, "not_found")
        if not of:
            return None
        both = BranchPoints.joined(asides)
        return BranchFollower(self.problem[np.array(of)], both, np.array(names), self.table, self.steps)

    def _passed(
        self, problem: ContinuationProblem, before: BranchPoints, after: BranchPoints
    ) -> list[list[Special]]:
        """The points of steps at the values of the parameter that each branch has to have."""
        passed: list[list[Special]] = [[] for _ in before.parameter]
        for value in self.steps.through:
            rows = np.flatnonzero((before.parameter - value) * (after.parameter - value) < 0.0)
            if rows.size:
                there, converged = problem[rows].at(before[rows], np.full(rows.size, value))
                for k in np.flatnonzero(converged):
                    here = there[[k]]
                    passed[rows[k]].append(
                        Special("", ahead(problem[rows[[k]]], before[rows[[k]]], here), here)
                    )
        return passed

    def _end(self, rows: Int[np.ndarray, " rows"], why: str) -> None:
        self.table.end(self.names[rows], why)
        self.going[rows] = False

    def _reject(self, rows: Int[np.ndarray, " rows"]) -> None:
        """Halve rejected steps; where they become too short, try to jump over a discontinuity of the map."""
        self.length[rows] *= SHORTER
        rows = rows[self.length[rows] < self.steps.shortest]
        if not rows.size:
            return
        problem = self.problem[rows]
        for row in rows:
            self._mark_corner(np.array([row]))
        over, crossed = _jump_over(problem, self.branch_points[rows], self.steps.longest)
        good = np.flatnonzero(crossed)
        self.branch_points = self.branch_points.merged(rows[good], over[good])
        self.tests_before[rows] = np.nan
        self.length[rows] = self.steps.first
        self.table.write(self.names[rows[good]], problem[good], over[good], ["kink"] * good.size)
        self._end(rows[~crossed], "lost")

    def _mark_corner(self, row: Int[np.ndarray, " 1"]) -> None:
        """Record the branch point in a corner of the map at which one branch (1,) ends, if there is one."""
        problem, before = self.problem[row], self.branch_points[row]
        crossing, beta = branch_point(problem, before)
        if crossing is None or not abs(beta) <= IMPERFECT:
            return
        if 0.0 <= ahead(problem, before, crossing.here) <= AT_END * self.steps.shortest:
            self.table.write(self.names[row], problem, crossing.here, [crossing.kind], tolerance=TOGETHER)
            self.crossings.append((int(row[0]), crossing.here, crossing.aside))

    def _accept(
        self, rows: Int[np.ndarray, " rows"], after: BranchPoints, specials: list[list[Special]]
    ) -> None:
        """Record accepted steps and their bifurcations, and end branches that are complete."""
        problem, before, names = self.problem[rows], self.branch_points[rows], self.names[rows]
        passed = self._passed(problem, before, after)
        for k, on_step in enumerate(specials):
            for special in sorted([*on_step, *passed[k]], key=lambda special: special.arclength):
                if problem.low <= special.here.parameter[0] <= problem.high:
                    only = np.array([k])
                    self.table.write(
                        names[only], problem[only], special.here, [special.kind], tolerance=TOGETHER
                    )
                    if special.kind in CROSSINGS:
                        self.crossings.append((int(rows[k]), special.here, special.aside))
        inside = (after.parameter >= problem.low) & (after.parameter <= problem.high)
        out = np.flatnonzero(~inside)
        if out.size:
            last, beyond = problem[out], after[out]
            branch_points, converged = last.at(beyond, np.clip(beyond.parameter, problem.low, problem.high))
            reached = np.flatnonzero(converged)
            self.table.write(names[out[reached]], last[reached], branch_points[reached], [""] * reached.size)
            self._end(rows[out], "range")
        within = np.flatnonzero(inside)
        if not within.size:
            return
        rows, names, after, problem = rows[within], names[within], after[within], problem[within]
        self.table.write(names, problem, after, _jumps(before[within], after))
        self.branch_points = self.branch_points.merged(rows, after)
        home = self.home[rows]
        closed = _distance(problem, after, home) < NEAR_HOME * self.length[rows]
        closed &= np.sum(problem.weights * after.tangent * home.tangent, axis=1) > 0.0
        closed &= self.table.counts(names) > AWAY
        self._end(rows[closed], "closed")
        self._end(rows[~closed & (self.table.counts(names) >= self.steps.most)], "most")
        easy = rows[after.corrections <= FEW]
        self.length[easy] = np.minimum(LONGER * self.length[easy], self.steps.longest)


def _jumps(before: BranchPoints, after: BranchPoints) -> list[str]:
    """For each step "kink" where the parameter moved against the tangents at both of its ends, else ""."""
    way = after.parameter - before.parameter
    against = (way * before.tangent[:, -1] < 0.0) & (way * after.tangent[:, -1] < 0.0)
    return np.where(against, "kink", "").tolist()


def _jump_over(
    problem: ContinuationProblem, before: BranchPoints, longest: float
) -> tuple[BranchPoints, Converged]:
    """Branch points beyond a discontinuity of the map or of its derivative, and whether found (n,).

    Where a trajectory grazes an event the map has no derivative, and may jump. No short step converges there,
    but a longer one may cross it, either by arclength or at a given value of the parameter.
    """
    best, landed = before, np.zeros(len(before.parameter), bool)
    for share in JUMPS:
        for across in (True, False):
            rows = np.flatnonzero(~landed)
            if not rows.size:
                return best, landed
            active, start = problem[rows], before[rows]
            length = share * longest
            after, good = (
                active.step(start, np.full(rows.size, length)) if across else _beyond(active, start, length)
            )
            good = good & (np.sum(active.weights * start.tangent * after.tangent, axis=1) > 0.0)
            good &= (after.parameter >= problem.low) & (after.parameter <= problem.high)
            good &= _distance(active, start, after) < 2.0 * longest
            best = best.merged(rows[good], after[good])
            landed[rows[good]] = True
    return best, landed


def _beyond(
    problem: ContinuationProblem, before: BranchPoints, length: float
) -> tuple[BranchPoints, Converged]:
    """Fixed points by damped Newton steps where the parameter is a `length` ahead; which converged (n,)."""
    change = length * before.tangent
    parameter = before.parameter + change[:, -1]
    size = before.points.at.shape[1]
    starts = Points(before.points.at + change[:, :size], before.points.modes)
    fix = {
        problem.mapping.conserved[k].name: problem.held.values[:, i] for i, k in enumerate(problem.held.which)
    }
    values = {**problem.values, problem.parameter: parameter}
    fixed = newton(problem.mapping, starts, values, fix=fix, most=10)
    good = np.flatnonzero(fixed.converged)
    if not good.size:
        return before, fixed.converged
    sign = np.sign(before.tangent[good, -1])
    branch_points = problem[good].first(fixed.points[good], fixed.drift[good], parameter[good], sign)
    return before.merged(good, branch_points), fixed.converged


def _distance(problem: ContinuationProblem, a: BranchPoints, b: BranchPoints) -> PerBranch:
    """The weighted distance between branch points, (n,)."""
    change = np.zeros_like(problem.weights)
    size = a.points.at.shape[1]
    change[:, :size] = problem.mapping.difference(a.points.at, b.points.at)
    change[:, -1] = a.parameter - b.parameter
    return np.sqrt(np.sum(problem.weights * change**2, axis=1))
