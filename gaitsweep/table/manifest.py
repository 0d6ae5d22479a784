"""The manifest: what makes a directory a result directory, and whose it is."""

from __future__ import annotations

import datetime
import json
from pathlib import Path
from typing import Any

from gaitsweep.table.files import LOCK_NAME, TableError, is_partial, reason
from gaitsweep.version import version

MANIFEST = "manifest.json"
JOB = "job.yaml"
TABLE = "table"
FIGURES = "figures"
FORMAT = 1  # of the directory; a change that older code cannot read raises it


def read_manifest(path: Path) -> dict[str, Any]:
    """Read a directory's manifest.

    Raises:
        TableError: there is none, it is no JSON, or this version of gaitsweep does not know its format.
    """
    try:
        manifest = json.loads((path / MANIFEST).read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        what = "is not a directory" if path.exists() and not path.is_dir() else f"has no {MANIFEST}"
        what = what if path.exists() else "does not exist"
        raise TableError(f"{path} is no result directory of gaitsweep: it {what}.") from None
    except OSError as error:
        raise TableError(f"{path / MANIFEST} cannot be read: {reason(error)}.") from error
    except ValueError as error:
        raise TableError(
            f"{path / MANIFEST} is no JSON any more ({error}): remove {path} and run the job again."
        ) from error
    needed = {"format": int, "job_hash": str, "rows": int, "block": int}
    if not isinstance(manifest, dict) or not all(isinstance(manifest.get(k), t) for k, t in needed.items()):
        raise TableError(
            f"{path / MANIFEST} is no manifest of gaitsweep: it lacks one of {', '.join(needed)}."
        )
    if manifest["format"] != FORMAT:
        raise TableError(
            f"{path} was written in format {manifest['format']}, and this version of gaitsweep reads "
            f"format {FORMAT}: use the version that its manifest names."
        )
    return manifest


def new_manifest(job_hash: str, n_rows: int, block: int) -> dict[str, Any]:
    """Make the manifest that a new directory starts with."""
    if n_rows < 1 or block < 1:
        raise ValueError(f"A table has at least one row and one row a part, not {n_rows} and {block}.")
    created = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {
        "format": FORMAT,
        "job_hash": job_hash,
        "rows": n_rows,
        "block": block,
        "gaitsweep": version(),
        "created": created,
    }


def claim(path: Path, job_hash: str, n_rows: int, block: int) -> dict[str, Any] | None:
    """Find out whether a job may use a directory; writes nothing.

    Returns:
        The manifest of this job's directory, or None where nothing stands yet.

    Raises:
        TableError: the directory is another job's, or not gaitsweep's.
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
    if not (path / MANIFEST).exists():
        raise TableError(
            f"{path} holds files that are not gaitsweep's ({min(entry.name for entry in entries)}) "
            f"and no {MANIFEST}: choose another directory with --out."
        )
    manifest = read_manifest(path)
    if manifest["job_hash"] != job_hash:
        raise TableError(
            f"{path} holds another job's table (its hash is {manifest['job_hash'][:12]}, this job's is "
            f"{job_hash[:12]}): choose another directory with --out, or remove that one."
        )
    if (manifest["rows"], manifest["block"]) != (n_rows, block):
        raise TableError(
            f"{path} holds {manifest['rows']} rows in blocks of {manifest['block']}, and this job has "
            f"{n_rows} rows in blocks of {block}: choose another directory with --out, or remove that one."
        )
    return manifest
