"""Which lane runs which row: filling, collecting, and the blocks that are open."""

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
from gaitsweep.engine.sweep.sweep_spec import Progress, SweepSpec

# Looks of XLA's first chunk, from which the length of the others follows.
FIRST_POLLS = 4


class LaneScheduler:
    """Which lane runs which row, and the blocks that are open.

    Args:
        spec: what is run.
        blocks: the blocks whose rows are wanted.
        restored: gives the rows of a block that an earlier run ended, where there are any.
    """

    def __init__(
        self,
        spec: SweepSpec,
        blocks: Sequence[int],
        restored: Callable[[int], EndedRows | None] | None = None,
    ) -> None:
        self.spec = spec
        self._restored: dict[int, EndedRows] = {}
        for number in blocks:
            found = None if restored is None else restored(number)
            if found is not None:
                self._restored[number] = found
        self.total = sum(min(spec.block, spec.n_rows - b * spec.block) for b in blocks)
        self.total -= sum(len(rows["row"]) for rows in self._restored.values())
        # a device without rows would have nothing to run
        self.groups = [lanes_on(device, spec) for device in spec.devices[: self.total]]
        size = spec.lanes * len(self.groups)
        self.open: dict[int, Block] = {}
        self.complete: list[int] = []  # open blocks all of whose rows have ended
        self.block_of = np.full(size, -1)
        self.row_of = np.zeros(size, np.int64)
        # rows go to the devices in turn, so that few rows are shared among all of them
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
        # a thread for each device: JAX lets go of Python while a program is compiled or runs
        self._threads = ThreadPoolExecutor(len(self.groups)) if len(self.groups) > 1 else None
        # what the lanes run with: parameters, then starts
        self._values: list[dict[str, np.ndarray]] = []

    def chunk(self, polls: int | None = None) -> ChunkOutput:
        """Advance the lanes of all devices at once, by so many polls or as `chunk_sizer` has it."""
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
        # devices give as many rows of their buffers as they have filled
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
                # idle lanes are computed too: the first row's values are sound ones for them
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
        """The newest block while it has rows that wait, then the next one."""
        while self._newest is None or self._newest.opened == self._newest.waiting.size:
            if not self._waiting:
                return None
            number = self._waiting.pop()
            self._newest = Block(self.spec, number, self._restored.pop(number, None))
            self.open[number] = self._newest
            if self._newest.missing == 0:  # the run was killed between its last row and its part
                self.complete.append(number)
        return self._newest

    def collect(self, output: ChunkOutput) -> None:
        """Take what a chunk gave."""
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
        # the first rows to end are the quick ones: those that still run say how long a row takes, too
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
        """Forget a block that is complete and written."""
        self.complete.remove(number)
        del self.open[number]

    @property
    def unstored(self) -> bool:
        """Whether an open block has rows that have ended and are not on disk."""
        return any(bool(np.any(block.ended & ~block.stored)) for block in self.open.values())

    def ended(self) -> list[EndedRows]:
        """The rows of open blocks that have ended and are not on disk, by block."""
        found = [block.unstored() for block in self.open.values()]
        return [rows for rows in found if len(rows["row"])]

    def mark_stored(self, ended: Sequence[EndedRows]) -> None:
        """Take it that what `ended` gave is on disk."""
        for rows in ended:
            self.open[int(rows["row"][0]) // self.spec.block].mark_stored(rows["row"])

    def progress(self, seconds: float) -> Progress:
        share = (self.done + self._running_share) / self.total if self.total else 1.0
        return Progress(self.done, self.total, share, self.attempts + self._running_attempts, seconds)
