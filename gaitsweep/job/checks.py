"""Whether a run can be made, and every value that its rows take is one that its model allows."""

from __future__ import annotations

import dataclasses
import graphlib
import itertools
import math
from collections.abc import Mapping

import numpy as np

from gaitsweep import near_miss
from gaitsweep.contract import Model, Quantity
from gaitsweep.expression import CONSTANTS, ExpressionError
from gaitsweep.job.axes import Spread
from gaitsweep.job.plan import MOST_CHECKED, Plan, inside, must
from gaitsweep.job.subject import Subject
from gaitsweep.kinds.complaints import Complaint, Path
from gaitsweep.kinds.runs import (
    MOST_SAMPLES,
    MOST_STAIRS,
    Continuation,
    Ramp,
    Settle,
    Staircase,
    Trace,
    moved_by,
)

_CHUNK = 50_000
_MOST_TURNS = 20  # of a path, at each of which formulas are checked; of a longer one at its ends alone


def check_names(plan: Plan, subject: Subject) -> list[Complaint]:
    """Complaints about formulas that use what is not there, or that go round in a circle."""
    complaints: list[Complaint] = []
    own = [*subject.parameters, *subject.sizes]
    for name in [*plan.settings, *plan.names]:
        allowed = own if name in subject.parameters else [*own, *subject.starts]
        for used in sorted(plan.uses(name)):
            if used in allowed:
                continue
            text = f"uses {used}, which is not a parameter of {subject.model.name}"
            if used in subject.starts:
                text = f"uses {used}, a start value, on which no parameter may depend"
            text += near_miss.suggestion(used, [*allowed, *CONSTANTS])
            complaints.append(Complaint(place(plan, subject, name), text))
    if complaints:
        return complaints
    try:
        plan.order  # noqa: B018 - computing the order is what finds a circle
    except graphlib.CycleError as error:
        circle = list(reversed(error.args[1]))
        text = f"depends on itself: {' -> '.join(circle)}."
        complaints.append(Complaint(place(plan, subject, circle[0]), text))
    return complaints


def check_ranges(plan: Plan, subject: Subject, run: object) -> list[Complaint]:
    """Complaints about values outside what the model allows, each with the first row that has one."""
    complaints: list[Complaint] = []
    moving = moved_by(run)
    wrong: set[str] = set()
    for name in plan.order:
        if name == moving or plan.closure([name]) & wrong:
            continue  # what follows from a wrong value is not told beside it
        complaint = _check_quantity(plan, subject, name, subject.quantities[name])
        if complaint is not None:
            complaints.append(complaint)
            wrong.add(name)
    if isinstance(run, Ramp | Staircase | Trace | Continuation) and run.parameter is not None:
        complaints.extend(_check_path(plan, subject, run))
    return complaints


def check_run(run: object) -> list[Complaint]:
    """Complaints about a run whose own fields do not fit each other."""
    if isinstance(run, Trace):
        return _check_trace(run)
    if isinstance(run, Continuation):
        return _check_continuation(run)
    return _check_stairs(run) if isinstance(run, Staircase) else []


def check_tolerance(run: object, model: Model) -> list[Complaint]:
    """Complaints about tolerances of what the model does not observe."""
    if not isinstance(run, Settle | Staircase) or not isinstance(run.tolerance, Mapping):
        return []
    names = [quantity.name for quantity in model.observables]
    return [
        Complaint(
            ("run", "tolerance", name),
            f"is not an observable of {model.name}{near_miss.suggestion(name, names)}",
        )
        for name in run.tolerance
        if name not in names
    ]


def _check_trace(run: Trace) -> list[Complaint]:
    if run.every > run.duration:
        text = f"is {run.every:g} s, but must not be longer than run.duration, {run.duration:g} s."
        return [Complaint(("run", "every"), text)]
    if run.duration / run.every > MOST_SAMPLES:
        text = f"makes {run.duration / run.every:.3g} samples a row; at most {MOST_SAMPLES} are kept."
        return [Complaint(("run", "every"), text)]
    return _check_way(run)


def _check_way(run: Trace) -> list[Complaint]:
    """Complaints about how a trace's parameter moves: all of it is said, or nothing."""
    if run.parameter is None:
        given = [name for name in Trace.ALONG if name in run.model_fields_set and getattr(run, name)]
        return [Complaint(("run", name), "moves nothing: name its run.parameter.") for name in given]
    for name in ("path", "rate"):
        if getattr(run, name) is None:
            return [Complaint(("run", name), f"is missing, but {run.parameter} moves along it.")]
    if run.after_cycles:
        text = f"is {run.after_cycles}, but {run.parameter} moves from the start: use run.hold."
        return [Complaint(("run", "after_cycles"), text)]
    return []


