"""A group of lanes on one device: the rows in them, and the chunks of polls that advance these."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Real

from gaitsweep.engine.recorders.recorder import BUFFER, POLL_INTERVAL
from gaitsweep.engine.sweep.blocks_of_rows import Block, as_slice
from gaitsweep.engine.sweep.engine_choice import polls_per_chunk
from gaitsweep.engine.sweep.lane import ChunkOutput, Lanes
from gaitsweep.engine.sweep.sweep_spec import SweepSpec

# Longest duration of a chunk (s), so that progress is shown and Ctrl-C takes effect.
MAX_CHUNK = 0.25
# Weight of the newest chunk in the exponential averages of durations.
NEWEST_WEIGHT = 0.2
# If a buffer has more records than this after a chunk, the next one is shorter: a full one stops its row.
NEARLY_FULL = 0.75 * BUFFER
# The share of the waiting lanes that may start during a chunk.
STARTED_SHARE = 0.75
# The largest factor between the polls of two successive chunks.
GROWTH = 2.0
XLA_GROWTH = 4
# Longest duration of a chunk of XLA (s), whose chunks have `shortest` polls unless they take longer.
MAX_CHUNK_XLA = 1.0


class ChunkSizer:
    """Chooses the number of polls in a chunk that minimises idle time.

    A row that has ended waits for the end of its chunk, half a chunk on average; each return to the host
    costs the host's time. The sum is smallest for chunks that last sqrt(2 x host time x row time). If lanes
    wait to replace those that end, a chunk lasts until few are left. No result depends on the choice.

    Args:
        shortest: polls in the first chunks, and the minimum.
    """

    def __init__(self, shortest: int) -> None:
        self.shortest = shortest
        self.polls = shortest
        self._returned = math.nan
        self._host = math.nan  # s of the host's work between two chunks
        self._poll = math.nan  # s of a poll and the attempts before it

    def record_start(self) -> float:
        """Record the start of a chunk, and the host's work since the last one.

        Returns:
            The time of the start (s).
        """
        now = time.perf_counter()
        self._host = _smoothed(self._host, now - self._returned)
        return now

    def record_end(self, began: float, polls: int) -> None:
        """Record the end of a chunk.

        Args:
            began: the time of its start, from `record_start` (s).
            polls: its number of polls.
        """
        self._returned = time.perf_counter()
        self._poll = _smoothed(self._poll, (self._returned - began) / max(polls, 1))

    def choose(self, row_attempts: float, fullest: int, waiting: float = 0.0) -> None:
        """Set the number of polls in the next chunk.

        Args:
            row_attempts: estimated attempts of a row.
            fullest: records in the fullest buffer after the last chunk.
            waiting: lanes that wait, for each one that runs.
        """
        if math.isnan(self._host) or self._poll <= 0.0:
            return
        row_polls = row_attempts / POLL_INTERVAL
        least_idle = math.sqrt(2.0 * self._host / self._poll * row_polls)
        best = max(least_idle, STARTED_SHARE * waiting * row_polls)
        most = min(best, MAX_CHUNK / self._poll, GROWTH * self.polls)
        if fullest > NEARLY_FULL:
            most = min(most, 0.5 * self.polls)
        self.polls = max(self.shortest, int(most))

    def choose_for_xla(self) -> None:
        """Set the number of polls in XLA's next chunk: `shortest`, or what fits into `MAX_CHUNK_XLA`."""
        if self._poll > 0.0:
            fitting = int(MAX_CHUNK_XLA / self._poll)
            self.polls = max(1, min(self.shortest, fitting, XLA_GROWTH * self.polls))


def _smoothed(old: float, new: float) -> float:
    """The exponential average after a new value; the new value itself if the average is unknown."""
    if math.isnan(old) or math.isnan(new):
        return new
    return old + NEWEST_WEIGHT * (new - old)


# Polls in XLA's first chunk, from whose duration the number of polls in the others follows.
FIRST_POLLS = 4
# The block of a lane without a row.
IDLE = -1


class TimedChunk(NamedTuple):
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
        # the values of all lanes; empty before the first row
        self._params: dict[str, Real[np.ndarray, "lanes ..."]] = {}
        self._starts: dict[str, Real[np.ndarray, "lanes ..."]] = {}
        self._fresh = np.zeros(self.size, bool)
        self._occupied = 0  # lanes with a row

    @property
    def busy(self) -> bool:
        """Whether any lane has a row."""
        return self._occupied > 0

    def place(
        self, block: Block, rows: Int[np.ndarray, " placed"], lanes: Int[np.ndarray, " placed"]
    ) -> None:
        """Put rows into lanes; the next chunk opens them.

        Args:
            block: the block of the rows.
            rows: their numbers (n,) in the block.
            lanes: their lanes (n,) in this group.
        """
        to_lanes, from_rows = as_slice(lanes), as_slice(rows)
        self.block_of[to_lanes] = block.number
        self.row_of[to_lanes] = rows
        self._fresh[to_lanes] = True
        self._occupied += rows.size
        for of_lanes, of_rows in ((self._params, block.params), (self._starts, block.starts)):
            if not of_lanes:  # idle lanes are computed as well, with the values of the first row
                of_lanes |= {n: np.repeat(column[:1], self.size, axis=0) for n, column in of_rows.items()}
            for name, values in of_lanes.items():
                values[to_lanes] = of_rows[name][from_rows]

    def free(self, has_ended: Bool[np.ndarray, " lanes"]) -> None:
        """Take the rows out of the lanes of a mask (size,), all of which have one."""
        self.block_of[has_ended] = IDLE
        self._occupied -= int(np.count_nonzero(has_ended))

    def reopen_all(self) -> None:
        """Open the rows of all lanes again, as if none of them had begun."""
        self.lanes.fill(self._params, self._starts, np.ones(self.size, bool))

    def chunk(self, polls: int | None = None) -> TimedChunk:
        """Open fresh rows and advance all.

        Args:
            polls: the number of polls, by default that which the sizer chooses.
        """
        if self._fresh.any():
            self.lanes.fill(self._params, self._starts, self._fresh)
            self._fresh = np.zeros(self.size, bool)
        polls = self.sizer.polls if polls is None else polls
        began = self.sizer.record_start()
        output = self.lanes.run_chunk(polls)
        if polls:
            self.sizer.record_end(began, polls)
        return TimedChunk(output, began)
