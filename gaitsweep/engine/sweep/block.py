"""The rows of one block: while they run, and when all of them are done."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from gaitsweep.engine.numerics import SHARE
from gaitsweep.engine.sweep.lane import ChunkOutput
from gaitsweep.engine.sweep.sweep_spec import SweepSpec


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


# Rows that have ended, as the engine gave them, in arrays by name: `row` (n,), the row's number in the table;
# what `BlockResult` has of each row, (n, ...); `kept` (n,), how many of the samples (sum of kept, width) are
# its own, in their order. So they are stored until their block is complete.
EndedRows = Mapping[str, np.ndarray]
_OF_ROWS = ("status", "cycles", "attempts", "t_end", "last", "period", "slowest", "fired")


class Block:
    """The rows of one block while they run.

    Outside the command line Ctrl-C may strike between any two statements. So a row's numbers are set before
    its `ended`, and `_samples` is replaced as a pair: whenever it strikes, a row is whole or not there.

    Args:
        spec: what is run.
        number: the block's.
        restored: rows of it that an earlier run ended.
    """

    def __init__(self, spec: SweepSpec, number: int, restored: EndedRows | None = None) -> None:
        self.number = number
        self.first = number * spec.block
        self.rows = min(spec.block, spec.n_rows - self.first)
        params, starts = spec.values(self.first, self.first + self.rows)
        self.starts = {SHARE: np.ones(self.rows), **starts}
        self.params = spec.model.on_host(params)
        self.opened = 0  # rows of `waiting` that have been put into lanes
        self.status = np.zeros(self.rows, np.int32)
        self.cycles = np.zeros(self.rows, np.int64)
        self.attempts = np.zeros(self.rows, np.int64)
        self.t_end = np.full(self.rows, np.nan)
        self.last = np.full((self.rows, len(spec.model.observables)), np.nan)
        self.period = np.zeros(self.rows, np.int8)
        self.slowest = np.full(self.rows, -1)
        self.fired = np.zeros((self.rows, 0), np.int64)
        self.ended = np.zeros(self.rows, bool)
        self.stored = np.zeros(self.rows, bool)  # and on disk, whether as part of a block or not
        self._width = spec.recorder.width
        # samples of rows that are stored, then all others: a list of rows (n,) and of numbers (n, width) each
        self._samples: tuple[list[_Samples], list[_Samples]] = ([], [])
        if restored is not None:
            mine = restored["row"] - self.first
            self._make_room(restored["fired"].shape[1])
            for name in _OF_ROWS:
                getattr(self, name)[mine] = restored[name]
            if len(restored["samples"]):
                self._samples[0].append((np.repeat(mine, restored["kept"]), restored["samples"]))
            self.ended[mine] = self.stored[mine] = True
        self.waiting = np.flatnonzero(~self.ended)  # rows that are to be run

    @property
    def missing(self) -> int:
        """Rows that have not ended."""
        return int(np.count_nonzero(~self.ended))

    def keep(self, rows: np.ndarray, output: ChunkOutput, lanes: np.ndarray) -> None:
        """Take what these lanes (n,) have kept; `rows` are those of all lanes."""
        if lanes.size:
            filled = output.record.filled[lanes]
            new = np.arange(output.kept.shape[1]) < filled[:, None]
            self._samples[1].append((np.repeat(rows[lanes], filled), output.kept[lanes][new]))

    def end(self, rows: np.ndarray, output: ChunkOutput, lanes: np.ndarray) -> None:
        """Take what the rows of these lanes (n,) have ended with."""
        mine, record = rows[lanes], output.record
        self.status[mine] = record.status[lanes]
        self.cycles[mine] = record.cycles[lanes]
        self.attempts[mine] = output.attempts[lanes]
        self.t_end[mine] = output.t[lanes]
        self.last[mine] = record.last[lanes]
        self.period[mine] = record.period[lanes]
        self.slowest[mine] = record.slowest[lanes]
        self._make_room(record.fired.shape[1])
        self.fired[mine] = record.fired[lanes]
        self.ended[mine] = True

    def _make_room(self, words: int) -> None:
        if not self.fired.size:  # only now is it known how many guards there are
            self.fired = np.zeros((self.rows, words), np.int64)

    def unstored(self) -> EndedRows:
        """The rows that have ended and are not on disk."""
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
        """Take it that these rows (n,), by their numbers in the table, are on disk."""
        stored = self.stored.copy()
        stored[rows - self.first] = True
        owner, samples = _in_order(self._samples[1], self._width)
        done = stored[owner]
        settled = [*self._samples[0], (owner[done], samples[done])]
        self.stored = stored  # first: a row that is not stored has its samples in the second list
        self._samples = settled, [(owner[~done], samples[~done])]

    def kept(self) -> tuple[np.ndarray, np.ndarray]:
        """What the recorder kept, in the order of rows: its row in the block (n,), its numbers (n, width)."""
        return _in_order([*self._samples[0], *self._samples[1]], self._width)

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


_Samples = tuple[np.ndarray, np.ndarray]


def _in_order(parts: Sequence[_Samples], width: int) -> _Samples:
    """Samples in the order of their rows; each row's stay in the order in which they came."""
    some = [part for part in parts if part[0].size]  # those of none have no type to go by
    if not some:
        return np.zeros(0, np.int64), np.zeros((0, width))
    owner = np.concatenate([part[0] for part in some])
    order = np.argsort(owner, kind="stable")
    return owner[order], np.concatenate([part[1] for part in some])[order]
