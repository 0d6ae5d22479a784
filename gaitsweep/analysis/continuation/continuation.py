"""Pseudo-arclength continuation of fixed points, stable and unstable, over a parameter."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Int

from gaitsweep.analysis.continuation.arclength import ContinuationProblem
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps, BranchFollower
from gaitsweep.analysis.continuation.branch_table import BranchTable
from gaitsweep.analysis.continuation.newton import ConservedConstraints, NewtonOutcome, newton
from gaitsweep.engine.poincare.maps import Map, Points, Values
from gaitsweep.errors import ArgumentError


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
        ArgumentError: the map does not have a name that is given, or the range has no width.
    """
    if not max(within) > min(within):
        raise ArgumentError(f"within is {list(within)}, but must be a range of two different numbers.")

    if begin is None:
        begin = min(within) if towards > 0 else max(within)
    follow = functools.partial(
        _followed,
        parameter=parameter,
        within=within,
        towards=towards,
        steps=steps or ArclengthSteps(),
        shown=values if shown is None else shown,
        with_points=with_points,
        crossing=crossing,
    )
    branches = follow(mapping, starts, values, begin, fix)
    refined = mapping.refined()
    if branches.empty or refined is None:
        return branches
    doubtful = branches.loc[(branches["end"] == "lost") | (branches["special"] == "kink"), "row"].unique()
    if not doubtful.size:
        return branches

    def of_doubtful(value: Any) -> Any:
        return np.broadcast_to(np.asarray(value, np.float64), (len(starts),))[doubtful]

    levels = {name: of_doubtful(value) for name, value in fix.items()} if isinstance(fix, Mapping) else fix
    others = {name: of_doubtful(value) for name, value in values.items()}
    return _replaced(
        branches, doubtful, follow(refined, starts[doubtful], others, of_doubtful(begin), levels)
    )


def _replaced(branches: pd.DataFrame, rows: Int[np.ndarray, " some"], again: pd.DataFrame) -> pd.DataFrame:
    """A table with the records of some rows (n,) replaced by those of `again`, whose `row` counts from 0."""
    again["row"] = rows[np.asarray(again["row"])]
    others = branches[~branches["row"].isin(rows.tolist())]
    both = again if others.empty else pd.concat([others, again])
    return both.iloc[np.argsort(np.asarray(both["row"]), kind="stable")].reset_index(drop=True)


def _followed(
    mapping: Map,
    starts: Points,
    values: Values,
    begin: Any,
    fix: Sequence[str] | Mapping[str, object],
    *,
    parameter: str,
    within: Sequence[float],
    towards: int,
    steps: ArclengthSteps,
    shown: Iterable[str],
    with_points: bool,
    crossing: bool,
) -> pd.DataFrame:
    """The branches on one map; arguments and result are those of `continuation`."""
    n = len(starts)
    begins = np.broadcast_to(np.asarray(begin, np.float64), (n,)).copy()
    complete = mapping.complete({**values, parameter: begins}, n)
    others = {name: column for name, column in complete.items() if name != parameter}
    fixed = newton(mapping, starts, complete, fix=fix)
    constraints = ConservedConstraints.of(mapping, fix, fixed.images.conserved_values)
    columns = {name: np.asarray(values[name]) for name in shown}
    observed = list(fixed.images.observed)
    table = BranchTable(mapping, parameter, columns, observed, n, constraints, with_points, crossing)
    for row in np.flatnonzero(~fixed.converged):
        table.failed(int(row), float(begins[row]), NewtonOutcome(int(fixed.outcome[row])).name)
    rows = np.flatnonzero(fixed.converged)
    if rows.size:
        problem = ContinuationProblem.of(mapping, parameter, within, others, constraints, fixed.points.at)
        sign = float(np.sign(towards))
        first = problem[rows].first(fixed.points[rows], fixed.drift[rows], begins[rows], sign)
        follower = BranchFollower(problem[rows], first, rows, table, steps)
        follower.follow()
        across = follower.crossing() if crossing else None
        if across is not None:
            across.follow()
    return table.table()
