"""Pseudo-arclength continuation of fixed points, stable and unstable, over a parameter.

Many branches are followed at once, each with its own other parameters and its own step lengths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.analysis.continuation.arclength import ContinuationProblem
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps, BranchFollower, BranchTable
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
        with_points: whether each record has its `Points` (of one point) as `at`.
        crossing: whether the branches that cross at branch points are followed, too, in both directions. Then
            `branch` numbers the branches of a row, 0 through its start, and `point` leaves out one number
            before each other.

    Returns:
        One record a point: row (of the start), point, parameter and other values, the map's observables,
        drift_NAME of each constrained quantity, multiplier (the largest modulus; multiplier_re and
        multiplier_im are its parts), unstable (the number of multipliers outside the unit circle), stable,
        special, corrections, end.
        `special` is fold, flip, neimark_sacker, transcritical, supercritical_pitchfork (the branch that turns
        exists where one more multiplier of the other is outside the unit circle), subcritical_pitchfork
        (where one fewer is), or branch_point (where two branches cross in another way, or several multipliers
        are 1 at once); corner: a fold at a corner of the map, where no multiplier is 1; kink: a step over a
        corner or a jump of the map; or empty.
        A branch that ends as lost, or has a kink, is followed again on the refined map (half the time step),
        and the result of that is returned: so neither is an artefact of the time step alone.
        `end` is the reason why the branch ends: range, closed, most, lost (no step converges, or the map is
        not defined beyond), or a `NewtonOutcome` where no fixed point was found at the start; or empty.

    Raises:
        ValueError: the map does not have a name that is given, or the range has no width.
    """
    if not max(within) > min(within):
        raise ArgumentError(f"within is {list(within)}, but must be a range of two different numbers.")
    follow = partial(
        _followed,
        parameter=parameter,
        within=within,
        towards=towards,
        steps=steps,
        shown=shown,
        with_points=with_points,
        crossing=crossing,
    )
    branches = follow(mapping, starts, values, begin=begin, fix=fix)
    refined = mapping.refined()
    if branches.empty or refined is None:
        return branches
    doubtful = branches.loc[(branches["end"] == "lost") | (branches["special"] == "kink"), "row"].unique()
    if not doubtful.size:
        return branches
    n = len(starts)

    def only(value: Any) -> Any:
        return np.broadcast_to(np.asarray(value, np.float64), (n,))[doubtful]

    again = follow(
        refined,
        starts[doubtful],
        {name: only(value) for name, value in values.items()},
        begin=None if begin is None else only(begin),
        fix={name: only(value) for name, value in fix.items()} if isinstance(fix, Mapping) else fix,
    )
    again["row"] = doubtful[np.asarray(again["row"])]
    kept = branches[~branches["row"].isin(doubtful)]
    both = again if kept.empty else pd.concat([kept, again])
    return both.iloc[np.argsort(np.asarray(both["row"]), kind="stable")].reset_index(drop=True)


def _followed(
    mapping: Map,
    starts: Points,
    values: Values,
    *,
    parameter: str,
    within: Sequence[float],
    begin: Any,
    towards: int,
    fix: Sequence[str] | Mapping[str, object],
    steps: ArclengthSteps | None,
    shown: Sequence[str] | None,
    with_points: bool,
    crossing: bool,
) -> pd.DataFrame:
    """The branches of one map, as for `continuation`."""
    n = len(starts)
    begin = (min(within) if towards > 0 else max(within)) if begin is None else begin
    at = np.broadcast_to(np.asarray(begin, np.float64), (n,)).copy()
    held_values = mapping.complete({**values, parameter: at}, n)
    others = {name: each for name, each in held_values.items() if name != parameter}
    found = newton(mapping, starts, held_values, fix=fix)
    held = ConservedConstraints.of(mapping, fix, found.images.conserved_values)
    ready = np.flatnonzero(found.converged)
    problem = ContinuationProblem.of(mapping, parameter, within, others, held, found.points.at)[ready]
    beside = {name: np.asarray(values[name]) for name in (values if shown is None else shown)}
    table = BranchTable(
        mapping, parameter, beside, list(found.images.observed), n, held, with_points, crossing
    )
    for row in np.flatnonzero(~found.converged):
        table.failed(int(row), float(at[row]), NewtonOutcome(int(found.outcome[row])).name)
    if ready.size:
        branch_points = problem.first(
            found.points[ready], found.drift[ready], at[ready], float(np.sign(towards))
        )
        follower = BranchFollower(problem, branch_points, ready, table, steps or ArclengthSteps())
        follower.follow()
        across = follower.crossing() if crossing else None
        if across is not None:
            across.follow()
    return table.table()
