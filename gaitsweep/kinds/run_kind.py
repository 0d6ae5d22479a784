"""The interface of a run kind, `RunKind`, and that of one that makes its own records, `TableRunKind`."""

from __future__ import annotations

import abc
import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, final

import numpy as np
import pandas as pd
from jaxtyping import Array, Bool, Float, Int
from pydantic import ValidationError

from gaitsweep.contract import Model
from gaitsweep.design import Design
from gaitsweep.engine.recorders.recorder import Recorder
from gaitsweep.engine.solver.methods import derivative_refusal
from gaitsweep.engine.sweep.boundary_cells import Grid
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.errors import ArgumentError
from gaitsweep.kinds.columns import Column, Records, row_number
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.diagnostics import Path as FieldPath
from gaitsweep.schema.strict_model import SchemaSection, StrictModel, from_pydantic, kind_of, plain


@dataclasses.dataclass(frozen=True)
class Movement:
    """A parameter that a run moves along `values`, and the fields of the job with its name and its values."""

    parameter: str
    values: tuple[float, ...]
    name_path: FieldPath
    values_path: FieldPath


class BlockProgress(Protocol):
    """Progress callback of a run kind that makes its own table: a note, and the share of the block done."""

    def __call__(self, note: str = "", share: float = 0.0) -> None: ...


class Schedule(Protocol):
    """The values of a parameter that moves: `times` (s) between which the length of steps is chosen."""

    @property
    def times(self) -> tuple[float, ...]: ...

    def at(self, t: Float[Array, " *times"]) -> Float[Array, " *times"]:
        """The parameter at time `t` (s)."""
        ...


@dataclasses.dataclass(frozen=True)
class Cost:
    """The likely and the largest number of attempts of a row, and the likely number of its records.

    `longer` and `longer_records` are the numbers of a row whose branch folds, for kinds that follow branches.
    """

    likely: float
    most: float
    records: float = 1.0
    longer: float | None = None
    longer_records: float | None = None


@dataclasses.dataclass(frozen=True)
class StartingPoints:
    """Whether each row has a starting point (n,), and the observables there (n, k)."""

    exists: Bool[np.ndarray, " sampled"]
    observed: Float[np.ndarray, "sampled observables"]


