"""Whether the figures that a job asks for fit its run, and the columns that they may name."""

from __future__ import annotations

from collections.abc import Iterable

from gaitsweep import near_miss
from gaitsweep.contract import Model
from gaitsweep.job.figure_checks import Given, refusals
from gaitsweep.job.figure_kinds import Figure, Hysteresis
from gaitsweep.job.gait_figures import GaitRamp
from gaitsweep.job.plan import Plan
from gaitsweep.kinds.complaints import Complaint
from gaitsweep.kinds.runs import Continuation, Hold, Ramp, Run, Settle, Staircase, Trace, moved_by


def table_columns(model: Model, varied: Iterable[str], run: Run) -> list[str]:
    """The columns of the table that a run makes, in their order."""
    axes = list(varied)
    if isinstance(run, Settle | Hold):
        observed = [f"{quantity.name}_end" for quantity in model.observables]
        traits = [quantity.name for quantity in model.label_fields]
        slowest, period = (["slowest"], ["attractor_period"]) if isinstance(run, Settle) else ([], [])
        head = ["status", "cycles", "t_end", *slowest, "stalled_by"]
        return ["row", *axes, *head, *observed, "gait", *period, *traits]
    if isinstance(run, Trace):
        moving = [] if run.parameter is None else ["pass", run.parameter]
        signals = [quantity.name for quantity in model.signals]
        return ["row", *axes, *moving, "t", *signals, "status", "stalled_by"]
    observed = [f"{quantity.name}_n" for quantity in model.observables]
    if isinstance(run, Continuation):
        return ["row", *axes, "point", run.parameter, *observed, *branch_columns(run)]
    if isinstance(run, Staircase):
        head = ["stair", "pass", run.parameter, "t", "crossing", "settled", "slowest", "status", "stalled_by"]
        return ["row", *axes, *head, *observed, "gait", *(quantity.name for quantity in model.label_fields)]
    moving = ["pass", run.parameter] if isinstance(run, Ramp) else []
    return ["row", *axes, "crossing", *moving, "t", "status", "stalled_by", *observed]


def branch_columns(run: Continuation) -> list[str]:
    """What a continuation's table says of a point, beside where it is."""
    found = ["multiplier", "multiplier_re", "multiplier_im", "unstable", "stable", "special", "corrections"]
    return ["gait", "time", *(f"drift_{name}" for name in run.fix), *found, "end", "status"]


def check_figures(figures: list[Figure], plan: Plan, run: Run) -> list[Complaint]:
    """Complaints about figures that cannot be drawn of the table that the run makes, or share a name."""
    model = plan.model
    columns = table_columns(model, plan.names, run)
    given = Given(plan, run, columns)
    observables = [quantity.name for quantity in model.observables]
    complaints: list[Complaint] = []
    stems: dict[str, int] = {}
    for index, figure in enumerate(figures):
        path = ("figures", index)
        if run.kind not in figure.runs:
            text = f"is {figure.kind}, which needs a run of {' or '.join(figure.runs)}, not of {run.kind}."
            complaints.append(Complaint((*path, "kind"), text))
            continue
        before = len(complaints)
        for field, column in figure.columns().items():
            if column not in columns:
                near = near_miss.suggestion(column, columns)
                text = f"is {column}, which is not a column of this job's table{near}"
                complaints.append(Complaint((*path, field), text))
        for place, name in figure.observed().items():
            if name not in observables:
                near = near_miss.suggestion(name, observables)
                text = f"is {name}, which is not an observable of {model.name}{near}"
                complaints.append(Complaint((*path, *place), text))
        moved = moved_by(run)
        if isinstance(figure, Hysteresis) and figure.parameter not in (None, moved):
            text = f"is {figure.parameter}, but this run moves {moved}: leave it out."
            complaints.append(Complaint((*path, "parameter"), text))
        if isinstance(figure, GaitRamp) and moved is None:
            text = "is gait_ramp, but this run moves nothing: name its run.parameter, with path and rate."
            complaints.append(Complaint((*path, "kind"), text))
        if len(complaints) == before:
            complaints += [Complaint((*path, *place), text) for place, text in refusals(figure, given)]
        stem = figure.name or figure.kind
        if stem in stems:
            text = f"is {stem}, the name of figures[{stems[stem]}] too: give each figure a name of its own."
            complaints.append(Complaint((*path, "name"), text))
        stems.setdefault(stem, index)
    return complaints
