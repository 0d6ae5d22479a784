"""The cache folder of results that can be computed again, each file with a digest of its content.

It is $GAITSWEEP_CACHE, by default $XDG_CACHE_HOME/gaitsweep or ~/.cache/gaitsweep. Kernels in it are loaded
as code: a folder that other users can write to is not used.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import stat
from collections.abc import Callable, Sequence
from pathlib import Path

from gaitsweep.compiling_threads import compiling
from gaitsweep.errors import warn

_DIGEST = 32  # bytes before the content of a file


def cache_folder(name: str) -> Path | None:
    """The folder of this name in the cache, created at its first use; None if it cannot be used.

    Warns if another user owns it or may write to it.

    Args:
        name: the name of the folder, such as kernels.
    """
    import tempfile  # which `--help` does not need

    try:
        cache = _cache()
        folder = cache / name
        cache.parent.mkdir(parents=True, exist_ok=True)
        for directory in (cache, folder):
            directory.mkdir(mode=0o700, exist_ok=True)
            # a sticky folder like /tmp keeps others from replacing what it has, but not from adding files
            if (reason := _unsafe(directory, may_be_sticky=directory == cache)) is not None:
                _warn_once(f"The cache {directory} is not used: {reason}.")
                return None
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError):  # a user without a home is a RuntimeError
        return None


def _cache() -> Path:
    """The folder of all caches; raises RuntimeError for a user without a home."""
    if own := os.environ.get("GAITSWEEP_CACHE"):
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gaitsweep"


@functools.cache
def _warn_once(sentence: str) -> None:
    """Warn with a sentence at its first use in this process."""
    warn(sentence)


def store_cached(file: Path, content: bytes) -> None:
    """Write a file of the cache with its digest, atomically; do nothing if it cannot be written."""
    import tempfile

    with contextlib.suppress(OSError):
        # closed below, before it is renamed
        draft = tempfile.NamedTemporaryFile(dir=file.parent, suffix=".tmp", delete=False)  # noqa: SIM115
        try:
            with draft:
                draft.write(hashlib.sha256(content).digest() + content)
            os.replace(draft.name, file)
        except BaseException:
            with contextlib.suppress(OSError):  # or it would replace a KeyboardInterrupt, and be suppressed
                os.unlink(draft.name)
            raise


def load_cached(file: Path) -> bytes | None:
    """The content of a file of the cache; None where it is missing, damaged or altered."""
    try:
        data = file.read_bytes()
    except OSError:
        return None
    content = data[_DIGEST:]
    return content if hashlib.sha256(content).digest() == data[:_DIGEST] else None


def compiled_once(suffix: str, key: Sequence[str], compile_: Callable[[], bytes]) -> bytes:
    """The machine code that `compile_` makes, or that it has made before with the same key.

    So a kernel is compiled once for a machine and not once for a run; a damaged file is compiled again.

    Args:
        suffix: the ending of the file's name, without the dot.
        key: all that determines the code: the source, the options, the compiler's version.
        compile_: compiles the source.
    """
    file = _kernel_file(suffix, key)
    if file is None:
        with compiling():
            return compile_()
    code = load_cached(file)
    if code is None:
        with compiling():
            code = compile_()
        store_cached(file, code)
    return code


def is_compiled(suffix: str, key: Sequence[str]) -> bool:
    """Whether `compiled_once` has compiled with this suffix and this key before."""
    file = _kernel_file(suffix, key)
    return file is not None and file.exists()


def _kernel_file(suffix: str, key: Sequence[str]) -> Path | None:
    """The file of a kernel's machine code; None without a cache."""
    folder = cache_folder("kernels")
    digest = hashlib.sha256("\n".join(key).encode()).hexdigest()
    return None if folder is None else folder / f"gaitsweep_kernel_{digest[:24]}.{suffix}"


def _unsafe(folder: Path, *, may_be_sticky: bool) -> str | None:
    """The reason why code from a folder may be another user's, or None.

    Args:
        folder: the folder.
        may_be_sticky: whether others may write to it if it has the sticky bit.
    """
    status = folder.stat()
    user = os.geteuid()
    if status.st_uid not in (user, 0):
        return (
            f"it belongs to user {status.st_uid}, but this process runs as user {user}; set "
            "GAITSWEEP_CACHE to your own"
        )
    others = stat.S_IWOTH if _is_own_group(status.st_gid, user) else stat.S_IWOTH | stat.S_IWGRP
    is_excused = may_be_sticky and bool(status.st_mode & stat.S_ISVTX)
    if status.st_mode & others and not is_excused:
        return f"other users can write to it; prevent that by chmod go-w {folder}"
    return None


def _is_own_group(group: int, user: int) -> bool:
    """Return whether a group is a user's own, as many systems make one for each user."""
    import grp
    import pwd

    try:
        name = pwd.getpwuid(user).pw_name
        entry = grp.getgrgid(group)
    except KeyError:
        return False
    return entry.gr_name == name and not set(entry.gr_mem) - {name}
