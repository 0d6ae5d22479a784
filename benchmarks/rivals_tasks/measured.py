"""Measurement of one library on one task, and the table of a task."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import math
import time
import warnings
from collections.abc import Callable, Iterable
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T")
Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Options:
    """The command's options.

    Attributes:
        rows: rows of a task; None: its own number.
        platform: cpu or cuda.
        repeats: timed calls, of which the fastest counts.
    """

    rows: list[int] | None
    platform: str
    repeats: int

    def rows_or(self, *own: int) -> list[int]:
        """The numbers of rows to measure."""
        return self.rows or list(own)


@dataclasses.dataclass(frozen=True)
class Line:
    """The result of one library.

    Attributes:
        name: of the library, with what it ran.
        cpu_s, clock_s: the time of the processor and of the clock (s); NaN if not measured.
        error: against the task's reference; NaN if not compared.
        note: what it cannot do, and other remarks.
    """

    name: str
    cpu_s: float = math.nan
    clock_s: float = math.nan
    error: float = math.nan
    note: str = ""


def print_lines(title: str, lines: Iterable[Line]) -> None:
    """Print the lines of a task as they come."""
    print(f"\n{title}\n{'CPU, s':>10s} {'clock, s':>10s} {'error':>9s}  library", flush=True)
    for line in lines:
        numbers = [f"{value:.3g}" if value == value else "-" for value in (line.cpu_s, line.clock_s)]
        error = f"{line.error:.1e}" if line.error == line.error else "-"
        note = f"\n{'':33s}{line.note}" if line.note else ""
        print(f"{numbers[0]:>10s} {numbers[1]:>10s} {error:>9s}  {line.name}{note}", flush=True)


def installed(name: str, module: str | None = None) -> Any:
    """A rival's module, or None if it is not installed.

    Args:
        name: of its distribution.
        module: of its import, if that has another name.
    """
    try:
        return import_module(module or name)
    except ImportError:
        return None


def missing(name: str) -> Line:
    """The line of a rival that is not installed."""
    return Line(name, note=f"not installed: pip install {name}")


def version_of(name: str) -> str:
    """A distribution's name and version."""
    return f"{name} {importlib.metadata.version(name)}"


def timed(work: Callable[[], T], repeats: int = 1) -> tuple[T, float, float]:
    """The result, CPU time (s) and time of the clock (s) of the call that took the processor least."""
    best: tuple[T, float, float] | None = None
    for _ in range(repeats):
        cpu, clock = time.process_time(), time.perf_counter()
        result = work()
        spent = time.process_time() - cpu, time.perf_counter() - clock
        if best is None or spent[0] < best[1]:
            best = result, *spent
    assert best is not None
    return best


def swept(model: Any, run: dict[str, Any], numerics: dict[str, Any], **values: Any) -> pd.DataFrame:
    """The table of a sweep by gaitsweep, without a self-check."""
    import gaitsweep as gs

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of starts on the surface of an event
        return gs.sweep(model, run=run, numerics=numerics, verify=0, **values).table
