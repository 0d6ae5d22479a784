"""Branches of fixed points over a parameter, stable and unstable ones, with their folds: pseudo-arclength.

Many branches are followed at once, each with its own other parameters and its own steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.analysis.continuation.arclength import Track
from gaitsweep.analysis.continuation.branch_follower import OnTheWay, Steps
from gaitsweep.analysis.continuation.branch_table import Book
from gaitsweep.analysis.continuation.conserved_constraints import Conditions
from gaitsweep.analysis.continuation.newton import Outcome, newton
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
    steps: Steps | None = None,
    shown: Sequence[str] | None = None,
) -> pd.DataFrame:
    """The branches of fixed points through n starts.

    Args:
        mapping: a return map, or any other.
        starts: points near fixed points.
        values: other parameters, numbers or one for each start (n,).
        parameter: the name of the parameter along which branches are followed.
        within: the range of it in which they are, two numbers.
        begin: its values at the starts, a number or (n,); the range's end that `towards` leads away from.
        towards: 1 or -1, the direction of the parameter in which a branch starts.
        fix: conserved quantities that are held, as for `newton`.
        steps: how long the steps are, and how many.
        shown: the values that the table has beside the parameter; all that are given if not said.

    Returns:
        One record a point: row (the start's), point, parameter and other values, what the map observes there,
        drift_NAME for what is held, multiplier (the largest in size; multiplier_re and multiplier_im its
        parts), unstable (how many are outside the unit circle), stable, special, corrections, end.
        `special` is fold, flip, neimark_sacker, branch_point; corner: a fold at a bend of the map, where no
        multiplier is 1; kink: a step over a place where the map bends or jumps; or nothing.
        A branch that ends as lost, or has a kink, is followed again on the map refined (half the step), and
        the branch of that is what is given: so neither is an artefact of the step alone.
        `end` says why the branch ends there: range, closed, most, lost (no step is short enough, or the map
        is not defined beyond), or, where no fixed point was found at the start, an `Outcome`; or nothing.

    Raises:
        ValueError: a name that the map does not have; a range without width.
    """
    if not max(within) > min(within):
        raise ArgumentError(f"within is {list(within)}, but must be a range: two numbers that differ.")
    follow = partial(_followed, parameter=parameter, within=within, towards=towards, steps=steps, shown=shown)
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
    steps: Steps | None,
    shown: Sequence[str] | None,
) -> pd.DataFrame:
    """The branches on one map; see `continuation`."""
    n = len(starts)
    begin = (min(within) if towards > 0 else max(within)) if begin is None else begin
    at = np.broadcast_to(np.asarray(begin, np.float64), (n,)).copy()
    held_values = mapping.complete({**values, parameter: at}, n)
    others = {name: each for name, each in held_values.items() if name != parameter}
    found = newton(mapping, starts, held_values, fix=fix)
    held = Conditions.of(mapping, fix, found.images.conserved_values)
    ready = np.flatnonzero(found.converged)
    track = Track.of(mapping, parameter, within, others, held, found.points.at)[ready]
    beside = {name: np.asarray(values[name]) for name in (values if shown is None else shown)}
    book = Book(mapping, parameter, beside, n, held)
    for row in np.flatnonzero(~found.converged):
        book.failed(int(row), float(at[row]), Outcome(int(found.outcome[row])).name)
    if ready.size:
        places = track.first(found.points[ready], found.drift[ready], at[ready], float(np.sign(towards)))
        OnTheWay(track, places, ready, book, steps or Steps()).follow()
    return book.table()
