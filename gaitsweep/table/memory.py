"""Table in memory, which a run writes as it writes a result directory."""

from __future__ import annotations

import collections
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from gaitsweep import near_miss
from gaitsweep.table.atomic_files import TableError
from gaitsweep.table.frames import (
    MOST_SEPARATE,
    PartRecords,
    RowColumns,
    SharedDict,
    joined_frames,
    joined_parts,
    shared,
)
from gaitsweep.table.manifest import Layout, json_value, new_manifest
from gaitsweep.table.parquet_parts import arrow_part, checked_counts, missing_blocks
from gaitsweep.table.reading import Rows, Selection, added_counts


class FramePart(NamedTuple):
    """The records of a block, None if they are in the columns of all rows; and its rows by status."""

    records: pd.DataFrame | None
    counts: dict[str, int]


class MemoryTable:
    """Table in memory, with the methods of `ResultDirectory` that a run uses.

    Columns have the values and types that a result directory gives.

    Args:
        job: the resolved job.
        layout: that of the table.
    """

    path = None
    notes: tuple[str, ...] = ()
    rows_open = 0

    def __init__(self, job: Mapping[str, Any], layout: Layout) -> None:
        self.layout = layout
        self.manifest: dict[str, Any] = new_manifest(layout, job)
        self._parts: dict[int, FramePart] = {}
        self._columns: RowColumns | None = None  # of all rows; None before the first block
        self._lock = threading.Lock()
        self._tallies: dict[str, dict[int, dict[str, int]]] = {}  # of each column and block

    @property
    def rows_done(self) -> int:
        """Number of rows in complete blocks."""
        return sum(self.counts().values())

    def missing_blocks(self) -> list[int]:
        """Return the blocks that are not complete, in order."""
        return missing_blocks(self.layout.blocks, self._parts)

    def counts(self) -> dict[str, int]:
        """Return the numbers of rows in complete blocks by status."""
        return added_counts(part.counts for part in list(self._parts.values()))

    def tally(self, column: str | None) -> dict[str, int]:
        """Count the values of a column of text in complete blocks; None: the statuses of the rows."""
        if column is None:
            return self.counts()
        of_parts = self._tallies.setdefault(column, {})
        for number, part in list(self._parts.items()):
            if number not in of_parts and column in (records := self._records(number, part, [column])):
                codes, names = pd.factorize(records[column])  # in the order of their first records
                counts = np.bincount(codes[codes >= 0], minlength=len(names))
                of_parts[number] = dict(zip(names.tolist(), counts.tolist(), strict=True))
        tally: collections.Counter[str] = collections.Counter()
        for counts in of_parts.values():
            tally.update(counts)
        return dict(tally.most_common())

    def encoded(self, number: int, frame: pd.DataFrame) -> FramePart:
        """Check the records of a block, for `write_encoded`; threads may do so at the same time."""
        counts = checked_counts(frame, number, self.layout)
        with self._lock:
            self._columns = self._columns or RowColumns(frame, self.layout.rows)
        filled = self._columns.fill(frame, *self.layout.rows_of(number))
        if filled:
            return FramePart(None, counts)
        records = frame.copy(deep=False)
        records.attrs = {}  # pandas would compare those of all blocks
        return FramePart(records, counts)

    def write_encoded(self, number: int, part: FramePart) -> None:
        """Add a block that `encoded` has checked."""
        self._parts[number] = part

    def tidy_digests(self) -> None:
        """Do nothing: there are no files."""

    def update_manifest(self, **fields: Any) -> None:
        """Set fields of the manifest (JSON values; None removes a field)."""
        manifest = self.manifest | fields
        self.manifest = {name: value for name, value in manifest.items() if value is not None}

    def load(self, rows: Rows | None = None, *, last: bool = False) -> pd.DataFrame:
        """Return the complete table, or the records of some rows, with the `.attrs` of `table.load`.

        Args:
            rows: the rows; None: all.
            last: give the records away, so that they are not in memory twice if they fill columns.
        """
        selection = Selection.of(None, rows, self.layout.rows)
        blocks = {number: selection.records_of_frame(block) for number, block in self._blocks()}
        frame = self._joined(blocks).reset_index(drop=True)
        # pandas warns where columns are added to a table that has too many separate ones
        if not last or frame.shape[1] > MOST_SEPARATE:
            frame = frame.copy()
        manifest = shared(json_value(self.manifest))
        frame.attrs.update(
            job=manifest["job"],
            manifest=manifest,
            quantities=manifest.get("quantities", SharedDict()),
            complete=True,
            rows_missing=0,
            rows_open=0,
        )
        return frame

    def load_parts(self, columns: Sequence[str]) -> Iterator[pd.DataFrame]:
        """Yield the records of the complete table, which a reader does not change."""
        names = list(dict.fromkeys(columns))
        blocks = dict(self._blocks(names))
        known = {name for block in blocks.values() for name in block}
        for name in names:
            if name not in known:
                near = near_miss.suggestion(
                    name, dict.fromkeys(n for _, block in self._blocks() for n in block)
                )
                raise TableError(f"{name} is not a column of the table{near}")
        yield pd.DataFrame(self._joined(blocks), columns=names)

    def _records(self, number: int, part: FramePart, names: Sequence[str] | None = None) -> pd.DataFrame:
        """Return the records of a block, or those of these columns that it has."""
        if part.records is None:
            assert self._columns is not None
            return self._columns.frame(*self.layout.rows_of(number), names)
        if names is None:
            return part.records
        return pd.DataFrame(part.records, columns=[name for name in names if name in part.records])

    def _blocks(self, names: Sequence[str] | None = None) -> Iterator[tuple[int, pd.DataFrame]]:
        """Yield the records of each block as `_records` does, or of all as one if they fill columns."""
        if self._columns is not None and self._in_columns:
            yield 0, self._columns.frame(0, self.layout.rows, names)
        else:
            for number, part in sorted(self._parts.items()):
                yield number, self._records(number, part, names)

    @property
    def _in_columns(self) -> bool:
        """Whether the records of all rows are in the columns."""
        parts = self._parts.values()
        return len(parts) == len(self.layout.blocks) and all(part.records is None for part in parts)

    def _joined(self, blocks: Mapping[int, pd.DataFrame]) -> pd.DataFrame:
        """Join the records that `_blocks` yields, without a copy if they fill columns."""
        joined = blocks[0] if self._in_columns else joined_frames(list(blocks.values()))
        if joined is not None:
            return joined
        parts = PartRecords()
        for number, records in blocks.items():
            parts.add(*arrow_part(records, number, self.layout.job_hash, {}))
        return joined_parts(Path(), parts, None)
