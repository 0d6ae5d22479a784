"""The progress of a run on a terminal: a bar, the rate and the time left."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn

_WHOLE = 1_000_000  # steps of the bar


class ProgressBar:
    """A context manager with a progress bar on standard error, which is called to update it.

    A continued run starts its bar where the last one stopped, and estimates the time left from there.
    """

    def __init__(self, console: Console | None = None, unit: str = "rows") -> None:
        self._unit = unit
        self._progress = Progress(
            TextColumn(f"{{task.fields[rows]}} {unit}"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
            TextColumn("{task.description}"),
            console=console or Console(stderr=True),
            transient=True,
        )
        self._task: TaskID | None = None

    def __call__(self, done: int, total: int, rate: float, fraction: float, note: str) -> None:
        """Update the bar; `rate` is 0 while it is not known, and `fraction` counts rows under way in part."""
        rows = f"{done}/{total}"
        speed = f"{rate:.3g} {self._unit}/s" if rate > 0 else ""
        steps = round(fraction * _WHOLE)
        if self._task is None:
            # with its start value, the bar does not count an earlier run's progress in this one's speed
            self._task = self._progress.add_task(note, total=_WHOLE, completed=steps, rows=rows, rate=speed)
        self._progress.update(self._task, description=note, completed=steps, rows=rows, rate=speed)

    def __enter__(self) -> ProgressBar:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()
