"""The specification of a sweep, and its progress."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Literal

from gaitsweep.contract import Model
from gaitsweep.engine.devices import Device
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.recorders.recorder import Recorder
from gaitsweep.engine.sweep.lane import RowDrive, Values

EngineName = Literal["xla", "kernel"]
RequestedEngine = Literal["auto", "xla", "kernel"]


@dataclasses.dataclass(frozen=True)
class SweepSpec:
    """The specification of a sweep: its rows and their model, recorder, numerics and engine.

    Attributes:
        model: the model of all rows.
        recorder: the recorder of all rows.
        numerics: the numerics of all rows.
        n_rows: the number of rows.
        block: the number of rows in a block.
        lanes: the number of lanes on each device.
        devices: the devices of the run.
        values: `values(first, last)` returns the parameters and the initial conditions of rows first..last-1,
            arrays of that length by name. The initial conditions may contain `STEP_FACTOR`, the factor on a
            row's step lengths.
        drive: the parameters at a time from a row's values, for ramps and staircases.
        engine: the engine that runs the rows.
        most_samples: a row also ends, without a status, once it has so many samples or more.
        quick: compile a kernel of a CPU quickly, to code of the same results that runs up to twice as long.
        varied: names of parameters that may differ between rows even where those of this sweep do not: sweeps
            that vary the same ones share a kernel of a GPU, whatever their rows are.
    """

    model: Model
    recorder: Recorder
    numerics: ResolvedNumerics
    n_rows: int
    block: int
    lanes: int
    devices: list[Device]
    values: Callable[[int, int], tuple[Values, Values]]
    drive: RowDrive | None = None
    engine: EngineName = "xla"
    most_samples: int | None = None
    quick: bool = False
    varied: frozenset[str] = frozenset()


@dataclasses.dataclass(frozen=True)
class SweepProgress:
    """The progress of a sweep.

    Attributes:
        done: rows that have ended.
        rows: all rows.
        share: the fraction of the work that is done, 0 to 1.
        attempts: attempts of all rows so far.
        seconds: time since the start (s).
        note: a remark.
    """

    done: int
    rows: int
    share: float
    attempts: int
    seconds: float
    note: str = ""

    @property
    def rate(self) -> float:
        """Rows per second; 0 until a row has ended, since the duration of rows is not known before."""
        if self.done == 0 or self.seconds <= 0.0:
            return 0.0
        return self.share * self.rows / self.seconds
