"""What a sweep is asked to do, and how far it has come."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from gaitsweep.contract import Model, Params
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recorder import Recorder
from gaitsweep.engine.sweep.xla import Device, Values


@dataclasses.dataclass(frozen=True)
class SweepSpec:
    """What is to be run: all rows, and how.

    `values(first, last)` gives the parameters and the starts of rows first..last-1, arrays of that length;
    `drive` the parameters at a time from a row's raw values, for ramps and staircases; `engine` is xla or
    kernel. Starts may have `SHARE` among them, by which a row's steps are shorter than the numerics say.
    """

    model: Model
    recorder: Recorder
    numerics: Numerics
    n_rows: int
    block: int
    lanes: int
    devices: list[Device]
    values: Callable[[int, int], tuple[Values, Values]]
    drive: Callable[..., Params] | None = None
    engine: str = "xla"


@dataclasses.dataclass(frozen=True)
class Progress:
    """Where a run stands: rows done, rows of this run, share done, attempts, seconds since the start."""

    done: int
    rows: int
    share: float
    attempts: int
    seconds: float
