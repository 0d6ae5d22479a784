"""Ctrl-C and SIGTERM during a run: recorded at once, acted on between two chunks of work."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Terminated(KeyboardInterrupt):
    """SIGTERM requested a stop of the run."""

    exit_code = 128 + signal.SIGTERM


@contextlib.contextmanager
def stop_requests() -> Iterator[Callable[[], None]]:
    """A context that records the first SIGINT or SIGTERM; a second one raises at once.

    Its value is a function that raises KeyboardInterrupt or Terminated if a stop was requested. An exception
    raised by the signal handler itself could hit a library's callback, which may suppress it.
    """
    asked: type[KeyboardInterrupt] | None = None

    def obey() -> None:
        if asked is not None:
            raise asked

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        again = asked is not None
        asked = Terminated if number == signal.SIGTERM else KeyboardInterrupt
        if again:
            raise asked

    # only the main thread may handle signals; other threads keep Python's handlers
    main = threading.current_thread() is threading.main_thread()
    before = {number: signal.signal(number, note) for number in _SIGNALS} if main else {}
    try:
        yield obey
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
