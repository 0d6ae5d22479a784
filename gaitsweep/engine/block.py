"""The rows of one block: while they run, and when all of them are done."""

from __future__ import annotations

import dataclasses

import numpy as np

from gaitsweep.engine.lane import Given
from gaitsweep.engine.numerics import SHARE
from gaitsweep.engine.work import Work


@dataclasses.dataclass(frozen=True)
class BlockResult:
    """One block's rows, in their order.

    `first` the first row's number; `status`, `cycles`, `attempts`, `t_end` (n,); `last` observables at the
    last crossing (n, observables); `period`, `slowest` (n,) and `fired` (n, words) as in `Record`; `labels`
    `gait` (an index, -1: not labelled) and the traits, for each row or, on stairs, for each sample; `owner`,
    `samples`: what the recorder kept, the row's number and the kept numbers, in order.
    """

    first: int
    status: np.ndarray
    cycles: np.ndarray
    attempts: np.ndarray
    t_end: np.ndarray
    last: np.ndarray
    period: np.ndarray
    slowest: np.ndarray
    fired: np.ndarray
    labels: dict[str, np.ndarray]
    owner: np.ndarray
    samples: np.ndarray


class Block:
    """The rows of one block while they run."""

    def __init__(self, work: Work, number: int) -> None:
        self.number = number
        self.first = number * work.block
        self.rows = min(work.block, work.n_rows - self.first)
        params, starts = work.values(self.first, self.first + self.rows)
        self.starts = {SHARE: np.ones(self.rows), **starts}
        self.params = work.model.on_host(params)
        self.opened = 0  # rows that have been put into lanes
        self.missing = self.rows  # rows that have not ended
        self.status = np.zeros(self.rows, np.int32)
        self.cycles = np.zeros(self.rows, np.int64)
        self.attempts = np.zeros(self.rows, np.int64)
        self.t_end = np.full(self.rows, np.nan)
        self.last = np.full((self.rows, len(work.model.observables)), np.nan)
        self.period = np.zeros(self.rows, np.int8)
        self.slowest = np.full(self.rows, -1)
        self.fired = np.zeros((self.rows, 0), np.int64)
        self._owners: list[np.ndarray] = []
        self._samples: list[np.ndarray] = []

    def keep(self, rows: np.ndarray, given: Given, lanes: np.ndarray) -> None:
        """Take what these lanes (n,) have kept; `rows` are those of all lanes."""
        if lanes.size:
            filled = given.record.filled[lanes]
            new = np.arange(given.kept.shape[1]) < filled[:, None]
            self._samples.append(given.kept[lanes][new])
            self._owners.append(np.repeat(rows[lanes], filled))

    def end(self, rows: np.ndarray, given: Given, lanes: np.ndarray) -> None:
        """Take what the rows of these lanes (n,) have ended with."""
        mine, record = rows[lanes], given.record
        self.status[mine] = record.status[lanes]
        self.cycles[mine] = record.cycles[lanes]
        self.attempts[mine] = given.attempts[lanes]
        self.t_end[mine] = given.t[lanes]
        self.last[mine] = record.last[lanes]
        self.period[mine] = record.period[lanes]
        self.slowest[mine] = record.slowest[lanes]
        if not self.fired.size:  # only now is it known how many guards there are
            self.fired = np.zeros((self.rows, record.fired.shape[1]), np.int64)
        self.fired[mine] = record.fired[lanes]
        self.missing -= lanes.size

    def kept(self) -> tuple[np.ndarray, np.ndarray]:
        """What the recorder kept, in the order of rows: its row in the block (n,), its numbers (n, width)."""
        owner = np.concatenate([np.zeros(0, np.int64), *self._owners])
        # a row's samples came in their order
        order = np.argsort(owner, kind="stable")
        return owner[order], np.concatenate(self._samples)[order] if self._samples else np.zeros((0, 0))

    def result(self, labels: dict[str, np.ndarray]) -> BlockResult:
        owner, samples = self.kept()
        return BlockResult(
            first=self.first,
            status=self.status,
            cycles=self.cycles,
            attempts=self.attempts,
            t_end=self.t_end,
            last=self.last,
            period=self.period,
            slowest=self.slowest,
            fired=self.fired,
            labels=labels,
            owner=owner + self.first,
            samples=samples,
        )
