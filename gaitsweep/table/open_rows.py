"""Files of ended rows of incomplete blocks, which exist until the parts of the blocks are written.

`table/open-00003.parquet` is the third file of such rows. It contains the engine's exact results,
without gaits, which are determined for whole blocks.
"""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gaitsweep.row_outcome import RowOutcome
from gaitsweep.table.parts import UNREADABLE, DamagedPart, on_one_line, readable

_KEY = b"gaitsweep open rows"


def open_bytes(rows: RowOutcome, job_hash: str) -> bytes:
    """Encode rows as parquet with a checksum for each page."""
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
    flat = pa.array(np.ascontiguousarray(values).ravel())
    return pa.LargeListArray.from_arrays(pa.array(ends.astype(np.int64)), flat)


def read_open(data: bytes, job_hash: str, n_rows: int) -> RowOutcome:
    """Read the rows of a file of open rows.

    Raises:
        DamagedPart: they cannot be decoded, or belong to another job or table.
    """
    try:
        file = pq.ParquetFile(readable(data), page_checksum_verification=True)
        table = file.read()
        said: dict[str, Any] = json.loads((table.schema.metadata or {})[_KEY])
        rows: dict[str, np.ndarray] = {}
        for name in table.column_names:
            column = table.column(name).combine_chunks()
            if name in said["widths"]:
                width = int(said["widths"][name])
                flat = column.flatten().to_numpy()
                rows[name] = flat.reshape(flat.size // width if width else 0, width)
            else:
                rows[name] = column.to_numpy(zero_copy_only=False)
        mine = rows["row"]
        sound = (
            mine.dtype == np.int64
            and bool(np.all((mine >= 0) & (mine < n_rows)))
            and int(rows["kept"].sum()) == len(rows["samples"])
            and all(len(values) == mine.size for name, values in rows.items() if name != "samples")
        )
        its_hash = str(said["job_hash"])
    except UNREADABLE as error:
        raise DamagedPart(f"it cannot be read ({on_one_line(error)})") from error
    if its_hash != job_hash:
        raise DamagedPart(f"it belongs to another job (hash {its_hash[:12]})")
    if not sound:
        raise DamagedPart("its rows do not belong to this table")
    row, kept, samples = (rows.pop(name) for name in ("row", "kept", "samples"))
    return RowOutcome(row, rows, kept, samples)
