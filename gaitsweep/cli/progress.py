"""Display of progress: a bar on a terminal, lines elsewhere."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn

from gaitsweep.runs.progress import Progress as RunProgress
from gaitsweep.runs.progress import progress_lines

_WHOLE = 1_000_000  # steps of the bar


@contextlib.contextmanager
def shown_progress(unit: str = "rows", console: Console | None = None) -> Iterator[RunProgress]:
    """A context that shows progress on standard error, as a bar on a terminal and as lines elsewhere.

    The bar of a continued run starts where the last run stopped, and estimates the time left from there.

    Args:
        unit: the unit of the counts.
        console: another terminal.
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
