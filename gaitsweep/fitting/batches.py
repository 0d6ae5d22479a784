"""Batches of sets that are measured side by side, and end in the order in which they began.

A batch lasts as long as its slowest row. Near its end most lanes of a GPU would be idle, so other batches run
meanwhile.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from types import TracebackType
from typing import Generic, TypeVar

from gaitsweep.engine.sweep.sweep_spec import SweepProgress

T = TypeVar("T")
# Seconds between two polls of the running batches.
_POLL = 0.1


class Batches(Generic[T]):
    """Running batches, each in a thread.

    Args:
        threads: batches that run at a time; others wait.
        on_progress: progress callback, called about ten times a second during `oldest` with the progress of
            each running batch; an exception that it raises is raised by `oldest`.
    """

    def __init__(self, threads: int, on_progress: Callable[[list[SweepProgress]], None]) -> None:
        self._threads, self._on_progress = ThreadPoolExecutor(threads), on_progress
        self._under_way: deque[tuple[Future[T], list[SweepProgress]]] = deque()
        self._stopped = threading.Event()

    def __enter__(self) -> Batches[T]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopped.set()
        self._threads.shutdown(cancel_futures=True)

    def begin(self, measure: Callable[[Callable[[SweepProgress], None]], T]) -> None:
        """Measure a batch in a thread; `measure` receives a progress callback."""
        done: list[SweepProgress] = []

        def on_progress(now: SweepProgress) -> None:
            if self._stopped.is_set():  # nobody reads its result
                raise InterruptedError
            done[:] = [now]

        self._under_way.append((self._threads.submit(measure, on_progress), done))

    def oldest(self) -> T:
        """Wait for the batch that began first, and return its result."""
        future, _ = self._under_way[0]
        while not future.done():
            wait([future], timeout=_POLL)
            self._on_progress([done[0] for _, done in self._under_way if done])
        self._under_way.popleft()
        return future.result()
