"""Checks of a job's formulas, of the values of its rows and along its run's paths, and of its figures."""

from __future__ import annotations

import dataclasses
import graphlib
import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from gaitsweep import near_miss
from gaitsweep.contract import Quantity
from gaitsweep.design.axes import RangeAxis
from gaitsweep.design.design import MAX_CHECKED, Design, inside, requirement
from gaitsweep.expression import CONSTANTS, ExpressionError
from gaitsweep.job.model_spec import ModelSpec
from gaitsweep.kinds import RUN_KINDS, RunKind
from gaitsweep.kinds.run_kind import Movement, table_columns
from gaitsweep.plot.figure_style import FigureStyle
from gaitsweep.plot.kind import FIGURES, FigureKind, PlannedTable, kinds_with_gait_colours
from gaitsweep.plot.style_names import StyleNames
from gaitsweep.schema.diagnostics import Diagnostic, Path, unknown_name
from gaitsweep.schema.strict_model import kind_of

_CHUNK = 50_000  # rows whose values are checked at a time
# Turns of a path at which, and between which, formulas are checked; of a longer path its ends alone are.
_MAX_TURNS = 20
_PARTS = 32  # of the way between two turns, at whose ends formulas are checked


def check_names(design: Design, spec: ModelSpec) -> list[Diagnostic]:
    """Return errors about formulas that use unknown names or depend on themselves.

    Args:
        design: the job's rows.
        spec: its model.
    """
    diagnostics: list[Diagnostic] = []
    for_parameters = [*spec.parameters, *spec.sizes]
    for name in [*design.settings, *design.names]:
        allowed = for_parameters if name in spec.parameters else [*for_parameters, *spec.starts]
        for used in sorted(design.uses(name)):
            if used in allowed:
                continue
            text = f"uses {used}, which is not a parameter of {spec.model.name}"
            if used in spec.starts:
                text = f"uses {used}, which is a start value; parameters cannot depend on start values"
            text += near_miss.suggestion(used, [*allowed, *CONSTANTS])
            diagnostics.append(Diagnostic(path_of_value(design, spec, name), text))
    if diagnostics:
        return diagnostics
    try:
        design.order  # noqa: B018 - its computation finds a cycle
    except graphlib.CycleError as error:
        cycle = list(reversed(error.args[1]))
        text = f"depends on itself: {' -> '.join(cycle)}."
        diagnostics.append(Diagnostic(path_of_value(design, spec, cycle[0]), text))
    return diagnostics


def check_ranges(design: Design, spec: ModelSpec, run: RunKind) -> list[Diagnostic]:
    """Return errors about values that the model does not allow, each with the first such row.

    Args:
        design: the job's rows.
        spec: its model.
        run: its run, whose moving parameters are checked along their paths.
    """
    diagnostics: list[Diagnostic] = []
    moving = run.moved
    wrong: set[str] = set()
    for name in design.order:
        if name == moving or design.closure([name]) & wrong:
            continue  # values that follow from a wrong value are not reported
        diagnostic = _check_quantity(design, spec, name, spec.quantities[name])
        if diagnostic is not None:
            diagnostics.append(diagnostic)
            wrong.add(name)
    for movement in run.movements:
        diagnostics.extend(_check_path(design, spec, run, movement))
    return diagnostics


def path_of_value(design: Design, spec: ModelSpec, name: str) -> Path:
    """Return the path of a parameter's or start's value in the job, even if the job leaves it out.

    Args:
        design: the job's rows.
        spec: its model.
        name: the parameter or start.
    """
    for group in design.groups:
        if name in group.paths:
            return group.paths[name]
    return ("params" if name in spec.parameters else "start", name)


def _check_quantity(design: Design, spec: ModelSpec, name: str, quantity: Quantity) -> Diagnostic | None:
    """Return the diagnostic of the first row whose value of a quantity is not allowed, or None."""
    path = path_of_value(design, spec, name)
    if not design.checkable(name):
        return None  # Design.values checks these, block by block
    if _between_its_ends(design, name, quantity):
        return None
    spans = design.spans(name)
    count = math.prod(design.groups[position].length for position in spans)
    for begin in range(0, count, _CHUNK):
        points = np.arange(begin, min(begin + _CHUNK, count), dtype=np.int64)
        rows = design.rows_over(points, spans)
        try:
            values = design.at(rows, [name])[name]
        except ExpressionError as error:
            return Diagnostic(path, f"has no value: {error}")
        wrong = np.flatnonzero(~inside(values, quantity))
        if wrong.size:
            setting = design.settings.get(name)
            formula = f'"{setting}", which is ' if isinstance(setting, str) else ""
            first = wrong[np.argmin(rows[wrong])]
            in_row = f" in row {rows[first]}" if spans else ""
            return Diagnostic(path, f"is {formula}{values[first]:g}{in_row}, but {requirement(quantity)}.")
    return None


def _between_its_ends(design: Design, name: str, quantity: Quantity) -> bool:
    """Return whether both ends of a name's axis are allowed, so that its points need no check."""
    for group in design.groups:
        axis = group.axes.get(name)
        if isinstance(axis, RangeAxis) and not axis.formulas and not quantity.whole:
            ends = np.array([axis.low, axis.high], np.float64)
            return bool(inside(ends, quantity).all()) and not (axis.logarithmic and ends.min() <= 0.0)
    return False


