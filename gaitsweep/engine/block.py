"""The rows of one block: while they run, and when all of them are done."""

from __future__ import annotations

import dataclasses

import numpy as np

from gaitsweep.engine.work import Work


@dataclasses.dataclass(frozen=True)
class BlockResult:
    """One block's rows, in their order.

    `first` the first row's number; `status`, `cycles`, `attempts`, `t_end` (n,); `last` observables at the
    last crossing (n, observables); `labels` `gait` (an index, -1: not labelled) and the traits, (n,) each;
    `owner`, `samples`: what the recorder kept, the row's number and the kept numbers, in order.
    """

    first: int
    status: np.ndarray
    cycles: np.ndarray
    attempts: np.ndarray
    t_end: np.ndarray
    last: np.ndarray
    labels: dict[str, np.ndarray]
    owner: np.ndarray
    samples: np.ndarray


class Block:
    """The rows of one block while they run."""

    def __init__(self, work: Work, number: int) -> None:
        self.first = number * work.block
        self.rows = min(work.block, work.n_rows - self.first)
        self.params, self.starts = work.values(self.first, self.first + self.rows)
        self.missing = self.rows
        self.status = np.zeros(self.rows, np.int32)
        self.cycles = np.zeros(self.rows, np.int64)
        self.attempts = np.zeros(self.rows, np.int64)
        self.t_end = np.full(self.rows, np.nan)
        self.last = np.full((self.rows, len(work.model.observables)), np.nan)
        self.kept: dict[int, list[np.ndarray]] = {}

    def result(self, labels: dict[str, np.ndarray]) -> BlockResult:
        samples = [np.concatenate(self.kept[row]) for row in sorted(self.kept)]
        owner = [np.full(len(kept), row) for row, kept in zip(sorted(self.kept), samples, strict=True)]
        empty = np.zeros((0, 0))
        return BlockResult(
            first=self.first,
            status=self.status,
            cycles=self.cycles,
            attempts=self.attempts,
            t_end=self.t_end,
            last=self.last,
            labels=labels,
            owner=np.concatenate(owner) + self.first if owner else np.zeros(0, np.int64),
            samples=np.concatenate(samples) if samples else empty,
        )
