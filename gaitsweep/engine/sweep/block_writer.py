"""Writing of complete blocks, one after the other, while other rows run."""

from __future__ import annotations

import functools
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from typing import Any

from gaitsweep.engine.sweep.blocks_of_rows import Block
from gaitsweep.engine.sweep.labels import labelled
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.row_outcome import RowOutcome


class BlockWriter:
    """A thread that writes blocks one after the other while rows continue, and threads that encode them.

    Args:
        spec: the sweep.
        encode: as of `sweep`.
        write: as of `sweep`.
        written: called with the number of each written block, by the waiting thread.
    """

    # Blocks that may wait, for each GPU.
    MAX_WAITING = 8
    # Threads that label and encode, for each GPU, since that takes as long as the rows do on a GPU.
    ENCODING = 2

    def __init__(
        self,
        spec: SweepSpec,
        encode: Callable[[int, RowOutcome], Any] | None,
        write: Callable[[int, Any], None],
        written: Callable[[int], None],
    ) -> None:
        gpus = len(spec.devices) if spec.devices[0].platform == "gpu" else 1
        self._spec = spec
        self._encode = encode
        self._write = write
        self._written = written
        self._thread = ThreadPoolExecutor(1)
        self._most = self.MAX_WAITING * gpus
        self._encoding = ThreadPoolExecutor(self.ENCODING * gpus)
        # writes in progress, each with the function to call when it is on disk
        self._pending: deque[tuple[Future[None], Callable[[], None]]] = deque()
        self._latest_s = 1.0  # s of writing the latest block; the first one loads libraries

    def write(self, block: Block, *, last: bool) -> None:
        """Queue a block for encoding and writing; an error of an earlier block is raised.

        Args:
            block: the block.
            last: whether no row is left that could run meanwhile; the block is then written at once.
        """
        self.take_done(self._most)
        if last and not self._pending:
            self._write(block.number, self._encoded(block))
            self._written(block.number)
            return
        encoded = self._encoding.submit(copy_context().run, self._encoded, block)
        job = self._thread.submit(self._write_timed, block.number, encoded)
        # a block that could not be written stays open, so that its rows are stored
        self._pending.append((job, functools.partial(self._written, block.number)))

    def _encoded(self, block: Block) -> Any:
        """The labelled rows of a block, converted by `encode` if the sweep has one."""
        rows = labelled(self._spec, block)
        return rows if self._encode is None else self._encode(block.number, rows)

    def _write_timed(self, number: int, encoded: Future[Any]) -> None:
        """Write a block when it is encoded, and record the time that it takes."""
        began = time.perf_counter()
        self._write(number, encoded.result())
        self._latest_s = time.perf_counter() - began

    def store(self, keep: Callable[[], None], stored: Callable[[], None]) -> None:
        """Queue a store of rows.

        Args:
            keep: stores the rows, in the writing thread.
            stored: called afterwards, by the waiting thread.
        """
        self._pending.append((self._thread.submit(keep), stored))

    def take_done(self, most: int) -> None:
        """Record finished writes, and wait until fewer than `most` writes are pending."""
        while self._pending and (len(self._pending) >= most or self._pending[0][0].done()):
            self._take()

    def _take(self) -> None:
        """Wait for the first pending write, and record it."""
        future, done = self._pending.popleft()
        future.result()
        done()

    @property
    def ahead_s(self) -> float:
        """The estimated time (s) until one more block would be written."""
        waiting = sum(not future.done() for future, _ in self._pending)
        return (1 + waiting) * self._latest_s

    def end(self) -> None:
        """Finish all pending writes; the error of the first one that failed is raised."""
        failures: list[BaseException] = []
        try:
            while self._pending:
                try:
                    self._take()
                except BaseException as failure:
                    failures.append(failure)
        finally:
            self._thread.shutdown()
            self._encoding.shutdown()
        if failures:
            raise failures[0]
