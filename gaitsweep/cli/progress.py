"""The progress of a run: a bar on a terminal, a line every half minute elsewhere, with the time left."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn

_WHOLE = 1_000_000  # steps of the bar
INTERVAL = 30.0  # s between two lines
_ENOUGH = 0.01  # share done before a time left is told: of the first few steps it would be a guess

# Told what is done, the total, the rate (0 while it is not known), the share done (what is under way counts
# in part) and a remark.
Update = Callable[[int, int, float, float, str], None]


def progress_lines(unit: str = "rows", file: TextIO | None = None, interval: float = INTERVAL) -> Update:
    """The function that prints a line of progress now and then, for logs and notebooks.

    The rate and the time left are those since its first call: what an earlier run did is not counted.

    Args:
        unit: what is counted.
        file: where the lines go, standard error by default.
        interval: least time between two lines, s; the first comes after it.
    """
    last = time.monotonic()
    begun: tuple[float, float] | None = None  # when, and the share done then

    def update(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        nonlocal last, begun
        now = time.monotonic()
        if begun is None or fraction < begun[1]:  # the next of several runs
            begun = now, fraction
        if now - last < interval:
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


@contextlib.contextmanager
def shown_progress(unit: str = "rows", console: Console | None = None) -> Iterator[Update]:
    """A context with a bar on standard error where that is a terminal, with lines elsewhere.

    A continued run starts its bar where the last one stopped, and estimates the time left from there.

    Args:
        unit: what is counted.
        console: the terminal, if it is another.
    """
    if console is None and not sys.stderr.isatty():
        yield progress_lines(unit)
        return
    task: TaskID | None = None
    columns = BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[rate]}"), TimeRemainingColumn()
    with Progress(
        TextColumn(f"{{task.fields[rows]}} {unit}"),
        *columns,
        TextColumn("{task.description}"),
        console=console or Console(stderr=True),
        transient=True,
    ) as shown:

        def update(done: int, total: int, rate: float, fraction: float, note: str) -> None:
            nonlocal task
            rows, steps = f"{done}/{total}", round(fraction * _WHOLE)
            speed = f"{rate:.3g} {unit}/s" if rate > 0 else ""
            if task is None:
                # with its start value, the bar does not count an earlier run's progress in this one's speed
                task = shown.add_task(note, total=_WHOLE, completed=steps, rows=rows, rate=speed)
            shown.update(task, description=note, completed=steps, rows=rows, rate=speed)

        yield update
