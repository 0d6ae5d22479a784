"""Reading of result directories: their contents, and their tables as data frames."""

from __future__ import annotations

import collections
import dataclasses
import functools
import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from numpy.typing import ArrayLike

from gaitsweep import near_miss
from gaitsweep.schema.former_names import renamed
from gaitsweep.table.digests import digest_of
from gaitsweep.table.examination import Examination
from gaitsweep.table.files import TableError, read_file, reason
from gaitsweep.table.manifest import FIGURES, JOB, TABLE, Layout, is_job, read_manifest
from gaitsweep.table.parts import Footer

Rows = slice | range | ArrayLike

_LARGEST_JOB = 64 * 2**20  # bytes
_WITHOUT_NUMBERS = ("name", "verify", "figures", "style")  # fields of a job that decide no number
_DEEPEST, _MOST_EVENTS = 50, 400_000  # of an edited `job.yaml`


def figure_files(path: Path) -> list[Path]:
    """The files of a directory's figures, sorted by name."""
    files = (path / FIGURES).glob("*")
    return sorted(file for file in files if file.suffix in (".png", ".pdf", ".svg") and file.is_file())


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """The contents of a result directory at one moment, without its records; a run may be writing it.

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
        """Read a result directory.

        Raises:
            TableError: it is not a result directory, or its manifest or `job.yaml` cannot be read.
        """
        return _snapshot(Path(path))

    @property
    def job_edited(self) -> bool:
        """Whether `job.yaml` was changed after the run in a field that decides the table's numbers."""
        own, now = (
            {key: value for key, value in job.items() if key not in _WITHOUT_NUMBERS}
            for job in (self.job, self.written)
        )
        return own != now

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
        """The number of rows that are stored, including those of incomplete blocks."""
        return self.rows_done + self.rows_open

    @property
    def figures(self) -> list[Path]:
        """The files of drawn figures, sorted by name."""
        return figure_files(self.path)

    @property
    def complete(self) -> bool:
        """Whether all rows are present."""
        return self.rows_done == self.manifest["rows"]

    @property
    def without_digests(self) -> str:
        """Sentence on files without digests, in which damage may go undetected."""
        n, consequence = len(self.files.undigested), "so some damage cannot be detected"
        again = "" if self.manifest["format"] == 1 else ". Run its job again to write the digests"
        have = "has" if n == 1 else "have"
        return f"{n} file{'s' * (n != 1)} of the table {have} no digests, {consequence}{again}"

    def require_sound(self) -> None:
        """Refuse a table with damaged files or files of another table.

        Raises:
            TableError: there are such files; the message names them.
        """
        _refuse_faults(self.files)


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


def add_counts(footers: dict[int, Footer]) -> dict[str, int]:
    """Return the numbers of rows by status over all parts, the most frequent status first."""
    total: collections.Counter[str] = collections.Counter()
    for footer in footers.values():
        total.update(footer.counts)
    return dict(sorted(total.items(), key=lambda item: (-item[1], item[0])))


# Columns of tables with one record a row from which `outcome` follows, where their parts are older than it.
_SOURCES = ("cycles", "gait", "status")


@dataclasses.dataclass(frozen=True)
class Selection:
    """The records to read from a table: some or all columns of some or all rows."""

    columns: tuple[str, ...] | None = None
    rows: range | np.ndarray | None = None  # in rising order

    @classmethod
    def of(cls, columns: Sequence[str] | None, rows: Rows | None, n_rows: int) -> Selection:
        """The selection of `columns` and `rows` from a table of `n_rows` rows; see `load`.

        Raises:
            TableError: the table does not have these rows, or they are not row numbers.
        """
        names = None if columns is None else _decoded(columns)
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
        """The selected records of a part."""
        row = table.column("row").to_numpy()
        if self.columns is not None:
            table = table.select([name for name in table.column_names if name in self.columns])
        if self.rows is None or not row.size:
            return table
        if isinstance(self.rows, range):
            first, stop, step = self.rows.start, self.rows.stop, self.rows.step
            selected = (row >= first) & (row < stop) & ((row - first) % step == 0)
        else:
            of_part = slice(*np.searchsorted(self.rows, [row[0], row[-1] + 1]))
            selected = np.isin(row, self.rows[of_part])
        return table if selected.all() else table.filter(pa.array(selected))


