"""Parts of a table: parquet files with the rows of one block each, and a footer that identifies it.

A file of open rows, such as `table/open-00003.parquet`, has the ended rows of incomplete blocks, and exists
until the parts of these are written. It contains the engine's exact results, without gaits, which are
determined for whole blocks.
"""

from __future__ import annotations

import dataclasses
import io
import json
import re
from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from gaitsweep.column_meanings import COLUMNS
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.table.manifest import Layout

_KEY = b"gaitsweep"  # of the metadata of a part
# Columns that are categorical even where a frame has them as text.
CATEGORICAL = ("status", "gait", "outcome")


class Numbered(NamedTuple):
    """Numbered names of one kind of files of a table, such as `part-00003.parquet`."""

    kind: str

    def name(self, number: int) -> str:
        """Return the file name with a number."""
        return f"{self.kind}-{number:05d}.parquet"

    def number(self, name: str) -> int | None:
        """Return the number in a file name, or None if it is not a file of this kind."""
        match = re.fullmatch(rf"{self.kind}-([0-9]{{5,18}})\.parquet", name)
        if match is None:
            return None
        number = int(match[1])
        return number if self.name(number) == name else None


PARTS = Numbered("part")


@dataclasses.dataclass(frozen=True)
class Footer:
    """Metadata of a part: its block, the hash of its job, rows by status, and names by categorical column."""

    part: int
    job_hash: str
    counts: dict[str, int]
    categories: dict[str, list[str]]

    @property
    def rows(self) -> int:
        """Number of rows of the sweep in this part; a row may have many records."""
        return sum(self.counts.values())


class EncodedPart(NamedTuple):
    """The bytes of a part, and its footer."""

    data: bytes
    footer: Footer


class ArrowPart(NamedTuple):
    """The records of a part in Arrow, with the codes of categorical columns, and its footer."""

    records: pa.Table
    footer: Footer

    def encoded(self) -> EncodedPart:
        """Encode the part as parquet with a checksum for each page, and its `Footer` in the metadata.

        Categories are text, which parquet encodes with its own dictionary; their order is in the footer. So
        any other reader of parquet sees plain text, and finds the unit and the meaning of a column in the
        metadata of its arrow field, under the keys `unit` and `meaning`.
        """
        metadata = {_KEY: json.dumps(dataclasses.asdict(self.footer)).encode()}
        plain = [
            field.with_type(pa.string()) if pa.types.is_dictionary(field.type) else field
            for field in self.records.schema
        ]
        file = io.BytesIO()
        pq.write_table(
            self.records.cast(pa.schema(plain, metadata)),
            file,
            compression="zstd",
            use_dictionary=list(self.footer.categories),  # pyright: ignore[reportArgumentType] (its stub: bool)
            write_page_checksum=True,
        )
        return EncodedPart(file.getvalue(), self.footer)


class DamagedPart(Exception):
    """A part differs from what was written; the message gives the evidence."""


def missing_blocks(numbers: Iterable[int], footers: Container[int]) -> list[int]:
    """Return the blocks without a valid part, in their order.

    Args:
        numbers: the blocks that are looked for.
        footers: the valid parts, such as footers by block.
    """
    return [number for number in numbers if number not in footers]


def _count_statuses(frame: pd.DataFrame) -> dict[str, int]:
    """Return the numbers of rows by status, that of their last record, for records in the order of rows."""
    rows = frame["row"].to_numpy()
    status = pd.Categorical(frame["status"])
    ends_row = rows[:-1] != rows[1:]
    codes = status.codes if ends_row.all() else status.codes[np.append(ends_row, True)]
    counts = [np.count_nonzero(codes == code) for code in range(len(status.categories))]
    return dict(sorted((str(status.categories[code]), int(counts[code])) for code in np.flatnonzero(counts)))


def _check_frame(frame: pd.DataFrame, start: int, stop: int) -> None:
    """Check that a frame has records of rows `start` to `stop - 1`, in order.

    Raises:
        ValueError: it has not, because of a bug.
    """
    if lacking := {"row", "status"} - {*frame.columns}:
        listed = ", ".join(map(str, frame.columns))
        raise ValueError(f"A part needs the column {min(lacking)}; this one has {listed}.")
    if not all(isinstance(column, str) for column in frame.columns) or not frame.columns.is_unique:
        raise ValueError("The columns of a part must have different names that are text.")
    rows = frame["row"].to_numpy()
    if rows.dtype != np.int64:
        raise ValueError(f"The column row of a part must be int64, not {rows.dtype}.")
    if rows.size and (rows[0] < start or rows[-1] >= stop or np.any(rows[1:] < rows[:-1])):
        raise ValueError(f"The rows of a part must be in order, from {start} to {stop - 1}.")


