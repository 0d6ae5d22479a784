"""The assignment of rows to lanes: filling free lanes, collecting results, and the open blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from gaitsweep.contract import Status
from gaitsweep.engine.sweep.block import Block, EndedRows
from gaitsweep.engine.sweep.chunk_sizer import ChunkSizer
from gaitsweep.engine.sweep.engines import lanes_on, polls_per_chunk
from gaitsweep.engine.sweep.lane import ChunkOutput
from gaitsweep.engine.sweep.sweep_spec import SweepProgress, SweepSpec

# Polls in XLA's first chunk, from whose duration the number of polls in the others follows.
FIRST_POLLS = 4


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
        restored: Callable[[int], EndedRows | None] | None = None,
    ) -> None:
        self.spec = spec
        found = {} if restored is None else {number: restored(number) for number in blocks}
        self._restored = {number: rows for number, rows in found.items() if rows is not None}
        self.total = sum(min(spec.block, spec.n_rows - b * spec.block) for b in blocks)
        self.total -= sum(len(rows["row"]) for rows in self._restored.values())
        # a device without rows would have nothing to run
        self.groups = [lanes_on(device, spec) for device in spec.devices[: self.total]]
        size = spec.lanes * len(self.groups)
        self.open: dict[int, Block] = {}
        self.complete: list[int] = []  # open blocks whose rows have all ended
        self.block_of = np.full(size, -1)
        self.row_of = np.zeros(size, np.int64)
        # consecutive rows go to different devices, so that a few rows use all devices
        self._order = np.arange(size).reshape(len(self.groups), spec.lanes).T.ravel()
        self.done = 0
        self.attempts = 0
        self.cycles = 0
        self._running_share = 0.0
        self._running_attempts = 0
        self._waiting = list(blocks)[::-1]
        self._newest: Block | None = None
        self.chunk_sizer = ChunkSizer(polls_per_chunk(spec))
        if spec.engine == "xla":
            self.chunk_sizer.polls = FIRST_POLLS
        # a thread for each device: JAX releases the GIL while it compiles or runs a program
        self._threads = ThreadPoolExecutor(len(self.groups)) if len(self.groups) > 1 else None
        # the values of all lanes: parameters, then initial conditions
        self._values: list[dict[str, np.ndarray]] = []

    def chunk(self, polls: int | None = None) -> ChunkOutput:
        """Advance the lanes of all devices by `polls`, by default the number that `chunk_sizer` chooses."""
        if polls is not None:
            return self._advanced(polls)
        polls, began = self.chunk_sizer.polls, self.chunk_sizer.begins()
        output = self._advanced(polls)
        self.chunk_sizer.ended(began, polls)
        return output

    def _advanced(self, polls: int) -> ChunkOutput:
        if self._threads is None:
            return self.groups[0].run_chunk(polls)
        outputs = list(self._threads.map(lambda lanes: lanes.run_chunk(polls), self.groups))
        # buffers of devices have different depths: a device returns only the records that it has filled
        depth = max(one.kept.shape[1] for one in outputs)
        outputs = [
            one._replace(kept=np.pad(one.kept, ((0, 0), (0, depth - one.kept.shape[1]), (0, 0))))
            for one in outputs
        ]
        return jax.tree.map(lambda *parts: np.concatenate(parts), *outputs)

    @property
    def busy(self) -> bool:
        return bool(np.any(self.block_of >= 0))

    def refill(self) -> None:
        """Put waiting rows into free lanes."""
        fresh = np.zeros(self.block_of.size, bool)
        free = self._order[self.block_of[self._order] < 0]
        while free.size or not self.groups:
            block = self._with_waiting_rows()
            if block is None:
                break
            rows = block.waiting[block.opened : block.opened + free.size]
            lanes, free = free[: rows.size], free[rows.size :]
            block.opened += rows.size
            self.block_of[lanes], self.row_of[lanes], fresh[lanes] = block.number, rows, True
            if not self._values:
                # idle lanes are computed too, with the values of the first row
                self._values = [
                    {name: np.repeat(column[:1], fresh.size, axis=0) for name, column in given.items()}
                    for given in (block.params, block.starts)
                ]
            for held, given in zip(self._values, (block.params, block.starts), strict=True):
                for name, column in held.items():
                    column[lanes] = given[name][rows]
        if fresh.any():
            for i, group in enumerate(self.groups):
                part = slice(i * group.size, (i + 1) * group.size)
                if fresh[part].any():
                    params, starts = ({k: v[part] for k, v in held.items()} for held in self._values)
                    group.fill(params, starts, fresh[part])

    def _with_waiting_rows(self) -> Block | None:
        """The newest block while it has waiting rows, then the next block."""
        while self._newest is None or self._newest.opened == self._newest.waiting.size:
            if not self._waiting:
                return None
            number = self._waiting.pop()
            self._newest = Block(self.spec, number, self._restored.pop(number, None))
            self.open[number] = self._newest
            # the earlier run was killed after its last row and before its part was written
            if self._newest.missing == 0:
                self.complete.append(number)
        return self._newest

    def collect(self, output: ChunkOutput) -> None:
        """Collect the output of a chunk."""
        record, _, t, attempts = output
        busy = self.block_of >= 0
        running = busy & (record.status == Status.running)
        ended = busy & ~running
        for number in np.unique(self.block_of[busy & (ended | (record.filled > 0))]):
            block, mine = self.open[number], self.block_of == number
            block.keep(self.row_of, output, np.flatnonzero(mine & (record.filled > 0)))
            block.end(self.row_of, output, np.flatnonzero(mine & ended))
            if block.missing == 0:
                self.complete.append(int(number))
        self.done += int(np.count_nonzero(ended))
        self.attempts += int(attempts[ended].sum())
        self.cycles += int(record.cycles[ended].sum())
        self.block_of[ended] = -1
        # the first rows that end are short ones, so running rows count in the estimate as well
        typical = self.cycles / self.done if self.done else 0.0
        if running.any() and self.done:
            typical = max(typical, float(np.mean(record.cycles[running])))
        self._running_share = float(np.sum(self.spec.recorder.share(record, t, typical)[running]))
        self._running_attempts = int(np.sum(attempts[running]))
        if self.spec.engine == "kernel":
            of_ended = self.attempts / self.done if self.done else 0.0
            of_running = float(np.mean(attempts[running])) if running.any() else 0.0
            self.chunk_sizer.choose(max(of_ended, of_running), int(record.filled.max(initial=0)))
        else:
            self.chunk_sizer.limit()

    def close(self, number: int) -> None:
        """Remove a block that is complete and written."""
        self.complete.remove(number)
        del self.open[number]

    @property
    def unstored(self) -> bool:
        """Whether an open block has ended rows that are not on disk."""
        return any(bool(np.any(block.ended & ~block.stored)) for block in self.open.values())

    def ended(self) -> list[EndedRows]:
        """The ended rows of open blocks that are not on disk, by block."""
        found = [block.unstored() for block in self.open.values()]
        return [rows for rows in found if len(rows["row"])]

    def mark_stored(self, ended: Sequence[EndedRows]) -> None:
        """Mark the rows that `ended` returned as stored on disk."""
        for rows in ended:
            self.open[int(rows["row"][0]) // self.spec.block].mark_stored(rows["row"])

    def progress(self, seconds: float) -> SweepProgress:
        share = (self.done + self._running_share) / self.total if self.total else 1.0
        return SweepProgress(self.done, self.total, share, self.attempts + self._running_attempts, seconds)
