"""Writing parts of a table that other processes write too: the workers of a cluster, an array of jobs."""

from __future__ import annotations

import os
import secrets
import socket
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from gaitsweep.table.digests import add_digest, digest_of, read_digests
from gaitsweep.table.examination import examined_part
from gaitsweep.table.files import PARTS, read_file, replace_file, writing
from gaitsweep.table.manifest import FORMAT, TABLE, rows_of
from gaitsweep.table.parts import DamagedPart, checked_part

# No two processes have the same, also not two of different machines.
WRITER = f"{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(4)}"


class PartWriter:
    """Writes parts into a result directory whose manifest belongs to another process.

    A part has the same bytes whoever writes it, so that one may replace another's.
    """

    def __init__(
        self,
        path: Path,
        job_hash: str,
        n_rows: int,
        block: int,
    ) -> None:
        """Take the directory, and what its manifest says.

        Args:
            path: the result directory, which exists.
            job_hash, n_rows, block: as for `ResultDirectory.open`.
        """
        self.path = path
        self._known = {"format": FORMAT, "job_hash": job_hash, "rows": n_rows, "block": block}

    def rows_of(self, number: int) -> tuple[int, int]:
        """The first row of a block, and the row after its last."""
        return rows_of(self._known, number)

    def has(self, number: int) -> bool:
        """Whether the part of a block is there and sound."""
        return not self.missing([number])

    def missing(self, numbers: Iterable[int]) -> list[int]:
        """Those of some blocks whose part is not there or not sound."""
        parts = {number: self.path / TABLE / PARTS.name(number) for number in numbers}
        there = {number for number, part in parts.items() if part.exists()}
        # digests are read after names, since the line of a file is written before its name
        digests = read_digests(self.path) if there else {}

        def sound(number: int, part: Path) -> bool:
            try:
                examined_part(read_file(part), digests.get(f"{TABLE}/{part.name}"), self._known, number)
            except (OSError, DamagedPart):
                return False
            return True

        return [number for number, part in parts.items() if number not in there or not sound(number, part)]

    def encoded(
        self, number: int, frame: pd.DataFrame, quantities: Mapping[str, Mapping[str, Any]] | None = None
    ) -> bytes:
        """The part with the records of a block.

        Args:
            number: the block.
            frame: its records.
            quantities: unit and meaning of the columns, by name, as in the manifest.

        Raises:
            ValueError: the frame does not belong to the block.
        """
        return checked_part(frame, number, self.rows_of(number), self._known["job_hash"], quantities)[0]

    def write(self, number: int, data: bytes) -> None:
        """Write a part that `encoded` has made; it is on disk when this returns.

        Raises:
            WriteError: the disk is full or the file cannot be written; no incomplete part is left.
        """
        start, stop = self.rows_of(number)
        name = PARTS.name(number)
        with writing(f"Part {number} (rows {start} to {stop - 1}) could not be written to {self.path}"):
            add_digest(self.path, f"{TABLE}/{name}", digest_of(data), writer=WRITER)
            replace_file(self.path / TABLE / name, lambda file: file.write(data))