def _check_path(design: Design, spec: ModelSpec, run: RunKind, movement: Movement) -> list[Diagnostic]:
    """Return errors of values that a moving parameter, or one that follows it, must not have."""
    moving = movement.parameter
    turns = movement.values
    quantity = spec.parameters[moving]
    diagnostics = [
        Diagnostic((*movement.values_path, index), f"is {value:g}, but {requirement(quantity)}.")
        for index, value in enumerate(turns)
        if not inside(np.array(value), quantity)
    ]
    if diagnostics:
        return diagnostics
    pairs = {(min(pair), max(pair)) for pair in itertools.pairwise(turns)}
    for name in design.following(moving):
        # stairs may be whole where the places between turns are not
        is_whole = quantity.whole or spec.parameters[name].whole
        rows = math.prod(design.groups[position].length for position in design.spans(name))
        between = MAX_CHECKED // rows - len(set(turns))  # how many places between turns may be checked
        parts = 1 if is_whole else min(_PARTS, max(between, 0) // max(len(pairs), 1) + 1)
        values = [*sorted(set(turns)), *(a + (b - a) * k / parts for a, b in pairs for k in range(1, parts))]
        are_few = rows * len(values) <= MAX_CHECKED and len(turns) <= _MAX_TURNS
        for value in values if are_few else (min(turns), max(turns)):
            design_at_value = dataclasses.replace(design, settings={**design.settings, moving: value})
            diagnostic = _check_quantity(design_at_value, spec, name, spec.parameters[name])
            if diagnostic is not None:
                begin = diagnostic.text.removesuffix(".")
                text = f"{begin}, where the {run.kind_name} has {moving} = {value:g}."
                diagnostics.append(Diagnostic(diagnostic.path, text))
                break
    return diagnostics


def check_figures(
    figures: Mapping[int, FigureKind], style: FigureStyle, design: Design, run: RunKind
) -> list[Diagnostic]:
    """Return errors about figures that cannot be drawn from the run's table, or that share a name.

    Args:
        figures: the figures by their places in the job.
        style: the style of all figures.
        design: the job's rows.
        run: their run.
    """
    columns = table_columns(design, run)
    table = PlannedTable(design, run, columns)
    wrong = _check_style(figures, style, table, columns)
    stems: dict[str, int] = {}
    for index, figure in figures.items():
        path = ("figures", index)
        if not figure.suits(type(run)):
            wrong.append(_unsuited(figure, path, table))
            continue
        wrong += _check_figure(figure, path, table, columns)
        first = stems.setdefault(figure.stem, index)
        if first != index:
            text = f"is {figure.stem}, like that of figures[{first}]"
            text += f": give it a name of its own, such as name: {figure.stem}_{index + 1}."
            wrong.append(Diagnostic((*path, "name"), text))
    return wrong


def _check_style(
    figures: Mapping[int, FigureKind], style: FigureStyle, table: PlannedTable, columns: Sequence[str]
) -> list[Diagnostic]:
    """Return errors about the style of all figures of a table with these columns."""
    names = StyleNames.of_model(table.model, columns)
    wrong = [Diagnostic(("style", *place), text) for place, text in names.unknown(style)]
    colours = style.colours or {}
    used = (figure.colours_of(name, dict(figure)) for figure in figures.values() for name in colours)
    if figures and colours and not any(used):
        kinds = ", ".join(figure.kind_name for figure in figures.values())
        text = f"has no effect: no figure of this job colours gaits ({kinds}). {kinds_with_gait_colours()}"
        wrong.append(Diagnostic(("style", "colours"), f"{text} Remove it."))
    return wrong


def _check_figure(
    figure: FigureKind, path: Path, table: PlannedTable, columns: Sequence[str]
) -> list[Diagnostic]:
    """Return errors about the columns and observables of a figure, or else about what it refuses."""
    observables = [quantity.name for quantity in table.model.observables]
    lacking = {field: column for field, column in figure.columns().items() if column not in columns}
    unknown = []
    for field, column in lacking.items():
        text = f"is {column}, which is not a column of this job's table"
        unknown.append(Diagnostic((*path, field), text + near_miss.column_suggestion(column, columns)))
    unknown += [
        unknown_name((*path, *place), name, f"an observable of {table.model.name}", observables)
        for place, name in figure.observed().items()
        if name not in observables
    ]
    return unknown or [Diagnostic((*path, *place), text) for place, text in figure.refusals(table)]


def _unsuited(figure: FigureKind, path: Path, table: PlannedTable) -> Diagnostic:
    """Return the diagnostic of a figure that cannot show the table of a run of this kind."""
    run = table.run
    others = [kind_of(run_kind) for run_kind in RUN_KINDS.values() if figure.kind_name in run_kind.figures]
    suited_runs = " or ".join(dict.fromkeys([*figure.runs, *others]))
    suited = {name: kind for name, kind in FIGURES.items() if kind.suits(type(run))}
    suited_figures = [name for name, kind in suited.items() if kind.needs_are_met(table)]
    text = (
        f"is {figure.kind_name}, which needs a run of kind {suited_runs}, not {run.kind_name}. "
        f"Figures of {run.kind_name} for {table.model.name}: {', '.join(suited_figures)}."
    )
    if "orbit" in suited_figures:
        text += " An observable over a parameter is an orbit: x: PARAMETER, y: OBSERVABLE."
    return Diagnostic((*path, "kind"), text)
