"""The number of polls in a chunk, the work of the device between two returns to the host."""

from __future__ import annotations

import math
import time

from gaitsweep.engine.recorders.recorder import BUFFER, POLL_INTERVAL

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
