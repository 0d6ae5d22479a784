"""Manifest of a result directory, which identifies its job, and the fields that others read in it."""

from __future__ import annotations

import dataclasses
import datetime
import functools
import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, ValidationError

import gaitsweep
from gaitsweep.schema.diagnostics import clipped
from gaitsweep.table.atomic_files import TableError, is_partial, read_file, reason
from gaitsweep.table.locks import LOCK_NAME

MANIFEST = "manifest.json"
JOB = "job.yaml"
TABLE = "table"
FIGURES = "figures"
FORMAT = 2  # of the directory; it is increased by a change that older versions cannot read
SEAL = "sha256"  # the digest of all other fields
IDENTITY = ("format", "job_hash", "rows", "block")  # the fields that every manifest has and that never change
_LARGEST = 256 * 2**20  # bytes

_Count = Annotated[int, Field(ge=1, lt=2**63)]
_CountOrZero = Annotated[int, Field(ge=0)]
# Types whose values JSON gives back as they are.
_OF_JSON = frozenset({float, int, str, bool, type(None)})


class DamagedManifest(TableError):
    """A manifest that was changed after gaitsweep wrote it, or is missing beside a table.

    `what` describes the damage; with a directory, the message also says how to repair it.
    """

    def __init__(self, what: str, path: Path | None = None) -> None:
        again = f"run the job of {path} again to rewrite it, if the parts of the table belong to that job."
        super().__init__(what if path is None else f"{what}: {again}")
        self.what = what.rstrip(".")


