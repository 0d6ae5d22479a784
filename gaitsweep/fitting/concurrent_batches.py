"""Batches of sets that are measured side by side, each in a thread."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from types import TracebackType

from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.fitting.measure import MeasuredByName

# Seconds between two polls of the running batches.
_POLL = 0.1
# The measures of a batch by name; None of a batch that is on disk.
Batch = MeasuredByName | None


class ConcurrentBatches:
    """Batches of sets that are measured side by side, each in a thread, and end in the order of their begin.

    A batch lasts as long as its slowest row. Near its end most lanes of a GPU would be idle, so other batches
    run meanwhile.

    Args:
        threads: batches that run at a time; others wait.
        on_progress: progress callback, called about ten times a second during `oldest` with the progress of
            each running batch; an exception that it raises is raised by `oldest`.
    """

    def __init__(self, threads: int, on_progress: Callable[[list[SweepProgress]], None]) -> None:
        self._threads = ThreadPoolExecutor(threads)
        self._on_progress = on_progress
        self._under_way: deque[tuple[Future[Batch], list[SweepProgress]]] = deque()
        self._stopped = threading.Event()

    def __enter__(self) -> ConcurrentBatches:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopped.set()
        self._threads.shutdown(cancel_futures=True)

    def begin(self, measure: Callable[[Callable[[SweepProgress], None]], Batch]) -> None:
        """Measure a batch in a thread; `measure` receives a progress callback."""
        latest: list[SweepProgress] = []

        def on_progress(now: SweepProgress) -> None:
            if self._stopped.is_set():  # nobody reads its result
                raise InterruptedError
            latest[:] = [now]

        self._under_way.append((self._threads.submit(measure, on_progress), latest))

    def oldest(self) -> Batch:
        """Wait for the batch that began first, and return its result."""
        future, _ = self._under_way[0]
        while not future.done():
            wait([future], timeout=_POLL)
            self._on_progress([latest[0] for _, latest in self._under_way if latest])
        self._under_way.popleft()
        return future.result()
