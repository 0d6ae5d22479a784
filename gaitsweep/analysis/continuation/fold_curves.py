"""Folds of fixed points followed in the plane of two parameters, and the cusps where two folds meet."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.bifurcation_curves import CurvePoint, followed
from gaitsweep.analysis.continuation.bifurcation_tests import branch_test, fold_test, located_on_branch
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.branch_table import in_terms_of_flow
from gaitsweep.analysis.continuation.critical_points import (
    CriticalEquations,
    CriticalPoint,
    SecondParameter,
    equations_at,
)
from gaitsweep.analysis.continuation.lockstep import alone
from gaitsweep.analysis.continuation.newton import ConservedConstraints, NewtonOutcome, newton
from gaitsweep.engine.poincare.maps import Map, Points, Values
from gaitsweep.errors import ArgumentError

# Steps of the search for the first fold.
MOST_TO_A_FOLD = 60


def fold_curves(
    mapping: Map,
    starts: Points,
    values: Values,
    *,
    parameters: Sequence[str],
    within: Mapping[str, Sequence[float]],
    begin: Mapping[str, Any],
    to_fold: int = 0,
    towards: int = 0,
    fix: Sequence[str] = (),
    steps: ArclengthSteps | None = None,
) -> pd.DataFrame:
    """Follow the first fold on the branch through each of n starts in the plane of two parameters.

    Args:
        mapping: a return map, or any other.
        starts: points near fixed points at `begin`.
        values: other parameters, numbers or one for each start (n,).
        parameters: the names of both; branches are followed along the first to their fold.
        within: their ranges, two numbers each.
        begin: their values at the starts, numbers or one for each start (n,).
        to_fold: 1 or -1, the direction of the first parameter in which the fold is looked for; 0: in both by
            turns, until there is one.
        towards: 1 or -1, the direction of the second parameter in which the curve is first followed; 0: both.
        fix: conserved quantities to constrain, as for `newton`.
        steps: lengths and number of the steps; parameters are shares of their ranges.

    Returns:
        One record a point: row, point (0: the first fold; below 0 behind it where both directions are
        followed), both parameters, the map's observables, multiplier (the one next to 1), unstable (how many
        others are outside the unit circle), side (1 or -1: whether the two fixed points that meet exist above
        or below the curve in the first parameter), curvature (zero at a cusp), special (a
        bifurcation of codimension 2: cusp, resonance_1_1, fold_flip or fold_neimark_sacker; kink, a step
        over a corner or jump of the map; or empty), corrections, end (range, most, lost, no_fold: none
        on the branch, or a `NewtonOutcome` where no fixed point was found at the start; of both ends where
        both directions are followed).

    Raises:
        ArgumentError: there are not two parameters, or a range has no width.
    """
    _check_ranges(parameters, within)
    steps = steps or ArclengthSteps()
    records: list[dict[str, Any]] = []
    complete = mapping.complete({**values, **begin}, len(starts))
    for row in range(len(starts)):
        row_values = {name: column[row : row + 1] for name, column in complete.items()}
        start = starts[np.array([row])]
        fold = _first_fold(mapping, start, row_values, parameters, within, to_fold, fix, steps)
        if isinstance(fold, str):
            at = {name: float(complete[name][row]) for name in parameters}
            records.append({"row": row, "point": 0, **at, "end": fold})
        else:
            records += _curve_through(*fold, towards, row, steps)
    return in_terms_of_flow(mapping, pd.DataFrame(records))


def _check_ranges(parameters: Sequence[str], within: Mapping[str, Sequence[float]]) -> None:
    """Refuse parameters that are not two, or a range without a width."""
    if len(parameters) != 2 or parameters[0] == parameters[1]:
        raise ArgumentError(f"parameters are {', '.join(parameters)}, but a curve of folds needs two.")
    for name in parameters:
        if name not in within or not max(within[name]) > min(within[name]):
            raise ArgumentError(f"within has no range for {name}: give two different numbers.")


def _first_fold(
    mapping: Map,
    start: Points,
    values: dict[str, Float[np.ndarray, " 1"]],
    parameters: Sequence[str],
    within: Mapping[str, Sequence[float]],
    to_fold: int,
    fix: Sequence[str],
    steps: ArclengthSteps,
) -> tuple[CriticalEquations, CriticalPoint] | str:
    """The equations and the point of the first fold on the branch through a start.

    If there is none, the `end` of its record is returned.
    """
    first = parameters[0]
    fixed = newton(mapping, start, values, fix=fix)
    if not fixed.converged[0]:
        return NewtonOutcome(int(fixed.outcome[0])).name
    constraints = ConservedConstraints.of(mapping, fix, fixed.images.conserved_values)
    others = {name: column for name, column in values.items() if name != first}
    problem = ContinuationProblem.of(mapping, first, within[first], others, constraints, fixed.points.at)
    before = problem.first(fixed.points, fixed.drift, values[first], float(np.sign(to_fold) or 1))
    ahead = [before] if to_fold else [before, dataclasses.replace(before, tangent=-before.tangent)]
    lengths = [np.array([steps.longest]) for _ in ahead]
    ends = [""] * len(ahead)
    for _ in range(MOST_TO_A_FOLD):
        for k, before in enumerate(ahead):
            if ends[k]:
                continue
            steps.on_progress([0], [0.0])
            after, ok = problem.step(before, lengths[k])
            if not ok[0]:
                lengths[k] = 0.5 * lengths[k]
                ends[k] = "lost" if lengths[k][0] < steps.shortest else ""
            elif not problem.low <= after.parameter[0] <= problem.high:
                ends[k] = "no_fold"
            elif branch_test(problem, before)[0] * branch_test(problem, after)[0] < 0.0:
                ahead[k] = after  # at a pitchfork, a branch that turns has no fold
            elif fold_test(problem, before)[0] * fold_test(problem, after)[0] < 0.0:
                ends_of_step = fold_test(problem, before)[0], fold_test(problem, after)[0]
                fold = located_on_branch(problem, before, lengths[k][0], fold_test, ends_of_step)
                if fold is not None:
                    return _on_curve(problem, fold.point, parameters, within)
                ends[k] = "lost"
            else:
                ahead[k] = after
    return "lost" if "lost" in ends else "no_fold"


def _on_curve(
    problem: ContinuationProblem,
    fold: BranchPoints,
    parameters: Sequence[str],
    within: Mapping[str, Sequence[float]],
) -> tuple[CriticalEquations, CriticalPoint] | str:
    """The equations and the first point of a fold's curve; the `end` of its record if it has none."""
    name = parameters[1]
    second = SecondParameter(name, float(min(within[name])), float(max(within[name])))
    equations, unknowns = equations_at(problem, fold, "fold", second)
    first = alone(equations.first(fold.points, unknowns))
    return "lost" if first is None else (equations, first)


