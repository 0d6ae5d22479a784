"""Columns of a table, each declared once; data frames are built from these declarations."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int, Real, Shaped

from gaitsweep.column_meanings import COLUMNS
from gaitsweep.contract import HybridModel, Model, Quantity, names_gait
from gaitsweep.engine.carry import unpacked
from gaitsweep.engine.pushed_model import state_quantities
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.skeleton import contact_signals
from gaitsweep.status import RECURRENT, Status
from gaitsweep.table.frames import categorical, outcomes

AT_REST = "rest"  # in place of the gait of a stationary point
UNKNOWN_GAIT = "unknown"  # gait of a row whose label is not the index of a gait; the label follows
STATUSES = [status.name for status in Status if status is not Status.running]

ColumnValues: TypeAlias = "np.ndarray | pd.Categorical"


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of a table.

    Args:
        name: its name in the table.
        read: function from the `Records` to its values (n,); by default the number of the same name.
        quantity: the model's quantity in the column, for its unit and meaning.
        repeats: whether many records have the same value, so that the column compresses well.
    """

    name: str
    read: Callable[[Records], ColumnValues] | None = None
    quantity: Quantity | None = None
    repeats: bool = True

    def values(self, records: Records) -> ColumnValues:
        """The values of the column, (n,)."""
        return records[self.name] if self.read is None else self.read(records)


@dataclasses.dataclass(frozen=True)
class Records:
    """The records of a block of rows.

    Attributes:
        model: the rows' model.
        block: the results of the rows.
        rows: the row of each record, (n,).
        place: the position of its numbers among the block's samples, (n,), -1 for a row without samples;
            None if each row has one record and no samples.
        names: the names of the recorder's numbers.
        samples: these numbers, (n, names), NaN where missing.
    """

    model: Model
    block: RowOutcome
    rows: Int[np.ndarray, " records"]
    place: Int[np.ndarray, " records"] | None
    names: tuple[str, ...]
    samples: Float[np.ndarray, "samples names"]

    @classmethod
    def of(cls, model: Model, block: RowOutcome, names: tuple[str, ...] | None) -> Records:
        """One record for each sample of a block, or for each row if `names` of the samples' numbers are None.

        A row without samples has one record without numbers.
        """
        if names is None:
            return cls(model, block, block.row, None, (), np.zeros((block.row.size, 0)))
        records = np.maximum(block.record_counts, 1)
        place = np.full(records.sum(), -1)
        place[np.repeat(block.record_counts > 0, records)] = np.arange(len(block.samples))
        samples = _placed(block.samples.reshape(-1, len(names)), place, np.nan)
        return cls(model, block, np.repeat(block.row, records), place, names, samples)

    def __getitem__(self, name: str) -> Real[np.ndarray, "records ..."]:
        """A number of each record, (n,): that of the sample with this name, else that of the row."""
        if name in self.names:
            return self.samples[:, self.names.index(name)]
        return self.of_row(self.block.numbers[name])

    @functools.cached_property
    def status(self) -> pd.Categorical:
        """The status of each record's row."""
        # statuses are numbered from 0, running
        return categorical(self.of_row(self.block.status) - 1, STATUSES)

    @functools.cached_property
    def gait(self) -> pd.Categorical:
        """The gait of each record."""
        return gaits(self.model, self.label("gait", -1))

    @property
    def recorded(self) -> Bool[np.ndarray, " records"]:
        """Mask of the records that have numbers, (n,)."""
        return np.ones(self.rows.size, bool) if self.place is None else self.place >= 0

    def of_row(self, values: Shaped[np.ndarray, "rows ..."]) -> Shaped[np.ndarray, "records ..."]:
        """The value of each record's row (n, ...), from the values of the block's rows."""
        return (
            values
            if self.place is None
            else np.repeat(values, np.maximum(self.block.record_counts, 1), axis=0)
        )

    def label(self, name: str, absent: float | None = None) -> Real[np.ndarray, " records"]:
        """A gait's number or a trait (n,); `absent` (by default 0 or NaN) where it was not read."""
        if self.place is None or name in self.block.labels:
            return self.of_row(self.block.labels[name])
        labels = self.block.sample_labels[name]
        if absent is None:
            absent = 0 if labels.dtype.kind in "iu" else np.nan
        return _placed(labels, self.place, absent)