def _check_continuation(run: Continuation) -> list[Complaint]:
    if run.path[0] == run.path[1]:
        return [Complaint(("run", "path", 1), f"is {run.path[1]:g}, as where the branch starts.")]
    if not run.shortest <= run.step <= run.longest:
        text = f"is {run.step:g}, but must lie between run.shortest, {run.shortest:g}, and run.longest, "
        return [Complaint(("run", "step"), f"{text}{run.longest:g}.")]
    return []


def _check_stairs(run: Staircase) -> list[Complaint]:
    pairs = list(itertools.pairwise(run.path))
    for index, (before, value) in enumerate(pairs, start=1):
        if value == before:
            text = f"is {value:g}, as the value before it is: leave one of the two out."
            return [Complaint(("run", "path", index), text)]
    stairs = 1.0 + sum(max(1.0, abs(b - a) / run.step) for a, b in pairs)
    if stairs > MOST_STAIRS:
        text = f"is {run.step:g}, which makes {stairs:.6g} stairs; at most {MOST_STAIRS} are made."
        return [Complaint(("run", "step"), text)]
    return []


def place(plan: Plan, subject: Subject, name: str) -> Path:
    """Where the value of a name is written, or would be."""
    for group in plan.groups:
        if name in group.paths:
            return group.paths[name]
    return ("params" if name in subject.parameters else "start", name)


def _check_quantity(plan: Plan, subject: Subject, name: str, quantity: Quantity) -> Complaint | None:
    path = place(plan, subject, name)
    if not plan.checkable(name):
        return None  # Plan.values checks these, block by block
    if _between_its_ends(plan, name, quantity):
        return None
    spans = [(plan.groups[position].length, plan.stride(position)) for position in plan.spans(name)]
    count = math.prod(length for length, _ in spans)
    for begin in range(0, count, _CHUNK):
        points = np.arange(begin, min(begin + _CHUNK, count), dtype=np.int64)
        rows = _rows_of(points, spans)
        try:
            values = plan.at(rows, [name])[name]
        except ExpressionError as error:
            return Complaint(path, f"has no value: {error}")
        wrong = np.flatnonzero(~inside(values, quantity))
        if wrong.size:
            row = int(rows[wrong].min()) if spans else None
            value = float(values[wrong[np.argmin(rows[wrong])]])
            return Complaint(path, _out_of_range(plan, name, quantity, value, row))
    return None


def _between_its_ends(plan: Plan, name: str, quantity: Quantity) -> bool:
    """Whether a name has all its points between two numbers that the model allows: none need be made."""
    for group in plan.groups:
        points = group.points.get(name)
        if isinstance(points, Spread) and not points.formulas:
            ends = np.array([points.low, points.high], np.float64)
            return bool(inside(ends, quantity).all()) and not (points.logarithmic and ends.min() <= 0.0)
    return False


def _rows_of(points: np.ndarray, spans: list[tuple[int, int]]) -> np.ndarray:
    """The rows that go through all combinations of some axes, the others at their first point."""
    rows = np.zeros_like(points)
    for length, stride in reversed(spans):
        rows += points % length * stride
        points = points // length
    return rows


def _out_of_range(plan: Plan, name: str, quantity: Quantity, value: float, row: int | None) -> str:
    setting = plan.settings.get(name)
    formula = f'"{setting}", which is ' if isinstance(setting, str) else ""
    where = "" if row is None else f" in row {row}"
    return f"is {formula}{value:g}{where}, but {must(quantity)}."


def _check_path(
    plan: Plan, subject: Subject, run: Ramp | Staircase | Trace | Continuation
) -> list[Complaint]:
    moving, path = str(run.parameter), run.path or []
    quantity = subject.parameters[moving]
    complaints = []
    for index, value in enumerate(path):
        if not inside(np.array(value), quantity):
            complaints.append(Complaint(("run", "path", index), f"is {value:g}, but {must(quantity)}."))
    if complaints:
        return complaints
    for name in plan.following(moving):
        rows = math.prod(plan.groups[position].length for position in plan.spans(name))
        few = rows * len(path) <= MOST_CHECKED and len(path) <= _MOST_TURNS
        turns = sorted(set(path)) if few else [min(path), max(path)]
        for value in turns:
            there = dataclasses.replace(plan, settings={**plan.settings, moving: value})
            complaint = _check_quantity(there, subject, name, subject.parameters[name])
            if complaint is not None:
                where = f"where the {run.kind} has {moving} = {value:g}."
                text = f"{complaint.text.removesuffix('.')}, {where}"
                complaints.append(Complaint(complaint.path, text))
                break
    return complaints
