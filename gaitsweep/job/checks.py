"""Whether formulas can be worked out, rows have values that the model allows, and figures fit the run."""

from __future__ import annotations

import dataclasses
import graphlib
import math

import numpy as np

from gaitsweep import near_miss
from gaitsweep.contract import Quantity
from gaitsweep.expression import CONSTANTS, ExpressionError
from gaitsweep.job.axes import Spread
from gaitsweep.job.model_spec import ModelSpec
from gaitsweep.job.plan import MOST_CHECKED, Plan, inside, must
from gaitsweep.kinds import RUN_KINDS, RunKind
from gaitsweep.kinds.diagnostics import Diagnostic, JobError, Path
from gaitsweep.kinds.part import kind_of
from gaitsweep.kinds.run_kind import Movement, table_columns
from gaitsweep.models.conformity import NAMED, faults_of_rows
from gaitsweep.plot.kind import FigureKind, PlannedTable

_CHUNK = 50_000
# Rows at which a model's functions are evaluated before a job runs, and axes whose corners are among them.
_TRIED, _CORNERED = 64, 5
_MOST_TURNS = 20  # of a path, at each of which formulas are checked; of a longer one at its ends alone


def check_names(plan: Plan, spec: ModelSpec) -> list[Diagnostic]:
    """Diagnostics about formulas that use what is not there, or that go round in a circle."""
    diagnostics: list[Diagnostic] = []
    own = [*spec.parameters, *spec.sizes]
    for name in [*plan.settings, *plan.names]:
        allowed = own if name in spec.parameters else [*own, *spec.starts]
        for used in sorted(plan.uses(name)):
            if used in allowed:
                continue
            text = f"uses {used}, which is not a parameter of {spec.model.name}"
            if used in spec.starts:
                text = f"uses {used}, a start value, on which no parameter may depend"
            text += near_miss.suggestion(used, [*allowed, *CONSTANTS])
            diagnostics.append(Diagnostic(place(plan, spec, name), text))
    if diagnostics:
        return diagnostics
    try:
        plan.order  # noqa: B018 - computing the order is what finds a circle
    except graphlib.CycleError as error:
        circle = list(reversed(error.args[1]))
        text = f"depends on itself: {' -> '.join(circle)}."
        diagnostics.append(Diagnostic(place(plan, spec, circle[0]), text))
    return diagnostics


def check_ranges(plan: Plan, spec: ModelSpec, run: RunKind) -> list[Diagnostic]:
    """Diagnostics about values outside what the model allows, each with the first row that has one."""
    diagnostics: list[Diagnostic] = []
    moving = run.moved
    wrong: set[str] = set()
    for name in plan.order:
        if name == moving or plan.closure([name]) & wrong:
            continue  # what follows from a wrong value is not told beside it
        diagnostic = _check_quantity(plan, spec, name, spec.quantities[name])
        if diagnostic is not None:
            diagnostics.append(diagnostic)
            wrong.add(name)
    for movement in run.movements:
        diagnostics.extend(_check_path(plan, spec, run, movement))
    return diagnostics


def place(plan: Plan, spec: ModelSpec, name: str) -> Path:
    """Where the value of a name is written, or would be."""
    for group in plan.groups:
        if name in group.paths:
            return group.paths[name]
    return ("params" if name in spec.parameters else "start", name)


def _check_quantity(plan: Plan, spec: ModelSpec, name: str, quantity: Quantity) -> Diagnostic | None:
    path = place(plan, spec, name)
    if not plan.checkable(name):
        return None  # Plan.values checks these, block by block
    if _between_its_ends(plan, name, quantity):
        return None
    spans = plan.spans(name)
    count = math.prod(plan.groups[position].length for position in spans)
    for begin in range(0, count, _CHUNK):
        points = np.arange(begin, min(begin + _CHUNK, count), dtype=np.int64)
        rows = plan.rows_over(points, spans)
        try:
            values = plan.at(rows, [name])[name]
        except ExpressionError as error:
            return Diagnostic(path, f"has no value: {error}")
        wrong = np.flatnonzero(~inside(values, quantity))
        if wrong.size:
            setting = plan.settings.get(name)
            formula = f'"{setting}", which is ' if isinstance(setting, str) else ""
            where = f" in row {rows[wrong].min()}" if spans else ""
            value = values[wrong[np.argmin(rows[wrong])]]
            return Diagnostic(path, f"is {formula}{value:g}{where}, but {must(quantity)}.")
    return None


def _between_its_ends(plan: Plan, name: str, quantity: Quantity) -> bool:
    """Whether a name has all its points between two numbers that the model allows: none need be made."""
    for group in plan.groups:
        points = group.points.get(name)
        if isinstance(points, Spread) and not points.formulas:
            ends = np.array([points.low, points.high], np.float64)
            return bool(inside(ends, quantity).all()) and not (points.logarithmic and ends.min() <= 0.0)
    return False


