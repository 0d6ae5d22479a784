"""The manifest, which identifies a result directory and its job."""

from __future__ import annotations

import datetime
import hashlib
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from gaitsweep.table.files import LOCK_NAME, TableError, is_partial, read_file, reason
from gaitsweep.version import version

MANIFEST = "manifest.json"
JOB = "job.yaml"
TABLE = "table"
FIGURES = "figures"
FORMAT = 2  # of the directory; it is increased by a change that older versions cannot read
FORMATS = (1, FORMAT)  # formats that can be read; format 1 has no digests
SEAL = "sha256"  # the digest of all other fields
_LARGEST = 256 * 2**20  # bytes


class DamagedManifest(TableError):
    """A manifest that was changed after gaitsweep wrote it, or is missing beside a table.

    `what` describes the damage; with a directory, the message also says how to repair it.
    """

    def __init__(self, what: str, path: Path | None = None) -> None:
        again = f"run the job of {path} again to rewrite it, if the parts of the table belong to that job."
        super().__init__(what if path is None else f"{what}: {again}")
        self.what = what.rstrip(".")


def sealed(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """A manifest of JSON values with the digest of its fields, which reveals edits."""
    fields = {name: value for name, value in manifest.items() if name != SEAL}
    text = json.dumps(fields, sort_keys=True, separators=(",", ":"))
    return {**fields, SEAL: hashlib.sha256(text.encode()).hexdigest()}


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
        if (path / TABLE).is_dir():
            raise DamagedManifest(f"{MANIFEST} of {path} is missing", path) from None
        what = f"is not a result directory of gaitsweep: it has no {MANIFEST}"
        if not path.is_dir():
            what = "is not a directory" if path.exists() else "does not exist"
        raise TableError(f"{path} {what}.") from None
    except OSError as error:
        raise TableError(f"{file} cannot be read: {reason(error)}.") from error
    except ValueError as error:
        raise DamagedManifest(f"{file} is damaged: it is not text ({error})", path) from error
    try:
        manifest = json.loads(text)
        json.dumps(manifest, ensure_ascii=False).encode()  # half a surrogate could not be printed
    except (ValueError, RecursionError) as error:
        raise DamagedManifest(f"{file} is damaged: it is not JSON ({error})", path) from error
    needed = ("format", "job_hash", "rows", "block")
    if not isinstance(manifest, dict) or not all(name in manifest for name in needed):
        raise DamagedManifest(f"{file} is not a manifest of gaitsweep: it lacks one of {', '.join(needed)}.")
    if manifest["format"] in FORMATS:  # a later one may have other fields
        _check_fields(file, manifest)
    if manifest["format"] not in FORMATS or isinstance(manifest["format"], bool):
        raise TableError(
            f"{path} has format {_short(manifest['format'])}, but this version of gaitsweep reads only "
            f"formats up to {FORMAT}. Use the version named in its manifest."
        )
    if manifest["format"] >= FORMAT and manifest.get(SEAL) != sealed(manifest)[SEAL]:
        raise DamagedManifest(f"{file} was changed after gaitsweep wrote it", path)
    return manifest


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{text[:40]}..."


def _check_fields(file: Path, manifest: Mapping[str, Any]) -> None:
    for name, (fits, allowed) in _FIELDS.items():
        if name in manifest and not fits(manifest[name]):
            raise DamagedManifest(
                f"{file}: {name} is {_short(json.dumps(manifest[name]))}, but must be {allowed}", file.parent
            )


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value < 2**63


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _by_name(fits: Callable[[Any], bool]) -> Callable[[object], bool]:
    return lambda value: isinstance(value, dict) and all(map(fits, value.values()))


def _is_quantity(value: object) -> bool:
    if not isinstance(value, dict) or not isinstance(value.get("circular", False), bool):
        return False
    return all(isinstance(value.get(name, ""), str) for name in ("unit", "meaning", "symbol"))


def is_job(value: object) -> bool:
    """Whether plain values are a job, in the fields on which readers of tables depend."""
    if not isinstance(value, dict):
        return False
    mappings = ("structure", "params", "start", "vary", "run", "numerics", "engine")
    if not all(isinstance(value.get(name, {}), dict) for name in mappings):
        return False
    figures = value.get("figures", [])
    if not isinstance(figures, list) or not all(isinstance(figure, dict) for figure in figures):
        return False
    return all(isinstance(value.get(name, ""), str) for name in ("name", "model"))


_COUNTS = _by_name(lambda value: isinstance(value, int) and not isinstance(value, bool) and value >= 0)

_SOME_ROWS = _by_name(
    lambda value: _COUNTS(value) and {"rows", "row"} <= set(value)
)  # a number, and the first


_are_texts = _by_name(lambda value: isinstance(value, str))


def _are_makers(value: object) -> bool:
    return isinstance(value, list) and all(
        isinstance(maker, dict)
        and _are_texts(maker.get("versions", {}))
        and isinstance(maker.get("parts"), list)
        and all(
            isinstance(span, list) and len(span) == 2 and all(isinstance(number, int) for number in span)
            for span in maker["parts"]
        )
        for maker in value
    )


def _are_axes(value: object) -> bool:
    return isinstance(value, list) and all(
        isinstance(axis, dict)
        and isinstance(axis.get("names"), list)
        and all(isinstance(name, str) for name in axis["names"])
        and _is_count(axis.get("length"))
        and isinstance(axis.get("drawn"), bool)
        for axis in value
    )


# fields that are read: name, test, description
_FIELDS: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "job_hash": (lambda value: isinstance(value, str), "text"),
    "rows": (_is_count, "a number of rows"),
    "block": (_is_count, "a number of rows"),
    "job": (is_job, "the resolved job"),
    "quantities": (_by_name(_is_quantity), "unit, meaning and symbol by name"),
    "timings": (_by_name(_is_number), "seconds and attempts by name"),
    "counts": (_COUNTS, "numbers of rows by status"),
    "gaits": (_COUNTS, "numbers of rows by gait"),
    "slowest": (_COUNTS, "numbers of rows by observable"),
    "mislabelled": (_SOME_ROWS, "rows by label"),
    "starts_beyond": (_SOME_ROWS, "rows by event"),
    "without_period": (_SOME_ROWS, "rows by period"),
    "axes": (_are_axes, "names, number of points and drawn of each axis"),
    "figures_drawn": (_are_texts, "digests by name"),
    "versions": (_are_texts, "versions by name"),
    "program": (_are_texts, "digests by name"),
    "made_before": (_are_makers, "versions and parts of each earlier maker"),
    "complete": (lambda value: isinstance(value, bool), "true or false"),
}


