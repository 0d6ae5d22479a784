"""Verification of the files of a table against its manifest and digests."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import pyarrow as pa

from gaitsweep.row_outcome import RowOutcome
from gaitsweep.table.atomic_files import TableError, is_partial, read_file, reason
from gaitsweep.table.digests import DIGESTS, digest_of, read_digests
from gaitsweep.table.manifest import TABLE, Layout
from gaitsweep.table.parquet_parts import (
    OPEN_ROWS,
    PARTS,
    DamagedPart,
    Footer,
    read_footer,
    read_open,
    read_records,
)

FOREIGN = ".foreign"  # suffix of a part of another table that was renamed
T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Fault:
    """An unusable file: `what` is the reason, and `foreign` is true if it belongs to another table.

    `digest_known` is true if a digest of the file is recorded.
    """

    file: Path
    what: str
    foreign: bool = False
    digest_known: bool = False

    @property
    def sentence(self) -> str:
        """File and reason."""
        return f"{self.file} is {'not a part of this table' if self.foreign else 'damaged'}: {self.what}"


class Examination:
    """Comparison of the files of a table, each read once, with the layout.

    The iteration over `parts` sets `footers` of valid parts and `faults` of the others, by block; `strangers`
    are files without a block; the iteration over `open_rows` sets `open_faults`. `digests` are the recorded
    digests of files, and `undigested` those of valid files without a recorded one, by name.

    Args:
        path: the result directory.
        layout: that of its table.

    Raises:
        TableError: the folder cannot be read.
    """

    def __init__(self, path: Path, layout: Layout) -> None:
        self.path = path
        self.folder = path / TABLE
        self.layout = layout
        self.footers: dict[int, Footer] = {}
        self.faults: dict[int, Fault] = {}
        self.strangers: list[Fault] = []
        self.open_faults: list[Fault] = []
        self.undigested: dict[str, str] = {}
        names: list[str] = []
        try:
            if self.folder.is_dir():
                names = sorted(entry.name for entry in self.folder.iterdir() if not is_partial(entry))
        except OSError as error:
            raise TableError(f"{self.folder} cannot be read: {reason(error)}.") from error
        # digests are read after names, since the line of a file is written before its name
        self.digests = read_digests(path)
        self._numbers: list[int] = []
        self._open_numbers: list[int] = []
        for name in names:
            number = PARTS.number(name)
            opened = OPEN_ROWS.number(name)
            if number is not None and number in self.layout.blocks:
                self._numbers.append(number)
            elif opened is not None:
                self._open_numbers.append(opened)
            elif name.endswith(".parquet"):
                what = "files of this table do not have such names. Move it out of this directory."
                self.strangers.append(Fault(self.folder / name, what, foreign=True))
        self.last_open = max(self._open_numbers, default=0)

    def parts(
        self, *, records: bool = False, columns: Sequence[str] | None = None
    ) -> Iterator[tuple[int, pa.Table | None]]:
        """Iterate over the valid parts in order, with their records if `records`.

        Args:
            records: whether the records are read.
            columns: the columns that are read, beside `row`; all by default.
        """

        def read(number: int, data: bytes, digest: str | None) -> tuple[Footer, pa.Table | None]:
            footer = examined_part(data, digest, self.layout, number)
            rows = self.layout.rows_of(number)
            return footer, read_records(data, footer, *rows, columns) if records else None

        for number in self._numbers:
            part = self._read(self.folder / PARTS.name(number), functools.partial(read, number))
            if isinstance(part, Fault):
                self.faults[number] = part
            elif part is not None:
                self.footers[number], table = part
                yield number, table

    def open_rows(self) -> Iterator[tuple[Path, RowOutcome]]:
        """Iterate over the files of ended rows of incomplete blocks."""

        def read(data: bytes, digest: str | None) -> RowOutcome:
            if digest is not None and digest_of(data) != digest:
                raise DamagedPart(f"its bytes differ from the digest in {DIGESTS}")
            return read_open(data, self.layout.job_hash, self.layout.rows)

        for number in self._open_numbers:
            file = self.folder / OPEN_ROWS.name(number)
            rows = self._read(file, read)
            if isinstance(rows, Fault):
                self.open_faults.append(rows)
            elif rows is not None:
                yield file, rows

    def _read(self, file: Path, read: Callable[[bytes, str | None], T]) -> T | Fault | None:
        """Read a file by `read`, from its bytes and its digest; None if the file has been removed."""
        name = f"{TABLE}/{file.name}"
        digest = self.digests.get(name)
        try:
            data = read_file(file)
            content = read(data, digest)
        except FileNotFoundError:
            return None
        except (OSError, DamagedPart) as error:
            what = reason(error) if isinstance(error, OSError) else error
            return Fault(file, f"{what}.", isinstance(error, _ForeignPart), digest is not None)
        if digest is None:
            self.undigested[name] = digest_of(data)
        return content


class _ForeignPart(DamagedPart):
    """A valid part of another job."""


def examined_part(data: bytes, digest: str | None, layout: Layout, number: int) -> Footer:
    """Compare a part with its digest and with the layout of its table.

    Args:
        data: the part's bytes.
        digest: their recorded digest; without it, the checksums of all pages are verified.
        layout: that of the table.
        number: the block.

    Raises:
        DamagedPart: the bytes are not those of the part that was written.
    """
    start, stop = layout.rows_of(number)
    if digest is not None and digest_of(data) != digest:
        _refuse_other_part(data, layout.job_hash, number)
        raise DamagedPart(f"its bytes differ from the digest in {DIGESTS}")
    footer = read_footer(data)
    _check_job(footer, layout.job_hash)
    if footer.part != number or footer.rows != stop - start:
        raise DamagedPart(
            f"it has {footer.rows} rows of part {footer.part} instead of {stop - start} rows of part {number}"
        )
    if digest is None:
        read_records(data, footer, start, stop)
    return footer


def examined_parts(path: Path, layout: Layout, numbers: Iterable[int]) -> dict[int, Footer]:
    """Return the footers of the valid parts among some, which other processes may have written.

    Args:
        path: the result directory.
        layout: that of its table.
        numbers: the blocks.
    """
    files = {number: path / TABLE / PARTS.name(number) for number in numbers}
    files = {number: file for number, file in files.items() if file.exists()}
    # digests are read after names, since the line of a file is written before its name
    digests = read_digests(path) if files else {}
    footers: dict[int, Footer] = {}
    for number, file in files.items():
        with contextlib.suppress(OSError, DamagedPart):
            digest = digests.get(f"{TABLE}/{file.name}")
            footers[number] = examined_part(read_file(file), digest, layout, number)
    return footers


def _refuse_other_part(data: bytes, job_hash: str, number: int) -> None:
    """Raise an error if a part with a wrong digest is a valid part of another job or block."""
    try:
        footer = read_footer(data)
    except DamagedPart:
        return
    _check_job(footer, job_hash)
    if footer.part != number:
        raise DamagedPart(f"it has part {footer.part} instead of {number}")


def _check_job(footer: Footer, job_hash: str) -> None:
    """Refuse a part of another job."""
    if footer.job_hash != job_hash:
        raise _ForeignPart(f"it belongs to another job (hash {footer.job_hash[:12]}, part {footer.part})")
