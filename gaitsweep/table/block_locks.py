"""Locks of single blocks, for processes that compute different blocks of a table at the same time.

The file `.blocks` has a record for each block: the number of starts without an end, and the process of the
last start. A process locks the record of the block that it computes; the operating system frees the lock when
the process ends in any way, also on another machine that shares a network file system.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import struct
import sys
from pathlib import Path
from typing import NamedTuple

from gaitsweep.errors import UnsupportedSystem

BLOCK_LOCKS = ".blocks"
_RECORD = 128  # bytes


class Begun(NamedTuple):
    """Count of starts of a block without an end, and the process that began it last."""

    times: int
    process: str


class BlockLocks:
    """The locks of the blocks of one directory; use it as a context manager, or call `close`."""

    def __init__(self, folder: Path) -> None:
        """Open the file of locks.

        Raises:
            UnsupportedSystem: this system has no locks of an open file.
            OSError: it cannot be created.
        """
        if not hasattr(fcntl, "F_OFD_SETLK"):
            raise UnsupportedSystem(
                f"Processes that share the directory {folder} need open file description locks, which "
                f"{sys.platform} "
                "lacks: run the job without --rows, or by --cluster with --collect."
            )
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        self._descriptor = os.open(folder / BLOCK_LOCKS, flags, 0o644)

    def take(self, number: int, process: str) -> bool:
        """Lock a block for a process; returns False if another process holds the lock.

        On a file system without locks it always succeeds; two processes may then compute the same block and
        write the same part.
        """
        try:
            self._lock(fcntl.F_WRLCK, number)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.EACCES):
                return False
        self._note(number, self.begun(number).times, process)
        return True

    def free(self, number: int) -> None:
        """Unlock a block."""
        with contextlib.suppress(OSError):
            self._lock(fcntl.F_UNLCK, number)

    def _lock(self, kind: int, number: int) -> None:
        # locks of the open file, not of the process: closing another descriptor would free those
        fields = struct.pack("hhqqi0q", kind, os.SEEK_SET, number * _RECORD, _RECORD, 0)
        fcntl.fcntl(self._descriptor, fcntl.F_OFD_SETLK, fields)

    def begun(self, number: int) -> Begun:
        """Number of starts of a block without an end, and the process of the last start."""
        times, _, process = os.pread(self._descriptor, _RECORD, number * _RECORD).decode(
            errors="replace"
        ).rstrip("\0 \n").partition(" ")  # fmt: skip
        return Begun(int(times), process) if times.isdigit() else Begun(0, "")

    def begin(self, number: int) -> None:
        """Record that the process with the lock of a block starts it."""
        times, process = self.begun(number)
        self._note(number, times + 1, process)

    def end(self, number: int) -> None:
        """Record that a block has ended, with a part or an error."""
        self._note(number, 0, "")

    def _note(self, number: int, times: int, process: str) -> None:
        record = f"{times} {process}".encode()[: _RECORD - 1].ljust(_RECORD - 1) + b"\n"
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
