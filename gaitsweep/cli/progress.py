"""Display of the progress of a run, a bar on a terminal and lines elsewhere, and requests to stop it."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.text import Text

from gaitsweep.compiling_threads import compiles_for, compiling_for
from gaitsweep.errors import EXIT_STOPPED, EXIT_TERMINATED, Terminated
from gaitsweep.runs.progress import COMPILING, percent, progress_lines
from gaitsweep.runs.progress import Progress as RunProgress

_BAR_STEPS = 1_000_000
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SHOWN_AFTER = 1.0  # s of a compilation from which it is shown
# Times (s) after a request to stop, from which this process does not wait for a compilation: while no row
# runs, and after rows were stopped and stored while another thread compiles.
_PATIENCE = 1.0
_PATIENCE_WHILE_STORING = 10.0


class _NoteBelow(Progress):
    """A bar with its note on a line below, which a narrow terminal cuts at its end.

    While the main thread compiles, the note says so, also before the first progress is reported.
    """

    def get_renderables(self) -> Iterator[RenderableType]:
        compiling = _compiling_note()
        yield self.make_tasks_table(self.tasks)
        for note in [compiling] if compiling else [task.description for task in self.tasks]:
            yield Text(note, style="dim", no_wrap=True, overflow="ellipsis")


def _compiling_note() -> str:
    """The note while the main thread compiles; empty if it does not, or has just begun."""
    main_thread = threading.main_thread().ident
    seconds = compiling_for(main_thread)
    if seconds is None or seconds <= _SHOWN_AFTER:
        return ""
    purpose = compiles_for(main_thread)
    return f"{COMPILING}{purpose and f' {purpose}'} for {seconds:.0f} s"


@contextlib.contextmanager
def shown_progress(unit: str = "rows", console: Console | None = None) -> Iterator[RunProgress]:
    """A context that shows progress on standard error, as a bar on a terminal and as lines elsewhere.

    The bar of a continued run starts where the last run stopped, and estimates the time left from there.

    Args:
        unit: the unit of the counts.
        console: another terminal.
    """
    if console is None and not sys.stderr.isatty():
        with _lines_while_compiling(progress_lines(unit)) as lines:
            yield lines
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
def _lines_while_compiling(lines: RunProgress) -> Iterator[RunProgress]:
    """A context with a callback as `lines`, which prints lines while the main thread compiles, too."""
    latest: tuple[int, int, float, float] = (0, 0, 0.0, 0.0)
    lock = threading.Lock()
    ended = threading.Event()

    def update(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        nonlocal latest
        with lock:
            latest = done, total, rate, fraction
            lines(*latest, note)

    def watch() -> None:
        while not ended.wait(1.0):
            with lock:
                if note := _compiling_note():
                    lines(*latest, note)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield update
    finally:
        ended.set()
        watcher.join()


class _StopRequest:
    """The first SIGINT or SIGTERM, which is raised where the run asks for it; a second one raises at once.

    An exception raised by the signal handler itself could hit a library's callback, which may suppress it.

    Args:
        exit_at_once: ends this process with an exit code; called in a thread after a request while a
            compilation, which nothing can interrupt, goes on. All files are written beside their place and
            renamed, so none is left half written.
    """

    def __init__(self, exit_at_once: Callable[[int], None] | None) -> None:
        self._exit_at_once = exit_at_once
        self._request: type[KeyboardInterrupt] | None = None
        self._code: int | None = None  # the exit code, once a signal was noticed
        self._raised_at: float | None = None
        self._ended = threading.Event()

    def raise_request(self) -> None:
        """Raise KeyboardInterrupt or Terminated if a stop was requested."""
        if self._request is not None:
            self._raised_at = self._raised_at or time.monotonic()
            raise self._request

    @contextlib.contextmanager
    def obeyed(self) -> Iterator[None]:
        """A context in which signals are recorded."""
        # only the main thread may handle signals; other threads keep Python's handlers
        main = threading.current_thread() is threading.main_thread()
        handlers = {number: signal.signal(number, self._record) for number in _SIGNALS} if main else {}
        watcher = threading.Thread(target=self._watch, daemon=True)
        try:
            with _signals_noticed(self._notice) if main else contextlib.nullcontext():
                watcher.start()
                yield
        finally:
            self._ended.set()
            for number, handler in handlers.items():
                signal.signal(number, handler)

    def _record(self, number: int, frame: FrameType | None) -> None:
        """Record a signal, as the handler of Python."""
        again = self._request is not None
        self._request = Terminated if number == signal.SIGTERM else KeyboardInterrupt
        if again:
            raise self._request

    def _notice(self, number: int) -> None:
        """Record the exit code of a signal, also before the handler of Python is called."""
        self._code = EXIT_TERMINATED if number == signal.SIGTERM else EXIT_STOPPED

    def _watch(self) -> None:
        """End the process if a compilation goes on for too long after a signal was noticed."""
        began: float | None = None
        main_ident = threading.main_thread().ident
        while not self._ended.wait(0.2):
            if self._code is None or self._exit_at_once is None:
                continue
            now = time.monotonic()
            began = began or now
            waits = now - began > _PATIENCE and compiling_for(main_ident) is not None
            stored = self._raised_at is not None and now - self._raised_at > _PATIENCE_WHILE_STORING
            if waits or (stored and compiling_for() is not None):
                self._exit_at_once(self._code)


@contextlib.contextmanager
def _signals_noticed(notice: Callable[[int], None]) -> Iterator[None]:
    """A context in which a thread calls `notice` with the number of each SIGINT and SIGTERM.

    A handler of Python waits until the main thread returns from compiled code, such as LLVM's.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)

    def read() -> None:
        while number := os.read(reader, 1):
            if number[0] in _SIGNALS:
                notice(number[0])

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(writer)
        thread.join()
        os.close(reader)


@contextlib.contextmanager
def stoppable_progress(unit: str = "rows", stopped: Callable[[], str] | None = None) -> Iterator[RunProgress]:
    """A context that shows the progress of a run in rows or sets, and stops the run at Ctrl-C.

    Args:
        unit: the unit of the counts.
        stopped: returns the sentence with which a run ends that is stopped while it compiles; None: such a
            run goes on until the compilation ends.
    """

    def exit_at_once(code: int) -> None:
        if sys.stderr.isatty():
            print("\033[?25h", end="", file=sys.stderr)  # the cursor, which a bar hides
        assert stopped is not None
        print(f"\n{stopped()}" if sys.stderr.isatty() else stopped(), file=sys.stderr, flush=True)
        os._exit(code)

    stop = _StopRequest(None if stopped is None else exit_at_once)
    with stop.obeyed(), shown_progress(unit) as shown:

        def on_progress(done: int, total: int, rate: float, fraction: float, note: str) -> None:
            stop.raise_request()
            shown(done, total, rate, fraction, note)

        yield on_progress
