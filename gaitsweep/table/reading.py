"""Reading a result directory: its contents, and its table as a data frame."""

from __future__ import annotations

import collections
import dataclasses
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import yaml

from gaitsweep.table.digests import digest_of
from gaitsweep.table.examination import Examination, Fault
from gaitsweep.table.files import TableError, read_file, reason
from gaitsweep.table.former_names import renamed
from gaitsweep.table.manifest import FIGURES, JOB, is_job, read_manifest
from gaitsweep.table.parts import Footer

_LARGEST_JOB = 64 * 2**20  # bytes
_DEEPEST, _MOST_EVENTS = 50, 400_000  # of an edited `job.yaml`


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """The contents of a result directory at one moment, without its records; a run may be writing it.

    `job` is the job that was run, `written` the content of `job.yaml`; they differ if it was edited.
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
        """Read a result directory.

        Raises:
            TableError: it is not a result directory, or its manifest or `job.yaml` cannot be read.
        """
        return _look(Path(path), None)

    @property
    def job_edited(self) -> bool:
        """Whether `job.yaml` was changed after the run wrote it."""
        return self.written is not self.job

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of ended rows by status."""
        return add_counts(self.files.footers)

    @property
    def rows_done(self) -> int:
        """The number of rows in complete parts."""
        return sum(footer.rows for footer in self.files.footers.values())

    @property
    def rows_safe(self) -> int:
        """The number of rows that need not be run again, with those of open blocks."""
        return self.rows_done + self.rows_open

    @property
    def figures(self) -> list[Path]:
        """The files of drawn figures, sorted by name."""
        return sorted(file for file in (self.path / FIGURES).glob("*.png") if file.is_file())

    @property
    def complete(self) -> bool:
        """Whether all rows are present."""
        return self.rows_done == self.manifest["rows"]

    def require_sound(self) -> None:
        """Refuse a table with damaged files or files of another table.

        Raises:
            TableError: there are such files; the message names them.
        """
        found = [*self.files.faults.values(), *self.files.strangers]
        if found:
            raise TableError(_refusal(found))


def _refusal(found: list[Fault]) -> str:
    more = ", ".join(fault.file.name for fault in found[1:6]) + (", ..." if len(found) > 6 else "")
    others = f" So {'is' if len(found) == 2 else 'are'} {more}." if more else ""
    if all(fault.file.suffix == ".parquet" and fault.foreign and not fault.digest_known for fault in found):
        return f"{found[0].sentence}{others}"
    return f"{found[0].sentence}{others} Run its job again, which makes that part anew."


def add_counts(footers: dict[int, Footer]) -> dict[str, int]:
    """Return the numbers of rows by status over all parts, the most frequent status first."""
    total: collections.Counter[str] = collections.Counter()
    for footer in footers.values():
        total.update(footer.counts)
    return dict(sorted(total.items(), key=lambda item: (-item[1], item[0])))


