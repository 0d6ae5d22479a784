"""Ctrl-C and SIGTERM during a run: recorded at once, obeyed between two chunks of work."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Terminated(KeyboardInterrupt):
    """SIGTERM asked the run to stop."""

    exit_code = 128 + signal.SIGTERM


class StopRequest:
    """A context that records the first SIGINT or SIGTERM for `obey` to raise; a second raises at once.

    A KeyboardInterrupt could be raised inside a library's callback, which may suppress it.
    """

    def __init__(self) -> None:
        self._asked: type[KeyboardInterrupt] | None = None
        self._before: dict[signal.Signals, Any] = {}

    def obey(self) -> None:
        """Raise KeyboardInterrupt, or Terminated, where a stop was asked for."""
        if self._asked is not None:
            raise self._asked

    def _note(self, number: int, frame: FrameType | None) -> None:
        again = self._asked is not None
        self._asked = Terminated if number == signal.SIGTERM else KeyboardInterrupt
        if again:
            raise self._asked

    def __enter__(self) -> StopRequest:
        # only the main thread may handle signals; other threads keep Python's handlers
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._note) for number in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
