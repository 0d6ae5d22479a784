"""One part of a table: a parquet file with the rows of one block, and in its footer what it belongs to."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

_KEY = b"gaitsweep"
_NAME = re.compile(r"part-(\d{5,})\.parquet")


@dataclasses.dataclass(frozen=True)
class Footer:
    """What a part says of itself: its block, its job's hash, its statuses and its categorical columns."""

    part: int
    job_hash: str
    counts: dict[str, int]
    categories: dict[str, list[str]]

    @property
    def rows(self) -> int:
        """The rows of the sweep in this part; a row may have many records."""
        return sum(self.counts.values())


class DamagedPart(Exception):
    """A part's file is cut short or is no parquet file."""


def part_name(number: int) -> str:
    """Name the file of a block."""
    return f"part-{number:05d}.parquet"


def part_numbers(folder: Path) -> list[int]:
    """List the blocks whose part stands in a folder, in order."""
    if not folder.is_dir():
        return []
    found = (_NAME.fullmatch(path.name) for path in folder.iterdir())
    return sorted(int(match[1]) for match in found if match)


def count_statuses(frame: pd.DataFrame) -> dict[str, int]:
    """Count the rows of the sweep by status: a row's status is that of its last record."""
    last = frame.drop_duplicates("row", keep="last")["status"].astype(str)
    return {str(status): int(number) for status, number in last.value_counts().sort_index().items()}


def check_frame(frame: pd.DataFrame, start: int, stop: int) -> None:
    """Refuse a frame that is not the records of rows `start` to `stop - 1`, in order.

    Raises:
        ValueError: what is wrong with it; the caller is at fault, not the user.
    """
    for column in ("row", "status"):
        if column not in frame:
            raise ValueError(
                f"A part needs the column {column}; this one has {', '.join(map(str, frame.columns))}."
            )
    if not all(isinstance(column, str) for column in frame.columns) or not frame.columns.is_unique:
        raise ValueError("The columns of a part need names that are text, each of them once.")
    rows = frame["row"].to_numpy()
    if rows.dtype != np.int64:
        raise ValueError(f"The column row of a part is int64, not {rows.dtype}.")
    if rows.size and (rows[0] < start or rows[-1] >= stop or np.any(np.diff(rows) < 0)):
        raise ValueError(f"The rows of a part stand in order, from {start} to {stop - 1}.")


def write_part(
    file: BinaryIO, frame: pd.DataFrame, number: int, job_hash: str, counts: Mapping[str, int]
) -> Footer:
    """Write a block's records as parquet, its `Footer` in the file's metadata.

    Categories are stored as text, which parquet encodes by a dictionary of its own; their order is kept in
    the footer. So any other reader of parquet sees plain text.

    Returns:
        The footer.
    """
    plain = frame.copy(deep=False)
    categories: dict[str, list[str]] = {}
    for column in frame.columns:
        values = frame[column]
        if isinstance(values.dtype, pd.CategoricalDtype):
            categories[column] = [str(category) for category in values.cat.categories]
            plain[column] = values.astype(object)
        elif column in ("status", "gait"):
            categories[column] = sorted({str(value) for value in values.dropna()})
    fields = []
    arrays = []
    for column in plain.columns:
        text = pa.string() if column in categories else None
        arrays.append(pa.Array.from_pandas(plain[column], type=text))
        fields.append(pa.field(column, arrays[-1].type))
    footer = Footer(number, job_hash, dict(counts), categories)
    metadata = {_KEY: json.dumps(dataclasses.asdict(footer)).encode()}
    pq.write_table(
        pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=metadata)),
        file,
        compression="zstd",
        use_dictionary=list(categories),  # pyright: ignore[reportArgumentType] (its stub says bool only)
    )
    return footer


def read_footer(path: Path) -> Footer:
    """Read what a part says of itself, without its records.

    Raises:
        DamagedPart: the file is cut short, is no parquet file, or none of ours.
        OSError: the file cannot be read.
    """
    try:
        metadata = pq.read_metadata(path).metadata or {}
        return Footer(**json.loads(metadata[_KEY]))
    except FileNotFoundError:
        raise
    except (pa.ArrowInvalid, pa.ArrowException, KeyError, ValueError, TypeError, EOFError) as error:
        raise DamagedPart(str(error)) from error


def read_records(path: Path, categories: Mapping[str, list[str]]) -> pa.Table:
    """Read a part's records, its categorical columns dictionary-encoded.

    Raises:
        DamagedPart: the records cannot be decoded.
    """
    try:
        return pq.ParquetFile(path, read_dictionary=list(categories)).read().replace_schema_metadata(None)
    except pa.ArrowException as error:
        raise DamagedPart(str(error)) from error
