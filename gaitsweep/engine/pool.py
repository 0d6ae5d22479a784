"""Which lane runs which row: filling, collecting, and the blocks that are open."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from gaitsweep.contract import Status
from gaitsweep.engine.block import Block
from gaitsweep.engine.engines import lanes_on, looks_of
from gaitsweep.engine.lane import Given
from gaitsweep.engine.work import Progress, Work


class Pool:
    """Which lane runs which row, and the blocks that are open."""

    def __init__(self, work: Work, blocks: Sequence[int]) -> None:
        self.work = work
        self.groups = [lanes_on(device, work) for device in work.devices]
        size = work.lanes * len(self.groups)
        self.open: dict[int, Block] = {}
        self.block_of = np.full(size, -1)
        self.row_of = np.zeros(size, np.int64)
        # rows go to the devices in turn, so that few rows are shared among all of them
        self._order = np.arange(size).reshape(len(self.groups), work.lanes).T.ravel()
        self.total = sum(min(work.block, work.n_rows - b * work.block) for b in blocks)
        self.done = 0
        self.attempts = 0
        self.cycles = 0
        self._running_share = 0.0
        self._running_attempts = 0
        self._waiting = self._queue(blocks)
        # what the lanes run with: parameters, then starts
        self._values: list[dict[str, np.ndarray]] = []

    def _queue(self, blocks: Sequence[int]) -> Iterator[tuple[int, int]]:
        for number in blocks:
            self.open[number] = Block(self.work, number)
            yield from ((number, row) for row in range(self.open[number].rows))

    def chunk(self, looks: int | None = None) -> Given:
        """Advance the lanes of all devices at once."""
        looks = looks_of(self.work) if looks is None else looks
        if len(self.groups) == 1:
            return self.groups[0].run_chunk(looks)
        # a thread for each device: JAX lets go of Python while a program is compiled or runs
        with ThreadPoolExecutor(len(self.groups)) as threads:
            given = list(threads.map(lambda lanes: lanes.run_chunk(looks), self.groups))
        return jax.tree.map(lambda *parts: np.concatenate(parts), *given)

    @property
    def busy(self) -> bool:
        return bool(np.any(self.block_of >= 0))

    def refill(self) -> None:
        """Put waiting rows into free lanes."""
        fresh = np.zeros(self.block_of.size, bool)
        for lane in self._order[self.block_of[self._order] < 0]:
            following = next(self._waiting, None)
            if following is None:
                break
            number, row = following
            block = self.open[number]
            self.block_of[lane], self.row_of[lane], fresh[lane] = number, row, True
            if not self._values:
                # idle lanes are computed too: the first row's values are sound ones for them
                self._values = [
                    {name: np.repeat(column[row], fresh.size) for name, column in given.items()}
                    for given in (block.params, block.starts)
                ]
            for held, given in zip(self._values, (block.params, block.starts), strict=True):
                for name, column in held.items():
                    column[lane] = given[name][row]
        if fresh.any():
            for i, lanes in enumerate(self.groups):
                part = slice(i * lanes.size, (i + 1) * lanes.size)
                params, starts = ({k: v[part] for k, v in held.items()} for held in self._values)
                lanes.fill(params, starts, fresh[part])

    def collect(self, given: Given) -> list[int]:
        """Take what a chunk gave; the numbers of the blocks that it completed."""
        record, rows, t, attempts = given
        complete = []
        for lane in np.flatnonzero((self.block_of >= 0) & (record.filled > 0)):
            kept = np.array(rows[lane, : int(record.filled[lane])])
            self.open[self.block_of[lane]].kept.setdefault(int(self.row_of[lane]), []).append(kept)
        running = (self.block_of >= 0) & (record.status == Status.running)
        for lane in np.flatnonzero((self.block_of >= 0) & ~running):
            block, row = self.open[self.block_of[lane]], self.row_of[lane]
            block.status[row] = record.status[lane]
            block.cycles[row] = record.cycles[lane]
            block.attempts[row] = attempts[lane]
            block.t_end[row] = t[lane]
            block.last[row] = record.last[lane]
            block.missing -= 1
            self.done += 1
            self.attempts += int(attempts[lane])
            self.cycles += int(record.cycles[lane])
            if block.missing == 0:
                complete.append(int(self.block_of[lane]))
            self.block_of[lane] = -1
        # the first rows to end are the quick ones: those that still run say how long a row takes, too
        typical = self.cycles / self.done if self.done else 0.0
        if running.any() and self.done:
            typical = max(typical, float(np.mean(record.cycles[running])))
        self._running_share = float(np.sum(self.work.recorder.share(record, t, typical)[running]))
        self._running_attempts = int(np.sum(attempts[running]))
        return sorted(complete)

    def close(self, number: int) -> Block:
        return self.open.pop(number)

    def progress(self, seconds: float) -> Progress:
        share = (self.done + self._running_share) / self.total
        return Progress(self.done, self.total, share, self.attempts + self._running_attempts, seconds)
