"""The progress of a run on a terminal: a bar, the rate and the time left."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn

_WHOLE = 1_000_000  # steps of the bar


@contextlib.contextmanager
def progress_bar(
    unit: str = "rows", console: Console | None = None
) -> Iterator[Callable[[int, int, float, float, str], None]]:
    """A context with a progress bar on standard error, where that is a terminal.

    Its value updates the bar, by what is done, the total, the rate (0 while it is not known), the share done
    (what is under way counts in part) and a remark. A continued run starts its bar where the last one
    stopped, and estimates the time left from there.
    """
    if console is None and not sys.stderr.isatty():
        yield lambda *_: None
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
