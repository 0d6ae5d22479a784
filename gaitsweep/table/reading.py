"""Reading of result directories: their contents, and their tables as data frames."""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import yaml
from numpy.typing import ArrayLike

from gaitsweep.errors import warn
from gaitsweep.table.atomic_files import TableError, read_file, reason
from gaitsweep.table.digests import digest_of
from gaitsweep.table.examination import Examination
from gaitsweep.table.frames import PartRecords, SharedDict, joined_parts, shared
from gaitsweep.table.manifest import FIGURES, JOB, Layout, is_job, read_manifest

Rows = slice | range | ArrayLike

_LARGEST_JOB = 64 * 2**20  # bytes
_WITHOUT_NUMBERS = ("name", "verify", "figures", "style")  # fields of a job that decide no number
_DEEPEST = 50  # lists and mappings inside each other in an edited `job.yaml`
_MAX_EVENTS = 400_000  # of YAML's parser in it
# Records in a frame of `load_parts`, at most, if a part has no more: it takes as long to make a frame of one
# part of a few thousand records as of sixteen such parts.
_MAX_RECORDS = 65_536


def figure_files(path: Path) -> list[Path]:
    """Return the files of a directory's figures, sorted by name."""
    files = (path / FIGURES).glob("*")
    return sorted(file for file in files if file.suffix in (".png", ".pdf", ".svg") and file.is_file())


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """Contents of a result directory at one moment, without its records; a run may be writing it.

    `job` is the job that was run, `written` the content of `job.yaml`; they differ if the file was edited.
    `files` are those of the table, examined; `rows_open` is the number of ended rows of incomplete blocks.
    """

    path: Path
    job: dict[str, Any]
    manifest: dict[str, Any]
    files: Examination
    rows_open: int
    written: dict[str, Any]

    @classmethod
    def of(cls, path: str | Path) -> Snapshot:
        """Return the present contents of a directory.

        Raises:
            TableError: it is not a result directory, or its manifest or `job.yaml` cannot be read.
        """
        return _snapshot(Path(path), None, None, None)

    @property
    def job_edited(self) -> bool:
        """Whether `job.yaml` was changed after the run in a field that decides the table's numbers."""
        return _deciding(self.job) != _deciding(self.written)

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of ended rows by status."""
        return added_counts(footer.counts for footer in self.files.footers.values())

    @property
    def rows_done(self) -> int:
        """Number of rows in complete parts."""
        return sum(footer.rows for footer in self.files.footers.values())

    @property
    def rows_safe(self) -> int:
        """Number of rows that are stored, including those of incomplete blocks."""
        return self.rows_done + self.rows_open

    @property
    def figures(self) -> list[Path]:
        """Files of drawn figures, sorted by name."""
        return figure_files(self.path)

    @property
    def complete(self) -> bool:
        """Whether all rows are present."""
        return self.rows_done == self.manifest["rows"]

    @property
    def without_digests(self) -> str:
        """Clause on files without digests, in which damage may go undetected."""
        count = len(self.files.undigested)
        files = "1 file of the table has" if count == 1 else f"{count} files of the table have"
        return f"{files} no digests, so some damage cannot be detected. Run its job again to write them"

    def require_sound(self) -> None:
        """Refuse a table with damaged files or files of another table.

        Raises:
            TableError: there are such files; the message names them.
        """
        _refuse_faults(self.files)


def _deciding(job: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a job that decide the table's numbers."""
    return {key: value for key, value in job.items() if key not in _WITHOUT_NUMBERS}


def _refuse_faults(files: Examination) -> None:
    """Raise TableError if a file of a table is damaged or belongs to another table."""
    faults = [*files.faults.values(), *files.strangers]
    if not faults:
        return
    more = ", ".join(fault.file.name for fault in faults[1:6]) + (", ..." if len(faults) > 6 else "")
    others = f" Also affected: {more}." if more else ""
    misplaced = all(
        fault.file.suffix == ".parquet" and fault.foreign and not fault.digest_known for fault in faults
    )
    advice = "" if misplaced else " Run its job again to replace it."
    raise TableError(f"{faults[0].sentence}{others}{advice}")


