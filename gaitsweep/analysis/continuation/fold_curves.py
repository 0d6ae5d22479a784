"""Folds of fixed points followed in the plane of two parameters, and the cusps where two folds meet.

At a fold the Jacobian A of Newton's equations F = 0 is singular. A bordered system defines the test function
g, [A b; c' 0] [v; g] = [0; 1], which is zero there; v and the solution w of the transposed system are null
vectors. A curve of folds is F = 0, g = 0 in the space of the coordinates and both parameters, followed by
pseudo-arclength. It is smooth where it passes a cusp: there the second derivative w' A_v v is zero, and the
curve in the plane of the parameters has its tip. A curve ends as lost where the map has a corner or a jump.

Source: Govaerts 2000, Numerical Methods for Bifurcations of Dynamical Equilibria, chapters 4 and 8.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
import pandas as pd
from jaxtyping import Complex, Float

from gaitsweep.analysis.continuation.arclength import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.bifurcation_tests import (
    branch_test,
    fold_test,
    located,
    located_on_branch,
)
from gaitsweep.analysis.continuation.continuation import JUMPS, ArclengthSteps
from gaitsweep.analysis.continuation.multipliers import multipliers
from gaitsweep.analysis.continuation.newton import (
    ConservedConstraints,
    NewtonOutcome,
    matrices,
    newton,
    residuals,
    sizes,
)
from gaitsweep.engine.poincare.maps import Map, MapEvaluation, Points, Values
from gaitsweep.errors import ArgumentError

Vector = Float[np.ndarray, " unknowns"]  # coordinates, drifts and both parameters
FoldVector = Float[np.ndarray, " fold_unknowns"]  # without the parameters
# Steps of the central differences: along v in scaled coordinates, of parameters as shares of their ranges.
ALONG, SHARE = 1e-4, 1e-5
# Tolerances on the scaled residuals of F and on g, and most corrections of a step.
TOLERANCE, FOLD_TOLERANCE, MOST_CORRECTIONS = 1e-9, 1e-6, 12
# Steps of the search for the first fold.
MOST_TO_A_FOLD = 60
# A cusp is found in an interval this short, as a share of its step.
SHORTEST_INTERVAL = 1e-5


@dataclasses.dataclass(frozen=True)
class FoldPoint:
    """A point of a fold curve.

    `point`, one of `Points`; `unknowns` (m + 2,): scaled coordinates, drifts, both parameters as shares of
    their ranges; `matrix` (m + 1, m + 2), the derivatives of F and g by them; unit `tangent` (m + 2,); null
    vectors `v` and `w` (m,), oriented as those of the point before; `curvature`, w' A_v v; `multipliers` of
    the map; `observed`.
    """

    point: Points
    unknowns: Vector
    matrix: Float[np.ndarray, "equations unknowns"]
    tangent: Vector
    v: FoldVector
    w: FoldVector
    curvature: float
    multipliers: Complex[np.ndarray, " multipliers"]
    observed: dict[str, float]
    corrections: int = 0


@dataclasses.dataclass(frozen=True)
class _Equations:
    """F = 0 and g = 0 of one curve: `low` and `width` (2,) scale the parameters, `scale` (m,) the others."""

    mapping: Map
    names: tuple[str, str]
    low: Float[np.ndarray, " 2"]
    width: Float[np.ndarray, " 2"]
    values: dict[str, Any]
    held: ConservedConstraints
    scale: FoldVector

    def parameters(self, unknowns: Vector) -> Float[np.ndarray, " 2"]:
        """The two parameters (2,) of these unknowns."""
        return self.low + self.width * unknowns[-2:]

    def at(
        self, like: Points, several: Float[np.ndarray, "several unknowns"], derivatives: bool = True
    ) -> tuple[
        Float[np.ndarray, "several fold_unknowns"],
        Float[np.ndarray, "several fold_unknowns fold_unknowns"],
        MapEvaluation,
    ]:
        """F (n, m), the scaled Jacobians A (n, m, m) and the images at the unknowns `several` (n, m + 2).

        `like` gives the modes; where the map is not defined, F and A are NaN.
        """
        n, size = len(several), like.at.shape[1]
        modes = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[:1], n, axis=0), like.modes)
        points = Points(several[:, :size] * self.scale[:size], modes)
        at = self.low + self.width * several[:, -2:]
        values = {**self.values, **{name: at[:, k] for k, name in enumerate(self.names)}}
        images = self.mapping.linearised(points, values)
        constraints = self.held[np.zeros(n, int)]
        miss = residuals(self.mapping, points, several[:, size:-2], images, constraints) / self.scale
        A = matrices(images, constraints) * self.scale[None, None, :] / self.scale[None, :, None]
        bad = ~images.sound
        miss[bad], A[bad] = np.nan, np.nan
        return miss, A, images


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
        or below the curve in the first parameter), curvature (zero at a cusp), special (`cusp`; `kink`, a
        step over a corner or jump of the map; or empty), corrections, end (range, most, lost, no_fold: none
        on the branch, or a `NewtonOutcome` where no fixed point was found at the start; of both ends where
        both directions are followed).

    Raises:
        ArgumentError: there are not two parameters, or a range has no width.
    """
    if len(parameters) != 2 or parameters[0] == parameters[1]:
        raise ArgumentError(f"parameters are {', '.join(parameters)}, but a curve of folds needs two.")
    for name in parameters:
        if name not in within or not max(within[name]) > min(within[name]):
            raise ArgumentError(f"within has no range for {name}: give two different numbers.")
    steps = steps or ArclengthSteps()
    n, records = len(starts), []
    complete = mapping.complete({**values, **begin}, n)
    for row in range(n):
        row_values = {name: column[row : row + 1] for name, column in complete.items()}
        fold, why = _first_fold(
            mapping, starts[np.array([row])], row_values, parameters, within, to_fold, fix, steps
        )
        if fold is None:
            at = {name: float(complete[name][row]) for name in parameters}
            records.append({"row": row, "point": 0, **at, "end": why})
            continue
        equations, first = fold
        if towards:
            records += _followed(equations, first, float(np.sign(towards)), row, steps)
            continue
        behind, ahead = (_followed(equations, first, sign, row, steps) for sign in (-1.0, 1.0))
        records += [{**record, "point": -record["point"]} for record in behind[:0:-1]] + ahead
        if len(behind) == 1 < len(ahead):
            ahead[0]["end"] = behind[0]["end"]
    return pd.DataFrame(records)


