"""The assignment of rows to lanes: filling free lanes, collecting results, and the open blocks.

Lanes work in groups, each in a thread: while the host collects the results of one group and opens new rows in
it, the others continue.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextvars import copy_context

import numpy as np

from gaitsweep.compiling_threads import compiling
from gaitsweep.engine.sweep.blocks_of_rows import Block
from gaitsweep.engine.sweep.engine_choice import groups_on
from gaitsweep.engine.sweep.lane_group import CollectedChunk, LaneGroup
from gaitsweep.engine.sweep.sweep_spec import SweepProgress, SweepSpec
from gaitsweep.row_outcome import ENGINE_NUMBERS, RowOutcome


def _restored_rows(
    spec: SweepSpec, blocks: Sequence[int], restored: Callable[[int], RowOutcome | None]
) -> dict[int, RowOutcome]:
    """The restored rows by block, without rows of another version, which lack a number."""
    declared = {row_number.name for row_number in (*ENGINE_NUMBERS, *spec.recorder.numbers)}
    rows_by_block: dict[int, RowOutcome] = {}
    for number in blocks:
        rows = restored(number)
        if rows is not None and declared <= rows.numbers.keys():
            rows_by_block[number] = rows
    return rows_by_block


class LaneScheduler:
    """Assigns rows to lanes, and collects the results of open blocks.

    Args:
        spec: the sweep.
        blocks: the numbers of the blocks to run.
        restored: returns the rows of a block that an earlier run has ended, or None.
    """

    def __init__(
        self,
        spec: SweepSpec,
        blocks: Sequence[int],
        restored: Callable[[int], RowOutcome | None] | None = None,
    ) -> None:
        self.spec = spec
        self._restored = {} if restored is None else _restored_rows(spec, blocks, restored)
        self.total = sum(min(spec.block, spec.n_rows - b * spec.block) for b in blocks)
        self.total -= sum(rows.row.size for rows in self._restored.values())
        # a device without rows would have nothing to run
        devices = spec.devices[: self.total]
        self.groups = [LaneGroup(lanes, spec) for device in devices for lanes in groups_on(device, spec)]
        self.open: dict[int, Block] = {}
        self.complete: list[int] = []  # open blocks whose rows have all ended
        self.being_written: set[int] = set()  # among the open blocks
        self.done = 0
        self.attempts = 0
        self.cycles = 0
        self._waiting = list(blocks)[::-1]
        self._newest: Block | None = None
        # a card ends rows as fast as blocks are made, so the next one is made in a thread
        on_card = spec.engine == "kernel" and spec.devices[0].platform == "gpu"
        self._making = ThreadPoolExecutor(1) if on_card else None
        self._next: Future[Block] | None = None
        # JAX and the kernels release the GIL while they compile or run a program
        self._threads = ThreadPoolExecutor(len(self.groups)) if len(self.groups) > 1 else None
        self._running: dict[Future[CollectedChunk], LaneGroup] = {}

    @property
    def busy(self) -> bool:
        """Whether any lane has a row."""
        return any(group.busy for group in self.groups)

    def open_first_rows(self) -> None:
        """Open the first rows; the programs are compiled."""
        self._fill(self.groups)
        with compiling():
            chunks = self.advance_all(0)
        for group, chunk in chunks:
            self._collect(group, chunk)

    def advance_all(self, polls: int) -> list[tuple[LaneGroup, CollectedChunk]]:
        """Advance all groups that have rows by `polls`, and wait for them."""
        busy = [group for group in self.groups if group.busy]
        if self._threads is None:
            return [(group, group.chunk(polls)) for group in busy]
        futures = [self._threads.submit(group.chunk, polls) for group in busy]
        return [(group, future.result()) for group, future in zip(busy, futures, strict=True)]

    def start(self) -> None:
        """Start all groups; `collect_next` collects their output."""
        for group in self.groups:
            self._continue(group)

    def collect_next(self) -> float:
        """Wait for the next chunk, collect it, and continue its group; returns its start time (s)."""
        if self._threads is None:
            (group,) = self.groups
            chunk = group.chunk()
        else:
            wait(self._running, return_when=FIRST_COMPLETED)
            future = next(future for future in self._running if future.done())
            group = self._running.pop(future)
            chunk = future.result()
        self._collect(group, chunk)
        self._continue(group)
        return chunk.began

    def shut_down(self) -> None:
        """Wait for running chunks."""
        if self._making is not None:
            self._making.shutdown(cancel_futures=True)
        if self._threads is not None:
            self._threads.shutdown(cancel_futures=True)

    def _continue(self, group: LaneGroup) -> None:
        """Fill the free lanes of a group, and start its next chunk in a thread if there are threads."""
        self._fill([group])
        if self._threads is not None and group.busy:
            self._running[self._threads.submit(group.chunk)] = group

    def _fill(self, groups: Sequence[LaneGroup]) -> None:
        """Put waiting rows into free lanes of groups, one row in each group in turn.

        So a few rows use all devices. Lanes that one group has more than another are filled later.
        """
        most = min((group.free.size for group in groups), default=0) * len(groups)
        filled = 0
        # without groups there are no rows to run, but blocks without missing rows
        while (filled < most or not groups) and (block := self._next_block()) is not None:
            rows = block.waiting[block.opened : block.opened + most - filled]
            block.opened += rows.size
            for number, group in enumerate(groups):
                of_group = rows[(number - filled) % len(groups) :: len(groups)]
                if of_group.size:
                    group.place(block, of_group)
            filled += rows.size

    def _next_block(self) -> Block | None:
        """The newest block while it has waiting rows, then the next block."""
        while self._newest is None or self._newest.opened == self._newest.waiting.size:
            if self._next is not None:
                self._newest, self._next = self._next.result(), None
            elif self._waiting:
                self._newest = self._made(self._waiting.pop())
            else:
                return None
            self.open[self._newest.number] = self._newest
            if self._making is not None and self._waiting:
                number = self._waiting.pop()
                self._next = self._making.submit(copy_context().run, self._made, number)
            # the earlier run was killed after its last row and before its part was written
            if self._newest.missing == 0:
                self.complete.append(self._newest.number)
        return self._newest

    def _made(self, number: int) -> Block:
        """The block with a number."""
        return Block(self.spec, number, self._restored.pop(number, None))

    def _collect(self, group: LaneGroup, chunk: CollectedChunk) -> None:
        """Pass the results of a chunk to its blocks, count its rows, and choose the size of the next one."""
        group.free = chunk.free
        for part in chunk.parts:
            block = self.open[part.number]
            block.add(part)
            if block.missing == 0:
                self.complete.append(block.number)
        self.done += chunk.ended
        self.attempts += chunk.attempts
        self.cycles += chunk.cycles
        # the first rows that end are short ones, so running rows count in the estimate as well
        typical = self.cycles / self.done if self.done else 0.0
        cycles = chunk.running.cycles
        if cycles.size and self.done:
            typical = max(typical, float(np.mean(cycles)))
        group.progress = float(np.sum(self.spec.recorder.progress(chunk.running, typical)))
        group.attempts = int(chunk.running_attempts.sum())
        if self.spec.engine != "kernel":
            group.sizer.choose_for_xla()
            return
        of_ended = self.attempts / self.done if self.done else 0.0
        of_running = group.attempts / cycles.size if cycles.size else 0.0
        waiting = group.size / group.lanes.at_a_time - 1.0
        group.sizer.choose(max(of_ended, of_running), chunk.fullest, waiting)

    def take(self, number: int) -> Block:
        """A complete block that can be written; it stays open until it is closed."""
        self.complete.remove(number)
        self.being_written.add(number)
        return self.open[number]

    def close(self, number: int) -> None:
        """Remove a written block."""
        self.being_written.remove(number)
        del self.open[number]

    @property
    def has_unstored_rows(self) -> bool:
        """Whether an open block has ended rows that are not on disk."""
        return any(block.has_unstored_rows for block in self.open.values())

    def unstored_rows(self, except_blocks: Container[int] = ()) -> list[RowOutcome]:
        """The ended rows that are not on disk, one element for each open block, without some blocks."""
        unstored = [block.unstored() for number, block in self.open.items() if number not in except_blocks]
        return [rows for rows in unstored if rows.row.size]

    def mark_stored(self, stored: Sequence[RowOutcome]) -> None:
        """Mark the rows that `unstored_rows` returned as stored on disk."""
        for rows in stored:
            block = self.open.get(int(rows.row[0]) // self.spec.block)
            if block is not None:  # otherwise its part has been written since
                block.mark_stored(rows.row)

    def progress(self, seconds: float) -> SweepProgress:
        """The progress of the sweep, `seconds` after its start."""
        done = self.done + sum(group.progress for group in self.groups)
        share = done / self.total if self.total else 1.0
        attempts = self.attempts + sum(group.attempts for group in self.groups)
        return SweepProgress(self.done, self.total, share, attempts, seconds)
