"""A group of lanes on one device: the rows in them, and the chunks of polls that advance these."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from gaitsweep.engine.recorders.recorder import BUFFER, POLL_INTERVAL, RunningRows
from gaitsweep.engine.sweep.blocks_of_rows import Block, BlockPart, Places, as_slice
from gaitsweep.engine.sweep.engine_choice import polls_per_chunk
from gaitsweep.engine.sweep.lane import ChunkOutput, Lanes
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.status import Status

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


_Numbers = Int[np.ndarray, " placed"]


class _Placed(NamedTuple):
    """Rows of a block, and their lanes."""

    block: Block
    rows: Places
    lanes: Places


class CollectedChunk(NamedTuple):
    """The results of a chunk.

    Attributes:
        began: the time at which it began (s).
        seconds: the time that the lanes ran (s).
        free: the lanes without a row.
        parts: the new samples and the ended rows of each block.
        ended: the number of ended rows.
        cycles, attempts: sums over the ended rows.
        running: the progress of the rows that go on.
        running_attempts: the attempts of these.
        fullest: the number of records in the fullest buffer.
    """

    began: float
    seconds: float
    free: Int[np.ndarray, " free"]
    parts: list[BlockPart]
    ended: int
    cycles: int
    attempts: int
    running: RunningRows
    running_attempts: Int[np.ndarray, " running"]
    fullest: int


class LaneGroup:
    """Some lanes of a device, the rows in them, and their progress.

    A chunk and the collection of its results run in a thread of the group, while other groups and the main
    loop continue. `free` are the lanes that the main loop may fill; `progress` and `attempts` are sums over
    the running rows, of the share of their work that is done and of their attempts.

    Args:
        lanes: the lanes.
        spec: the sweep.
    """

    def __init__(self, lanes: Lanes, spec: SweepSpec) -> None:
        self.lanes = lanes
        self.size = lanes.size
        self.free: Int[np.ndarray, " free"] = np.arange(self.size)
        self.progress = 0.0
        self.attempts = 0
        self.sizer = ChunkSizer(polls_per_chunk(spec))
        if spec.engine == "xla":
            self.sizer.polls = FIRST_POLLS
        self._most_samples = spec.most_samples
        # rows that the next chunk opens: their block, their numbers in it, their lanes
        self._fresh: list[tuple[Block, _Numbers, _Numbers]] = []
        # all rows in the lanes, or None once some of them have ended before others
        self._together: list[_Placed] | None = []
        self._block_of = np.full(self.size, IDLE)
        self._row_of = np.zeros(self.size, np.int64)

    @property
    def busy(self) -> bool:
        """Whether any lane has a row, or one that has ended and that the main loop has not taken yet."""
        return self.free.size < self.size

    def place(self, block: Block, rows: _Numbers) -> None:
        """Put rows (n,) of a block into the first free lanes; the next chunk opens them."""
        self._fresh.append((block, rows, self.free[: rows.size]))
        self.free = self.free[rows.size :]

    def chunk(self, polls: int | None = None) -> CollectedChunk:
        """Open fresh rows, advance all, and take those that have ended out of their lanes.

        Args:
            polls: the number of polls, by default that which the sizer chooses.
        """
        if self._fresh:
            self._open()
        polls = self.sizer.polls if polls is None else polls
        began = self.sizer.record_start()
        output = self.lanes.run_chunk(polls)
        seconds = time.perf_counter() - began
        if polls:
            self.sizer.record_end(began, polls)
        return self._collected(output, began, seconds)

    def _open(self) -> None:
        """Open the fresh rows."""
        fresh, self._fresh = self._fresh, []
        params: dict[str, list[np.ndarray]] = {}
        starts: dict[str, list[np.ndarray]] = {}
        for block, rows, lanes in fresh:
            placed = _Placed(block, as_slice(rows), as_slice(lanes))
            if self._together is not None:
                self._together.append(placed)
            self._block_of[placed.lanes] = block.number
            self._row_of[placed.lanes] = rows
            for columns, of_block in ((params, block.params), (starts, block.starts)):
                for name, values in of_block.items():
                    columns.setdefault(name, []).append(values[placed.rows])
        self.lanes.fill(
            {name: _joined(parts) for name, parts in params.items()},
            {name: _joined(parts) for name, parts in starts.items()},
            _joined([lanes for _, _, lanes in fresh]),
        )

    def _collected(self, output: ChunkOutput, began: float, seconds: float) -> CollectedChunk:
        """The results of a chunk, whose ended rows leave their lanes; the times are those of the results."""
        is_busy = self._block_of != IDLE
        is_running = is_busy & (output.numbers["status"] == Status.running)
        if self._most_samples is not None:
            is_running &= output.samples < self._most_samples
        running = np.flatnonzero(is_running)
        if running.size or self._together is None:
            has_ended = is_busy & ~is_running
            parts = self._parts(output, has_ended | (is_running & (output.filled > 0)), has_ended)
            if running.size and any(part.ended for part in parts):
                self._together = None
            self._block_of[has_ended] = IDLE
        else:  # short rows, whose numbers are moved in slices
            parts = [BlockPart.of(block.number, output, lanes, rows) for block, rows, lanes in self._together]
            self._block_of[:] = IDLE
        if not running.size:
            self._together = []
        cycles, attempts = output.numbers["cycles"], output.numbers["attempts"]
        times = output.numbers["t_end"]
        return CollectedChunk(
            began,
            seconds,
            np.flatnonzero(self._block_of == IDLE) if running.size else np.arange(self.size),
            parts,
            ended=sum(part.ended for part in parts),
            cycles=sum(int(part.numbers["cycles"].sum()) for part in parts),
            attempts=sum(int(part.numbers["attempts"].sum()) for part in parts),
            running=RunningRows(cycles[running], output.samples[running], times[running]),
            running_attempts=attempts[running],
            fullest=int(output.filled.max(initial=0)),
        )

    def _parts(
        self, output: ChunkOutput, changed: Bool[np.ndarray, " lanes"], has_ended: Bool[np.ndarray, " lanes"]
    ) -> list[BlockPart]:
        """The parts of a chunk's output by block, from masks of the lanes that changed and that ended."""
        lanes = np.flatnonzero(changed)
        number = self._block_of[lanes]
        if np.any(number[1:] < number[:-1]):
            lanes = lanes[np.argsort(number, kind="stable")]
            number = self._block_of[lanes]
        of_blocks = np.split(lanes, np.flatnonzero(number[1:] != number[:-1]) + 1) if lanes.size else ()
        return [
            BlockPart.of(int(self._block_of[lanes[0]]), output, lanes, self._row_of[lanes], has_ended[lanes])
            for lanes in of_blocks
        ]


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    """Arrays one after the other; a single one is not copied."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
