"""Writing of parts by one of several processes, such as workers of a cluster or an array of jobs."""

from __future__ import annotations

import os
import secrets
import socket
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from gaitsweep.table.digests import read_digests, write_file
from gaitsweep.table.examination import examined_part
from gaitsweep.table.files import PARTS, read_file, writing
from gaitsweep.table.manifest import TABLE, Layout
from gaitsweep.table.parts import DamagedPart, checked_part

# No two processes have the same, also not two of different machines.
WRITER = f"{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(4)}"


class PartWriter:
    """Writes parts into a result directory whose manifest belongs to another process.

    The bytes of a part do not depend on its writer, so one process may replace another's part.
    """

    def __init__(
        self,
        path: Path,
        layout: Layout,
    ) -> None:
        """Open a directory for writing parts.

        Args:
            path: the result directory, which exists.
            layout: that of its table.
        """
        self.path, self.layout = path, layout

    def has(self, number: int) -> bool:
        """Whether the part of a block exists and is valid."""
        return not self.missing([number])

    def missing(self, numbers: Iterable[int]) -> list[int]:
        """The blocks, among some, whose part is missing or invalid."""
        parts = {number: self.path / TABLE / PARTS.name(number) for number in numbers}
        there = {number for number, part in parts.items() if part.exists()}
        # digests are read after names, since the line of a file is written before its name
        digests = read_digests(self.path) if there else {}

        def sound(number: int, part: Path) -> bool:
            try:
                examined_part(read_file(part), digests.get(f"{TABLE}/{part.name}"), self.layout, number)
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
        return checked_part(frame, number, self.layout, quantities)[0]

    def write(self, number: int, data: bytes) -> None:
        """Write a part that `encoded` has made; it is on disk when this returns.

        Raises:
            WriteError: the disk is full or the file cannot be written; no incomplete part is left.
        """
        start, stop = self.layout.rows_of(number)
        with writing(f"Part {number} (rows {start} to {stop - 1}) could not be written to {self.path}"):
            write_file(self.path, f"{TABLE}/{PARTS.name(number)}", data, writer=WRITER)