def _first_fold(
    mapping: Map,
    start: Points,
    values: dict[str, Float[np.ndarray, " 1"]],
    parameters: Sequence[str],
    within: Mapping[str, Sequence[float]],
    to_fold: int,
    fix: Sequence[str],
    steps: ArclengthSteps,
) -> tuple[tuple[_Equations, FoldPoint] | None, str]:
    """The first fold on the branch through a start, or why there is none."""
    first = parameters[0]
    fixed = newton(mapping, start, values, fix=fix)
    if not fixed.converged[0]:
        return None, NewtonOutcome(int(fixed.outcome[0])).name
    constraints = ConservedConstraints.of(mapping, fix, fixed.images.conserved_values)
    others = {name: column for name, column in values.items() if name != first}
    problem = ContinuationProblem.of(mapping, first, within[first], others, constraints, fixed.points.at)
    before = problem.first(fixed.points, fixed.drift, values[first], float(np.sign(to_fold) or 1))
    ahead = [before] if to_fold else [before, dataclasses.replace(before, tangent=-before.tangent)]
    lengths, ends = [np.array([steps.longest]) for _ in ahead], [""] * len(ahead)
    for _ in range(MOST_TO_A_FOLD):
        for k in (k for k, end in enumerate(ends) if not end):
            steps.on_progress([0], [0.0])
            before = ahead[k]
            after, ok = problem.step(before, lengths[k])
            if not ok[0]:
                lengths[k] = 0.5 * lengths[k]
                ends[k] = "lost" if lengths[k][0] < steps.shortest else ""
            elif not problem.low <= after.parameter[0] <= problem.high:
                ends[k] = "no_fold"
            elif branch_test(problem, before)[0] * branch_test(problem, after)[0] < 0.0:
                ahead[k] = after  # at a pitchfork, a branch that turns has no fold
            elif fold_test(problem, before)[0] * fold_test(problem, after)[0] < 0.0:
                turns = fold_test(problem, before)[0], fold_test(problem, after)[0]
                fold = located_on_branch(problem, before, lengths[k][0], fold_test, turns)
                if fold is not None:
                    return _on_curve(problem, fold[0], parameters, within, values)
                ends[k] = "lost"
            else:
                ahead[k] = after
    return None, "lost" if "lost" in ends else "no_fold"