def sealed(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return a manifest of JSON values with the digest of its fields, which reveals edits."""
    fields = {name: value for name, value in manifest.items() if name != SEAL}
    text = json.dumps(fields, sort_keys=True, separators=(",", ":"))
    return {**fields, SEAL: hashlib.sha256(text.encode()).hexdigest()}


def json_value(value: Any) -> Any:
    """Convert values as JSON does: lists for tuples and arrays, Python's numbers for those of NumPy."""
    kind = type(value)
    if kind in _OF_JSON:
        return value
    if kind is dict and {str}.issuperset(map(type, value)):
        return {name: json_value(item) for name, item in value.items()}
    if kind is list:  # of a million numbers, as an axis may be
        return list(value) if _OF_JSON.issuperset(map(type, value)) else [json_value(item) for item in value]
    return json.loads(json.dumps(value, default=_plain))


def _plain(value: Any) -> Any:
    """Convert a value that JSON does not have: scalars and arrays of NumPy and JAX, and others to text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def read_manifest(path: Path) -> dict[str, Any]:
    """Read the manifest of a directory.

    Raises:
        DamagedManifest: it is not JSON, was changed after it was written, or is missing beside a table.
        TableError: the directory has none, or this version of gaitsweep does not know its format.
    """
    file = path / MANIFEST
    try:
        text = read_file(file, _LARGEST).decode()
    except (FileNotFoundError, NotADirectoryError):
        raise _missing(path) from None
    except OSError as error:
        raise TableError(f"{file} cannot be read: {reason(error)}.") from error
    except ValueError as error:
        raise DamagedManifest(f"{file} is damaged: it is not text ({error})", path) from error
    try:
        manifest = json.loads(text)
        json.dumps(manifest, ensure_ascii=False).encode()  # half a surrogate could not be printed
    except (ValueError, RecursionError) as error:
        raise DamagedManifest(f"{file} is damaged: it is not JSON ({error})", path) from error
    if not isinstance(manifest, dict) or not manifest.keys() >= {*IDENTITY}:
        raise DamagedManifest(
            f"{file} is not a manifest of gaitsweep: it lacks one of {', '.join(IDENTITY)}."
        )
    if manifest["format"] != FORMAT:
        raise TableError(
            f"{path} has format {clipped(str(manifest['format']))}, but this version of gaitsweep reads only "
            f"format {FORMAT}. Use the version named in its manifest."
        )
    _check_fields(file, manifest)
    if manifest.get(SEAL) != sealed(manifest)[SEAL]:
        raise DamagedManifest(f"{file} was changed after gaitsweep wrote it", path)
    return manifest


def manifest_bytes(manifest: Mapping[str, Any]) -> bytes:
    """Return the content of `manifest.json` with these JSON values."""
    fields = (f"  {json.dumps(name)}: {_indented(json.dumps(value))}" for name, value in manifest.items())
    return ("{\n" + ",\n".join(fields) + "\n}\n").encode()


# cached, since most fields are written several times, and Python indents them slowly
@functools.lru_cache(maxsize=64)
def _indented(value: str) -> str:
    """Indent a field of the manifest, from JSON without indents."""
    return json.dumps(json.loads(value), indent=2, ensure_ascii=False).replace("\n", "\n  ")


def _missing(path: Path) -> TableError:
    """Return the error of a directory without a manifest."""
    if (path / TABLE).is_dir():
        return DamagedManifest(f"{MANIFEST} of {path} is missing", path)
    if path.is_dir():
        return TableError(f"{path} is not a result directory of gaitsweep: it has no {MANIFEST}.")
    return TableError(f"{path} {'is not a directory' if path.exists() else 'does not exist'}.")


def _check_fields(file: Path, manifest: Mapping[str, Any]) -> None:
    """Refuse a manifest in which a field that readers use has a wrong value."""
    try:
        _Fields.model_validate(manifest)
    except ValidationError as error:
        name = str(error.errors()[0]["loc"][0])
        value, description = clipped(json.dumps(manifest[name])), _Fields.model_fields[name].description
        raise DamagedManifest(f"{file}: {name} is {value}, but must be {description}", file.parent) from None


class _Plain(BaseModel):
    """Values of JSON without conversion, in the fields on which readers of tables depend."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, defer_build=True)


class _Quantity(_Plain):
    unit: str = ""
    meaning: str = ""
    symbol: str = ""
    circular: bool = False


class _Axis(_Plain):
    names: list[str]
    length: _Count
    drawn: bool


class _Maker(_Plain):
    versions: dict[str, str] = {}
    parts: list[Annotated[list[int], Field(min_length=2, max_length=2)]]


class _SomeRows(_Plain):
    """A number of rows, of which `row` is the first, among `of` examined ones."""

    rows: _CountOrZero
    row: _CountOrZero
    of: _CountOrZero = 0


class _Job(_Plain):
    name: str = ""
    model: str = ""
    structure: dict = {}
    params: dict = {}
    start: dict = {}
    vary: dict = {}
    run: dict = {}
    numerics: dict = {}
    engine: dict = {}
    figures: list[dict] = []


class _Fields(_Plain):
    """Fields of a manifest that are read, each with its description in messages."""

    job_hash: str = Field(default="", description="text")
    rows: _Count = Field(default=1, description="a number of rows")
    block: _Count = Field(default=1, description="a number of rows")
    job: _Job = Field(default=_Job(), description="the resolved job")
    quantities: dict[str, _Quantity] = Field(default={}, description="unit, meaning and symbol by name")
    timings: dict[str, float] = Field(default={}, description="seconds and attempts by name")
    counts: dict[str, _CountOrZero] = Field(default={}, description="numbers of rows by status")
    gaits: dict[str, _CountOrZero] = Field(default={}, description="numbers of rows by gait")
    periods: dict[str, _CountOrZero] = Field(default={}, description="numbers of settled rows by period")
    slowest: dict[str, _CountOrZero] = Field(default={}, description="numbers of rows by observable")
    mislabelled: dict[str, _SomeRows] = Field(default={}, description="rows by label")
    starts_beyond: dict[str, _SomeRows] = Field(default={}, description="rows by event")
    without_period: dict[str, _SomeRows] = Field(default={}, description="rows by period")
    axes: list[_Axis] = Field(default=[], description="names, number of points and drawn of each axis")
    figures_drawn: dict[str, str] = Field(default={}, description="digests by name")
    versions: dict[str, str] = Field(default={}, description="versions by name")
    paper: dict[str, str] = Field(default={}, description="source and bibtex of the model's paper")
    program: dict[str, str] = Field(default={}, description="digests by name")
    made_before: list[_Maker] = Field(default=[], description="versions and parts of each earlier maker")
    complete: bool = Field(default=True, description="true or false")


def is_job(value: object) -> bool:
    """Return whether plain values are a job, in the fields on which readers of tables depend."""
    try:
        _Job.model_validate(value)
    except ValidationError:
        return False
    return True


@dataclasses.dataclass(frozen=True)
class Layout:
    """Rows of a table in blocks of `block`, each of which has a part.

    `job_hash` is the hash of all that determines the results.
    """

    job_hash: str
    rows: int
    block: int

    @classmethod
    def of(cls, manifest: Mapping[str, Any]) -> Layout:
        """Return the layout in a manifest."""
        return cls(manifest["job_hash"], manifest["rows"], manifest["block"])

    @property
    def blocks(self) -> range:
        """Numbers of the blocks."""
        return range(-(-self.rows // self.block))

    def rows_of(self, number: int) -> tuple[int, int]:
        """Return the first row of a block and the row after its last (equal past the table's end)."""
        return min(number * self.block, self.rows), min((number + 1) * self.block, self.rows)

    def rows_in(self, numbers: Iterable[int]) -> int:
        """Return the number of rows of blocks."""
        return sum(stop - first for first, stop in map(self.rows_of, numbers))

    def words(self, number: int) -> str:
        """Name a block in messages: "3 (rows 96 to 119)"."""
        first, stop = self.rows_of(number)
        return f"{number} (rows {first} to {stop - 1})"


def new_manifest(layout: Layout, job: Mapping[str, Any]) -> dict[str, Any]:
    """Return the manifest of a new directory.

    Args:
        layout: that of its table.
        job: the resolved job.
    """
    if layout.rows < 1 or layout.block < 1:
        raise ValueError(
            f"A table must have at least one row and one row per part, not {layout.rows} and {layout.block}."
        )
    return {
        "format": FORMAT,
        **dataclasses.asdict(layout),
        "gaitsweep": gaitsweep.__version__,
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "job": dict(job),
    }


def claim(path: Path, layout: Layout) -> dict[str, Any] | None:
    """Check whether a job may use a directory, without writing to it.

    Args:
        path: the directory.
        layout: that of the job's table.

    Returns:
        The manifest of the job's directory, or None for a new or empty directory.

    Raises:
        DamagedManifest: the manifest is damaged.
        TableError: the directory belongs to another job, or not to gaitsweep.
    """
    try:
        if not path.exists():
            return None
        if not path.is_dir():
            raise TableError(f"{path} is a file: choose another directory with --out.")
        entries = [entry for entry in path.iterdir() if entry.name != LOCK_NAME and not is_partial(entry)]
    except OSError as error:
        raise TableError(f"The result directory {path} cannot be read: {reason(error)}.") from error
    if not entries:
        return None
    if not (path / MANIFEST).exists() and not (path / TABLE).is_dir():
        raise TableError(
            f"{path} contains files that are not gaitsweep's ({min(entry.name for entry in entries)}) "
            f"and has no {MANIFEST}: choose another directory with --out."
        )
    manifest = read_manifest(path)
    stored = Layout.of(manifest)
    advice = "choose another directory with --out, or remove this one."
    if stored.job_hash != layout.job_hash:
        hashes = f"its hash is {stored.job_hash[:12]}, this job's is {layout.job_hash[:12]}"
        raise TableError(f"{path} contains the table of another job ({hashes}): {advice}")
    if stored != layout:
        raise TableError(
            f"{path} has {stored.rows} rows in blocks of {stored.block}, but this job has {layout.rows} rows "
            f"in blocks of {layout.block}: {advice}"
        )
    return manifest


class Difference(NamedTuple):
    """Words after a number of rows that a self-check found different: `mark` on a figure, else `sentence`."""

    mark: str
    sentence: str


# A settled row may move by this many times the tolerance of settling.
TOLERANCES: Final = 10.0
STORED_DIFFERS: Final = "stored_differs"
UNSTABLE: Final = "unstable"
# Differences that a self-check counts, by their fields in the manifest.
DIFFERENCES: Final = {
    STORED_DIFFERS: Difference(
        "not reproduced", "did not reproduce their stored records with the same steps"
    ),
    "status_differs": Difference("end otherwise", "ended with another status"),
    "gait_differs": Difference("change gait", "ended with another gait"),
    "count_differs": Difference("change their count", "ended with another count"),
    "moved": Difference("depend on the step", f"moved by more than {TOLERANCES:g} tolerances"),
    UNSTABLE: Difference(
        "rest on unstable gaits", "rest on an unstable gait, which any small displacement leaves"
    ),
}
# Rows whose observables change much with the step that is part of their model: marked, but no difference.
BY_STEP: Final = "by_step"
BY_STEP_WORDS: Final = Difference(
    "depend on the model's step", "changed by more than a tenth of an observable's size with the model's step"
)


def self_check_warned(check: object) -> bool:
    """Return whether the self-check in a manifest warned; false for none."""
    return isinstance(check, Mapping) and check.get("verdict") == "warned"