def new_manifest(job_hash: str, n_rows: int, block: int, job: Mapping[str, Any]) -> dict[str, Any]:
    """Return the manifest of a new directory."""
    if n_rows < 1 or block < 1:
        raise ValueError(
            f"A table must have at least one row and one row per part, not {n_rows} and {block}."
        )
    created = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {
        "format": FORMAT,
        "job_hash": job_hash,
        "rows": n_rows,
        "block": block,
        "gaitsweep": version(),
        "created": created,
        "job": dict(job),
    }


def rows_of(manifest: Mapping[str, Any], number: int) -> tuple[int, int]:
    """Return the first row of a block and the row after its last (equal past the table's end)."""
    block, rows = manifest["block"], manifest["rows"]
    return min(number * block, rows), min((number + 1) * block, rows)


def claim(path: Path, job_hash: str, n_rows: int, block: int) -> dict[str, Any] | None:
    """Check whether a job may use a directory, without writing to it.

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
    if manifest["job_hash"] != job_hash:
        raise TableError(
            f"{path} contains the table of another job (its hash is {manifest['job_hash'][:12]}, this "
            "job's is "
            f"{job_hash[:12]}): choose another directory with --out, or remove this one."
        )
    if (manifest["rows"], manifest["block"]) != (n_rows, block):
        raise TableError(
            f"{path} has {manifest['rows']} rows in blocks of {manifest['block']}, but this job has "
            f"{n_rows} rows in blocks of {block}: choose another directory with --out, or remove this one."
        )
    return manifest