def _on_curve(
    problem: ContinuationProblem,
    fold: BranchPoints,
    parameters: Sequence[str],
    within: Mapping[str, Sequence[float]],
    values: dict[str, Float[np.ndarray, " 1"]],
) -> tuple[tuple[_Equations, FoldPoint] | None, str]:
    """The equations of a fold's curve, and the fold as its first point."""
    low = np.array([float(min(within[name])) for name in parameters])
    width = np.array([float(max(within[name])) for name in parameters]) - low
    k = len(problem.held.which)
    scale = np.concatenate([sizes(fold.points.at)[0], np.ones(k)])
    others = {name: column[0] for name, column in values.items() if name not in parameters}
    equations = _Equations(
        problem.mapping, (parameters[0], parameters[1]), low, width, others, problem.held, scale
    )
    at = np.array([fold.parameter[0], values[parameters[1]][0]])
    unknowns = np.concatenate(
        [fold.points.at[0] / scale[: len(scale) - k], fold.drift[0], (at - low) / width]
    )
    _, A, _ = equations.at(fold.points, unknowns[None])
    if not np.isfinite(A).all():
        return None, "lost"
    left, _, right = np.linalg.svd(A[0])
    # along the branch the parameter turns: v is oriented as the first coordinate that grows with it
    return (equations, _differentiated(equations, fold.points, unknowns, left[:, -1], right[-1], None)), ""


def _differentiated(
    equations: _Equations,
    like: Points,
    unknowns: Vector,
    b: FoldVector,
    c: FoldVector,
    before: Vector | None,
    corrections: int = 0,
) -> FoldPoint:
    """A point of the curve with the derivatives of its equations, bordered by `b` and `c` (m,).

    The curve's tangent has a positive product with `before` (m + 2,), where it is given.
    """
    A = equations.at(like, unknowns[None])[1][0]
    v, w, _ = _null_vectors(A, b, c)
    m = len(v)
    shifts = np.zeros((6, m + 2))
    shifts[0, :m], shifts[1, :m] = ALONG * v, -ALONG * v
    for k in (0, 1):
        shifts[2 + 2 * k, m + k], shifts[3 + 2 * k, m + k] = SHARE, -SHARE
    miss, several, images = equations.at(like, np.concatenate([unknowns[None], unknowns + shifts]))
    gradients = images.conserved_jacobian[:1, equations.held.which]
    matrix = np.zeros((m + 1, m + 2))
    matrix[:m, :m] = several[0]
    for k in (0, 1):
        matrix[:m, m + k] = (miss[3 + 2 * k] - miss[4 + 2 * k]) / (2.0 * SHARE)
        matrix[m, m + k] = -w @ (several[3 + 2 * k] - several[4 + 2 * k]) @ v / (2.0 * SHARE)
    # A_z v = A_v z: second derivatives commute
    matrix[m, :m] = -w @ (several[1] - several[2]) / (2.0 * ALONG)
    tangent = np.full(m + 2, np.nan)
    if np.isfinite(matrix).all():
        tangent = np.linalg.svd(matrix)[2][-1]
        if before is not None and tangent @ before < 0.0:
            tangent = -tangent
    observed = {name: float(column[0]) for name, column in images.observed.items()}
    point = Points(unknowns[None, : like.at.shape[1]] * equations.scale[: like.at.shape[1]], like.modes)
    curvature, factors = float(-matrix[m, :m] @ v), np.full(1, np.nan, complex)
    if np.isfinite(images.jacobian[0]).all():
        factors = multipliers(images.jacobian[:1], gradients)[0]
    return FoldPoint(point, unknowns, matrix, tangent, v, w, curvature, factors, observed, corrections)


def _null_vectors(
    A: Float[np.ndarray, "fold_unknowns fold_unknowns"], b: FoldVector, c: FoldVector
) -> tuple[FoldVector, FoldVector, float]:
    """V and w (m,) with length 1, and g, of the Jacobian A (m, m) bordered by `b` and `c`."""
    m = len(A)
    full = np.zeros((m + 1, m + 1))
    full[:m, :m], full[:m, m], full[m, :m] = A, b, c
    last = np.zeros(m + 1)
    last[m] = 1.0
    right, left = np.linalg.solve(full, last), np.linalg.solve(full.T, last)
    v, w = right[:m], left[:m]
    return (
        v / np.linalg.norm(v),
        w / np.linalg.norm(w),
        float(right[m] / np.linalg.norm(v) / np.linalg.norm(w)),
    )


