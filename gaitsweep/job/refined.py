"""The axes of a job along which a settle run refines the edges of basins."""

from __future__ import annotations

import math

from gaitsweep import near_miss
from gaitsweep.job.axes import Points, Spread, Steps
from gaitsweep.job.plan import Plan
from gaitsweep.kinds.complaints import Complaint
from gaitsweep.kinds.runs import Settle


def refined_axes(plan: Plan, run: Settle) -> dict[int, bool]:
    """The places of the axes that are refined, and whether the last cell of each is next to its first.

    An axis closes where its quantity is an angle and its cells share out a whole turn between them.
    """
    grids = _grids(plan)
    if run.over is None:
        starts = {quantity.name for quantity in plan.model.initial_conditions}
        names = [name for name in grids if name in starts]
    else:
        names = [name for name in grids if name in run.over]
    return {grids[name]: _closes(plan, name) for name in names}


def check_refinement(plan: Plan, run: object) -> list[Complaint]:
    """Complaints about a run that refines what is no grid."""
    if not isinstance(run, Settle):
        return []
    if run.refine is None:
        if run.over is not None:
            return [Complaint(("run", "over"), "names axes that refine, but run.refine is not given.")]
        return []
    grids = _grids(plan)
    complaints = []
    for place, name in enumerate(run.over or []):
        if name in (run.over or [])[:place]:
            complaints.append(Complaint(("run", "over", place), f"is {name}, which is named twice."))
        elif name in plan.names and name not in grids:
            text = f"is {name}, whose points are no grid: only a linspace or logspace of its own refines."
            complaints.append(Complaint(("run", "over", place), text))
        elif name not in grids:
            near = near_miss.suggestion(name, grids) if grids else ": no axis of this job is a grid."
            complaints.append(Complaint(("run", "over", place), f"is {name}, which does not vary{near}"))
    if not complaints and not refined_axes(plan, run):
        text = "needs a grid: a linspace or logspace of a start under vary"
        others = f", or run.over with some of {', '.join(grids)}" if grids else ""
        complaints.append(Complaint(("run", "refine"), f"{text}{others}."))
    return complaints


def _grids(plan: Plan) -> dict[str, int]:
    """The axes of equal steps that move alone, by name: their places."""
    return {
        name: place
        for place, group in enumerate(plan.groups)
        for name, points in group.points.items()
        if len(group.points) == 1 and _equal_steps(points)
    }


def _equal_steps(points: Points) -> bool:
    return isinstance(points, Spread) and isinstance(points.fraction, Steps)


def _closes(plan: Plan, name: str) -> bool:
    points = plan.groups[_grids(plan)[name]].points[name]
    quantities = {q.name: q for q in (*plan.model.parameters, *plan.model.initial_conditions)}
    if not quantities[name].circular or not isinstance(points, Spread) or points.logarithmic:
        return False
    low, high = points.low, points.high
    turn = not isinstance(low, str) and not isinstance(high, str) and math.isclose(high - low, 2.0 * math.pi)
    return turn and isinstance(points.fraction, Steps) and points.fraction.at == "centre"
