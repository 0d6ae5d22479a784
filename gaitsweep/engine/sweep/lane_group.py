"""A group of lanes on one device: the rows in them, and the chunks that advance these."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Int, Real

from gaitsweep.engine.sweep.blocks_of_rows import Block
from gaitsweep.engine.sweep.engines import polls_per_chunk
from gaitsweep.engine.sweep.lane import ChunkOutput, Lanes
from gaitsweep.engine.sweep.polls_per_chunk import ChunkSizer
from gaitsweep.engine.sweep.sweep_spec import SweepSpec

# Polls in XLA's first chunk, from whose duration the number of polls in the others follows.
FIRST_POLLS = 4
# The block of a lane without a row.
IDLE = -1


class Chunk(NamedTuple):
    """The output of a chunk, and the time at which it began (s)."""

    output: ChunkOutput
    began: float


class LaneGroup:
    """Some lanes of a device, the rows in them, and their progress.

    `block_of` is the number of each lane's block, `IDLE` without a row, and `row_of` the row in that block;
    `progress` and `attempts` are sums over the running rows, of the share of their work that is done and of
    their attempts.

    Args:
        lanes: the lanes.
        spec: the sweep.
    """

    def __init__(self, lanes: Lanes, spec: SweepSpec) -> None:
        self.lanes = lanes
        self.size = lanes.size
        self.block_of = np.full(self.size, IDLE)
        self.row_of = np.zeros(self.size, np.int64)
        self.progress = 0.0
        self.attempts = 0
        self.sizer = ChunkSizer(polls_per_chunk(spec))
        if spec.engine == "xla":
            self.sizer.polls = FIRST_POLLS
        # the values of all lanes: parameters, then initial conditions
        self._values: list[dict[str, Real[np.ndarray, "lanes ..."]]] = []
        self._fresh = np.zeros(self.size, bool)

    @property
    def busy(self) -> bool:
        """Whether any lane has a row."""
        return bool(np.any(self.block_of != IDLE))

    def place(
        self, block: Block, rows: Int[np.ndarray, " placed"], lanes: Int[np.ndarray, " placed"]
    ) -> None:
        """Put rows into lanes; the next chunk opens them.

        Args:
            block: the block of the rows.
            rows: their numbers (n,) in the block.
            lanes: their lanes (n,) in this group.
        """
        self.block_of[lanes] = block.number
        self.row_of[lanes] = rows
        self._fresh[lanes] = True
        columns: tuple[Mapping[str, Real[np.ndarray, "rows ..."]], ...] = (block.params, block.starts)
        if not self._values:
            self._values = [self._repeated(by_name) for by_name in columns]
        for lane_values, column_by_name in zip(self._values, columns, strict=True):
            for name, column in lane_values.items():
                column[lanes] = column_by_name[name][rows]

    def _repeated(
        self, columns: Mapping[str, Real[np.ndarray, "rows ..."]]
    ) -> dict[str, Real[np.ndarray, "lanes ..."]]:
        """The values of the first row in all lanes: idle lanes are computed as well."""
        return {name: np.repeat(column[:1], self.size, axis=0) for name, column in columns.items()}

    def reopen_all(self) -> None:
        """Open the rows of all lanes again, as if none of them had begun."""
        params, starts = self._values
        self.lanes.fill(params, starts, np.ones(self.size, bool))

    def chunk(self, polls: int | None = None) -> Chunk:
        """Open fresh rows and advance all.

        Args:
            polls: the number of polls, by default that which the sizer chooses.
        """
        if self._fresh.any():
            params, starts = self._values
            self.lanes.fill(params, starts, self._fresh)
            self._fresh = np.zeros(self.size, bool)
        polls = self.sizer.polls if polls is None else polls
        began = self.sizer.record_start()
        output = self.lanes.run_chunk(polls)
        if polls:
            self.sizer.record_end(began, polls)
        return Chunk(output, began)
