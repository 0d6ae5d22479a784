"""Digests of the files of a directory, in `SHA256SUMS`, which `sha256sum -c` can read.

The line of a file is on disk before the file gets its name, so every file has a line, even after a kill. If a
name has several lines, the last one is valid. Processes that write parts of one table at the same time append
to files of their own, `SHA256SUMS.NAME`, since not every network file system lets two machines append to one
file; they become one file when the table is complete.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from collections.abc import Mapping
from pathlib import Path

from gaitsweep.table.atomic_files import TableError, read_file, reason, replace_file, sync_file, sync_folder

DIGESTS = "SHA256SUMS"
_LINE = re.compile(r"([0-9a-f]{64})  (\S.*)")
_LARGEST = 2**30  # bytes


def digest_of(data: bytes) -> str:
    """Return the SHA-256 digest of bytes, in hex."""
    return hashlib.sha256(data).hexdigest()


def read_digests(folder: Path) -> dict[str, str]:
    """Read the digests of a directory by file name; invalid lines are ignored.

    Raises:
        TableError: the file exists but cannot be read.
    """
    digests: dict[str, str] = {}
    for file in (folder / DIGESTS, *of_writers(folder)):
        try:
            text = read_file(file, _LARGEST).decode(errors="replace")
        except FileNotFoundError:
            continue
        except OSError as error:
            raise TableError(f"{file} cannot be read: {reason(error)}.") from error
        for line in text.split("\n"):
            if match := _LINE.fullmatch(line):
                digest, name = match.groups()
                digests[name] = digest
    return digests


def of_writers(folder: Path) -> list[Path]:
    """Return the files of processes that write parts at the same time, the last changed at the end."""
    changed: list[tuple[int, Path]] = []
    for file in folder.glob(f"{DIGESTS}.*"):
        with contextlib.suppress(OSError):  # removed meanwhile, when the table was completed
            changed.append((file.stat().st_mtime_ns, file))
    return [file for _, file in sorted(changed)]


def add_digest(folder: Path, name: str, digest: str, writer: str) -> None:
    """Append the digest of a file that is about to be written.

    Args:
        folder: the result directory.
        name: the file, from the directory.
        digest: its digest.
        writer: the name of this writer if others write the same table at the same time, else empty.

    Raises:
        OSError: it cannot be written.
    """
    path = folder / (f"{DIGESTS}.{writer}" if writer else DIGESTS)
    flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    is_new = not path.exists()
    with os.fdopen(os.open(path, flags, 0o666), "r+b", buffering=0) as file:
        size = os.fstat(file.fileno()).st_size
        # a power failure may have left an incomplete line
        is_torn = size > 0 and os.pread(file.fileno(), 1, size - 1) != b"\n"
        line = f"{digest}  {name}\n".encode()
        file.write(b"\n" + line if is_torn else line)
        sync_file(file, path)
    if is_new:
        sync_folder(folder)


def write_file(folder: Path, name: str, data: bytes, *, writer: str = "") -> None:
    """Write a file of a result directory after its digest; it is on disk when this returns.

    Args:
        folder, name, writer: as for `add_digest`.
        data: the file's bytes.

    Raises:
        OSError: it cannot be written; the old file is unchanged.
    """
    add_digest(folder, name, digest_of(data), writer)
    replace_file(folder / name, lambda file: file.write(data))


def write_digests(folder: Path, digests: Mapping[str, str]) -> None:
    """Replace the content of `SHA256SUMS`.

    Raises:
        OSError: it cannot be written; the old file is unchanged.
    """
    text = "".join(f"{digest}  {name}\n" for name, digest in sorted(digests.items()))
    replace_file(folder / DIGESTS, lambda file: file.write(text.encode()))
