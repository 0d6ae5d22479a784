"""How long a kernel runs between two returns to the host."""

from __future__ import annotations

import math
import time

from gaitsweep.engine.recorders.recorder import BUFFER, POLL_INTERVAL

# A chunk is at most this long (s), so that progress moves and Ctrl-C is answered.
LONGEST = 0.25
# Of the seconds measured, the share of the newest chunk.
NEWEST = 0.2
# A buffer fuller than this after a chunk makes the next one shorter: a full one makes its row wait.
FULL = 0.75 * BUFFER
# As LONGEST, for XLA, whose chunks are as long as `shortest` allows unless they take longer than this (s).
LONGEST_XLA = 1.0


class ChunkSizer:
    """Looks of the recorder between two returns to the host, from what the returns cost.

    A row that has ended waits for its chunk's end, half a chunk on average; each return costs what the host
    then does. The sum is least where a chunk lasts sqrt(2 x host x row). No result depends on it.

    Args:
        shortest: polls of the first chunks, and the least.
    """

    def __init__(self, shortest: int) -> None:
        self.shortest = shortest
        self.polls = shortest
        self._returned = math.nan
        self._host = math.nan  # s that the host takes between two chunks
        self._poll = math.nan  # s that a poll takes with the attempts before it

    def begins(self) -> float:
        """A chunk begins: what passed since the last one was the host's. Gives the time."""
        now = time.perf_counter()
        self._host = _smoothed(self._host, now - self._returned)
        return now

    def ended(self, began: float, polls: int) -> None:
        """The chunk that began then has ended."""
        self._returned = time.perf_counter()
        self._poll = _smoothed(self._poll, (self._returned - began) / max(polls, 1))

    def choose(self, row_attempts: float, fullest: int) -> None:
        """Set the polls of the next chunk.

        Args:
            row_attempts: attempts that a row takes, as far as is known.
            fullest: rows in the fullest buffer after the last chunk.
        """
        if math.isnan(self._host) or self._poll <= 0.0:
            return
        best = math.sqrt(2.0 * self._host / self._poll * row_attempts / POLL_INTERVAL)
        most = min(best, LONGEST / self._poll, 2.0 * self.polls)
        if fullest > FULL:
            most = min(most, 0.5 * self.polls)
        self.polls = max(self.shortest, int(most))

    def limit(self) -> None:
        """Set the polls of XLA's next chunk: as many as it has, or as fit into `LONGEST_XLA`."""
        if self._poll > 0.0:
            self.polls = max(1, min(self.shortest, int(LONGEST_XLA / self._poll), 4 * self.polls))


def _smoothed(old: float, new: float) -> float:
    if math.isnan(old) or math.isnan(new):
        return new
    return old + NEWEST * (new - old)
