"""What every kind of figure gives: its fields in a job, the runs and columns that it needs, its drawing."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar

from matplotlib.figure import Figure

from gaitsweep import near_miss
from gaitsweep.contract import Model
from gaitsweep.kinds.diagnostics import Path, found
from gaitsweep.kinds.part import Part, kind_of
from gaitsweep.kinds.run_kind import Rows, RunKind

TITLE = "text above the figure"
NAME = "file stem of the figure; its kind if not given"
HUE = "column that colours the points"
BANDWIDTH = "half the window of the smoothing, in the unit of y; 0.05 rad for an angle if not given"
TEXT_COLUMNS = frozenset({"status", "gait", "special", "end", "slowest", "stalled_by"})

Refusal = tuple[Path, str]  # where in the figure, and the end of the sentence


@dataclasses.dataclass(frozen=True)
class PlannedTable:
    """What is known of a table before its job runs: the rows, the run, and the names of its columns."""

    rows: Rows
    run: RunKind
    columns: Sequence[str]

    @property
    def model(self) -> Model:
        return self.rows.model

    @property
    def varied(self) -> tuple[str, ...]:
        return self.rows.names

    def missing(self, names: Sequence[str]) -> str | None:
        """The first of the names that is no column."""
        return next((name for name in names if name not in self.columns), None)

    def unit(self, column: str) -> str:
        """A column's unit; empty where it has none."""
        quantities = {c.name: c.quantity for c in self.run.columns(self.model) if c.quantity is not None}
        quantities |= {q.name: q for q in (*self.model.parameters, *self.model.initial_conditions)}
        return quantities[column].unit if column in quantities else ""


class FigureKind(Part):
    """A figure that a job may ask for.

    A kind has a field `kind: Literal["its_name"]` and may have `title` and `name`; its other fields are
    arguments of `draw`, which gets the table first. `check` finds what the job alone shows to be wrong; what
    only the table shows is refused by `draw`.
    """

    draw: ClassVar[Callable[..., Figure]]
    runs: ClassVar[tuple[str, ...]] = ()  # the kinds of runs that it suits
    column_fields: ClassVar[tuple[str, ...]] = ()  # the fields that name columns of the table
    observable_fields: ClassVar[tuple[str, ...]] = ()  # those that name observables, one or a list
    axis_fields: ClassVar[tuple[str, ...]] = ()  # those that name columns of numbers, drawn along an axis

    @property
    def kind_name(self) -> str:
        """The value of its field `kind`."""
        return kind_of(type(self))

    @property
    def stem(self) -> str:
        """The name of its file, without the ending."""
        return getattr(self, "name", None) or self.kind_name

    def suits(self, run: RunKind) -> bool:
        """Whether it can be drawn of a run's table."""
        return run.kind_name in self.runs or self.kind_name in run.figures

    def columns(self) -> dict[str, str]:
        """The columns that it names, by field."""
        named = {field: getattr(self, field) for field in self.column_fields}
        return {field: column for field, column in named.items() if column is not None}

    def observed(self) -> dict[tuple[str | int, ...], str]:
        """The observables that it names, by where in it they stand."""
        places: dict[tuple[str | int, ...], str] = {}
        for field in self.observable_fields:
            named = getattr(self, field)
            if isinstance(named, list):
                places |= {(field, number): name for number, name in enumerate(named)}
            else:
                places[field,] = named
        return places

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        """Why this kind of figure cannot be drawn of the table, beside what all kinds have in common."""
        yield from ()

    def refusals(self, table: PlannedTable) -> Iterator[Refusal]:
        """Why it cannot be drawn of the table, whose columns and observables that it names are there."""
        yield from self._titles()
        along = [(field, getattr(self, field)) for field in self.axis_fields]
        for number, (field, column) in enumerate(along):
            if column in TEXT_COLUMNS:
                numbers = [name for name in table.columns if name not in TEXT_COLUMNS]
                yield (
                    (field,),
                    f"is {column}, which has no numbers for an axis. {near_miss.allowing(numbers)}",
                )
            elif column is not None and column in [other for _, other in along[:number]]:
                yield (field,), f"is {column}, as {along[0][0]} is: name another column."
        yield from self.check(table)

    def needs(self, table: PlannedTable, what: str) -> Refusal:
        """The refusal of a table that lacks columns."""
        text = (
            f"is {self.kind_name}, which needs {what}: a run of {table.run.kind_name} of {table.model.name}"
        )
        return ("kind",), f"{text} has no such column."

    def _titles(self) -> Iterator[Refusal]:
        """What Matplotlib cannot set between dollar signs."""
        texts: list[tuple[Path, str]] = []
        for field in ("title", "titles", "points", "intervals"):
            written: Any = getattr(self, field, None)
            if isinstance(written, str):
                texts.append(((field,), written))
            elif written:
                texts += [((field, at if isinstance(written, list) else str(each)), str(each))
                          for at, each in enumerate(written)]  # fmt: skip
        for path, text in texts:
            if text.replace("\\$", "").count("$") < 2:
                continue
            from matplotlib.mathtext import MathTextParser  # only for a job that has formulas in its titles

            try:
                MathTextParser("path").parse(text)
            except (ValueError, RuntimeError, RecursionError):
                told = f"is {found(text)}, whose formula Matplotlib cannot set"
                yield path, f"{told}: write TeX between two dollar signs, and \\$ for a dollar."