class RunKind(StrictModel, abc.ABC):
    """The task of each row of a job.

    1. A kind gives a field `kind: Literal["its_name"]`, `recorder`, `columns` and `cost`. A kind that moves a
       parameter has the fields `parameter` and `path`.
    2. It may give the class variables and the members that have a default: `check`; `columns_of_block`;
       `model_of` where its rows have parameters beside those of the model; `filled` where an earlier table
       gives values of its rows; `movements` where it moves several parameters; `schedule` where a parameter
       moves while a row runs; `refined` where only some rows are simulated; `integrates`; `rests` where rows
       rest; `findings` with `columns_of_findings` for sentences about a table, and `tables` for other files.
    3. A kind whose records the sweep engine does not make derives from `TableRunKind`.

    In Python it is created without `kind`, as in `Settle(max_cycles=150)`; NumPy arrays and numbers are
    accepted.

    Raises:
        ArgumentError: an unknown field, or a value that is not allowed.
    """

    # how the self-check compares rows with the same rows at finer steps: at the fixed points where they
    # settle, at their ends, or at their first crossings
    compared: ClassVar[Literal["settled", "ends", "crossings"]] = "crossings"
    one_a_row: ClassVar[bool] = False  # whether the table has one record for each row
    figures: ClassVar[tuple[str, ...]] = ()  # kinds of figures of its table, beside those that name it
    # the fields without effect while the field of the key is not set: they are left out of the hash, so that
    # results that are older than these fields keep theirs
    idle_without: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    unhashed: ClassVar[tuple[str, ...]] = ()  # fields that say where values in the job are from

    def __init__(self, **fields: Any) -> None:
        kind = self.kind_name
        try:
            super().__init__(**{"kind": kind, **plain(fields)})
        except ValidationError as error:
            section = SchemaSection(f"run ({kind})", type(self), "run")
            wrong = from_pydantic(error, {kind: section}, kind, ("run",))
            raise ArgumentError("\n".join(map(str, wrong))) from None

    # pydantic then does not call it while it reads a job, whose errors are reported together
    __init__.__pydantic_base_init__ = True  # pyright: ignore[reportFunctionMemberAccess]

    @classmethod
    def model_of(cls, model: Model, written: Mapping[str, Any]) -> tuple[Model, list[Diagnostic]]:
        """The model of the rows of such a run, and diagnostics; by default that of the job.

        Args:
            model: the job's model.
            written: the fields of the run as written, which are not checked yet.
        """
        return model, []

    @classmethod
    def filled(
        cls, fields: Mapping[str, Any], model: Model, folder: Path
    ) -> tuple[dict[str, Any], list[Diagnostic]]:
        """The fields of a job with those that an earlier table gives, and diagnostics; by default as written.

        Args:
            fields: those of the job as written, which are not checked yet.
            model: the model of its rows, from `model_of`.
            folder: the job's, to which its paths are relative.
        """
        return dict(fields), []

    @property
    @final
    def kind_name(self) -> str:
        """The value of the field `kind`."""
        return kind_of(type(self))

    @property
    @final
    def moved(self) -> str | None:
        """The parameter that moves along `path`, or None."""
        return getattr(self, "parameter", None) if hasattr(self, "path") else None

    @property
    @final
    def turns(self) -> tuple[float, ...]:
        """The values between which the parameter moves, in order; empty if none moves."""
        return tuple(getattr(self, "path", None) or ())

    @property
    def movements(self) -> tuple[Movement, ...]:
        """The parameters that move; by default that of the fields `parameter` and `path`."""
        if self.moved is None:
            return ()
        return (Movement(self.moved, self.turns, ("run", "parameter"), ("run", "path")),)

    @final
    def places(self) -> Iterator[Mapping[str, float]]:
        """Values of the moving parameters at which the length of steps is chosen."""
        names = [movement.parameter for movement in self.movements]
        along = [path_values(movement.values) for movement in self.movements]
        return (dict(zip(names, at, strict=True)) for at in itertools.product(*along))

    @final
    def extreme_places(self) -> list[Mapping[str, float]]:
        """The `places` with the least, the middle and the largest values."""
        places = sorted(self.places(), key=lambda place: list(place.values()))
        return places[:: max(1, (len(places) - 1) // 2)]

    @abc.abstractmethod
    def recorder(self, model: Model) -> Recorder:
        """Recorder of each trajectory, which also decides when the trajectory ends."""

    @abc.abstractmethod
    def columns(self, model: Model) -> list[Column]:
        """The columns of the table after `row` and the axes, in order."""

    @abc.abstractmethod
    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        """Estimated attempts and records of a row.

        Args:
            rows: the job's rows.
            cycle: attempts in a cycle.
            period: length of a cycle, s.
        """

    def columns_of_block(self, model: Model, block: RowOutcome) -> list[Column]:
        """Columns after all others that the records of this block have; other blocks may lack them."""
        return []

    def schedule(self) -> Schedule | None:
        """The schedule of the parameter that moves while a row runs; None: no parameter moves."""
        return None

    def check(self, rows: Design, method: str) -> list[Diagnostic]:
        """Diagnostics of the fields beyond those of their types, by themselves and for these rows.

        Args:
            rows: the job's rows.
            method: the integration method that the job uses.
        """
        return []

    def refined(self, rows: Design) -> Grid | None:
        """The grid of which only the boundaries between gaits are simulated; None: all rows are simulated."""
        return None

    @property
    def integrates(self) -> bool:
        """Whether the table depends on the steps of an integration, which the self-check refines."""
        return True

    def rests(self, model: Model, records: pd.DataFrame) -> pd.DataFrame | None:
        """The places where rows rest, from all records of some rows; None: rows of this kind do not rest.

        Returns:
            A record for each of `records`: whether the row `rests` there, the number of the `crossing`, the
            `period` of its orbit in crossings, and the observables by their names.
        """
        return None

    @property
    def columns_of_findings(self) -> tuple[str, ...]:
        """The columns of the table that `findings` reads; empty: it has none."""
        return ()

    def findings(self, table: pd.DataFrame) -> list[str]:
        """Sentences about a complete table, for the output of commands and the report."""
        return []

    def tables(self, table: pd.DataFrame) -> dict[str, pd.DataFrame]:
        """The parts of a complete table that are files of their own beside it, by the name of the file."""
        return {}

    @classmethod
    @final
    def idle(cls, fields: Mapping[str, Any]) -> set[str]:
        """The names of those fields that have no effect beside the others (`idle_without`)."""
        return {name for key, names in cls.idle_without.items() if not fields.get(key) for name in names}

    @final
    def hashed(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        """The fields that decide the numbers of the table."""
        idle = self.idle(fields)
        return {name: value for name, value in fields.items() if name not in {*idle, *self.unhashed}}

    @final
    def all_columns(self, model: Model) -> list[Column]:
        """The columns, and those of the recorder's numbers that have a quantity."""
        declared = (number.quantity for number in self.recorder(model).numbers if number.quantity is not None)
        return [*self.columns(model), *map(row_number, declared)]

    @final
    def table(
        self, model: Model, axes: Mapping[str, Float[np.ndarray, " rows"]], block: RowOutcome
    ) -> pd.DataFrame:
        """The records of a block of rows.

        Args:
            model: the rows' model.
            axes: the values of the axes, (n,) each.
            block: the results of the n rows.
        """
        names = None if self.one_a_row else self.recorder(model).names
        records = Records.of(model, block, names)
        columns: dict[str, Any] = {"row": records.rows}
        columns |= {name: records.of_row(values) for name, values in axes.items()}
        declared = [*self.all_columns(model), *self.columns_of_block(model, block)]
        columns |= {column.name: column.values(records) for column in declared}
        return pd.DataFrame(columns, copy=False)


class TableRunKind(RunKind):
    """A run kind that makes the records of its rows itself, from fixed points at which these begin."""

    stores_starting_points: ClassVar[bool] = False  # whether the first record of a row is its starting point

    @abc.abstractmethod
    def block_table(
        self, rows: Design, spec: SweepSpec, first: int, last: int, on_progress: BlockProgress
    ) -> pd.DataFrame:
        """The records of rows first..last-1; `on_progress` is called repeatedly meanwhile."""

    @abc.abstractmethod
    def compile_time(self, rows: Design, spec: SweepSpec) -> float:
        """Estimated time (s) in which the programs of `block_table` are compiled."""

    @abc.abstractmethod
    def starting_points(
        self, rows: Design, spec: SweepSpec, sample: Int[np.ndarray, " sampled"], *shares: float
    ) -> list[StartingPoints]:
        """The fixed points at which the records of some rows begin, for each of these shares of the step."""


def check_derivative(model: Model, method: str) -> list[Diagnostic]:
    """Diagnostics about a method with which the return map of a model has no derivative."""
    try:
        refusal = derivative_refusal(method, model)
    except ArgumentError:  # which the check of the method reports
        return []
    text = f"is {method}, with which a return map has no derivative: {refusal}"
    return [] if refusal is None else [Diagnostic(("numerics", "method"), text)]


def check_path(path: Sequence[float]) -> list[Diagnostic]:
    """A diagnostic of the first value of `run.path` that is equal to the value before it."""
    for index, (before, value) in enumerate(itertools.pairwise(path), start=1):
        if value == before:
            text = f"is {value:g}, like the value before it: remove one of the two."
            return [Diagnostic(("run", "path", index), text)]
    return []


def path_values(path: Sequence[float]) -> Iterator[float]:
    """The values of a path, and three between each and the next."""
    yield path[0]
    for a, b in itertools.pairwise(path):
        yield from (a + (b - a) * share for share in (0.25, 0.5, 0.75, 1.0))


def table_columns(rows: Design, run: RunKind) -> list[str]:
    """The columns of the table of a run, in order."""
    return ["row", *rows.names, *(column.name for column in run.all_columns(rows.model))]
