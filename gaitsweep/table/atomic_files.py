"""Atomic replacement of files, and the errors of files that cannot be read or written."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, BinaryIO

from gaitsweep.errors import EXIT_FAILURE, UserError

_TEMPORARY: set[str] = set()  # folders of `temporary_folder`
PARTIAL = ".partial"  # suffix of the hidden temporary name of a file

# Errors that the user can correct, by another path or permissions; all others are failures of the machine.
_PLACE_AT_FAULT = (
    errno.EISDIR,
    errno.ENOTDIR,
    errno.EEXIST,
    errno.ENOTEMPTY,
    errno.ELOOP,
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ENAMETOOLONG,
)


class TableError(UserError):
    """A result directory cannot be used; the message is a sentence with advice."""


class WriteError(TableError):
    """A file of a result directory could not be written, for example on a full disk; old files are intact."""

    exit_code = EXIT_FAILURE


def reason(error: OSError) -> str:
    """Return the reason of an error of the operating system, in words."""
    if error.errno == errno.ENOSPC:
        return "the disk is full"
    # other libraries give no strerror, but a message, which may have a path
    return error.strerror.lower() if error.strerror else str(error) or type(error).__name__


@contextlib.contextmanager
def writing(failure: str, advice: str = "") -> Iterator[None]:
    """Context in which an OSError becomes a TableError if the user can correct it, else a WriteError.

    Args:
        failure: the beginning of the message, before the reason.
        advice: its end, after the reason.
    """
    try:
        yield
    except OSError as error:
        kind = TableError if error.errno in _PLACE_AT_FAULT else WriteError
        raise kind(f"{failure}: {reason(error)}{advice}.") from error


def read_file(path: Path, most: int | None = None) -> bytes:
    """Read a regular file, without blocking on other kinds of files.

    Args:
        path: the file.
        most: largest allowed size, bytes.

    Raises:
        OSError: it cannot be read, is a folder, a pipe or a device, or is too large.
    """
    # without O_NONBLOCK, opening a pipe waits for its writer
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    try:
        # of a folder it does not close the descriptor
        with os.fdopen(descriptor, "rb", closefd=False) as file:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise OSError(errno.EINVAL, "it is not a regular file", str(path))
            if most is not None and status.st_size > most:
                raise OSError(errno.EFBIG, f"it is larger than {most} bytes", str(path))
            return file.read()
    finally:
        os.close(descriptor)


def replace_file(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file to a hidden temporary name in the folder of `path`, flush it to disk, and rename it.

    A kill at any point leaves the old or the new file, and at most a temporary file, which `remove_partials`
    removes. A link at `path` is replaced, not followed. If several processes write the same file at the
    same time, the last one to finish wins.

    Args:
        path: the path of the file; its folder exists.
        write: writes the content to the open file.

    Raises:
        OSError: the file could not be written; `path` is unchanged, and the temporary file is removed.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}{PARTIAL}")
    opened = open(temporary, "xb")  # noqa: SIM115 - what is there already is not removed below
    try:
        with opened as file:
            write(file)
            sync_file(file, path)
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """Context with a folder that is removed at its end, so that files in it need not be flushed to disk."""
    with tempfile.TemporaryDirectory(prefix="gaitsweep_") as name:
        _TEMPORARY.add(name)
        try:
            yield Path(name)
        finally:
            _TEMPORARY.remove(name)


def _is_temporary(path: Path) -> bool:
    """Return whether a path is inside a folder of `temporary_folder`."""
    return any(f"{path}/".startswith(f"{folder}/") for folder in _TEMPORARY)


def sync_file(file: IO[bytes], path: Path) -> None:
    """Flush an open file, whose name is or will be `path`, to disk; not one in a `temporary_folder`."""
    file.flush()
    if not _is_temporary(path):
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Flush the entries of a folder to disk, where the file system can; not those of a `temporary_folder`."""
    if _is_temporary(folder):
        return
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def own_folder(path: Path) -> None:
    """Create a folder of a result directory, if it does not exist.

    Raises:
        TableError: there is a file, or a link, which could point out of the directory.
        OSError: it cannot be created.
    """
    if path.is_symlink():
        raise TableError(
            f"{path} is a link, which is not allowed here: remove it, or replace it by a folder."
        )
    if path.exists() and not path.is_dir():
        raise TableError(f"{path} is a file but must be a folder: move it elsewhere.")
    path.mkdir(exist_ok=True)


def is_partial(path: Path) -> bool:
    """Return whether a path is a temporary file of `replace_file`."""
    return path.name.startswith(".") and path.name.endswith(PARTIAL)


def remove_partials(folder: Path) -> None:
    """Remove temporary files of a killed run from a folder; only its writer may call this."""
    if folder.is_dir():
        for path in folder.iterdir():
            if is_partial(path) and (path.is_symlink() or path.is_file()):
                path.unlink(missing_ok=True)