def _look(path: Path, tables: dict[int, pa.Table] | None) -> Snapshot:
    """Read a directory, and the records of its valid parts into `tables` if it is given."""
    manifest = read_manifest(path)
    examined = Examination(path, manifest)
    run, on_disk = _job_of(path, manifest, examined.digests.get(JOB))
    job = renamed(run)
    written = job if on_disk is run else renamed(on_disk)
    for number, table in examined.parts(records=tables is not None):
        if tables is not None and table is not None:
            tables[number] = table
    opened = np.concatenate([np.zeros(0, np.int64), *(rows["row"] for _, rows in examined.open_rows())])
    done = np.array(sorted(examined.footers), np.int64)
    waiting = np.unique(opened[~np.isin(opened // examined.block, done)])
    return Snapshot(path, job, manifest, examined, waiting.size, written)


def _job_of(
    path: Path, manifest: dict[str, Any], digest: str | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The job that was run, and the content of `job.yaml`: the same object if it was not edited."""
    file = path / JOB
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
        raise TableError(f"{file} cannot be read: {text}. {_written_anew(path)}") from error
    if not is_job(written):
        raise TableError(f"{file} is no job any more. {_written_anew(path)}")
    return (written, written) if known is None else (known, written)


def _parsed(text: str) -> Any:
    """The values of a YAML text that may have been edited; raises what YAML's readers raise."""
    depth = 0
    for number, event in enumerate(yaml.parse(text, Loader=yaml.SafeLoader)):
        # the time of PyYAML grows with the square of the depth, and its value readers are recursive
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise ValueError("it is nested too deep")
        if number > _MOST_EVENTS:
            raise ValueError("it has too many values")
    return yaml.safe_load(text)


def _written_anew(path: Path) -> str:
    return f"Run the job of {path} again, which writes it anew."


def load(path: str | Path) -> pd.DataFrame:
    """Read the table of a result directory, complete or not, in the order of its rows.

    An incomplete table is read with a warning; ended rows of incomplete blocks are not included.

    `.attrs` has `job` and `manifest` (dicts, as the run wrote them), `quantities` (unit, meaning and symbol
    by name), `path`, `complete` (whether all rows are present), `rows_missing` (their number) and `rows_open`
    (the number of those that have ended and wait for their block).

    Args:
        path: the directory.

    Returns:
        One record for each row, crossing or sample; `status`, `gait` and other names are categories.

    Raises:
        TableError: it is not a result directory, has no complete part yet, or has a damaged file.
    """
    _, table = load_with_snapshot(path)
    return table


def load_with_snapshot(path: str | Path) -> tuple[Snapshot, pd.DataFrame]:
    """Read the table of a result directory as `load` does, with the snapshot of the directory."""
    tables: dict[int, pa.Table] = {}
    snapshot = _look(Path(path), tables)
    snapshot.require_sound()
    waiting = f"; {snapshot.rows_open} rows of its open blocks have ended" if snapshot.rows_open else ""
    if not snapshot.files.footers:
        raise TableError(
            f"{snapshot.path} has no finished part yet: run its job until there is one{waiting}."
        )
    _warn(snapshot)
    frame = _frame(snapshot, [tables[number] for number in sorted(tables)])
    rows = snapshot.manifest["rows"]
    frame.attrs.update(
        job=snapshot.job,
        manifest=snapshot.manifest,
        quantities=snapshot.manifest.get("quantities", {}),
        path=str(snapshot.path),
        complete=snapshot.complete,
        rows_missing=rows - snapshot.rows_done,
        rows_open=snapshot.rows_open,
    )
    return snapshot, frame


def _frame(snapshot: Snapshot, tables: list[pa.Table]) -> pd.DataFrame:
    categories: dict[str, list[str]] = {}
    for footer in snapshot.files.footers.values():
        for column, names in footer.categories.items():
            known = categories.setdefault(column, [])
            known.extend(name for name in names if name not in known)
    for i, table in enumerate(tables):
        for column in categories:
            place = table.schema.get_field_index(column)
            if place >= 0 and not pa.types.is_dictionary(table.schema.field(place).type):
                tables[i] = table = table.set_column(place, column, table.column(place).dictionary_encode())
    try:
        frame = pa.concat_tables(tables, promote_options="permissive").unify_dictionaries().to_pandas()
    except pa.ArrowException as error:
        raise TableError(
            f"The parts of {snapshot.path} do not fit together ({' '.join(str(error).split())}): "
            "they were written by different versions; run its job into another directory."
        ) from error
    for column, names in categories.items():
        if column in frame:
            frame[column] = pd.Categorical(frame[column], categories=names)
    return frame


def _warn(snapshot: Snapshot) -> None:
    if not snapshot.complete:
        rows = snapshot.manifest["rows"]
        waiting = f" ({snapshot.rows_open} of them have ended, in blocks that are open)"
        warnings.warn(
            f"{snapshot.path} is not complete: {rows - snapshot.rows_done} of {rows} rows are missing"
            f"{waiting if snapshot.rows_open else ''}. Its job, run again, goes on.",
            stacklevel=4,
        )
    if snapshot.job_edited:
        warnings.warn(
            f"{snapshot.path / JOB} was changed after the run: the manifest's job is the one that was run.",
            stacklevel=4,
        )
    if snapshot.files.without_digest:
        warnings.warn(
            f"{snapshot.path} is of an older version, whose parts carry no digests: "
            "not every damage of them is found.",
            stacklevel=4,
        )
