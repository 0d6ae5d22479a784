"""Writing of a result directory, new or continued, one part at a time.

`ResultDirectory` is its one writer; beside it or before it, other processes may write parts
(`SharedWriter`).
"""

from __future__ import annotations

import collections
import contextlib
import errno
import itertools
import os
import secrets
import socket
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import yaml

from gaitsweep.row_outcome import RowOutcome
from gaitsweep.table.atomic_files import (
    TableError,
    WriteError,
    own_folder,
    read_file,
    reason,
    remove_partials,
    replace_file,
    writing,
)
from gaitsweep.table.digests import DIGESTS, digest_of, of_writers, read_digests, write_digests, write_file
from gaitsweep.table.examination import FOREIGN, Examination, Fault, examined_parts
from gaitsweep.table.locks import BLOCK_LOCKS, Lock
from gaitsweep.table.manifest import (
    FIGURES,
    IDENTITY,
    JOB,
    MANIFEST,
    TABLE,
    DamagedManifest,
    Layout,
    claim,
    json_value,
    manifest_bytes,
    new_manifest,
    sealed,
)
from gaitsweep.table.parquet_parts import (
    OPEN_ROWS,
    PARTS,
    DamagedPart,
    EncodedPart,
    Footer,
    checked_records,
    count_names,
    missing_blocks,
    open_bytes,
    read_footer,
    readable,
    unreadable,
)
from gaitsweep.table.reading import Rows, added_counts, load, load_parts

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


