"""Storage of the ended rows of blocks that are not complete, so that a killed run loses few of them."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Protocol

from gaitsweep.engine.sweep.block_writer import BlockWriter
from gaitsweep.engine.sweep.lane_scheduler import LaneScheduler
from gaitsweep.row_outcome import RowOutcome

# An ended row is stored on disk within this time (s); a kill loses only rows that ended later.
SAFE_WITHIN = 5.0
# Reserve within that time (s), for steps that take longer than they did before.
_SPARE = 1.0


class OpenRows(Protocol):
    """Storage for ended rows of incomplete blocks: a result directory."""

    def restored(self, number: int) -> RowOutcome | None:
        """The rows of a block that an earlier run stored, or None."""

    def keep(self, rows: RowOutcome) -> None:
        """Store rows; they are safe when this returns."""


class OpenRowsKeeper:
    """Stores ended rows of open blocks before the oldest of them has waited `SAFE_WITHIN` s.

    `chunk_s` is the duration of the latest chunk (s).

    Args:
        scheduler: has the open blocks.
        open_rows: the storage; None: rows of incomplete blocks are not stored.
        writer: the writer of complete blocks, which stores rows as well.
    """

    def __init__(self, scheduler: LaneScheduler, open_rows: OpenRows | None, writer: BlockWriter) -> None:
        self._scheduler = scheduler
        self._open_rows = open_rows
        self._writer = writer
        self.chunk_s = 0.0
        self._store_s = 0.1
        self._storing = False  # at most one store at a time
        # start of the chunk in which the oldest row ended that is neither stored nor being stored
        self._oldest: float | None = None

    def chunk_ended(self, began: float) -> None:
        """Record that the chunk that began at `began` (s) has been collected."""
        self.chunk_s = time.perf_counter() - began
        if self._oldest is None and self._open_rows is not None and self._scheduler.has_unstored_rows:
            self._oldest = began

    def store_if_due(self, ahead: float = 0.0) -> None:
        """Store the rows if the oldest would wait longer than `SAFE_WITHIN`.

        Args:
            ahead: the time until the next call (s).
        """
        self._writer.take_done(sys.maxsize)
        if self._oldest is None or self._storing:
            return
        if not self._scheduler.has_unstored_rows:  # their parts have been written
            self._oldest = None
            return
        age = time.perf_counter() - self._oldest
        if age + ahead + self._writer.ahead_s + self._store_s > SAFE_WITHIN - _SPARE:
            # the rows of blocks that are being written are safe before these
            ended = self._scheduler.unstored_rows(self._scheduler.being_written)
            self._oldest = None
            if ended:
                self._storing = True
                self._writer.store(lambda: self._keep(ended), lambda: self._stored(ended))

    def store(self) -> None:
        """Store all ended rows of open blocks that are not on disk; no other write is pending."""
        ended = self._scheduler.unstored_rows()
        if self._open_rows is not None and ended:
            self._keep(ended)
            self._stored(ended)
        self._oldest = None

    def _stored(self, ended: Sequence[RowOutcome]) -> None:
        """Mark rows as stored."""
        self._scheduler.mark_stored(ended)
        self._storing = False

    def _keep(self, ended: Sequence[RowOutcome]) -> None:
        """Store rows, and record the time that it takes."""
        assert self._open_rows is not None
        began = time.perf_counter()
        self._open_rows.keep(RowOutcome.concat(ended))
        self._store_s = time.perf_counter() - began