def checked_counts(frame: pd.DataFrame, number: int, layout: Layout) -> dict[str, int]:
    """Count the rows of a block by status, after a check that none is missing.

    Args:
        frame: the records, in the order of their rows.
        number: the block.
        layout: that of the table.

    Raises:
        ValueError: the frame does not belong to the block.
    """
    if number not in layout.blocks:
        raise ValueError(f"Block {number} does not exist: the blocks are 0 to {layout.blocks[-1]}.")
    start, stop = layout.rows_of(number)
    _check_frame(frame, start, stop)
    counts = _count_statuses(frame)
    if (rows := sum(counts.values())) != stop - start:
        raise ValueError(f"The statuses of part {number} count {rows} rows, not {stop - start}.")
    return counts


def checked_records(
    frame: pd.DataFrame, number: int, layout: Layout, quantities: Mapping[str, Mapping[str, Any]] | None
) -> ArrowPart:
    """Convert a block's records to Arrow as `arrow_part` does, after the check of `checked_counts`."""
    return arrow_part(frame, number, layout.job_hash, checked_counts(frame, number, layout), quantities)


def arrow_part(
    frame: pd.DataFrame,
    number: int,
    job_hash: str,
    counts: Mapping[str, int],
    quantities: Mapping[str, Mapping[str, Any]] | None = None,
) -> ArrowPart:
    """Convert a block's records to Arrow, with the footer of their part.

    Args:
        frame: the records, in the order of their rows.
        number: the block.
        job_hash: the hash of the job.
        counts: rows by status.
        quantities: `unit` and `meaning` by the name of the column, as in the manifest; of the columns that
            are not there, those that run kinds add have theirs.
    """
    categories: dict[str, list[str]] = {}
    fields = []
    arrays = []
    for column in frame.columns:
        values = frame[column]
        if isinstance(values.dtype, pd.CategoricalDtype):
            categories[column] = [str(category) for category in values.cat.categories]
            arrays.append(_text(values.cat.codes.to_numpy(), categories[column]))
        elif column in CATEGORICAL:
            categories[column] = sorted({str(value) for value in values.dropna()})
            arrays.append(pa.Array.from_pandas(values, type=pa.string()))
        else:
            arrays.append(pa.Array.from_pandas(values))
        fields.append(pa.field(column, arrays[-1].type, metadata=_unit_and_meaning(column, quantities or {})))
    footer = Footer(number, job_hash, dict(counts), categories)
    return ArrowPart(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), footer)


def _unit_and_meaning(column: str, quantities: Mapping[str, Mapping[str, Any]]) -> dict[str, str] | None:
    """Return `unit` and `meaning` of a column, of the manifest or of a run kind; None without any."""
    observed = re.sub(r"_end_\d+\Z", "_end", column)  # at a further crossing of an orbit
    added = dict(zip(("unit", "meaning"), COLUMNS.get(column, ()), strict=False))
    quantity = quantities.get(observed) or added
    described = {name: quantity[name] for name in ("unit", "meaning") if quantity.get(name)}
    return described or None


def count_names(table: pa.Table, column: str) -> dict[str, int]:
    """Count the names in a column of text; none if the table lacks it, as a part of another version may."""
    if column not in table.column_names:
        return {}
    counts = table.column(column).value_counts().to_pylist()
    return {count["values"]: count["counts"] for count in counts if count["values"] is not None}


def _text(codes: np.ndarray, names: list[str]) -> pa.Array:
    """Return the names of codes (n,); -1 has no name."""
    # parts with few names and with many have indices of one type
    coded = pa.array(codes.astype(np.int32), mask=codes < 0)
    return pa.DictionaryArray.from_arrays(coded, pa.array(names, pa.string()))


def read_footer(data: bytes) -> Footer:
    """Read the footer of a part, without its records.

    Raises:
        DamagedPart: the bytes are truncated, or are not a parquet file of gaitsweep.
    """
    try:
        metadata = pq.read_metadata(pa.BufferReader(data)).metadata or {}
        footer = Footer(**json.loads(metadata[_KEY]))
        sound = (
            type(footer.part) is int
            and isinstance(footer.job_hash, str)
            and all(type(n) is int and n > 0 for n in footer.counts.values())
            and all(isinstance(name, str) for names in footer.categories.values() for name in names)
        )
    except unreadable() as error:
        raise DamagedPart(f"it cannot be read as parquet ({on_one_line(error)})") from error
    if not sound:
        raise DamagedPart("its footer is not one of gaitsweep")
    return footer


