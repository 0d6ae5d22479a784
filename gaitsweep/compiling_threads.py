"""Whether a thread of this process is compiling, for progress and for requests to stop."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator

_BEGAN: dict[int, float] = {}  # s on the monotonic clock, of each thread that is compiling
_PURPOSES: dict[int, str] = {}  # of the compilations of a thread, such as "the self-check"


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """A context in which this thread traces a model or compiles a program; it may be entered again."""
    thread = threading.get_ident()
    if thread in _BEGAN:
        yield
        return
    _BEGAN[thread] = time.monotonic()
    try:
        yield
    finally:
        del _BEGAN[thread]


@contextlib.contextmanager
def purpose_of_compiling(purpose: str) -> Iterator[None]:
    """A context in which this thread compiles for a purpose, such as "the self-check"; it may be nested."""
    thread = threading.get_ident()
    outer = compiles_for(thread)
    _PURPOSES[thread] = purpose
    try:
        yield
    finally:
        _PURPOSES[thread] = outer


def compiles_for(thread: int | None) -> str:
    """The purpose for which a thread compiles; empty if none was given."""
    return "" if thread is None else _PURPOSES.get(thread, "")


def compiling_for(thread: int | None = None) -> float | None:
    """The time (s) for which a thread has been compiling; None if it is not.

    Args:
        thread: its identifier; None: of all threads the longest time.
    """
    began = _BEGAN.get(thread) if thread is not None else min(_BEGAN.copy().values(), default=None)
    return None if began is None else time.monotonic() - began
