"""How long a kernel runs between two returns to the host."""

from __future__ import annotations

import math
import time

from gaitsweep.engine.recorders.recorder import BUFFER, CADENCE

# A chunk is at most this long (s), so that progress moves and Ctrl-C is answered.
LONGEST = 0.25
# Of the seconds measured, the share of the newest chunk.
NEWEST = 0.2
# A buffer fuller than this after a chunk makes the next one shorter: a full one makes its row wait.
FULL = 0.75 * BUFFER
# As LONGEST, for XLA, whose chunks are as long as `shortest` allows unless they take longer than this (s).
LONGEST_XLA = 1.0


class Pace:
    """Looks of the recorder between two returns to the host, from what the returns cost.

    A row that has ended waits for its chunk's end, half a chunk on average; each return costs what the host
    then does. The sum is least where a chunk lasts sqrt(2 x host x row). No result depends on it.

    Args:
        shortest: looks of the first chunks, and the least.
    """

    def __init__(self, shortest: int) -> None:
        self.shortest = shortest
        self.looks = shortest
        self._returned = math.nan
        self._host = math.nan  # s that the host takes between two chunks
        self._look = math.nan  # s that a look takes with the attempts before it

    def begins(self) -> float:
        """A chunk begins: what passed since the last one was the host's. Gives the time."""
        now = time.perf_counter()
        self._host = _smoothed(self._host, now - self._returned)
        return now

    def ended(self, began: float, looks: int) -> None:
        """The chunk that began then has ended."""
        self._returned = time.perf_counter()
        self._look = _smoothed(self._look, (self._returned - began) / max(looks, 1))

    def choose(self, row_attempts: float, fullest: int) -> None:
        """Set the looks of the next chunk.

        Args:
            row_attempts: attempts that a row takes, as far as is known.
            fullest: rows in the fullest buffer after the last chunk.
        """
        if math.isnan(self._host) or self._look <= 0.0:
            return
        best = math.sqrt(2.0 * self._host / self._look * row_attempts / CADENCE)
        most = min(best, LONGEST / self._look, 2.0 * self.looks)
        if fullest > FULL:
            most = min(most, 0.5 * self.looks)
        self.looks = max(self.shortest, int(most))

    def limit(self) -> None:
        """Set the looks of XLA's next chunk: as many as it has, or as fit into `LONGEST_XLA`."""
        if self._look > 0.0:
            self.looks = max(1, min(self.shortest, int(LONGEST_XLA / self._look), 4 * self.looks))


def _smoothed(old: float, new: float) -> float:
    if math.isnan(old) or math.isnan(new):
        return new
    return old + NEWEST * (new - old)
