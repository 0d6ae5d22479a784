"""The results of rows, as one dataclass of arrays from the recorder to the table."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int, Num, Real

    from gaitsweep.contract import Quantity


@dataclasses.dataclass(frozen=True)
class RowNumber:
    """A number of a row's result, by whose declaration it reaches the table.

    Args:
        name: its name.
        dtype: type of its stored values; along a trajectory an int32, or a float of the run's precision.
        absent: its value in rows that have not ended or were not simulated, and at the start of a trajectory.
        quantity: unit and meaning of its column; None if the run kind declares the column itself.
        crossings: if not 0, the number of crossings at which it holds the values of all observables, one
            crossing after the other; a recorder does not set such a number.
        compared: whether the self-check compares it, as it does the gait.
    """

    name: str
    dtype: type[np.generic]
    absent: float = 0
    quantity: Quantity | None = None
    crossings: int = 0
    compared: bool = False

    def shape(self, observables: int) -> tuple[int, ...]:
        """Its shape in one row."""
        return (self.crossings * observables,) if self.crossings else ()


# The numbers that the engine gives for every row. `attempts` counts steps tried, `t_end` is a time in s,
# `last` (k,) holds the observables at the last crossing of the section, `fired` (words,) has a bit for each
# guard that stalled the row.
ENGINE_NUMBERS = (
    RowNumber("status", np.int32),
    RowNumber("cycles", np.int64),
    RowNumber("attempts", np.int64),
    RowNumber("t_end", np.float64, np.nan),
    RowNumber("last", np.float64, np.nan, crossings=1),
    RowNumber("fired", np.int64),
)


class _Number:
    """Descriptor of a number: `rows.status` is `rows.numbers["status"]`."""

    def __set_name__(self, _: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, rows: None, _: type) -> _Number: ...
    @overload
    def __get__(self, rows: RowOutcome, _: type) -> Num[np.ndarray, "rows ..."]: ...
    def __get__(self, rows: RowOutcome | None, _: type) -> _Number | Num[np.ndarray, "rows ..."]:
        return self if rows is None else rows.numbers[self._name]


@dataclasses.dataclass(frozen=True)
class RowOutcome:
    """The results of rows (n,): numbers of each row, its records, and their gaits once they are labelled.

    Args:
        row: the number (n,) of each row in its table.
        numbers: those of each row, (n,) or (n, k), by name (`RowNumber`).
        record_counts: the number (n,) of records of each row.
        samples: the records (m, width), in the order of the rows.
        labels: the gait (an index, -1: none) and the label fields of each row, (n,) by name.
        sample_labels: those of each record, (m,) by name, for recorders that read the gait there.
    """

    row: Int[np.ndarray, " rows"]
    numbers: dict[str, Num[np.ndarray, "rows ..."]]
    record_counts: Int[np.ndarray, " rows"]
    samples: Float[np.ndarray, "records width"]
    labels: dict[str, Real[np.ndarray, " rows"]] = dataclasses.field(default_factory=dict)
    sample_labels: dict[str, Real[np.ndarray, " records"]] = dataclasses.field(default_factory=dict)
    status = _Number()
    cycles = _Number()
    attempts = _Number()
    t_end = _Number()
    last = _Number()
    fired = _Number()

    @classmethod
    def empty(
        cls, row: Int[np.ndarray, " rows"], numbers: Sequence[RowNumber], observables: int, width: int = 0
    ) -> RowOutcome:
        """Rows without results, whose numbers are read-only and take no memory before a row has its own.

        Args:
            row: the numbers (n,) of the rows in their table.
            numbers: those that the recorder declares.
            observables: the number of the model's observables.
            width: how many numbers a record has.
        """
        arrays = {
            number.name: np.broadcast_to(
                np.asarray(number.absent, number.dtype), (row.size, *number.shape(observables))
            )
            for number in (*ENGINE_NUMBERS, *numbers)
        }
        # how many words hold the guards is known only from a trajectory
        arrays["fired"] = np.zeros((row.size, 0), np.int64)
        return cls(row, arrays, np.zeros(row.size, np.int64), np.zeros((0, width)))

    @classmethod
    def concat(cls, parts: Sequence[RowOutcome]) -> RowOutcome:
        """The rows of several results, one after the other.

        Raises:
            ValueError: there is no result, and so no type of its numbers.
        """
        if not parts:
            raise ValueError("There are no results to join: give one or more, or use RowOutcome.empty.")
        names = [field.name for field in dataclasses.fields(cls)]
        return cls(**{name: _concatenated([getattr(part, name) for part in parts]) for name in names})

    def put(
        self, which: Int[np.ndarray, " ended"] | slice, numbers: Mapping[str, Num[np.ndarray, "ended ..."]]
    ) -> None:
        """Set the numbers of some rows.

        Args:
            which: the places of the rows (m,), or their slice.
            numbers: their numbers, (m, ...) each, by name; those of all rows may be kept without a copy.

        Raises:
            ValueError: a number has another shape than its recorder declares.
        """
        for name, own in list(self.numbers.items()):
            values = numbers[name]
            if own.shape[1:] == (0,):  # the words of guards are counted only now; other rows have no bit set
                own = np.broadcast_to(np.zeros((), own.dtype), (self.row.size, *values.shape[1:]))
            if own.shape[1:] != values.shape[1:]:
                raise ValueError(
                    f"{name} is declared with the shape {own.shape[1:]} in a row, but has {values.shape[1:]}."
                )
            if isinstance(which, slice) and which == slice(0, self.row.size, 1):
                own = np.require(values, own.dtype, "W")
            else:
                own = np.require(own, requirements="W")
                own[which] = values
            self.numbers[name] = own

    def take(self, which: Int[np.ndarray, " taken"]) -> RowOutcome:
        """The rows at the places `which` (m,), in that order."""
        counts = self.record_counts[which]
        first = np.cumsum(self.record_counts)[which] - counts
        records = np.repeat(first - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())
        return RowOutcome(
            row=self.row[which],
            numbers={name: values[which] for name, values in self.numbers.items()},
            record_counts=counts,
            samples=self.samples[records],
            labels={name: values[which] for name, values in self.labels.items()},
            sample_labels={name: values[records] for name, values in self.sample_labels.items()},
        )

    @property
    def owner(self) -> Int[np.ndarray, " records"]:
        """The number of the row of each record, (m,)."""
        return np.repeat(self.row, self.record_counts)

    @property
    def place(self) -> Int[np.ndarray, " records"]:
        """Place of each record's row among these rows, (m,)."""
        return np.repeat(np.arange(self.row.size), self.record_counts)


def _concatenated(parts: list[Any]) -> Any:
    """Arrays one after the other, or those of each name."""
    if isinstance(parts[0], dict):
        return {name: _concatenated([part[name] for part in parts]) for name in parts[0]}
    filled = [part for part in parts if len(part)]  # an empty one may have another dtype
    return np.concatenate(filled or parts)
