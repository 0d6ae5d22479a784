"""Writing a result directory: made or continued, one part at a time, by one writer."""

from __future__ import annotations

import errno
import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import pandas as pd
import yaml

from gaitsweep.table.files import Lock, TableError, WriteError, reason, remove_partials, replace_file
from gaitsweep.table.manifest import FIGURES, JOB, MANIFEST, TABLE, claim, new_manifest
from gaitsweep.table.parts import (
    DamagedPart,
    Footer,
    check_frame,
    count_statuses,
    part_name,
    part_numbers,
    read_footer,
    write_part,
)
from gaitsweep.table.reading import add_counts

_FIXED = ("format", "job_hash", "rows", "block")


class ResultDirectory:
    """A result directory open for writing; use it as a context manager, or call `close`.

    `notes` are sentences about what was found and mended at opening, for the user to read.
    """

    def __init__(self, path: Path, lock: Lock, manifest: dict[str, Any]) -> None:
        """Use `ResultDirectory.open`."""
        self.path = path
        self.manifest = manifest
        self.notes: list[str] = []
        self._lock = lock
        self._footers: dict[int, Footer] = {}

    @classmethod
    def open(
        cls, path: str | Path, job: Mapping[str, Any], job_hash: str, n_rows: int, block: int
    ) -> ResultDirectory:
        """Make a result directory, or continue the one that is there.

        Args:
            path: the directory; its parents are made.
            job: the resolved job, written to `job.yaml`.
            job_hash: what decides the numbers; a directory with another one is refused.
            n_rows: rows of the whole sweep.
            block: rows of a part.

        Raises:
            TableError: the directory belongs to another job, to something else than gaitsweep, or to a run
                that is still going on.
            WriteError: it cannot be made or written.
        """
        path = Path(path)
        claim(path, job_hash, n_rows, block)
        try:
            path.mkdir(parents=True, exist_ok=True)
            lock = Lock(path)
        except OSError as error:
            full = error.errno == errno.ENOSPC  # else the place is at fault, which the user chose
            kind = WriteError if full else TableError
            raise kind(f"The result directory {path} cannot be made: {reason(error)}.") from error
        try:
            # Looked at again, since another run may have made it between the first look and the lock.
            manifest = claim(path, job_hash, n_rows, block)
            directory = cls(path, lock, manifest or new_manifest(job_hash, n_rows, block))
            if not lock.exclusive:
                directory.notes.append(
                    f"The file system of {path} has no locks: do not run this job twice at once."
                )
            directory._prepare(job, new=manifest is None)
            directory._examine_parts()
        except OSError as error:
            lock.release()
            raise WriteError(f"The result directory {path} cannot be written: {reason(error)}.") from error
        except BaseException:
            lock.release()
            raise
        return directory

    def _prepare(self, job: Mapping[str, Any], new: bool) -> None:
        for folder in (self.path, self.path / TABLE, self.path / FIGURES):
            remove_partials(folder)
        if new:  # first of all, since a directory without one is foreign
            self._write_manifest()
        (self.path / TABLE).mkdir(exist_ok=True)
        text = yaml.dump(dict(job), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)
        job_file = self.path / JOB
        if not job_file.is_file() or job_file.read_text(encoding="utf-8") != text:
            replace_file(job_file, lambda file: file.write(text.encode()))

    def _examine_parts(self) -> None:
        for number in part_numbers(self.path / TABLE):
            file = self.path / TABLE / part_name(number)
            try:
                footer = read_footer(file)
            except DamagedPart:
                file.unlink()
                self.notes.append(f"{file} was damaged: it is removed, and its rows are run again.")
                continue
            start, stop = self.rows_of(number)
            if (
                footer.job_hash != self.manifest["job_hash"]
                or footer.part != number
                or footer.rows != stop - start
            ):
                raise TableError(
                    f"{file} belongs to another job (hash {footer.job_hash[:12]}, part {footer.part}): "
                    "move it out of this directory, and run again."
                )
            self._footers[number] = footer

    @property
    def n_rows(self) -> int:
        """Rows of the whole sweep."""
        return self.manifest["rows"]

    @property
    def n_blocks(self) -> int:
        """Parts of the whole table."""
        return -(-self.manifest["rows"] // self.manifest["block"])

    @property
    def rows_done(self) -> int:
        """How many rows stand in complete parts."""
        return sum(footer.rows for footer in self._footers.values())

    @property
    def figures(self) -> Path:
        """The folder of the figures, which is made when it is asked for."""
        folder = self.path / FIGURES
        folder.mkdir(exist_ok=True)
        return folder

    def rows_of(self, number: int) -> tuple[int, int]:
        """Give the first row of a block and the row after its last (equal past the table's end)."""
        block, rows = self.manifest["block"], self.manifest["rows"]
        return min(number * block, rows), min((number + 1) * block, rows)

    def missing_blocks(self) -> list[int]:
        """List the blocks that have no part yet, in order."""
        return [number for number in range(self.n_blocks) if number not in self._footers]

    def counts(self) -> dict[str, int]:
        """Count the rows of all complete parts by status."""
        return add_counts(self._footers)

    def write_part(self, number: int, frame: pd.DataFrame) -> None:
        """Write a block's records; they are safe when this returns.

        Args:
            number: the block.
            frame: its records, in the order of their rows and at least one for each, with `row` (int64)
                and `status`.

        Raises:
            WriteError: the disk is full or the file cannot be written; there is no half part.
            ValueError: the frame is not that block's.
        """
        start, stop = self.rows_of(number)
        if not 0 <= number < self.n_blocks:
            raise ValueError(f"There is no block {number}: the blocks are 0 to {self.n_blocks - 1}.")
        check_frame(frame, start, stop)
        counts = count_statuses(frame)
        if sum(counts.values()) != stop - start:
            raise ValueError(
                f"The statuses of part {number} count {sum(counts.values())} rows, not {stop - start}."
            )
        footer: list[Footer] = []

        def write(file: BinaryIO) -> None:
            footer.append(write_part(file, frame, number, self.manifest["job_hash"], counts))

        try:
            replace_file(self.path / TABLE / part_name(number), write)
        except OSError as error:
            raise WriteError(
                f"Part {number} (rows {start} to {stop - 1}) could not be written to {self.path}: "
                f"{reason(error)}; {self.rows_done} of {self.n_rows} rows are safe there, "
                "and the same command continues from them."
            ) from error
        self._footers[number] = footer[0]

    def update_manifest(self, **fields: Any) -> None:
        """Set fields of `manifest.json` (JSON values; None removes one), which is replaced as a whole.

        Raises:
            WriteError: it cannot be written; the old one stands.
            ValueError: a field that identifies the directory.
        """
        for name in fields:
            if name in _FIXED:
                raise ValueError(f"The manifest's {name} cannot change.")
        manifest = {k: v for k, v in (self.manifest | fields).items() if v is not None}
        old, self.manifest = self.manifest, manifest
        try:
            self._write_manifest()
        except OSError as error:
            self.manifest = old
            raise WriteError(f"{self.path / MANIFEST} could not be written: {reason(error)}.") from error

    def _write_manifest(self) -> None:
        text = json.dumps(self.manifest, indent=2, ensure_ascii=False, default=_plain) + "\n"
        replace_file(self.path / MANIFEST, lambda file: file.write(text.encode()))

    def close(self) -> None:
        """Let others write the directory; a second call does nothing."""
        self._lock.release()

    def __enter__(self) -> ResultDirectory:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class _Dumper(yaml.SafeDumper):
    """Writes a list that stands in two places twice, not as an anchor and an alias."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):  # NumPy's and JAX's scalars and arrays
        return value.tolist()
    return str(value)
