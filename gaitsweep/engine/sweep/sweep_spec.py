"""The specification of a sweep, and its progress."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from gaitsweep.contract import Model
from gaitsweep.engine.devices import Device
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.recorders.recorder import Recorder
from gaitsweep.engine.sweep.lane import RowDrive, Values


@dataclasses.dataclass(frozen=True)
class SweepSpec:
    """The specification of a sweep: its rows and their model, recorder, numerics and engine.

    Attributes:
        model, recorder, numerics: those of all rows.
        n_rows: the number of rows.
        block: the number of rows in a block.
        lanes: the number of lanes on each device.
        devices: the devices of the run.
        values: `values(first, last)` returns the parameters and the initial conditions of rows first..last-1,
            arrays of that length by name. The initial conditions may contain `STEP_FACTOR`, the factor on a
            row's step lengths.
        drive: the parameters at a time from a row's values, for ramps and staircases.
        engine: xla or kernel.
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
    engine: str = "xla"
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
        """Rows a second; 0 until a row has ended, since how long rows take is not known before."""
        return self.share * self.rows / self.seconds if self.done and self.seconds > 0 else 0.0
