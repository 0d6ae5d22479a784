"""Files that appear whole or not at all, and the lock that keeps a directory to one writer."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import socket
import stat
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from gaitsweep.errors import FAILED, UserError

PARTIAL = ".partial"  # ends the hidden name under which a file is written
LOCK_NAME = ".lock"

_NO_LOCKS_HERE = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL)
# What stands in the way is the user's, who can move it or choose another place; all else failed by itself.
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
    """A result directory is refused; the message is one sentence that says what to do instead."""


class WriteError(TableError):
    """A file of a result directory could not be written (a full disk, say); what stood there is safe."""

    exit_code = FAILED


def reason(error: OSError) -> str:
    """Say in words why the operating system refused."""
    if error.errno == errno.ENOSPC:
        return "the disk is full"
    return (error.strerror or str(error) or type(error).__name__).lower()


def not_written(sentence: str, error: OSError) -> TableError:
    """Make the error of a file that could not be written: the user's fault, or the machine's."""
    return (TableError if error.errno in _PLACE_AT_FAULT else WriteError)(sentence)


def read_file(path: Path, most: int | None = None) -> bytes:
    """Read a regular file, and wait for nothing else.

    Args:
        path: the file.
        most: bytes that it may have.

    Raises:
        OSError: it cannot be read, is a folder, a pipe or a device, or is larger.
    """
    # without O_NONBLOCK the opening of a pipe waits for whoever writes it
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        if most is not None and found.st_size > most:
            raise OSError(errno.EFBIG, f"it has more than {most} bytes", str(path))
        return file.read()


def replace_file(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file to a hidden temporary name beside `path`, flush it to disk, and rename it.

    Killed at any point it leaves the old file or the new one, and at most a temporary that `remove_partials`
    takes away. A link that stands at either name is replaced, not followed.

    Args:
        path: where the file shall stand; its folder exists.
        write: writes the content to the open file.

    Raises:
        OSError: the file could not be written; `path` is as it was and the temporary is gone.
    """
    temporary = path.with_name(f".{path.name}{PARTIAL}")
    with contextlib.suppress(FileNotFoundError):
        temporary.unlink()
    try:
        # opened by its path, which programs that write it instead of us need to know
        with open(temporary, "xb", opener=_without_links) as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def _without_links(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NOFOLLOW, 0o666)


def sync_folder(folder: Path) -> None:
    """Bring a folder's names to disk; a file system that cannot do it has nothing to lose by it."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def own_folder(path: Path) -> None:
    """Make a folder of a result directory unless it is there.

    Raises:
        TableError: a file stands there, or a link, which would lead the writer out of the directory.
        OSError: it cannot be made.
    """
    if path.is_symlink():
        raise TableError(f"{path} is a link, which is not followed: put a folder there, or remove it.")
    if path.exists() and not path.is_dir():
        raise TableError(f"{path} is a file where a folder belongs: move it away.")
    path.mkdir(exist_ok=True)


def is_partial(path: Path) -> bool:
    """Tell a temporary of `replace_file` from every other file."""
    return path.name.startswith(".") and path.name.endswith(PARTIAL)


def remove_partials(folder: Path) -> None:
    """Remove the temporaries that a killed run left in a folder; only its one writer may call this."""
    if folder.is_dir():
        for path in folder.iterdir():
            if is_partial(path) and (path.is_symlink() or path.is_file()):
                path.unlink(missing_ok=True)


class Lock:
    """The right to write a directory, which the kernel takes back when its process ends, however it ends."""

    def __init__(self, folder: Path) -> None:
        """Take the lock of a folder.

        Raises:
            TableError: another run holds it, or what stands at its name is no file of ours.
            OSError: the lock file cannot be made.
        """
        self.exclusive = True
        path = folder / LOCK_NAME
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        try:
            self._descriptor = os.open(path, flags, 0o644)
        except OSError as error:
            if error.errno == errno.ELOOP:
                raise TableError(f"{path} is a link, which is not followed: remove it.") from None
            raise
        found = os.fstat(self._descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:  # what is written would stand elsewhere too
            self.release()
            raise TableError(f"{path} is no lock file of gaitsweep: remove it.")
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
