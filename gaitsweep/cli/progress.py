"""Display of the progress of a run, a bar on a terminal and lines elsewhere, and requests to stop it."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.text import Text

from gaitsweep.errors import Terminated
from gaitsweep.runs.progress import Progress as RunProgress
from gaitsweep.runs.progress import percent, progress_lines

_BAR_STEPS = 1_000_000
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class _NoteBelow(Progress):
    """A bar with its note on a line below, which a narrow terminal cuts at its end."""

    def get_renderables(self) -> Iterator[RenderableType]:
        yield self.make_tasks_table(self.tasks)
        for task in self.tasks:
            yield Text(task.description, style="dim", no_wrap=True, overflow="ellipsis")


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
    with _NoteBelow(
        TextColumn(f"{{task.fields[rows]}} {unit}"),
        BarColumn(20),
        TextColumn("{task.fields[share]}"),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
        console=console or Console(stderr=True),
        transient=True,
    ) as shown:

        def update(done: int, total: int, rate: float, fraction: float, note: str) -> None:
            nonlocal task
            steps = round(fraction * _BAR_STEPS)
            fields: dict[str, Any] = {
                "rows": f"{done}/{total}",
                "share": percent(done, total, fraction),
                "rate": f"{rate:.3g} {unit}/s" if rate > 0 else "",
            }
            if task is None:
                # with its start value, the bar does not count an earlier run's progress in this one's speed
                task = shown.add_task(note, total=_BAR_STEPS, completed=steps, **fields)
            shown.update(task, description=note, completed=steps, **fields)

        yield update


@contextlib.contextmanager
def stop_requests() -> Iterator[Callable[[], None]]:
    """A context that records the first SIGINT or SIGTERM; a second one raises at once.

    Its value is a function that raises KeyboardInterrupt or Terminated if a stop was requested. An exception
    raised by the signal handler itself could hit a library's callback, which may suppress it.
    """
    request: type[KeyboardInterrupt] | None = None

    def raise_request() -> None:
        if request is not None:
            raise request

    def record(number: int, frame: FrameType | None) -> None:
        nonlocal request
        again = request is not None
        request = Terminated if number == signal.SIGTERM else KeyboardInterrupt
        if again:
            raise request

    # only the main thread may handle signals; other threads keep Python's handlers
    main = threading.current_thread() is threading.main_thread()
    handlers = {number: signal.signal(number, record) for number in _SIGNALS} if main else {}
    try:
        yield raise_request
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def stoppable_progress(unit: str = "rows") -> Iterator[RunProgress]:
    """A context that shows the progress of a run in rows or sets, and stops the run at Ctrl-C."""
    with stop_requests() as raise_request, shown_progress(unit) as shown:

        def on_progress(done: int, total: int, rate: float, fraction: float, note: str) -> None:
            raise_request()
            shown(done, total, rate, fraction, note)

        yield on_progress
