"""The progress of a run: a bar on a terminal, a line every half minute elsewhere, with the time left."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn

_WHOLE = 1_000_000  # steps of the bar
INTERVAL = 30.0  # s between two lines


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


class ProgressLines:
    """A context manager that prints a line of progress now and then, for logs and notebooks.

    The rate and the time left are those since its first call: what an earlier run did is not counted.

    Args:
        unit: what is counted.
        file: where the lines go, standard error by default.
        interval: least time between two lines, s; the first comes after it.
    """

    def __init__(self, unit: str = "rows", file: TextIO | None = None, interval: float = INTERVAL) -> None:
        self._unit, self._file, self._interval = unit, file, interval
        self._last = time.monotonic()
        self._begun: tuple[float, float] | None = None  # when, and the share done then

    def __call__(self, done: int, total: int, rate: float, fraction: float, note: str) -> None:
        """Print a line if it is time; the arguments are those of `ProgressBar`."""
        now = time.monotonic()
        if self._begun is None or fraction < self._begun[1]:  # the next of several runs
            self._begun = now, fraction
        if now - self._last < self._interval:
            return
        self._last = now
        begun, share = self._begun
        parts = [f"{done}/{total} {self._unit}", f"{100 * fraction:.0f} %"]
        if rate > 0:
            parts.append(f"{rate:.3g} {self._unit}/s")
        if share < fraction < 1:
            parts.append(f"{(now - begun) * (1 - fraction) / (fraction - share):.0f} s left")
        print(", ".join([*parts, note] if note else parts), file=self._file or sys.stderr, flush=True)

    def __enter__(self) -> ProgressLines:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass


def shown_progress(unit: str = "rows") -> ProgressBar | ProgressLines:
    """The bar on a terminal, lines elsewhere."""
    return ProgressBar(unit=unit) if sys.stderr.isatty() else ProgressLines(unit)
