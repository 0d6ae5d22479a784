"""Continuation of fixed points, stable and unstable, over a parameter or a conserved quantity's value.

Tables of branches have these columns. `special` is empty or one of

- fold, flip, neimark_sacker, transcritical;
- supercritical_pitchfork: the branch that turns exists where one more multiplier of the other is outside the
  unit circle; subcritical_pitchfork: where one fewer is;
- branch_point: two branches cross in another way, or several multipliers are 1 at once. Where the map has a
  corner along the branch, its halves on both sides decide: a pitchfork if they are on one side of the
  parameter, transcritical if on two, branch_point if that is not clear;
- corner: a fold at a corner of the map, where no multiplier is 1;
- kink: a step over a corner or a jump of the map.

`end` is empty or the reason why the branch ends: range, closed, most (the largest number of points), lost (no
step converges, or the map is not defined beyond), not_found (half of a crossing branch that was not found;
this is its only point), or a `NewtonOutcome` where no fixed point was found at the start.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from gaitsweep.analysis.continuation.arclength_step import ContinuationProblem
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps, BranchFollower
from gaitsweep.analysis.continuation.branch_table import BranchTable
from gaitsweep.analysis.continuation.newton import ConservedConstraints, NewtonOutcome, newton
from gaitsweep.engine.poincare.maps import Map, Points, Values
from gaitsweep.errors import ArgumentError
from gaitsweep.near_miss import suggestion


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
            `branch` numbers the branches of a row, 0 through its start, and one number of `point` is left out
            before each further branch.

    Returns:
        One record a point: row (of the start), point, parameter and other values, the map's observables,
        drift_NAME of each constrained quantity, multiplier (the largest modulus; multiplier_re and
        multiplier_im are its parts), unstable (the number of multipliers outside the unit circle, without
        those that cross it at this point), stable, special, corrections, end; `special` and `end` are
        described at the top of this file.

        A branch that ends as lost, or has a kink, is followed again on the refined map (half the time step),
        and the result of that is returned: so neither is an artefact of the time step alone.

        Stationary points (a `StationaryMap`) have columns and names of flows instead, as of
        `in_terms_of_flow`, with `coefficient`, that of the normal form (`normal_forms`).

    Raises:
        ArgumentError: the map does not have a name that is given, the range has no width, or `towards` is not
            1 or -1.
    """
    if not max(within) > min(within):
        raise ArgumentError(f"within is {list(within)}, but must be a range of two different numbers.")
    if towards not in (1, -1):
        raise ArgumentError(f"towards is {towards}, but must be 1 or -1.")
    if unknown := sorted(set(shown or ()) - set(values)):
        raise ArgumentError(
            f"shown has {unknown[0]}, which is no name in values{suggestion(unknown[0], values)}"
        )
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
    return _followed_on_refined(branches, follow, mapping, starts, values, begin, fix)


def _followed_on_refined(
    branches: pd.DataFrame,
    follow: Callable[..., pd.DataFrame],
    mapping: Map,
    starts: Points,
    values: Values,
    begin: Any,
    fix: Sequence[str] | Mapping[str, object],
) -> pd.DataFrame:
    """A table of branches, those of lost or kinked rows replaced by the branches on the refined map.

    Args:
        branches: the table.
        follow: the function `(mapping, starts, values, begin, fix) -> branches` that made it.
        mapping, starts, values, begin, fix: its arguments.
    """
    refined = mapping.refined()
    if branches.empty or refined is None:
        return branches
    rows = branches.loc[(branches["end"] == "lost") | (branches["special"] == "kink"), "row"].unique()
    if not rows.size:
        return branches

    def of_rows(value: Any) -> Float[np.ndarray, " some"]:
        return np.broadcast_to(np.asarray(value, np.float64), (len(starts),))[rows]

    levels: Sequence[str] | dict[str, object] = fix if not isinstance(fix, Mapping) else {}
    if isinstance(fix, Mapping):  # None: the value at the start
        levels = {name: None if value is None else of_rows(value) for name, value in fix.items()}
    values_of_rows = {name: of_rows(value) for name, value in values.items()}
    again = follow(refined, starts[rows], values_of_rows, of_rows(begin), levels)
    return _replaced(branches, rows, again)


def _replaced(branches: pd.DataFrame, rows: Int[np.ndarray, " some"], again: pd.DataFrame) -> pd.DataFrame:
    """A table with the records of some rows (n,) replaced by those of `again`, whose `row` counts from 0."""
    again["row"] = rows[np.asarray(again["row"])]
    others = branches[~branches["row"].isin(rows.tolist())]
    table = again if others.empty else pd.concat([others, again])
    return table.iloc[np.argsort(np.asarray(table["row"]), kind="stable")].reset_index(drop=True)


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
        table.add_failed(int(row), float(begins[row]), NewtonOutcome(int(fixed.outcome[row])).name)
    rows = np.flatnonzero(fixed.converged)
    if rows.size:
        problem = ContinuationProblem.of(
            mapping, parameter, within, others, constraints, fixed.points, fixed.images
        )
        sign = float(np.sign(towards))
        first = problem[rows].first(fixed.points[rows], fixed.drift[rows], begins[rows], sign)
        follower = BranchFollower(problem[rows], first, rows, table, steps)
        follower.follow()
        across = follower.crossing() if crossing else None
        if across is not None:
            across.follow()
    return table.table()
