"""Concurrent measurement of batches of sets, each in a thread."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from types import TracebackType

from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.fitting.measure import MeasuredByName

_POLL_SECONDS = 0.1  # between two looks at the running batches
# The measures of a batch by name; None of a batch that is on disk.
Batch = MeasuredByName | None


class ConcurrentBatches:
    """Batches of sets that are measured side by side, each in a thread, and returned in the order of `begin`.

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
        # each batch with a list of its latest progress, empty at first
        self._running: deque[tuple[Future[Batch], list[SweepProgress]]] = deque()
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
            if self._stopped.is_set():  # ends a thread whose result is no longer needed
                raise InterruptedError
            latest[:] = [now]

        self._running.append((self._threads.submit(measure, on_progress), latest))

    def oldest(self) -> Batch:
        """Wait for the batch that began first, and return its result.

        Raises:
            Exception: what `measure` or the progress callback raised.
        """
        future, _ = self._running[0]
        while not future.done():
            wait([future], timeout=_POLL_SECONDS)
            self._on_progress([latest[0] for _, latest in self._running if latest])
        self._running.popleft()
        return future.result()