def _stepped(equations: _Equations, before: FoldPoint, length: float) -> FoldPoint | None:
    """The point of the curve one arclength step ahead; None where the corrections do not converge."""
    guess = length * before.tangent
    matrix = np.concatenate([before.matrix, before.tangent[None]])
    change, step, like = guess.copy(), np.zeros_like(guess), before.point
    norm = np.inf
    for number in range(1, MOST_CORRECTIONS + 1):
        unknowns = before.unknowns + change
        miss, A, images = equations.at(like, unknowns[None])
        if not np.isfinite(A).all():
            return None
        _, _, g = _null_vectors(A[0], before.w, before.v)
        off = before.tangent @ change - length
        now = float(np.max(np.abs(miss[0])))
        if now <= TOLERANCE and abs(g) <= FOLD_TOLERANCE and abs(off) <= 1e-9:
            after = _differentiated(equations, like, unknowns, before.w, before.v, before.tangent, number)
            return after if np.isfinite(after.tangent).all() else None
        if max(now, abs(g)) > 10.0 * norm + 1e-3:
            return None
        norm = max(now, abs(g))
        wrong = np.concatenate([miss[0], [g, off]])
        if number > 1:  # Broyden's update: what the last step did not foresee
            matrix += np.outer(wrong, step) / (step @ step)
        try:
            step = np.linalg.solve(matrix, -wrong)
        except np.linalg.LinAlgError:
            return None
        change = change + step
        like = Points(like.at, images.points.modes)
    return None


def _followed(
    equations: _Equations, before: FoldPoint, sign: float, row: int, steps: ArclengthSteps
) -> list[dict[str, Any]]:
    """The records of one curve, from its first fold in the direction `sign` of the second parameter."""
    if not np.isfinite(before.tangent).all():
        return [_record(equations, before, row, 0, "") | {"end": "lost"}]
    if sign * before.tangent[-1] < 0.0:
        before = dataclasses.replace(before, tangent=-before.tangent)
    records = [_record(equations, before, row, 0, "")]
    length, end = steps.first, "most"
    while len(records) < steps.most:
        steps.on_progress([len(records)], [len(records) / steps.most])
        after = _stepped(equations, before, length)
        if after is None or after.tangent @ before.tangent < 0.9:
            length *= 0.5
            if length >= steps.shortest:
                continue
            leap = _leap(equations, before, steps.longest)
            if leap is None:
                end = "lost"
                break
            records.append(_record(equations, leap, row, len(records), "kink"))
            before, length = leap, steps.first
            continue
        if before.curvature * after.curvature < 0.0:
            tip = _cusp(equations, before, after, length)
            if tip is not None:
                records.append(_record(equations, tip, row, len(records), "cusp"))
        if np.any((after.unknowns[-2:] < 0.0) | (after.unknowns[-2:] > 1.0)):
            end = "range"
            break
        records.append(_record(equations, after, row, len(records), ""))
        if after.corrections <= 5:
            length = min(1.4 * length, steps.longest)
        before = after
    records[-1]["end"] = end
    return records


def _leap(equations: _Equations, before: FoldPoint, longest: float) -> FoldPoint | None:
    """The point behind a corner or a jump of the map, where no short step leads over it; else None."""
    for share in JUMPS:
        after = _stepped(equations, before, share * longest)
        if after is not None and after.tangent @ before.tangent > 0.0:
            return after
    return None


def _cusp(equations: _Equations, before: FoldPoint, after: FoldPoint, length: float) -> FoldPoint | None:
    """The cusp on a step of a curve."""
    cusp = located(
        (before.curvature, after.curvature),
        length,
        lambda arclength: _stepped(equations, before, arclength),
        lambda point: point.curvature,
        0.0,
        SHORTEST_INTERVAL,
    )
    return None if cusp is None else cusp[0]


def _record(equations: _Equations, fold: FoldPoint, row: int, point: int, special: str) -> dict[str, Any]:
    at, m = equations.parameters(fold.unknowns), len(fold.v)
    critical = int(np.argmin(np.abs(fold.multipliers - 1.0)))
    others = np.delete(fold.multipliers, critical)
    return {
        "row": row,
        "point": point,
        **dict(zip(equations.names, map(float, at), strict=True)),
        **fold.observed,
        "multiplier": float(fold.multipliers[critical].real),
        "unstable": int(np.sum(np.abs(others) > 1.0)),
        # near a fold w' F_p dp + curvature x^2 / 2 = 0
        "side": float(-np.sign(fold.curvature * (fold.w @ fold.matrix[:m, m]))),
        "curvature": fold.curvature,
        "special": special,
        "corrections": fold.corrections,
        "end": "",
    }
