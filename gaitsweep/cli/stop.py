"""Ctrl-C during a run: noted at once, obeyed between two chunks of work."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any


class StopRequest:
    """A context in which the first SIGINT is only noted, and `obey` raises it; a second one raises at once.

    A KeyboardInterrupt can strike anywhere, inside a library's callback too, which may swallow it.
    """

    def __init__(self) -> None:
        self._asked = False
        self._before: Any = None

    def obey(self) -> None:
        """Raise KeyboardInterrupt where a stop was asked for."""
        if self._asked:
            raise KeyboardInterrupt

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self._asked:
            raise KeyboardInterrupt
        self._asked = True

    def __enter__(self) -> StopRequest:
        # only a main thread may handle signals; elsewhere Python's own way stays
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)
