"""Table in memory, which a run writes as it writes a result directory."""

from __future__ import annotations

import collections
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from gaitsweep import near_miss
from gaitsweep.table.atomic_files import TableError
from gaitsweep.table.frames import PartRecords, RowColumns, SharedDict, joined_frames, joined_parts, shared
from gaitsweep.table.manifest import Layout, json_value, new_manifest, sealed
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
            if number not in of_parts and column in (records := self._records(number, part)):
                counts = records[column].value_counts()
                of_parts[number] = {str(name): int(count) for name, count in counts.items() if count}
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
        return FramePart(None if filled else frame, counts)

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
            last: give the records away, so that they are not in memory twice.
        """
        frame = self._frame(None, rows, is_copy=not last)
        manifest = shared(sealed(json_value(self.manifest)))
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
        yield self._frame(columns, None, is_copy=False)

    def _records(self, number: int, part: FramePart) -> pd.DataFrame:
        """Return the records of a block."""
        if part.records is not None:
            return part.records
        assert self._columns is not None
        return self._columns.frame(*self.layout.rows_of(number))

    def _frame(self, columns: Sequence[str] | None, rows: Rows | None, *, is_copy: bool) -> pd.DataFrame:
        """Return the records of some columns and rows; without `is_copy` they may be those of the table."""
        selection = Selection.of(columns, rows, self.layout.rows)
        parts = sorted(self._parts.items())
        in_columns = None if any(part.records is not None for _, part in parts) else self._columns
        if in_columns is None:
            blocks = {number: self._records(number, part) for number, part in parts}
        else:
            blocks = {0: in_columns.frame(0, self.layout.rows)}
        known = dict.fromkeys(name for records in blocks.values() for name in records)
        for name in columns or ():
            if name not in known:
                raise TableError(f"{name} is not a column of the table{near_miss.suggestion(name, known)}")
        blocks = {number: selection.records_of_frame(records) for number, records in blocks.items()}
        own = in_columns is None or is_copy
        joined = joined_frames(list(blocks.values())) if own else blocks[0]
        if joined is None:
            arrow = PartRecords()
            for number, records in blocks.items():
                arrow.add(*arrow_part(records, number, self.layout.job_hash, {}))
            return joined_parts(Path(), arrow, columns)
        return joined if columns is None else pd.DataFrame(joined, columns=[*dict.fromkeys(columns)])