def _placed(
    values: Real[np.ndarray, "samples ..."], place: Int[np.ndarray, " records"], absent: float
) -> Real[np.ndarray, "records ..."]:
    """The value at each place, or `absent` if the place is -1."""
    last = np.full((1, *values.shape[1:]), absent, values.dtype)
    return np.concatenate([values, last])[place]


def changing(*names: str) -> list[Column]:
    """The numbers of these names, of which each record has its own."""
    return [Column(name, repeats=False) for name in names]


def observed_at_crossings(model: Model) -> list[Column]:
    """The observables at each crossing, such as `psi_1_n`."""
    return [Column(f"{q.name}_n", None, q, False) for q in model.observables]


def drifts(held: Iterable[str], conserved: Iterable[Quantity]) -> list[Column]:
    """The columns of drifts, such as `drift_E`: a cycle adds so much to a conserved quantity that is held."""
    units = {q.name: q.unit for q in conserved}
    added = [
        Quantity(f"drift_{name}", units.get(name, "1"), f"what a cycle adds to {name}, which is held")
        for name in held
    ]
    return [Column(quantity.name, None, quantity, False) for quantity in added]


def rests_at_crossings(
    model: Model, records: pd.DataFrame, rests: Bool[np.ndarray, " records"]
) -> pd.DataFrame:
    """The records of `RunKind.rests`, for rows with records of crossings at fixed points."""
    observed = {q.name: records[f"{q.name}_n"] for q in model.observables}
    return pd.DataFrame({"rests": rests, "crossing": records["crossing"], "period": 1, **observed})


def observed_at_end(
    model: Model,
    values: Callable[[RowOutcome, int], Float[np.ndarray, " rows"]] = lambda rows, i: rows.last[:, i],
) -> list[Column]:
    """The observables where each row ended, such as `psi_1_end`.

    Args:
        model: the model.
        values: function from the results of a block's rows to the observable (n,) at a place; by default that
            of the last crossing.
    """
    return [
        Column(f"{q.name}_end", lambda records, i=i: values(records.block, i), q, False)
        for i, q in enumerate(model.observables)
    ]


def observed_on_orbits(model: Model, block: RowOutcome) -> list[Column]:
    """The observables at crossings 2 to p of the orbits that the rows of a block are on, as `psi_1_end_2`.

    Rows without a period (`RECURRENT`) have as many crossings as the recorder keeps, the latest first.
    """
    k, longest = len(model.observables), int(block.numbers["period"].max(initial=1))
    if k and RECURRENT.among(block.status).any():
        longest = 1 + block.numbers["orbit"].shape[1] // k
    return [
        Column(f"{q.name}_end_{c + 2}", lambda records, at=c * k + i: records["orbit"][:, at], q, False)
        for c in range(longest - 1)
        for i, q in enumerate(model.observables)
    ]


def states_at_end(model: HybridModel) -> list[Column]:
    """The numbers of the state where each row settled, such as `state_angle`; NaN where it did not settle."""

    def read(records: Records, place: int) -> ColumnValues:
        block = records.block
        values = np.full(block.row.size, np.nan)
        kept = block.record_counts > 0
        if kept.any():  # rows that a refined run infers have no samples
            values[kept] = block.samples[:, place]
        return np.where(block.status == Status.settled, values, np.nan)

    return [
        Column(q.name, lambda records, i=i: read(records, i), q, False)
        for i, q in enumerate(state_quantities(model))
    ]


def label_fields(model: Model) -> list[Column]:
    """The model's `label_fields`."""

    def read(records: Records, name: str) -> ColumnValues:
        return gaits(model, records.label(name, -1)) if names_gait(name) else records.label(name)

    return [Column(q.name, lambda records, q=q: read(records, q.name), q, False) for q in model.label_fields]