def _curve_through(
    equations: CriticalEquations, first: CriticalPoint, towards: int, row: int, steps: ArclengthSteps
) -> list[dict[str, Any]]:
    """The records of the curve through a first fold, in the direction `towards`; in both where that is 0."""
    if towards:
        return _records(equations, first, float(np.sign(towards)), row, steps)
    behind, ahead = (_records(equations, first, sign, row, steps) for sign in (-1.0, 1.0))
    if len(behind) == 1 < len(ahead):
        ahead[0]["end"] = behind[0]["end"]
    return [*({**record, "point": -record["point"]} for record in behind[:0:-1]), *ahead]


def _records(
    equations: CriticalEquations, first: CriticalPoint, sign: float, row: int, steps: ArclengthSteps
) -> list[dict[str, Any]]:
    """The records of one curve, from its first fold in the direction `sign` of the second parameter."""
    curve, end = alone(followed(equations, first, sign, steps))
    records = [_record(equations, at, row, point) for point, at in enumerate(curve)]
    records[-1]["end"] = end
    return records


def _record(equations: CriticalEquations, at: CurvePoint, row: int, point: int) -> dict[str, Any]:
    """The record of one point of a curve of folds."""
    fold = at.point
    parameters = equations.parameters(fold.unknowns)
    others = equations.other_multipliers(fold.unknowns, fold.multipliers)
    critical = fold.multipliers[int(np.argmin(np.abs(fold.multipliers - 1.0)))]
    curvature = fold.tests["cusp"]
    return {
        "row": row,
        "point": point,
        **dict(zip(equations.names, map(float, parameters), strict=True)),
        **fold.observed,
        "multiplier": float(critical.real),
        "unstable": int(np.sum(np.abs(others) > 1.0)),
        # near a fold w' F_p dp + curvature x^2 / 2 = 0
        "side": float(-np.sign(curvature * (fold.w @ fold.matrix[: equations.m, equations.m]))),
        "curvature": curvature,
        "special": at.special,
        "corrections": fold.corrections,
        "end": "",
    }