def read_records(
    data: bytes, footer: Footer, start: int, stop: int, columns: Sequence[str] | None = None
) -> pa.Table:
    """Read the records of a part, with categorical columns dictionary-encoded.

    Args:
        data: the part's bytes.
        footer: their footer, from `read_footer`.
        start, stop: the first row of its block, and the row after its last.
        columns: those that are decoded, beside `row`, as far as the part has them; all by default.

    Raises:
        DamagedPart: the records cannot be decoded, or belong to other rows.
    """
    try:
        file = pq.ParquetFile(
            readable(data), read_dictionary=list(footer.categories), page_checksum_verification=True
        )
        table = file.read(None if columns is None else list(dict.fromkeys(["row", *columns])))
        # parts of older versions have no units: without metadata all parts have one schema
        table = table.cast(pa.schema([field.remove_metadata() for field in table.schema]))
        rows = table.column("row").to_numpy()
    except unreadable() as error:
        raise DamagedPart(f"its records cannot be read ({on_one_line(error)})") from error
    different = rows[np.flatnonzero(np.diff(rows, prepend=start - 1))] if rows.size else rows
    if not np.array_equal(different, np.arange(start, stop)):
        raise DamagedPart(f"its rows are not {start} to {stop - 1} in order")
    return table


def readable(data: bytes) -> pa.BufferReader:
    """Return a reader of a copy of the bytes in Arrow's memory.

    Arrow's threads may release the copy after the last read has returned. With Python's memory the process
    would abort if Python had ended meanwhile.
    """
    own = pa.allocate_buffer(len(data))
    np.frombuffer(own, np.uint8)[:] = np.frombuffer(data, np.uint8)
    return pa.BufferReader(own)


def unreadable() -> tuple[type[Exception], ...]:
    """Return the errors of the parquet reader and the JSON reader for damaged bytes."""
    values = KeyError, ValueError, TypeError, AttributeError, EOFError, OverflowError, RecursionError
    return pa.ArrowException, OSError, *values, MemoryError


def on_one_line(error: BaseException) -> str:
    """Return the message of a library's error on one line, shortened to 120 characters."""
    text = " ".join(str(error).split())
    return text if len(text) <= 120 else f"{text[:120]}..."


OPEN_ROWS = Numbered("open")
_OPEN_KEY = b"gaitsweep open rows"  # of the metadata


def open_bytes(rows: RowOutcome, job_hash: str) -> bytes:
    """Encode ended rows of open blocks as parquet with a checksum for each page."""
    arrays = {"row": rows.row, **rows.numbers, "kept": rows.record_counts, "samples": rows.samples}
    columns: dict[str, pa.Array] = {}
    widths: dict[str, int] = {}
    for name, values in arrays.items():
        if values.ndim == 1:
            columns[name] = pa.array(values)
            continue
        widths[name] = values.shape[1]
        lengths = rows.record_counts if name == "samples" else np.ones(len(values), np.int64)
        columns[name] = _lists(values, np.concatenate([[0], np.cumsum(lengths)]) * values.shape[1])
    metadata = {_OPEN_KEY: json.dumps({"job_hash": job_hash, "widths": widths}).encode()}
    file = io.BytesIO()
    table = pa.table(columns).replace_schema_metadata(metadata)
    pq.write_table(table, file, compression="zstd", use_dictionary=False, write_page_checksum=True)
    return file.getvalue()


def _lists(values: np.ndarray, ends: np.ndarray) -> pa.Array:
    """Return numbers as lists, whose places in the flat array are between successive `ends`."""
    flat = pa.array(np.ascontiguousarray(values).ravel())
    return pa.LargeListArray.from_arrays(pa.array(ends.astype(np.int64)), flat)


def read_open(data: bytes, job_hash: str, n_rows: int) -> RowOutcome:
    """Read the rows of a file of open rows.

    Args:
        data: the file's bytes.
        job_hash: the hash of the table's job.
        n_rows: the number of rows of the table.

    Raises:
        DamagedPart: they cannot be decoded, or belong to another job or table.
    """
    try:
        file = pq.ParquetFile(readable(data), page_checksum_verification=True)
        table = file.read()
        metadata: dict[str, Any] = json.loads((table.schema.metadata or {})[_OPEN_KEY])
        arrays: dict[str, np.ndarray] = {}
        for name in table.column_names:
            column = table.column(name).combine_chunks()
            if name in metadata["widths"]:
                width = int(metadata["widths"][name])
                flat = column.flatten().to_numpy()
                count = flat.size // max(width, 1) if name == "samples" else len(column)
                arrays[name] = flat.reshape(count, width)
            else:
                arrays[name] = column.to_numpy(zero_copy_only=False)
        row = arrays.pop("row")
        kept = arrays.pop("kept")
        samples = arrays.pop("samples")
        sound = (
            row.dtype == np.int64
            and bool(np.all((row >= 0) & (row < n_rows)))
            and int(kept.sum()) == len(samples)
            and all(len(values) == row.size for values in (kept, *arrays.values()))
        )
        hash_of_rows = str(metadata["job_hash"])
    except unreadable() as error:
        raise DamagedPart(f"it cannot be read ({on_one_line(error)})") from error
    if hash_of_rows != job_hash:
        raise DamagedPart(f"it belongs to another job (hash {hash_of_rows[:12]})")
    if not sound:
        raise DamagedPart("its rows do not belong to this table")
    return RowOutcome(row, arrays, kept, samples)
