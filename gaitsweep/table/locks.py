"""Locks of a directory for its writer, and of its blocks for processes that compute a table together.

The file `.blocks` has a record for each block: the number of starts without an end, and the process of the
last start. A process locks the record of the block that it computes; the operating system frees the lock when
the process ends in any way, also on another machine that shares a network file system.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import socket
import stat
import struct
import sys
from pathlib import Path
from typing import NamedTuple

from gaitsweep.errors import UnsupportedSystem
from gaitsweep.table.atomic_files import TableError

LOCK_NAME = ".lock"
BLOCK_LOCKS = ".blocks"
# Errors of a file system that has no locks.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL)
_RECORD = 128  # bytes


def this_process() -> str:
    """Return the name of this process in messages."""
    return f"process {os.getpid()} on {socket.gethostname()}"


class BusyDirectory(TableError):
    """Another run is writing to the directory."""


class Lock:
    """A lock for writing to a directory, released by the operating system when the process ends.

    Args:
        folder: the directory.
        shared: share the lock with other processes that only write parts.

    Raises:
        BusyDirectory: another run holds it.
        TableError: the lock file is not a regular file.
        OSError: the lock file cannot be created.
    """

    def __init__(self, folder: Path, *, shared: bool = False) -> None:
        self._erases_name = False
        self.file_system_has_locks = True
        path = folder / LOCK_NAME
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        try:
            self._descriptor = os.open(path, flags, 0o644)
        except OSError as error:
            if error.errno == errno.ELOOP:
                raise TableError(f"{path} is a link, which is not allowed here: remove it.") from None
            raise
        try:
            self._take(path, shared=shared)
        except BaseException:  # such as of a full disk, after which the lock is free again
            self.release()
            raise

    def _take(self, path: Path, *, shared: bool) -> None:
        """Lock the open file at `path`, and write the name of this process into it."""
        status = os.fstat(self._descriptor)
        # writing to a file with a second name (a hard link) would change that file, too
        if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
            raise TableError(f"{path} is not a lock file of gaitsweep: remove it.")
        try:
            fcntl.flock(self._descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.pread(self._descriptor, 200, 0).decode(errors="replace").strip()
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                raise BusyDirectory(
                    f"Another run ({holder or 'unknown process'}) is writing to {path.parent}: "
                    "wait until it ends, stop it, or choose another directory with --out."
                ) from None
            if error.errno not in _NO_LOCKS:
                raise
            self.file_system_has_locks = False
        self._erases_name = not shared
        os.ftruncate(self._descriptor, 0)
        os.pwrite(self._descriptor, f"{this_process()}\n".encode(), 0)

    def release(self) -> None:
        """Release the lock; a second call does nothing."""
        if self._descriptor >= 0:
            if self._erases_name:  # a directory that is published shall not name the machine
                with contextlib.suppress(OSError):
                    os.ftruncate(self._descriptor, 0)
            os.close(self._descriptor)
            self._descriptor = -1


class UnfinishedStarts(NamedTuple):
    """Number of starts of a block without an end, and the process of the last start."""

    starts: int
    process: str


class BlockLocks:
    """Locks of the blocks of one directory; use it as a context manager, or call `close`.

    Args:
        folder: the directory.

    Raises:
        UnsupportedSystem: this system has no locks of an open file.
        OSError: the file of locks cannot be created.
    """

    def __init__(self, folder: Path) -> None:
        if not hasattr(fcntl, "F_OFD_SETLK"):
            raise UnsupportedSystem(
                f"Processes that share the directory {folder} need open file description locks, which "
                f"{sys.platform} lacks: run the job without --rows, or by --cluster with --collect."
            )
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        self._descriptor = os.open(folder / BLOCK_LOCKS, flags, 0o644)

    def take(self, number: int, process: str) -> bool:
        """Lock a block for a process; returns False if another process holds the lock.

        On a file system without locks it always succeeds; two processes may then compute the same block and
        write the same part.

        Args:
            number: the block.
            process: the name of the process in messages.

        Raises:
            OSError: the block cannot be locked for another reason.
        """
        try:
            self._lock(fcntl.F_WRLCK, number)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.EACCES):
                return False
            if error.errno not in _NO_LOCKS:
                raise
        self._write_record(number, self.unfinished_starts(number).starts, process)
        return True

    def free(self, number: int) -> None:
        """Unlock a block."""
        with contextlib.suppress(OSError):
            self._lock(fcntl.F_UNLCK, number)

    def _lock(self, kind: int, number: int) -> None:
        """Lock or unlock the record of a block.

        Args:
            kind: F_WRLCK or F_UNLCK of `fcntl`.
            number: the block.

        Raises:
            OSError: another process holds the lock, or the file system has none.
        """
        # `struct flock` of 64-bit systems: kind, origin, begin and length of the range, process (0), padding
        # a lock of the open file, since a process loses its own locks when it closes any descriptor of a file
        fields = struct.pack("hhqqi0q", kind, os.SEEK_SET, number * _RECORD, _RECORD, 0)
        fcntl.fcntl(self._descriptor, fcntl.F_OFD_SETLK, fields)

    def unfinished_starts(self, number: int) -> UnfinishedStarts:
        """Return the starts of a block that have no end yet."""
        record = os.pread(self._descriptor, _RECORD, number * _RECORD).decode(errors="replace")
        starts, _, process = record.rstrip("\0 \n").partition(" ")
        return UnfinishedStarts(int(starts), process) if starts.isdigit() else UnfinishedStarts(0, "")

    def begin(self, number: int) -> None:
        """Record that the process with the lock of a block starts it."""
        starts, process = self.unfinished_starts(number)
        self._write_record(number, starts + 1, process)

    def end(self, number: int) -> None:
        """Record that a block has ended, with a part or an error."""
        self._write_record(number, 0, "")

    def _write_record(self, number: int, starts: int, process: str) -> None:
        """Write the starts of a block without an end, and the process of the last one."""
        record = f"{starts} {process}".encode()[: _RECORD - 1].ljust(_RECORD - 1) + b"\n"
        os.pwrite(self._descriptor, record, number * _RECORD)

    def close(self) -> None:
        """Free all locks; a second call does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __enter__(self) -> BlockLocks:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