class ResultDirectory:
    """A result directory open for writing; use it as a context manager, or call `close`.

    `ResultDirectory.open` makes one. `notes` are sentences for the user about damage that was found and
    repaired at opening.
    """

    def __init__(self, path: Path, lock: Lock, manifest: dict[str, Any]) -> None:
        self.path = path
        self.manifest = manifest
        self.layout = Layout.of(manifest)
        self.notes: list[str] = []
        self._lock = lock
        self._footers: dict[int, Footer] = {}
        # files of ended rows of open blocks, and the blocks that still need them
        self._open_files: dict[Path, set[int]] = {}
        self._restored: dict[int, RowOutcome] = {}
        self._last_open = 0
        self._tallies: dict[str, dict[int, dict[str, int]]] = {}  # counts of names by column and part

    @classmethod
    def open(cls, path: str | Path, job: Mapping[str, Any], layout: Layout) -> ResultDirectory:
        """Create a result directory, or continue an existing one.

        Args:
            path: the directory; its parents are created.
            job: the resolved job, written to `job.yaml`.
            layout: that of the table; a directory with another layout is refused.

        Raises:
            TableError: the directory belongs to another job or program, or another run is writing it.
            WriteError: it cannot be created or written.
        """
        path = Path(path)
        _claimed(path, layout)  # before the directory is created or locked
        try:
            path.mkdir(parents=True, exist_ok=True)
            lock = Lock(path)
        except OSError as error:
            full = error.errno == errno.ENOSPC  # else the place is at fault, which the user chose
            kind = WriteError if full else TableError
            raise kind(f"The result directory {path} cannot be created: {reason(error)}.") from error
        try:
            # checked again, since another run may have created it between the first check and the lock
            claimed = _claimed(path, layout)
            manifest = claimed if isinstance(claimed, dict) else None
            directory = cls(path, lock, manifest or new_manifest(layout, job))
            if isinstance(claimed, DamagedManifest):
                directory.notes.append(
                    f"{claimed.what}: it will be rewritten, since the table's parts belong to this job."
                )
            if not lock.file_system_has_locks:
                directory.notes.append(
                    f"The file system of {path} has no locks: do not run this job twice at the same time."
                )
            with writing(f"The result directory {path} cannot be written"):
                directory._prepare(job, new=manifest is None)
                directory._examine()
        except BaseException:
            lock.release()
            raise
        return directory

    def _prepare(self, job: Mapping[str, Any], *, new: bool) -> None:
        """Write the manifest, the job and the folders of a directory, as far as they are missing or old."""
        for folder in (self.path, self.path / TABLE, self.path / FIGURES):
            remove_partials(folder)
        plain = json_value(dict(job))
        # first, since a directory without a manifest is not recognised
        if new or self.manifest.get("job") != plain:
            self.manifest["job"] = plain
            self._write_manifest()
        own_folder(self.path / TABLE)
        text = yaml.dump(dict(job), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100).encode()
        job_file = self.path / JOB
        try:
            unchanged = read_file(job_file) == text
        except FileNotFoundError:
            unchanged = False
        except OSError as error:
            raise TableError(f"{job_file} cannot be read: {reason(error)}. Move it away.") from error
        if not unchanged or read_digests(self.path).get(JOB) != digest_of(text):
            write_file(self.path, JOB, text)
            self._keep_latest_digests()

    def _examine(self) -> None:
        """Verify the files, remove damaged ones, and restore the ended rows of open blocks."""
        examined = Examination(self.path, self.layout)
        collections.deque(examined.parts(), maxlen=0)  # the iteration examines them
        if examined.strangers:
            raise TableError(examined.strangers[0].sentence)
        for fault in examined.faults.values():
            if fault.foreign and not fault.digest_known:
                # no part of this table was ever there: the file was put there by mistake
                advice = "move it out of this directory and run the job again."
                raise TableError(f"{fault.sentence[:-1]}: {advice}")
            self._clear(fault)
        self._footers = examined.footers
        self._last_open = examined.last_open
        self._restore(examined)
        for fault in examined.open_faults:
            self._clear(fault)
        if examined.undigested:
            self._record_digests(examined)

    def _restore(self, examined: Examination) -> None:
        """Read the ended rows of open blocks, and remove files whose blocks all have parts."""
        stored: dict[int, list[RowOutcome]] = {}
        for file, rows in examined.open_rows():
            blocks = rows.row // self.layout.block
            missing = [int(number) for number in np.unique(blocks) if int(number) not in self._footers]
            for number in missing:
                stored.setdefault(number, []).append(rows.take(np.flatnonzero(blocks == number)))
            if missing:
                self._open_files[file] = set(missing)
            else:  # the earlier run was killed after it had written their parts
                file.unlink(missing_ok=True)
        for number, parts in stored.items():
            newest = max((part.numbers.keys() for part in parts), key=len)  # older versions may have fewer
            rows = RowOutcome.concat([part for part in parts if part.numbers.keys() == newest])
            _, first = np.unique(rows.row, return_index=True)  # a row may stand in several files
            self._restored[number] = rows.take(first)

    def _record_digests(self, examined: Examination) -> None:
        """Record the digests of valid files that have none."""
        count = len(examined.undigested)
        subject = "1 file" if count == 1 else f"{count} files"
        write_digests(self.path, read_digests(self.path) | examined.undigested)
        self.notes.append(
            f"{subject} of {self.path / TABLE} had no digests in {DIGESTS}. Job, block, rows and page "
            "checksums are correct there: the files are used, and their digests are written again."
        )

    def _clear(self, fault: Fault) -> None:
        """Remove an unusable file; a part of another job is renamed instead."""
        file = fault.file
        if file.is_dir() and not file.is_symlink():
            try:
                file.rmdir()
            except OSError as error:
                text = f"{file} is a folder but must be a file: move it out of this directory."
                raise TableError(text) from error
            self.notes.append(f"{file} was a folder: it was removed, and its rows run again.")
        elif fault.foreign:
            endings = itertools.chain([FOREIGN], (f".{number}{FOREIGN}" for number in itertools.count(2)))
            candidates = (file.with_name(f"{file.name}{ending}") for ending in endings)
            aside = next(candidate for candidate in candidates if not candidate.exists())
            file.rename(aside)
            self.notes.append(
                f"{fault.sentence} It was renamed to {aside.name}, and the rows of this table run again."
            )
        else:
            file.unlink(missing_ok=True)
            self.notes.append(
                f"{file} was damaged: it was removed, and its rows run again ({fault.what[:-1]})."
            )

    @property
    def rows_done(self) -> int:
        """Number of rows in complete parts."""
        return sum(footer.rows for footer in self._footers.values())

    @property
    def rows_open(self) -> int:
        """Number of ended rows in open blocks when the directory was opened."""
        return sum(rows.row.size for rows in self._restored.values())

    def missing_blocks(self) -> list[int]:
        """Return the blocks without a part, in order."""
        return missing_blocks(self.layout.blocks, self._footers)

    def counts(self) -> dict[str, int]:
        """Return the numbers of rows in complete parts by status."""
        # a copy: another thread may write a part
        return added_counts(footer.counts for footer in list(self._footers.values()))

    def tally(self, column: str | None) -> dict[str, int]:
        """Count the values of a column of text in complete parts, each of which is read once.

        Args:
            column: its name; None: the statuses of the rows.
        """
        if column is None:
            return self.counts()
        of_parts = self._tallies.setdefault(column, {})
        for number in self._footers.keys() - of_parts.keys():
            of_parts[number] = {}
            # the table's readers report a file that has been damaged meanwhile
            with contextlib.suppress(*unreadable()):
                file = self.path / TABLE / PARTS.name(number)
                table = pq.ParquetFile(readable(read_file(file))).read([column])
                of_parts[number] = count_names(table, column)
        tally: collections.Counter[str] = collections.Counter()
        for counts in of_parts.values():
            tally.update(counts)
        return dict(tally.most_common())

    def load(self, rows: Rows | None = None) -> pd.DataFrame:
        """Read the table, or the records of some rows; see `table.load`."""
        return load(self.path, rows=rows)

    def load_parts(self, columns: Sequence[str]) -> Iterator[pd.DataFrame]:
        """Read the records of a complete table, some parts at a time; see `table.load_parts`."""
        return load_parts(self.path, columns)

    def write_part(self, number: int, frame: pd.DataFrame) -> None:
        """Write the records of a block; they are on disk when this returns.

        Args:
            number: the block.
            frame: its records, in the order of their rows and at least one for each row, with `row` (int64)
                and `status`.

        Raises:
            WriteError: the disk is full or the file cannot be written; no incomplete part is left.
            ValueError: the frame does not belong to the block.
        """
        self.write_encoded(number, self.encoded(number, frame))

    def encoded(self, number: int, frame: pd.DataFrame) -> EncodedPart:
        """Encode the records of a block, for `write_encoded`; threads may do so at the same time.

        Args:
            number: the block.
            frame: its records, as for `write_part`.

        Raises:
            ValueError: the frame does not belong to the block.
        """
        return checked_records(frame, number, self.layout, self.manifest.get("quantities")).encoded()

    def write_encoded(self, number: int, part: EncodedPart) -> None:
        """Write a part that `encoded` has made; it is on disk when this returns.

        Args:
            number: the block.
            part: its bytes and footer.

        Raises:
            WriteError: as for `write_part`.
        """
        data, footer = part
        failure = f"Part {self.layout.words(number)} could not be written to {self.path}"
        safe = f"; {self.rows_done} of {self.layout.rows} rows are safe there, and the same command continues"
        with writing(failure, f"{safe} from them"):
            write_file(self.path, f"{TABLE}/{PARTS.name(number)}", data)
        self._has_part(number, footer)

    def write_part_bytes(self, number: int, data: bytes) -> None:
        """Write a part that another process has encoded.

        Args:
            number: the block.
            data: the bytes of the part.

        Raises:
            WriteError: as for `write_part`.
            DamagedPart: the bytes are not this part of this table.
        """
        footer = read_footer(data)
        expected = (number, self.layout.job_hash, self.layout.rows_in([number]))
        if (footer.part, footer.job_hash, footer.rows) != expected:
            raise DamagedPart(f"it is not part {number} of this table")
        self.write_encoded(number, EncodedPart(data, footer))

    def take_parts(self, numbers: Sequence[int]) -> list[int]:
        """Read parts that other processes have written.

        Args:
            numbers: the blocks.

        Returns:
            The blocks whose part is missing or invalid.
        """
        footers = examined_parts(self.path, self.layout, numbers)
        for number, footer in footers.items():
            self._has_part(number, footer)
        return [number for number in numbers if number not in footers]

    def _has_part(self, number: int, footer: Footer) -> None:
        """Record that a part is on disk, and remove stored rows that are no longer needed."""
        self._footers[number] = footer
        self._restored.pop(number, None)
        for file, blocks in list(self._open_files.items()):
            blocks.discard(number)
            if not blocks:
                del self._open_files[file]
                with contextlib.suppress(OSError):  # the next run tries again
                    file.unlink(missing_ok=True)

    def restored(self, number: int) -> RowOutcome | None:
        """Return the rows of an open block that an earlier run has stored by `keep`, or None."""
        return self._restored.get(number)

    def keep(self, rows: RowOutcome) -> None:
        """Store ended rows of open blocks until their part is written; they are on disk when this returns.

        Raises:
            WriteError: the disk is full or the file cannot be written.
        """
        name = OPEN_ROWS.name(self._last_open + 1)
        with writing(f"{rows.row.size} finished rows could not be stored in {self.path / TABLE / name}"):
            write_file(self.path, f"{TABLE}/{name}", open_bytes(rows, self.layout.job_hash))
        self._last_open += 1
        blocks = {int(number) for number in np.unique(rows.row // self.layout.block)}
        self._open_files[self.path / TABLE / name] = blocks

    def write_beside(self, name: str, data: bytes) -> None:
        """Write a file beside the table, with its digest, for `read_beside`.

        Raises:
            WriteError: it cannot be written; the old file is unchanged, and is read no more.
        """
        with writing(f"{self.path / name} could not be written"):
            write_file(self.path, name, data)
            self._keep_latest_digests()

    def _keep_latest_digests(self) -> None:
        """Keep one line for each name, since `sha256sum -c` tests a file against all of its lines."""
        write_digests(self.path, read_digests(self.path))

    def read_beside(self, name: str) -> bytes | None:
        """Read what `write_beside` wrote; None, with a note, if it is missing, damaged or edited."""
        digest = read_digests(self.path).get(name)
        try:
            data = read_file(self.path / name)
        except FileNotFoundError:
            return None
        except OSError:
            data = b""
        if digest is not None and digest_of(data) == digest:
            return data
        what = "has no digest" if digest is None else f"differs from its digest in {DIGESTS}"
        self.notes.append(f"{self.path / name} {what}: it will be rewritten.")
        return None

    def update_manifest(self, **fields: Any) -> None:
        """Set fields of `manifest.json` (JSON values; None removes a field).

        Raises:
            WriteError: it cannot be written; the old file is unchanged.
            ValueError: a field identifies the directory and cannot change.
        """
        if fixed := fields.keys() & {*IDENTITY}:
            raise ValueError(f"The manifest's {min(fixed)} cannot change.")
        if not fields:
            return
        old = self.manifest
        self.manifest = {name: value for name, value in (old | fields).items() if value is not None}
        try:
            with writing(f"{self.path / MANIFEST} could not be written"):
                self._write_manifest()
        except TableError:
            self.manifest = old
            raise

    def tidy_digests(self) -> None:
        """Reduce `SHA256SUMS` to one line for each existing file, and remove leftovers of other writers.

        Raises:
            WriteError: it cannot be written; the old file is unchanged.
        """
        others = of_writers(self.path)
        names = {f"{TABLE}/{PARTS.name(number)}" for number in self._footers}
        names |= {f"{TABLE}/{file.name}" for file in self._open_files}
        known = read_digests(self.path)
        names |= {name for name in known if "/" not in name and (self.path / name).is_file()}
        with writing(f"{self.path / DIGESTS} could not be written"):
            write_digests(self.path, {name: known[name] for name in names if name in known})
            for file in (*others, self.path / BLOCK_LOCKS):
                file.unlink(missing_ok=True)
            remove_partials(self.path / TABLE)

    def _write_manifest(self) -> None:
        """Write `manifest.json`, sealed."""
        self.manifest = plain = sealed(json_value(self.manifest))
        replace_file(self.path / MANIFEST, lambda file: file.write(manifest_bytes(plain)))

    def close(self) -> None:
        """Release the directory for other writers; a second call does nothing."""
        self._lock.release()

    def __enter__(self) -> ResultDirectory:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _claimed(path: Path, layout: Layout) -> dict[str, Any] | DamagedManifest | None:
    """Return the manifest from `claim`, or the error if it is damaged but the parts belong to this job."""
    try:
        return claim(path, layout)
    except DamagedManifest as error:
        examined = Examination(path, layout)
        if not any(True for _ in examined.parts()) and not any(True for _ in examined.open_rows()):
            text = f"{error} It has no valid part of this job: choose another directory with --out."
            raise TableError(text) from error
        return error


_SafeDumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # which C makes ten times as fast


class _Dumper(_SafeDumper):
    """Writer of YAML that writes a repeated list twice, not as an anchor and an alias."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write all values in full."""
        return True
