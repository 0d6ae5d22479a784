"""Checks of a job's figures and their style, against the columns of its table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gaitsweep import near_miss
from gaitsweep.design.design import Design
from gaitsweep.kinds import RUN_KINDS, RunKind
from gaitsweep.kinds.run_kind import table_columns
from gaitsweep.plot.figure_style import FigureStyle
from gaitsweep.plot.kind import FIGURES, FigureKind, PlannedTable, kinds_with_gait_colours
from gaitsweep.plot.style_names import StyleNames
from gaitsweep.schema.diagnostics import Diagnostic, Path, unknown_name
from gaitsweep.schema.strict_model import kind_of


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
    uses_colours = any(
        figure.colours_of(name, dict(figure)) for figure in figures.values() for name in colours
    )
    if figures and colours and not uses_colours:
        kinds = ", ".join(figure.kind_name for figure in figures.values())
        text = f"has no effect: no figure of this job colours gaits ({kinds}). {kinds_with_gait_colours()}"
        wrong.append(Diagnostic(("style", "colours"), f"{text} Remove it."))
    return wrong


def _check_figure(
    figure: FigureKind, path: Path, table: PlannedTable, columns: Sequence[str]
) -> list[Diagnostic]:
    """Return errors about the columns and observables of a figure, or else about what it refuses."""
    observables = [quantity.name for quantity in table.model.observables]
    unknown = [
        Diagnostic(
            (*path, field),
            f"is {column}, which is not a column of this job's table"
            + near_miss.column_suggestion(column, columns),
        )
        for field, column in figure.columns().items()
        if column not in columns
    ]
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
    suited_figures = [
        name for name, kind in FIGURES.items() if kind.suits(type(run)) and kind.needs_are_met(table)
    ]
    text = (
        f"is {figure.kind_name}, which needs a run of kind {suited_runs}, not {run.kind_name}. "
        f"Figures of {run.kind_name} for {table.model.name}: {', '.join(suited_figures)}."
    )
    if "orbit" in suited_figures:
        text += " An observable over a parameter is an orbit: x: PARAMETER, y: OBSERVABLE."
    return Diagnostic((*path, "kind"), text)
