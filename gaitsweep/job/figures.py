"""Whether the figures that a job asks for fit its run."""

from __future__ import annotations

from gaitsweep import near_miss
from gaitsweep.job.plan import Plan
from gaitsweep.kinds import RUN_KINDS, RunKind
from gaitsweep.kinds.diagnostics import Diagnostic
from gaitsweep.kinds.part import kind_of
from gaitsweep.kinds.run_kind import table_columns
from gaitsweep.plot.figure_kind import FigureKind, PlannedTable


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
            text = f"is {figure.kind_name}, which needs a run of {' or '.join(_suited(figure))}"
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


def _suited(figure: FigureKind) -> list[str]:
    """The kinds of runs that a figure suits."""
    others = [kind_of(part) for part in RUN_KINDS.values() if figure.kind_name in part.figures]
    return list(dict.fromkeys([*figure.runs, *others]))
