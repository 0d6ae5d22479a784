"""Table in memory, which a run writes as it writes a result directory."""

from __future__ import annotations

import collections
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from gaitsweep import near_miss
from gaitsweep.table.atomic_files import TableError
from gaitsweep.table.frames import PartRecords, SharedDict, joined_parts, shared
from gaitsweep.table.manifest import Layout, json_value, new_manifest, sealed
from gaitsweep.table.parquet_parts import ArrowPart, checked_records, count_names, missing_blocks
from gaitsweep.table.reading import Rows, Selection, add_counts


class MemoryTable:
    """Table in memory, with the methods of `ResultDirectory` that a run uses.

    Columns have the values and types that a result directory gives, since the same functions convert them.

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
        self._parts: dict[int, ArrowPart] = {}
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
        return add_counts(part.footer for part in list(self._parts.values()))

    def tally(self, column: str | None) -> dict[str, int]:
        """Count the values of a column of text in complete blocks; None: the statuses of the rows."""
        if column is None:
            return self.counts()
        of_parts = self._tallies.setdefault(column, {})
        for number, part in list(self._parts.items()):
            if number not in of_parts:
                of_parts[number] = count_names(part.records, column)
        tally: collections.Counter[str] = collections.Counter()
        for counts in of_parts.values():
            tally.update(counts)
        return dict(tally.most_common())

    def encoded(self, number: int, frame: pd.DataFrame) -> ArrowPart:
        """Convert the records of a block, for `write_encoded`; threads may do so at the same time."""
        return checked_records(frame, number, self.layout)

    def write_encoded(self, number: int, part: ArrowPart) -> None:
        """Add a block that `encoded` has converted."""
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
            last: give up the records, so that they are not in memory twice.
        """
        frame = self._frame(None, rows, last=last)
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
        """Yield the records of the complete table."""
        yield self._frame(columns, None)

    def _frame(self, columns: Sequence[str] | None, rows: Rows | None, *, last: bool = False) -> pd.DataFrame:
        """Return the records of some columns and rows."""
        selection = Selection.of(columns, rows, self.layout.rows)
        parts = PartRecords()
        for _, (records, footer) in sorted(self._parts.items()):
            for name in columns or ():
                if name not in records.column_names:
                    near = near_miss.suggestion(name, records.column_names)
                    raise TableError(f"{name} is not a column of the table{near}")
            parts.add(selection.records_of(records), footer)
            del records
        if last:
            self._parts = {}
        return joined_parts(Path(), parts, columns)
