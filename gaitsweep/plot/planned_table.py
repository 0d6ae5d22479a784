"""The table of a job that has not run yet, for checks of its figures."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from gaitsweep.contract import Model
from gaitsweep.design import Design
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.schema.diagnostics import Path

Refusal = tuple[Path, str]  # where in the figure, and the end of the sentence


@dataclasses.dataclass(frozen=True)
class PlannedTable:
    """The rows, the run and the columns of a table whose job has not run yet."""

    rows: Design
    run: RunKind
    columns: Sequence[str]

    @property
    def model(self) -> Model:
        return self.rows.model

    @property
    def varied(self) -> tuple[str, ...]:
        return self.rows.names

    def missing(self, names: Sequence[str]) -> str | None:
        """The first of the names that is not a column."""
        return next((name for name in names if name not in self.columns), None)

    def unit(self, column: str) -> str:
        """A column's unit, or an empty text."""
        quantities = {c.name: c.quantity for c in self.run.all_columns(self.model) if c.quantity is not None}
        quantities |= {q.name: q for q in (*self.model.parameters, *self.model.initial_conditions)}
        return quantities[column].unit if column in quantities else ""
