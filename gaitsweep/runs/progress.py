"""Progress of a run: its callback, and lines for logs and notebooks, one every half minute."""

from __future__ import annotations

import sys
import time
from typing import Protocol, TextIO

INTERVAL = 30.0  # s between two lines
_ENOUGH = 0.01  # share done before a time left is printed: from the first few steps it would be a guess


class Progress(Protocol):
    """Callback that reports the progress of a run."""

    def __call__(self, done: int, total: int, rate: float, fraction: float, note: str, /) -> None:
        """Report progress.

        Args:
            done, total: rows done, and in all.
            rate: rows a second; 0 while it is not known.
            fraction: the share done; running rows count in part.
            note: a remark.
        """


def progress_lines(unit: str = "rows", file: TextIO | None = None, interval: float | None = None) -> Progress:
    """Progress callback that prints a line now and then, for logs and notebooks.

    The rate and the time left count from its first call, without the rows of an earlier run.

    Args:
        unit: what is counted.
        file: where the lines go, standard error by default.
        interval: least time between two lines, s, half a minute by default; the first comes after it.
    """
    apart = INTERVAL if interval is None else interval
    last = time.monotonic()
    begun: tuple[float, float] | None = None  # when, and the share done then

    def update(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        nonlocal last, begun
        now = time.monotonic()
        if begun is None or fraction < begun[1]:  # the next of several runs
            begun = now, fraction
        if now - last < apart:
            return
        last = now
        since, share = begun
        parts = [f"{done}/{total} {unit}", f"{100 * fraction:.0f} %"]
        if rate > 0:
            parts.append(f"{rate:.3g} {unit}/s")
        if share + _ENOUGH <= fraction < 1:
            parts.append(f"{(now - since) * (1 - fraction) / (fraction - share):.0f} s left")
        print(", ".join([*parts, note] if note else parts), file=file or sys.stderr, flush=True)

    return update
