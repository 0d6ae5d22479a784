"""Run kind `settle`: each row is followed until the state on its section stops moving, or repeats."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pandas as pd
from pydantic import Field, PlainValidator

from gaitsweep import near_miss
from gaitsweep.contract import HybridModel, Model
from gaitsweep.design import Design
from gaitsweep.engine.pushed_model import state_quantities
from gaitsweep.engine.recorders.bounds import TOLERANCE, tolerances
from gaitsweep.engine.recorders.recorder import Recorder
from gaitsweep.engine.recorders.settle import (
    CONFIRMED_FOR,
    FIRST_TEST,
    MAX_CYCLES,
    MAX_PERIOD,
    SettleRecorder,
)
from gaitsweep.engine.recorders.states import StateRecorder
from gaitsweep.engine.sweep.boundary_cells import Grid
from gaitsweep.engine.tangents import coordinate_count
from gaitsweep.kinds.columns import (
    GAIT,
    OUTCOME,
    SLOWEST,
    STALLED_BY,
    STATUS,
    Column,
    label_fields,
    observed_at_end,
    observed_on_orbits,
    states_at_end,
)
from gaitsweep.kinds.run_kind import Cost, RunKind, check_derivative
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.numbers import (
    WHOLE,
    Count,
    CountOrZero,
    Flag,
    InvalidValue,
    Positive,
    PositiveOrEach,
    Text,
    Word,
    checked,
    read_whole,
)
from gaitsweep.status import Status

MOST_COARSE = 1024  # cells a side
MOST_PERIOD = 64  # crossings of the longest orbits that may be asked for
OrbitPeriod = Annotated[int, PlainValidator(checked(read_whole, low=1, high=MOST_PERIOD)), WHOLE]
# Crossings after which an orbit settles at the earliest, in longest periods.
SETTLING_PERIODS = FIRST_TEST + CONFIRMED_FOR
# Mean share of the allowed cycles that a settling row takes; a chain of three modules takes 0.37.
LIKELY_SHARE = 0.4


def _power_of_two(value: Any) -> int:
    """Read a power of two from 2 to `MOST_COARSE`."""
    number = read_whole(value, low=2, high=MOST_COARSE)
    if number & (number - 1):
        below = 1 << (number.bit_length() - 1)
        raise InvalidValue(f"is {number}, but must be a power of two; did you mean {below} or {2 * below}?")
    return number


def tolerance_field(noun: str, default: float = TOLERANCE) -> Any:
    """The field with the tolerance on settled rows or stairs."""
    return Field(
        default=default,
        description=f"largest change per cycle of a settled {noun}: of angles in rad, of other observables "
        "as a fraction of their scale; one number for all, or numbers by observable (1e-3 for the others)",
    )


class SettlesRows(RunKind):
    """The base of run kinds that follow rows until they settle."""

    compared: ClassVar = "settled"
    one_a_row: ClassVar[bool] = True

    kind: Any = Field(init=False)  # first among the fields
    max_cycles: Count = Field(default=MAX_CYCLES, description="cycles after which a row is given up")
    tolerance: PositiveOrEach = tolerance_field("row")
    max_time: Positive | None = Field(
        default=None, description="simulated time after which a row is given up, in s"
    )
    max_period: OrbitPeriod | None = Field(
        default=None,
        description=f"crossings of the longest orbits that settle, at most {MOST_PERIOD}; by default "
        f"{MAX_PERIOD}. They settle after {SETTLING_PERIODS} times as many crossings at the earliest",
    )

    def settling(self, model: Model) -> SettleRecorder:
        """The recorder that settles a row."""
        longest, bounds = self.max_period or MAX_PERIOD, tolerances(model, self.tolerance)
        return SettleRecorder(model, self.max_cycles, bounds, self.max_time, longest)

    def columns_of_block(self, model: Model, block: RowOutcome) -> list[Column]:
        return observed_on_orbits(model, block)

    def rests(self, model: Model, records: pd.DataFrame) -> pd.DataFrame:
        period = records["attractor_period"].to_numpy()
        return pd.DataFrame(
            {
                "rests": (records["status"].astype(str) == Status.settled.name) & (period > 0),
                "crossing": records["cycles"],
                "period": np.maximum(period, 1),
                **{q.name: records[f"{q.name}_end"] for q in model.observables},
            }
        )

    def check_settling(self, model: Model) -> list[Diagnostic]:
        """Diagnostics about the fields with which rows settle."""
        wrong = check_tolerance(self.tolerance, model)
        if self.max_period and self.max_cycles < (needed := SETTLING_PERIODS * self.max_period):
            text = (
                f"is {self.max_period}, but orbits settle after {SETTLING_PERIODS} times as many crossings: "
                f"give a run.max_cycles of {needed} or more; it is {self.max_cycles}."
            )
            wrong.append(Diagnostic(("run", "max_period"), text))
        return wrong

    def likely_cycles(self, period: float) -> tuple[float, float]:
        """The likely and the largest number of cycles until a row settles."""
        cycles = float(self.max_cycles)
        if self.max_time is not None:
            cycles = min(cycles, self.max_time / period)
        return LIKELY_SHARE * cycles, cycles


class Settle(SettlesRows):
    """Follow each row until its state at the section stops changing or repeats; one record per row."""

    # without refinement every row runs, whatever the other two fields are; results are older than max_period
    idle_without: ClassVar = {
        "refine": ("refine", "over", "coarse"),
        "max_period": ("max_period",),
        "exponents": ("exponents",),
        "states": ("states",),
    }

    kind: Literal["settle"] = Field(
        init=False,
        description="settle: simulate until the state at the section stops changing, or repeats every 2 to "
        "`max_period` crossings",
    )
    exponents: CountOrZero = Field(
        default=0,
        description="Lyapunov exponents to compute, the largest first: columns lyapunov_1, ... (1/s) with "
        "standard errors; rows that do not settle may then end as chaotic or quasi_periodic, where "
        "`max_cycles` is 64 or more",
    )
    states: Flag = Field(
        default=False,
        description="whether the table has the state where each row settled, modes included, from which a "
        "run of kind perturb continues: columns state_...",
    )
    refine: Annotated[Literal["boundary"], Word()] | None = Field(
        default=None,
        description="boundary: simulate only the cells of a grid that border on another gait, and infer the "
        "others",
    )
    over: list[Text] | None = Field(
        default=None,
        min_length=1,
        description="axes to refine; by default all linspace and logspace axes of starts",
    )
    coarse: Annotated[int, PlainValidator(checked(_power_of_two)), WHOLE] = Field(
        default=8,
        description="spacing in cells of the first starts that refine simulates, a power of two; "
        "what is narrower may be missed",
    )

    def recorder(self, model: Model) -> Recorder:
        settling = dataclasses.replace(self.settling(model), exponents=self.exponents)
        if not (self.states and isinstance(model, HybridModel)):
            return settling
        return StateRecorder(model, settling, len(state_quantities(model)))

    def columns(self, model: Model) -> list[Column]:
        return [
            STATUS,
            Column("cycles"),
            Column("t_end", repeats=False),
            SLOWEST,
            STALLED_BY,
            *observed_at_end(model),
            GAIT,
            OUTCOME,
            Column("attractor_period", lambda records: records["period"]),
            *label_fields(model),
            *(states_at_end(model) if self.states and isinstance(model, HybridModel) else ()),
        ]

    def check(self, rows: Design, method: str) -> list[Diagnostic]:
        return [
            *self.check_settling(rows.model),
            *self._check_refinement(rows),
            *self._check_exponents(rows.model, method),
            *self._check_states(rows.model),
        ]

    def _check_states(self, model: Model) -> list[Diagnostic]:
        """Diagnostics about states of a model that moves in steps, which no other run continues."""
        if not self.states or (isinstance(model, HybridModel) and model.locates_events):
            return []
        text = f"is true, for a run of kind perturb, which {model.name} cannot have: it moves in steps."
        return [Diagnostic(("run", "states"), text)]

    def _check_exponents(self, model: Model, method: str) -> list[Diagnostic]:
        """Diagnostics about exponents of a map without a derivative, or more of them than it has."""
        wrong = check_derivative(model, method) if self.exponents else []
        if self.exponents and not wrong and self.exponents > (count := coordinate_count(model)):
            text = f"is {self.exponents}, but the section of {model.name} has {count} coordinates."
            wrong.append(Diagnostic(("run", "exponents"), text))
        return wrong

    def refined(self, rows: Design) -> Grid | None:
        if self.refine is None:
            return None
        return Grid(tuple(group.length for group in rows.groups), self._refined_axes(rows), self.coarse)

    def _refined_axes(self, rows: Design) -> dict[int, bool]:
        """The axes to refine, by their places in a grid, and whether each is closed."""
        starts = {quantity.name for quantity in rows.model.initial_conditions}
        wanted = starts if self.over is None else set(self.over)
        return {axis.place: axis.closed for name, axis in rows.grids.items() if name in wanted}

    def _check_refinement(self, rows: Design) -> list[Diagnostic]:
        """Diagnostics about refinement of axes that do not form a grid."""
        if self.refine is None:  # a stored job has the default of each field
            fields = type(self).model_fields
            written = [name for name in ("over", "coarse") if getattr(self, name) != fields[name].default]
            text = "has no effect without run.refine: give that too, or remove it."
            return [Diagnostic(("run", name), text) for name in written]
        grids, over = rows.grids, self.over or []
        wrong = []
        for index, name in enumerate(over):
            field = ("run", "over", index)
            if name in over[:index]:
                wrong.append(Diagnostic(field, f"is {name}, which is named twice."))
            elif name in rows.names and name not in grids:
                text = (
                    f"is {name}, whose points do not form a grid: only separate linspace and "
                    "logspace axes can be refined."
                )
                wrong.append(Diagnostic(field, text))
            elif name not in grids:
                near = near_miss.suggestion(name, grids) if grids else ": no axis of this job is a grid."
                wrong.append(Diagnostic(field, f"is {name}, which does not vary{near}"))
        if not wrong and not self._refined_axes(rows):
            text = "needs a grid: a linspace or logspace of a start under vary"
            others = f", or run.over with some of {', '.join(grids)}" if grids else ""
            wrong.append(Diagnostic(("run", "refine"), f"{text}{others}."))
        return wrong

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        likely, most = self.likely_cycles(period)
        return Cost(likely * cycle, most * cycle)


def check_tolerance(tolerance: float | Mapping[str, float], model: Model) -> list[Diagnostic]:
    """Diagnostics about tolerances of names that are not observables of the model."""
    if not isinstance(tolerance, Mapping):
        return []
    names = [quantity.name for quantity in model.observables]
    text = f"is not an observable of {model.name}"
    return [
        Diagnostic(("run", "tolerance", name), f"{text}{near_miss.suggestion(name, names)}")
        for name in tolerance
        if name not in names
    ]
