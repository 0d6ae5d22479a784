"""Stored output of complete jobs, which the same command prints again without loading JAX.

It is stored in the user's cache with the digests of all files on which it depends: the job and the files
that it names, the program, and every file of the result directory. If one of them has changed, the command
runs normally.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from gaitsweep.cache_folder import cache_folder, load_cached, store_cached

_MAX_STORED = 200  # commands whose output is stored
# Variables that choose the device, so that the same file may be another job.
_DEVICE_VARIABLES = ("JAX_PLATFORMS", "CUDA_VISIBLE_DEVICES", "XLA_FLAGS", "JAX_ENABLE_X64")
_LOCK = ".lock"
_OF_PROGRAM = (".py", ".xml", ".yaml")  # code, bodies and parameter sets


class StoredOutput(NamedTuple):
    """The output of a command: on standard output, and on standard error."""

    printed: str
    errors: str


def load_output(command: Sequence[str]) -> StoredOutput | None:
    """Load the stored output of the same command; None if anything has changed since.

    Args:
        command: the arguments of the command.
    """
    file = _output_file(command)
    if file is None:
        return None
    try:
        stored = json.loads(load_cached(file) or b"")
        folder = Path(stored["folder"])
        files = stored["files"]
        in_folder = {name for name in files if Path(name).is_relative_to(folder)}
        if stored["program"] != _program() or set(_files_in(folder)) != in_folder:
            return None
        if any(_digest(Path(name)) != digest for name, digest in files.items()):
            return None
        return StoredOutput(str(stored["printed"]), str(stored["errors"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def digests_of(sources: Iterable[Path]) -> dict[str, str]:
    """Digests of the files of a job that has just been read, by absolute path; {} if one cannot be read."""
    try:
        return {str(source.absolute()): _digest(source) for source in sources}
    except OSError:
        return {}


def store_output(
    command: Sequence[str], sources: Mapping[str, str], folder: Path, printed: str, errors: str
) -> None:
    """Store the output of a command whose job is complete, unless a file of the job has changed meanwhile.

    Args:
        command: the arguments of the command.
        sources: `digests_of` the files from which the job was read, such as its config and the profile of its
            ground, of the time at which they were read.
        folder: the result directory.
        printed, errors: the text on standard output and on standard error.
    """
    file = _output_file(command)
    # an edited file is of another job than the one whose outcome this is
    if file is None or not sources or digests_of(map(Path, sources)) != sources:
        return
    with contextlib.suppress(OSError):
        folder = folder.absolute()
        files = {**sources, **{name: _digest(Path(name)) for name in _files_in(folder)}}
        state = {"folder": str(folder), "files": files, "program": _program()}
        store_cached(file, json.dumps({**state, "printed": printed, "errors": errors}).encode())
        oldest_first = sorted(file.parent.glob("*.json"), key=lambda output: output.stat().st_mtime)
        for old in oldest_first[:-_MAX_STORED]:
            old.unlink()


def _output_file(command: Sequence[str]) -> Path | None:
    """The cache file of a command, or None without a writable cache."""
    folder = cache_folder("complete")
    if folder is None:
        return None
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    device = [platform.node(), cores, *map(os.environ.get, _DEVICE_VARIABLES)]
    key = json.dumps([list(command), str(Path.cwd()), device])
    return folder / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.json"


def _program() -> str:
    """An identifier of the files of this program, and of the Python that runs it."""
    root = Path(__file__).parents[1]
    stamps = []
    files = [file for file in root.rglob("*") if file.suffix in _OF_PROGRAM]
    for file in sorted(files):
        status = file.stat()
        stamps.append(f"{file.relative_to(root)} {status.st_size} {status.st_mtime_ns}")
    return hashlib.sha256("\n".join([sys.version, sys.prefix, *stamps]).encode()).hexdigest()


def _files_in(folder: Path) -> Iterator[str]:
    """The paths of all files below a folder, except for its lock."""
    for place, _, names in os.walk(folder):
        yield from (os.path.join(place, name) for name in names if name != _LOCK)


def _digest(file: Path) -> str:
    """The SHA-256 of a file."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