def added_counts(counts_of_parts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    """Return the numbers of rows by status over some parts, the most frequent status first."""
    total: collections.Counter[str] = collections.Counter()
    for counts in counts_of_parts:
        total.update(counts)
    return dict(sorted(total.items(), key=lambda item: (-item[1], item[0])))


@dataclasses.dataclass(frozen=True)
class Selection:
    """Records to read from a table: some or all columns of some or all rows."""

    columns: tuple[str, ...] | None = None
    rows: range | np.ndarray | None = None  # in rising order

    @classmethod
    def of(cls, columns: Sequence[str] | None, rows: Rows | None, n_rows: int) -> Selection:
        """Select some columns and rows.

        Args:
            columns, rows: as for `load`.
            n_rows: the number of rows of the table.

        Raises:
            TableError: the table does not have these rows, or they are not row numbers.
        """
        names = None if columns is None else tuple(columns)
        if rows is None:
            return cls(names)
        if isinstance(rows, slice):
            rows = range(*rows.indices(n_rows))
        if isinstance(rows, range):
            numbers = rows if rows.step > 0 else rows[::-1]
        else:
            numbers = np.unique(np.asarray(rows))
            if numbers.size and numbers.dtype.kind not in "iu":
                raise TableError(f"rows contains {numbers[0]!s}, but must be a slice or row numbers.")
        if len(numbers) and not 0 <= numbers[0] <= numbers[-1] < n_rows:
            wrong = numbers[0] if numbers[0] < 0 else numbers[-1]
            raise TableError(f"rows contains {wrong}, but the table has rows 0 to {n_rows - 1}.")
        return cls(names, numbers)

    def records_of(self, table: pa.Table) -> pa.Table:
        """Return the selected records of a part."""
        selected = self._selected(table.column("row").to_numpy())
        if self.columns is not None:
            table = table.select([name for name in table.column_names if name in self.columns])
        return table if selected is None else table.filter(pa.array(selected))

    def records_of_frame(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return the records of the selected rows of a block."""
        selected = self._selected(frame["row"].to_numpy())
        return frame if selected is None else frame.loc[selected]

    def _selected(self, row: np.ndarray) -> np.ndarray | None:
        """The mask (n,) of the selected records among those of rows (n,) in order; None: all of them."""
        if self.rows is None or not row.size:
            return None
        if isinstance(self.rows, range):
            wanted = self.rows
            selected = (row >= wanted.start) & (row < wanted.stop)
            selected &= (row - wanted.start) % wanted.step == 0
        else:
            of_part = slice(*np.searchsorted(self.rows, [row[0], row[-1] + 1]))
            selected = np.isin(row, self.rows[of_part])
        return None if selected.all() else selected


def _snapshot(
    path: Path, parts: PartRecords | None, columns: Sequence[str] | None, rows: Rows | None
) -> Snapshot:
    """Read a directory, and if `parts` are given the records of its valid parts into them, as for `load`."""
    manifest = read_manifest(path)
    selection = Selection.of(columns, rows, manifest["rows"])
    examined = Examination(path, Layout.of(manifest))
    job, written = _jobs_of(path, manifest, examined.digests.get(JOB))
    for number, table in examined.parts(records=parts is not None, columns=selection.columns):
        if parts is not None and table is not None:
            parts.add(selection.records_of(table), examined.footers[number])
    opened = np.concatenate([np.zeros(0, np.int64), *(rows.row for _, rows in examined.open_rows())])
    done = np.array(sorted(examined.footers), np.int64)
    waiting = np.unique(opened[~np.isin(opened // examined.layout.block, done)])
    return Snapshot(path, job, manifest, examined, waiting.size, written)


def _jobs_of(
    path: Path, manifest: dict[str, Any], digest: str | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read the job of a directory: as it was run, and as `job.yaml` has it; the same object if not edited."""
    file = path / JOB
    advice = f"Run the job of {path} again to rewrite it."
    known = manifest.get("job")
    try:
        data = read_file(file, _LARGEST_JOB)
        if known is not None and digest == digest_of(data):
            return known, known
        written = _parsed(data.decode())
    except FileNotFoundError:
        job = known or {}
        return job, job
    except OSError as error:
        raise TableError(f"{file} cannot be read: {reason(error)}.") from error
    except (ValueError, TypeError, OverflowError, RecursionError, yaml.YAMLError) as error:
        text = " ".join(str(error).split())[:200]
        raise TableError(f"{file} cannot be read: {text}. {advice}") from error
    if not is_job(written):
        raise TableError(f"{file} was changed and is not a job. {advice}")
    if known is None or (digest is None and written == known):
        return written, written
    return known, written


def _parsed(text: str) -> Any:
    """Parse YAML text that may have been edited; raises the exceptions of YAML's readers."""
    depth = 0
    for number, event in enumerate(yaml.parse(text, Loader=yaml.SafeLoader)):
        # the time of PyYAML grows with the square of the depth, and its value readers are recursive
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise ValueError("it is nested too deep")
        if number > _MAX_EVENTS:
            raise ValueError("it has too many values")
    return yaml.safe_load(text)


def load(
    path: str | Path, columns: str | Sequence[str] | None = None, rows: Rows | None = None
) -> pd.DataFrame:
    """Read the table of a result directory, complete or not, in the order of its rows.

    An incomplete table is read with a warning; ended rows of incomplete blocks are not included. Parts are
    read one after the other, so that memory holds the wanted columns and rows only.

    `.attrs` has `job` and `manifest` (dicts, as the run wrote them), `quantities` (unit, meaning and symbol
    by name), `path`, `complete` (whether all rows are present), `rows_missing` (their number) and `rows_open`
    (the number of those that have ended and wait for their block).

    Args:
        path: the directory.
        columns: the names of the columns, in their order; all by default.
        rows: the rows whose records are read: a slice of row numbers, or the numbers themselves, (n,); all by
            default.

    Returns:
        One record for each row, crossing or sample; `status`, `gait` and other names are categories.

    Raises:
        TableError: it is not a result directory, has no complete part yet, has a damaged file, or lacks a
            column or a row.

    Example:
        >>> import tempfile, gaitsweep as gs
        >>> from gaitsweep.examples.hopper import Hopper
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     result = gs.sweep(Hopper(), launch_0=[2.5, 5.0, 7.0], phase_0=2.0, out=folder)
        ...     table = gs.load(folder, columns=["launch_0", "status"], rows=slice(1, 3))
        >>> table["launch_0"].tolist(), table["status"].tolist()
        ([5.0, 7.0], ['settled', 'settled'])
        >>> table.attrs["complete"], table.attrs["rows_missing"]
        (True, 0)
    """
    _, table = load_with_snapshot(path, columns, rows)
    return table


def load_with_snapshot(
    path: str | Path, columns: str | Sequence[str] | None = None, rows: Rows | None = None
) -> tuple[Snapshot, pd.DataFrame]:
    """Read the table of a result directory, with the snapshot of the directory.

    Args:
        path, columns, rows: as for `load`, whose errors it raises.
    """
    path = Path(path)
    columns = [columns] if isinstance(columns, str) else columns
    parts = PartRecords()
    snapshot = _snapshot(path, parts, columns, rows)
    snapshot.require_sound()
    if not snapshot.files.footers:
        waiting = f"; {snapshot.rows_open} rows of incomplete blocks have ended" if snapshot.rows_open else ""
        raise TableError(f"{path} has no complete part yet: run its job further{waiting}.")
    _warn(snapshot)
    frame = joined_parts(path, parts, columns)
    manifest = shared(snapshot.manifest)
    frame.attrs.update(
        job=shared(snapshot.job),
        manifest=manifest,
        quantities=manifest.get("quantities", SharedDict()),
        path=str(path),
        complete=snapshot.complete,
        rows_missing=snapshot.manifest["rows"] - snapshot.rows_done,
        rows_open=snapshot.rows_open,
    )
    return snapshot, frame


def load_parts(path: str | Path, columns: Sequence[str]) -> Iterator[pd.DataFrame]:
    """Yield the records of a complete table, some parts at a time, so that few are in memory.

    Args:
        path: the directory.
        columns: the names of the columns.

    Raises:
        TableError: as `load`; a damaged file is found when its part is read.
    """
    path = Path(path)
    selection = Selection(tuple(columns))
    examined = Examination(path, Layout.of(read_manifest(path)))
    parts = PartRecords()
    for number, table in examined.parts(records=True, columns=selection.columns):
        if table is not None:
            parts.add(selection.records_of(table), examined.footers[number])
        if parts.length > _MAX_RECORDS // 2:
            yield joined_parts(path, parts, columns)
            parts = PartRecords()
    if parts.length:
        yield joined_parts(path, parts, columns)
    _refuse_faults(examined)


def _warn(snapshot: Snapshot) -> None:
    """Warn of missing rows, an edited job, and files without digests."""
    if not snapshot.complete:
        rows = snapshot.manifest["rows"]
        waiting = f" ({snapshot.rows_open} of them have ended, in incomplete blocks)"
        warn(
            f"{snapshot.path} is not complete: {rows - snapshot.rows_done} of {rows} rows are missing"
            f"{waiting if snapshot.rows_open else ''}. Run its job again to continue.",
        )
    if snapshot.job_edited:
        warn(
            f"{snapshot.path / JOB} was changed after the run; the manifest has the job that was run.",
        )
    if snapshot.files.undigested:
        warn(f"{snapshot.path}: {snapshot.without_digests}.")
