"""The rows of one block, while they run and when all of them have ended."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from gaitsweep.engine.numerics import STEP_FACTOR
from gaitsweep.engine.sweep.lane import ChunkOutput
from gaitsweep.engine.sweep.sweep_spec import SweepSpec


@dataclasses.dataclass(frozen=True)
class BlockResult:
    """The results of one block, in the order of its rows.

    `first` is the number of the first row; `status`, `cycles`, `attempts`, `t_end` (n,); `last` (n,
    observables) the observables at the last crossing; `period`, `slowest` (n,) and `fired` (n, words) as in
    `Record`; `labels` the `gait` (an index, -1: no label) and the label fields, for each row or, for a
    staircase, for each record; `samples` (m, width) the records and `owner` (m,) the row of each.
    """

    first: int
    labels: dict[str, np.ndarray]
    owner: np.ndarray
    samples: np.ndarray
    status: np.ndarray
    cycles: np.ndarray
    attempts: np.ndarray
    t_end: np.ndarray
    last: np.ndarray
    period: np.ndarray
    slowest: np.ndarray
    fired: np.ndarray


# Rows that have ended, as arrays by name: `row` (n,), the number of the row in the table; the fields of
# `BlockResult` that have one entry a row, (n, ...); `kept` (n,), the number of samples of each row, whose
# `samples` (sum of kept, width) are in the order of the rows. They are stored until their block is complete.
EndedRows = Mapping[str, np.ndarray]
_OF_ROWS = ("status", "cycles", "attempts", "t_end", "last", "period", "slowest", "fired")
_RECORDED = [name for name in _OF_ROWS if name not in ("attempts", "t_end")]


class Block:
    """The rows of one block while they run.

    Outside the command line a KeyboardInterrupt may be raised between any two statements. So a row's values
    are set before its `ended`, and `_samples` is replaced as a pair: a row is always complete or absent.

    Args:
        spec: the sweep.
        number: the number of the block.
        restored: rows of the block that an earlier run has ended.
    """

    def __init__(self, spec: SweepSpec, number: int, restored: EndedRows | None = None) -> None:
        self.number = number
        self.first = number * spec.block
        self.rows = min(spec.block, spec.n_rows - self.first)
        params, starts = spec.values(self.first, self.first + self.rows)
        self.starts = {STEP_FACTOR: np.full(self.rows, spec.numerics.factor), **starts}
        self.params = spec.model.on_host(params)
        self.opened = 0  # rows of `waiting` that have a lane already
        self.status = np.zeros(self.rows, np.int32)
        self.cycles = np.zeros(self.rows, np.int64)
        self.attempts = np.zeros(self.rows, np.int64)
        self.t_end = np.full(self.rows, np.nan)
        self.last = np.full((self.rows, len(spec.model.observables)), np.nan)
        self.period = np.zeros(self.rows, np.int8)
        self.slowest = np.full(self.rows, -1)
        self.fired = np.zeros((self.rows, 0), np.int64)
        self.ended = np.zeros(self.rows, bool)
        self.stored = np.zeros(self.rows, bool)  # ended and on disk, in a part or in a file of open rows
        self._width = spec.recorder.width
        # samples of stored rows, then those of all other rows: lists of pairs (rows (n,), numbers (n, width))
        self._samples: tuple[list[_Samples], list[_Samples]] = ([], [])
        if restored is not None:
            mine = restored["row"] - self.first
            self._make_room(restored["fired"].shape[1])
            for name in _OF_ROWS:
                getattr(self, name)[mine] = restored[name]
            if len(restored["samples"]):
                self._samples[0].append((np.repeat(mine, restored["kept"]), restored["samples"]))
            self.ended[mine] = self.stored[mine] = True
        self.waiting = np.flatnonzero(~self.ended)  # rows that have to be run

    @property
    def missing(self) -> int:
        """Rows that have not ended."""
        return int(np.count_nonzero(~self.ended))

    def keep(self, rows: np.ndarray, output: ChunkOutput, lanes: np.ndarray) -> None:
        """Append the new records of the lanes `lanes` (n,); `rows` are the rows of all lanes."""
        if lanes.size:
            filled = output.record.filled[lanes]
            new = np.arange(output.kept.shape[1]) < filled[:, None]
            self._samples[1].append((np.repeat(rows[lanes], filled), output.kept[lanes][new]))

    def end(self, rows: np.ndarray, output: ChunkOutput, lanes: np.ndarray) -> None:
        """Store the final values of the rows in the lanes `lanes` (n,)."""
        mine, record = rows[lanes], output.record
        self._make_room(record.fired.shape[1])
        for name in _RECORDED:
            getattr(self, name)[mine] = getattr(record, name)[lanes]
        self.attempts[mine] = output.attempts[lanes]
        self.t_end[mine] = output.t[lanes]
        self.ended[mine] = True

    def _make_room(self, words: int) -> None:
        if not self.fired.size:  # the number of guards is known only now
            self.fired = np.zeros((self.rows, words), np.int64)

    def unstored(self) -> EndedRows:
        """The rows that have ended but are not on disk."""
        mine = np.flatnonzero(self.ended & ~self.stored)
        owner, samples = _in_order(self._samples[1], self._width)
        wanted = np.isin(owner, mine)
        return {
            "row": self.first + mine,
            **{name: getattr(self, name)[mine] for name in _OF_ROWS},
            "kept": np.bincount(owner[wanted], minlength=self.rows)[mine],
            "samples": samples[wanted],
        }

    def mark_stored(self, rows: np.ndarray) -> None:
        """Mark rows (n,), by their numbers in the table, as stored on disk."""
        stored = self.stored.copy()
        stored[rows - self.first] = True
        owner, samples = _in_order(self._samples[1], self._width)
        done = stored[owner]
        settled = [*self._samples[0], (owner[done], samples[done])]
        self.stored = stored  # first, since the samples of a row that is not stored are in the second list
        self._samples = settled, [(owner[~done], samples[~done])]

    def kept(self) -> tuple[np.ndarray, np.ndarray]:
        """All records in the order of their rows: the row in the block (n,), and its numbers (n, width)."""
        return _in_order([*self._samples[0], *self._samples[1]], self._width)

    def result(self, labels: dict[str, np.ndarray]) -> BlockResult:
        owner, samples = self.kept()
        ends = {name: getattr(self, name) for name in _OF_ROWS}
        return BlockResult(self.first, labels, owner + self.first, samples, **ends)


_Samples = tuple[np.ndarray, np.ndarray]


def _in_order(parts: Sequence[_Samples], width: int) -> _Samples:
    """Samples in the order of their rows; the samples of one row keep their order."""
    some = [part for part in parts if part[0].size]  # an empty part has no dtype
    if not some:
        return np.zeros(0, np.int64), np.zeros((0, width))
    owner = np.concatenate([part[0] for part in some])
    order = np.argsort(owner, kind="stable")
    return owner[order], np.concatenate([part[1] for part in some])[order]
