"""Whether a model has the branches that a continuation asks for."""

from __future__ import annotations

from gaitsweep import near_miss
from gaitsweep.contract import Model
from gaitsweep.engine.propose import own_steps
from gaitsweep.kinds.complaints import Complaint
from gaitsweep.kinds.runs import Continuation


def check_branches(model: Model, run: object, method: str) -> list[Complaint]:
    """Complaints about a continuation of a map that has no derivative, or of what is not conserved."""
    if not isinstance(run, Continuation):
        return []
    complaints = []
    chart = model.chart()
    names = [] if chart is None else [quantity.name for quantity in chart.conserved]
    for index, name in enumerate(run.fix):
        if name not in names:
            near = near_miss.suggestion(name, names) if names else "."
            text = f"is {name}, which {model.name} does not conserve{near}"
            complaints.append(Complaint(("run", "fix", index), text))
    try:
        steps = own_steps(method, model)
    except ValueError:  # of which the check of the method tells
        return complaints
    if steps is not None:
        text = f"is {method}, steps of fixed length, through which a return map has no derivative: use rk4."
        complaints.append(Complaint(("numerics", "method"), text))
    return complaints
