"""Result directories: a table in parts that survive any interruption, and what made it.

A directory holds `job.yaml` (resolved), `manifest.json`, `table/part-00000.parquet` and so on (one part a
block of rows), `figures/` and perhaps `report.html`. A part that exists is complete.
"""

from __future__ import annotations

from gaitsweep.table.directory import ResultDirectory
from gaitsweep.table.files import TableError, WriteError, reason, replace_file
from gaitsweep.table.reading import Snapshot, load

__all__ = ["ResultDirectory", "Snapshot", "TableError", "WriteError", "load", "reason", "replace_file"]
