"""Result directories: a table in parts that survives interruptions, with its provenance.

A directory contains `job.yaml` (resolved), `manifest.json`, `table/part-00000.parquet` and so on (one part
for each block of rows), `SHA256SUMS` (the digest of each part), `figures/` and optionally `report.html`. A
part that exists is complete; during a run, ended rows of other blocks are in `table/open-00001.parquet` and
so on.

`directory` writes one, also parts of one beside other processes, and knows which parts are missing; `memory`
is a table without files; `reading` reads them. `manifest`, `parquet_parts`, `digests` and `locks` have the
names and formats of their files. `atomic_files` writes any file whole or not at all, `examination` verifies
them, `frames` joins parts.
"""

from __future__ import annotations

from gaitsweep.table.atomic_files import (
    TableError,
    WriteError,
    own_folder,
    read_file,
    reason,
    replace_file,
    writing,
)
from gaitsweep.table.directory import ResultDirectory
from gaitsweep.table.memory import MemoryTable
from gaitsweep.table.parquet_parts import EncodedPart
from gaitsweep.table.reading import Snapshot, load, load_parts, load_with_snapshot

Table = ResultDirectory | MemoryTable  # of a run that writes it

__all__ = [
    "EncodedPart",
    "MemoryTable",
    "ResultDirectory",
    "Snapshot",
    "Table",
    "TableError",
    "WriteError",
    "load",
    "load_parts",
    "load_with_snapshot",
    "own_folder",
    "read_file",
    "reason",
    "replace_file",
    "writing",
]
