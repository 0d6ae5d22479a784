"""Writer of parts into a table that several processes share and write at the same time."""

from __future__ import annotations

import os
import secrets
import socket
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from gaitsweep.table.atomic_files import writing
from gaitsweep.table.digests import write_file
from gaitsweep.table.examination import examined_parts
from gaitsweep.table.manifest import TABLE, Layout
from gaitsweep.table.parquet_parts import PARTS, checked_records, missing_blocks

# No two processes have the same, also not two of different machines.
WRITER = f"{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(4)}"


class SharedWriter:
    """Writer of parts into a result directory whose manifest belongs to another process.

    The bytes of a part do not depend on its writer, so one process may replace another's part.

    Args:
        path: the result directory, which exists.
        layout: that of its table.
    """

    def __init__(self, path: Path, layout: Layout) -> None:
        self.path = path
        self.layout = layout

    def has(self, number: int) -> bool:
        """Return whether the part of a block exists and is valid."""
        return not self.missing_blocks([number])

    def missing_blocks(self, numbers: Sequence[int]) -> list[int]:
        """Return the blocks, among some, whose part is missing or invalid."""
        return missing_blocks(numbers, examined_parts(self.path, self.layout, numbers))

    def encoded(
        self, number: int, frame: pd.DataFrame, quantities: Mapping[str, Mapping[str, Any]] | None = None
    ) -> bytes:
        """Encode the part with the records of a block.

        Args:
            number: the block.
            frame: its records.
            quantities: unit and meaning of the columns, by name, as in the manifest.

        Raises:
            ValueError: the frame does not belong to the block.
        """
        return checked_records(frame, number, self.layout, quantities).encoded().data

    def write(self, number: int, data: bytes) -> None:
        """Write a part that `encoded` has made; it is on disk when this returns.

        Raises:
            WriteError: the disk is full or the file cannot be written; no incomplete part is left.
        """
        with writing(f"Part {self.layout.words(number)} could not be written to {self.path}"):
            write_file(self.path, f"{TABLE}/{PARTS.name(number)}", data, writer=WRITER)
