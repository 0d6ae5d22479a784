"""Files of ended rows of incomplete blocks, such as `table/open-00003.parquet`.

A file exists until the parts of its blocks are written. It contains the engine's exact results, without
gaits, which are determined for whole blocks.
"""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gaitsweep.row_outcome import RowOutcome
from gaitsweep.table.parquet_parts import DamagedPart, Numbered, on_one_line, readable, unreadable

OPEN_ROWS = Numbered("open")
_KEY = b"gaitsweep open rows"  # of the metadata


def open_bytes(rows: RowOutcome, job_hash: str) -> bytes:
    """Encode ended rows of open blocks as parquet with a checksum for each page."""
    arrays = {"row": rows.row, **rows.numbers, "kept": rows.kept, "samples": rows.samples}
    columns: dict[str, pa.Array] = {}
    widths: dict[str, int] = {}
    for name, values in arrays.items():
        if name == "samples":
            widths[name] = values.shape[1]
            ends = np.cumsum(rows.kept) * values.shape[1]
            columns[name] = _lists(values, np.concatenate([[0], ends]))
        elif values.ndim == 2:
            widths[name] = values.shape[1]
            columns[name] = _lists(values, np.arange(len(values) + 1) * values.shape[1])
        else:
            columns[name] = pa.array(values)
    metadata = {_KEY: json.dumps({"job_hash": job_hash, "widths": widths}).encode()}
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
        metadata: dict[str, Any] = json.loads((table.schema.metadata or {})[_KEY])
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
