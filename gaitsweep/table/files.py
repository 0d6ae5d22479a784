"""Files that appear whole or not at all, and the lock that keeps a directory to one writer."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from gaitsweep.user_error import FAILED, UserError

PARTIAL = ".partial"  # ends the hidden name under which a file is written
LOCK_NAME = ".lock"

_NO_LOCKS_HERE = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL)


class TableError(UserError):
    """A result directory is refused; the message is one sentence that says what to do instead."""


class WriteError(TableError):
    """A file of a result directory could not be written (a full disk, say); what stood there is safe."""

    exit_code = FAILED


def reason(error: OSError) -> str:
    """Say in words why the operating system refused."""
    if error.errno == errno.ENOSPC:
        return "the disk is full"
    return (error.strerror or str(error) or type(error).__name__).lower()


def replace_file(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file to a hidden temporary name beside `path`, flush it to disk, and rename it.

    Killed at any point it leaves the old file or the new one, and at most a temporary that `remove_partials`
    takes away.

    Args:
        path: where the file shall stand; its folder exists.
        write: writes the content to the open file.

    Raises:
        OSError: the file could not be written; `path` is as it was and the temporary is gone.
    """
    temporary = path.with_name(f".{path.name}{PARTIAL}")
    try:
        with open(temporary, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    # The rename itself is on disk only after this; a file system that cannot do it has nothing to lose by it.
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def is_partial(path: Path) -> bool:
    """Tell a temporary of `replace_file` from every other file."""
    return path.name.startswith(".") and path.name.endswith(PARTIAL)


def remove_partials(folder: Path) -> None:
    """Remove the temporaries that a killed run left in a folder; only its one writer may call this."""
    if folder.is_dir():
        for path in folder.iterdir():
            if is_partial(path) and path.is_file():
                path.unlink(missing_ok=True)


class Lock:
    """The right to write a directory, which the kernel takes back when its process ends, however it ends."""

    def __init__(self, folder: Path) -> None:
        """Take the lock of a folder.

        Raises:
            TableError: another run holds it.
            OSError: the lock file cannot be made.
        """
        self.exclusive = True
        self._descriptor = os.open(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.pread(self._descriptor, 200, 0).decode(errors="replace").strip()
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                self.release()
                raise TableError(
                    f"Another run ({holder or 'of unknown process'}) is writing {folder}: "
                    "wait until it ends, stop it, or choose another directory with --out."
                ) from None
            if error.errno not in _NO_LOCKS_HERE:
                self.release()
                raise
            self.exclusive = False
        os.ftruncate(self._descriptor, 0)
        os.pwrite(self._descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode(), 0)

    def release(self) -> None:
        """Give the lock back; a second call does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