def _snapshot(path: Path, parts: _Parts | None = None, selection: Selection | None = None) -> Snapshot:
    """Read a directory, and the selected records of its valid parts into `parts` if it is given."""
    selection = selection or Selection()
    manifest = read_manifest(path)
    examined = Examination(path, Layout.of(manifest))
    run, on_disk = _job_of(path, manifest, examined.digests.get(JOB))
    job = renamed(run)
    written = job if on_disk is run else renamed(on_disk)
    for number, table in examined.parts(parts is not None, selection.columns):
        if parts is not None and table is not None:
            footer = examined.footers[number]
            parts.add(selection.records_of(table), footer, table.num_rows / footer.rows)
    opened = np.concatenate([np.zeros(0, np.int64), *(rows.row for _, rows in examined.open_rows())])
    done = np.array(sorted(examined.footers), np.int64)
    waiting = np.unique(opened[~np.isin(opened // examined.layout.block, done)])
    return Snapshot(path, job, manifest, examined, waiting.size, written)


def _job_of(
    path: Path, manifest: dict[str, Any], digest: str | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The job that was run, and the content of `job.yaml`: the same object if it was not edited."""
    file, advice = path / JOB, f"Run the job of {path} again to rewrite it."
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
    """The values of a YAML text that may have been edited; raises the exceptions of YAML's readers."""
    depth = 0
    for number, event in enumerate(yaml.parse(text, Loader=yaml.SafeLoader)):
        # the time of PyYAML grows with the square of the depth, and its value readers are recursive
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise ValueError("it is nested too deep")
        if number > _MOST_EVENTS:
            raise ValueError("it has too many values")
    return yaml.safe_load(text)


def load(
    path: str | Path,
    columns: Sequence[str] | None = None,
    rows: Rows | None = None,
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
    path: str | Path, columns: Sequence[str] | None = None, rows: Rows | None = None
) -> tuple[Snapshot, pd.DataFrame]:
    """Read the table of a result directory as `load` does, with the snapshot of the directory."""
    path = Path(path)
    n_rows = read_manifest(path)["rows"]
    selection = Selection.of(columns, rows, n_rows)
    parts = _Parts(n_rows if selection.rows is None else len(selection.rows))
    snapshot = _snapshot(path, parts, selection)
    snapshot.require_sound()
    if not snapshot.files.footers:
        waiting = f"; {snapshot.rows_open} rows of incomplete blocks have ended" if snapshot.rows_open else ""
        raise TableError(f"{path} has no complete part yet: run its job further{waiting}.")
    _warn(snapshot)
    frame = _frame(path, parts, columns)
    frame.attrs.update(
        job=snapshot.job,
        manifest=snapshot.manifest,
        quantities=snapshot.manifest.get("quantities", {}),
        path=str(path),
        complete=snapshot.complete,
        rows_missing=snapshot.manifest["rows"] - snapshot.rows_done,
        rows_open=snapshot.rows_open,
    )
    return snapshot, frame


# Records in a frame of `load_parts`, at most, if a part has no more: a frame of one part of a few thousand
# takes as long as one of sixteen.
_TOGETHER = 65_536


def load_parts(path: str | Path, columns: Sequence[str]) -> Iterator[pd.DataFrame]:
    """The records of a complete table, some parts at a time, so that few are in memory.

    Args:
        path: the directory.
        columns: the names of the columns.

    Raises:
        TableError: as `load`; a damaged file is found when its part is read.
    """
    path, selection = Path(path), Selection(_decoded(columns))
    examined = Examination(path, Layout.of(read_manifest(path)))
    parts = _Parts(_TOGETHER)
    for number, table in examined.parts(True, selection.columns):
        if table is not None:
            parts.add(selection.records_of(table), examined.footers[number])
        if parts.length > _TOGETHER // 2:
            yield _frame(path, parts, columns)
            parts = _Parts(_TOGETHER)
    if parts.length:
        yield _frame(path, parts, columns)
    _refuse_faults(examined)


@dataclasses.dataclass
class _Part:
    """The records of a part: its columns, and the names of the categorical ones, which have their codes."""

    length: int
    columns: dict[str, np.ndarray | pa.ChunkedArray]
    categories: dict[str, list[str]]


class _Parts:
    """Parts in order; numeric columns of all parts are read into one array, without copies.

    Args:
        n_rows: the number of rows of the table; with the first part, it gives the number of records.
    """

    def __init__(self, n_rows: int) -> None:
        self._n_rows, self._room = n_rows, 0
        self._whole: dict[str, np.ndarray] = {}
        self.parts: list[_Part] = []
        self.length = 0

    def add(self, table: pa.Table, footer: Footer, a_row: float = 1.0) -> None:
        """Add the records of a part, with about `a_row` records per row."""
        self._room = self._room or math.ceil(a_row * self._n_rows)
        columns: dict[str, np.ndarray | pa.ChunkedArray] = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            if name in footer.categories:
                columns[name] = self._placed(name, _codes(column, footer.categories[name]))
            elif pa.types.is_floating(column.type) or (
                pa.types.is_integer(column.type) and not column.null_count
            ):
                columns[name] = self._placed(name, column.to_numpy())
            else:  # text, flags, and whole numbers of which some are missing
                columns[name] = column
        self.parts.append(_Part(table.num_rows, columns, footer.categories))
        self.length += table.num_rows

    def _placed(self, name: str, values: np.ndarray) -> np.ndarray:
        """The values in their place in the whole column, if they fit there."""
        if name not in self._whole:
            self._whole[name] = np.empty(self._room, values.dtype)
        whole = self._whole[name]
        place = whole[self.length : self.length + len(values)]
        if whole.dtype != values.dtype or len(place) != len(values):
            return np.array(values)
        place[:] = values
        return place

    def whole(self, name: str) -> np.ndarray | None:
        """The column of all parts, if all have their values there."""
        whole = self._whole.get(name)
        complete = all(getattr(part.columns.get(name), "base", None) is whole for part in self.parts)
        return None if whole is None or not complete else whole[: self.length]


def _decoded(columns: Sequence[str]) -> tuple[str, ...]:
    """The columns of the parts that are needed for these columns of the table."""
    return (*columns, *_SOURCES) if "outcome" in columns else tuple(columns)


def frame_of(
    parts: Iterable[tuple[pa.Table, Footer, float]], n_rows: int, columns: Sequence[str] | None
) -> pd.DataFrame:
    """The records of parts in memory, of `n_rows` rows; each has its footer and its records per row."""
    together = _Parts(n_rows)
    for records, footer, a_row in parts:
        together.add(records, footer, a_row)
    return _frame(Path(), together, columns)


def _frame(path: Path, parts: _Parts, columns: Sequence[str] | None) -> pd.DataFrame:
    """The records of all parts."""
    names = list(dict.fromkeys(name for part in parts.parts for name in part.columns))
    older = all(name in names for name in _SOURCES) and any("outcome" not in p.columns for p in parts.parts)
    if older:
        names = [name for name in names if name != "outcome"]
        names.insert(names.index("gait") + 1, "outcome")
    values: dict[str, Any] = {}
    for name in names if columns is None else dict.fromkeys(columns):
        if name not in names:
            raise TableError(f"{name} is not a column of {path}{_near_column(path, name)}")
        try:
            if older and name == "outcome":
                values[name] = outcomes(_joined("gait", parts), _joined("status", parts))
            else:
                values[name] = _joined(name, parts)
        except pa.ArrowException as error:
            raise TableError(
                f"The parts of {path} do not fit together ({' '.join(str(error).split())}): "
                "different versions wrote them. Run its job into another directory."
            ) from error
    return pd.DataFrame(values, index=pd.RangeIndex(parts.length), copy=False)


def outcomes(gait: pd.Categorical, status: ArrayLike) -> pd.Categorical:
    """The column `outcome`: the gait of each row (n,), or the reason why it has none."""
    from gaitsweep.contract import Outcome, Status  # imports JAX

    names = list(dict.fromkeys([*gait.categories, *map(str, Outcome)]))
    codes = np.where(gait.codes < 0, names.index(Outcome.NO_GAIT), gait.codes.astype(np.int32))
    codes[~Status.SOUND.among(status)] = names.index(Outcome.FAILED)
    codes[Status.UNDECIDED.among(status)] = names.index(Outcome.NOT_SETTLED)
    return categorical(codes, names)


def categorical(codes: ArrayLike, names: Sequence[str]) -> pd.Categorical:
    """The names of codes (n,); -1 has no name."""
    return pd.Categorical.from_codes(codes, dtype=_categories(tuple(names)))


# cached, since pandas takes longer to look for repeated names than a small column takes
@functools.lru_cache(maxsize=256)
def _categories(names: tuple[str, ...]) -> pd.CategoricalDtype:
    return pd.CategoricalDtype(list(names))


def _near_column(path: Path, name: str) -> str:
    """The end of the message about an unknown column."""
    file = next(iter(sorted((path / TABLE).glob("part-*.parquet"))))
    return near_miss.suggestion(name, pq.read_schema(file).names)


def _joined(name: str, parts: _Parts) -> Any:
    """A column of all parts: categorical, an array, or a series."""
    whole = parts.whole(name)
    if not any(name in part.categories for part in parts.parts):
        return _promoted(name, parts.parts) if whole is None else whole
    categories = list(dict.fromkeys(text for part in parts.parts for text in part.categories.get(name, ())))
    if whole is None or any(part.categories[name] != categories for part in parts.parts):
        whole = np.concatenate([_recoded(name, part, categories) for part in parts.parts])
    return categorical(whole, categories)


def _recoded(name: str, part: _Part, categories: list[str]) -> np.ndarray:
    """The codes (n,) of a part's column among the categories of all parts."""
    column = part.columns.get(name)
    if column is None:
        return np.full(part.length, -1, _narrow(categories))
    if isinstance(column, pa.ChunkedArray):
        return _codes(column, categories)
    codes = [*map(categories.index, part.categories[name]), -1]
    return np.array(codes, _narrow(categories))[column]


def _promoted(name: str, parts: list[_Part]) -> pd.Series:
    """A column of text or flags, or one whose type differs between parts of different versions."""
    pieces = [_in_arrow(part.columns.get(name, pa.nulls(part.length))) for part in parts]
    kinds = [pa.schema([pa.field(name, piece.type)]) for piece in pieces]
    common = pa.unify_schemas(kinds, promote_options="permissive").types[0]
    chunks = [chunk.cast(common) for piece in pieces for chunk in piece.chunks]
    return pa.chunked_array(chunks, common).to_pandas()


def _in_arrow(piece: np.ndarray | pa.Array | pa.ChunkedArray) -> pa.ChunkedArray:
    """A column of a part, which may be missing or lie in NumPy's memory, as an array of Arrow."""
    return piece if isinstance(piece, pa.ChunkedArray) else pa.chunked_array([pa.array(piece)])


def _narrow(categories: list[str]) -> np.dtype[Any]:
    """The smallest integer type for codes of categories, as in pandas."""
    return np.min_scalar_type(-max(len(categories), 1))


def _codes(column: pa.ChunkedArray, categories: list[str]) -> np.ndarray:
    """The index of each name among the categories, -1 for missing names."""
    place = {name: number for number, name in enumerate(categories)}
    codes = [np.zeros(0, _narrow(categories))]
    for chunk in column.chunks:
        encoded = chunk if pa.types.is_dictionary(chunk.type) else chunk.dictionary_encode()
        names = encoded.dictionary.to_pylist()
        code_of_name = np.array([*(place.get(name, -1) for name in names), -1], _narrow(categories))
        codes.append(code_of_name[encoded.indices.fill_null(-1).to_numpy()])
    return np.concatenate(codes)


def _warn(snapshot: Snapshot) -> None:
    if not snapshot.complete:
        rows = snapshot.manifest["rows"]
        waiting = f" ({snapshot.rows_open} of them have ended, in incomplete blocks)"
        warnings.warn(
            f"{snapshot.path} is not complete: {rows - snapshot.rows_done} of {rows} rows are missing"
            f"{waiting if snapshot.rows_open else ''}. Run its job again to continue.",
            stacklevel=4,
        )
    if snapshot.job_edited:
        warnings.warn(
            f"{snapshot.path / JOB} was changed after the run; the manifest has the job that was run.",
            stacklevel=4,
        )
    if snapshot.files.undigested:
        warnings.warn(
            f"{snapshot.path}: {snapshot.without_digests}.",
            stacklevel=4,
        )
