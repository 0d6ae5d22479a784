"""Progress of a run: its callback, and lines for logs and notebooks, one every half minute."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import Protocol, TextIO

COMPILING = "compiling"  # the note until something is measured
INTERVAL = 30.0  # s between two lines
_ENOUGH = 0.01  # share done before a time left is printed: from the first few steps it would be a guess
_NAMES = 5  # of gaits in a remark


def so_far(counts: Mapping[str, int]) -> str:
    """Format the rows of finished blocks by gait or status: "; 60 rows so far: 31 source, 29 direct"."""
    rows = sum(counts.values())
    if not rows:
        return ""
    named = [f"{number} {name}" for name, number in counts.items()]
    if len(named) > _NAMES:
        named[_NAMES:] = ["..."]
    return f"; {rows} row{'s' * (rows != 1)} so far: {', '.join(named)}"


def steps_per_second(rate: float) -> str:
    """Format a number of steps a second: "2.4 million steps/s", "53 000 steps/s"."""
    if rate >= 1e6:
        return f"{rate / 1e6:.1f} million steps/s"
    rounded = float(f"{rate:.2g}")
    return f"{f'{rounded:,.0f}'.replace(',', ' ') if rounded >= 10 else f'{rounded:g}'} steps/s"


def percent(done: int, total: int, fraction: float) -> str:
    """Format the share done: "43 %", or "50 % of the work" where it differs from that of ended rows.

    Nothing is 100 % before its end.

    Args:
        done, total: rows that have ended, and in all.
        fraction: the share done; running rows count in part.
    """
    work = _whole_percent(fraction)
    rows = _whole_percent(done / max(total, 1))
    return f"{work} %" if work == rows else f"{work} % of the work"


def _whole_percent(share: float) -> int:
    """A share as a whole number of percent, 100 only where it is complete."""
    return 100 if share >= 1 else min(round(100 * share), 99)


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

    The time left counts from the first rise of the share, without compilation and the rows of an earlier run.

    Args:
        unit: what is counted.
        file: where the lines go, standard error by default.
        interval: least time between two lines, s, half a minute by default; the first comes after it.
    """
    interval = INTERVAL if interval is None else interval
    printed_at = time.monotonic()
    first_share: float | None = None  # at the first call
    rise: tuple[float, float] | None = None  # when the share first rose, and the share done then

    def update(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        nonlocal printed_at, rise, first_share
        now = time.monotonic()
        if first_share is None or fraction < first_share:  # the next of several runs
            first_share = fraction
            rise = None
        elif rise is None and fraction > first_share:
            rise = now, fraction
        if now - printed_at < interval:
            return
        printed_at = now
        parts = [f"{done}/{total} {unit}", percent(done, total, fraction)] if total else []
        if rate > 0:
            parts.append(f"{rate:.3g} {unit}/s")
        if rise is not None and rise[1] + _ENOUGH <= fraction < 1:
            since, share = rise
            parts.append(f"{(now - since) * (1 - fraction) / (fraction - share):.0f} s left")
        if note:
            parts.append(note)
        print(", ".join(parts), file=file or sys.stderr, flush=True)

    return update