def remarks_on_rows(plan: Plan, name: str) -> list[str]:
    """What `check-model` would say of a user's model at some of a job's own rows, a sentence each.

    The corners of the axes are among them, and all rows of a small job. A model of gaitsweep's own or with
    `host_parameters` is not looked at, nor rows of which a formula has no value: their block says so.

    Args:
        plan: the job's rows.
        name: that of the model in the job.
    """
    model = plan.model
    if model.host_parameters or type(model).__module__.startswith("gaitsweep."):
        return []
    rows = _some_rows(plan)
    try:
        values, starts = plan.values_in(rows)
        varied = plan.at(rows, plan.names[:NAMED])
    except (ExpressionError, JobError):
        return []

    def where(place: int) -> str:
        at = ", ".join(f"{name} = {each[place]:.6g}" for name, each in varied.items())
        more = ", ..." if len(plan.names) > NAMED else ""
        return f" at the start of row {rows[place]}" + (f" ({at}{more})" if at else "")

    return [f"The model is {name}, {words}" for words in faults_of_rows(model, values, starts, where)]


def _some_rows(plan: Plan) -> np.ndarray:
    """`_TRIED` rows: the corners of the first axes, then others drawn from all; of fewer rows some twice."""
    if plan.n_rows <= _TRIED:
        return np.arange(_TRIED) % plan.n_rows  # as many, so that the same program evaluates them
    axes = [place for place, group in enumerate(plan.groups) if group.length > 1][:_CORNERED]
    corners = np.zeros(1, np.int64)
    for place in axes:
        last = (plan.groups[place].length - 1) * plan.stride(place)
        corners = np.concatenate([corners, corners + last])
    others = np.random.default_rng(0).integers(0, plan.n_rows, _TRIED - corners.size - 1)
    return np.concatenate([corners, others, [plan.n_rows - 1]])


def _check_path(plan: Plan, spec: ModelSpec, run: RunKind, movement: Movement) -> list[Diagnostic]:
    moving, path = movement.parameter, movement.values
    quantity = spec.parameters[moving]
    diagnostics = []
    for index, value in enumerate(path):
        if not inside(np.array(value), quantity):
            diagnostics.append(Diagnostic((*movement.valued, index), f"is {value:g}, but {must(quantity)}."))
    if diagnostics:
        return diagnostics
    for name in plan.following(moving):
        rows = math.prod(plan.groups[position].length for position in plan.spans(name))
        few = rows * len(path) <= MOST_CHECKED and len(path) <= _MOST_TURNS
        turns = sorted(set(path)) if few else [min(path), max(path)]
        for value in turns:
            there = dataclasses.replace(plan, settings={**plan.settings, moving: value})
            diagnostic = _check_quantity(there, spec, name, spec.parameters[name])
            if diagnostic is not None:
                where = f"where the {run.kind_name} has {moving} = {value:g}."
                text = f"{diagnostic.text.removesuffix('.')}, {where}"
                diagnostics.append(Diagnostic(diagnostic.path, text))
                break
    return diagnostics


def check_figures(figures: list[FigureKind], plan: Plan, run: RunKind) -> list[Diagnostic]:
    """Diagnostics about figures that cannot be drawn of the run's table, or that have the same name."""
    model = plan.model
    columns = table_columns(plan, run)
    table = PlannedTable(plan, run, columns)
    observables = [quantity.name for quantity in model.observables]
    wrong: list[Diagnostic] = []
    stems: dict[str, int] = {}
    for index, figure in enumerate(figures):
        path = ("figures", index)
        if not figure.suits(run):
            others = [kind_of(part) for part in RUN_KINDS.values() if figure.kind_name in part.figures]
            suited = " or ".join(dict.fromkeys([*figure.runs, *others]))
            text = f"is {figure.kind_name}, which needs a run of {suited}"
            wrong.append(Diagnostic((*path, "kind"), f"{text}, not of {run.kind_name}."))
            continue
        before = len(wrong)
        for field, column in figure.columns().items():
            if column not in columns:
                near = near_miss.suggestion(column, columns)
                text = f"is {column}, which is not a column of this job's table{near}"
                wrong.append(Diagnostic((*path, field), text))
        for place, name in figure.observed().items():
            if name not in observables:
                near = near_miss.suggestion(name, observables)
                text = f"is {name}, which is not an observable of {model.name}{near}"
                wrong.append(Diagnostic((*path, *place), text))
        if len(wrong) == before:
            wrong += [Diagnostic((*path, *place), text) for place, text in figure.refusals(table)]
        if figure.stem in stems:
            text = f"is {figure.stem}, the name of figures[{stems[figure.stem]}] too"
            wrong.append(Diagnostic((*path, "name"), f"{text}: give each figure a name of its own."))
        stems.setdefault(figure.stem, index)
    return wrong