def signals(model: Model) -> list[Column]:
    """The signals of a sample; contacts of feet count as repeating."""
    contacts = contact_signals(q.name for q in model.signals)
    return [Column(q.name, None, q, q.name in contacts) for q in model.signals]


def row_number(quantity: Quantity) -> Column:
    """A number of the row (`RowNumber`), the same in all of its records."""
    return Column(
        quantity.name, lambda records: records.of_row(records.block.numbers[quantity.name]), quantity
    )


def _crossing(records: Records) -> Real[np.ndarray, " records"]:
    """The number of each record's crossing."""
    # a row that kept no crossing has the number of those that it made
    cycles = records.of_row(records.block.cycles)
    return np.where(records.recorded, records["crossing"], cycles).astype(np.int64)


def _stalled_by(records: Records) -> pd.Categorical:
    """The names of the guards that stalled each row; missing for other rows."""
    model = records.model
    names = model.guard_names if isinstance(model, HybridModel) else ()
    words = records.of_row(records.block.fired)
    stalled = np.flatnonzero(words.any(axis=1))  # few, if any
    guards = []
    for row in unpacked(words[stalled]):
        fired = (names[i] if i < len(names) else f"guard {i + 1}" for i in np.flatnonzero(row))
        guards.append(" and ".join(dict.fromkeys(fired)))  # guards of one event have its name
    categories, numbers = np.unique(np.array(guards, dtype=object), return_inverse=True)
    codes = np.full(len(words), -1)
    codes[stalled] = numbers
    return categorical(codes, categories.tolist())


def _slowest(records: Records) -> pd.Categorical:
    """The observable that prevented a row or a stair from settling; missing if its number is negative."""
    names = [q.name for q in records.model.observables]
    codes = np.nan_to_num(records["slowest"], nan=-1.0).astype(int)
    return categorical(codes, names)


STATUS = Column("status", lambda records: records.status)
STALLED_BY = Column("stalled_by", _stalled_by)
CROSSING = Column("crossing", _crossing)
GAIT = Column("gait", lambda records: records.gait)
OUTCOME = Column("outcome", lambda records: outcomes(records.gait, records.status))
SLOWEST = Column("slowest", _slowest)


def gaits(model: Model, codes: Int[np.ndarray, " rows"]) -> pd.Categorical:
    """Gaits from their `gait_codes` (n,); a gait that was not read is "none" if the model has that gait.

    A label that is not an index of a gait has a category of its own, "unknown (7)".
    """
    names = list(model.gaits)
    unread = names.index("none") if "none" in names else -1
    outside = np.unique(codes[(codes < -1) | (codes >= len(names))])
    categories = np.where(codes == -1, unread, codes)
    for category, code in enumerate(outside.tolist(), start=len(names)):
        categories[codes == code] = category
    names += [f"{UNKNOWN_GAIT} ({code + (code < 0)})" for code in outside.tolist()]
    return categorical(categories, names)


def quantities_of(model: Model, columns: Sequence[Column] = ()) -> dict[str, dict[str, Any]]:
    """Unit, meaning, symbol and circularity of the table's columns, by name.

    The meaning of `status` has the first line of the docstring of the model's `failed`.
    """
    named = {
        # a start stands in the table by its own name, an observable with _end or _n
        **{f"{q.name}_{end}": q for q in model.observables for end in ("end", "n")},
        **{q.name: q for q in (*model.parameters, *model.observables, *model.signals, *model.label_fields)},
        **{q.name: q for q in model.initial_conditions},
        **{c.name: Quantity(c.name, *COLUMNS[c.name]) for c in columns if c.name in COLUMNS},
        **{c.name: c.quantity for c in columns if c.quantity is not None},
    }
    if (fall := (type(model.original).failed.__doc__ or "").strip().partition("\n")[0]) and "status" in named:
        meaning = f"{named['status'].meaning}; fell: {fall[0].lower()}{fall[1:].removesuffix('.')}"
        named["status"] = dataclasses.replace(named["status"], meaning=meaning)
    return {
        name: {"unit": q.unit, "meaning": q.meaning, "symbol": q.symbol, "circular": q.circular}
        for name, q in named.items()
    }
