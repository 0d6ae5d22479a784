"""Kinds of figures: footfalls, and the nine gaits of four-legged models."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field

from gaitsweep import near_miss
from gaitsweep.kinds.diagnostics import found
from gaitsweep.kinds.numbers import Count, CountOrZero, Flag, Positive, Real, Stem, Text
from gaitsweep.kinds.trace import Trace
from gaitsweep.plot.figure_kind import (
    NAME,
    TEXT_COLUMNS,
    TITLE,
    FigureKind,
    PlannedTable,
    Refusal,
)
from gaitsweep.plot.gaits.footprints import footprints
from gaitsweep.plot.gaits.gait_ramp import gait_ramp
from gaitsweep.plot.gaits.gait_series import gait_series
from gaitsweep.plot.gaits.loading_rule import loading_rule
from gaitsweep.plot.gaits.nine_gaits import nine_gaits
from gaitsweep.plot.gaits.speed_gaits import speed_gaits

MEASURES = ("load_together", "load_late", "load_stance", "tilt_together", "tilt_late", "tilt_stance")
_LEGS = ("LF", "RF", "LH", "RH")


class Footprints(FigureKind):
    """Which leg is on the ground when."""

    draw: ClassVar = staticmethod(footprints)
    runs: ClassVar[tuple[str, ...]] = ("trace",)
    column_fields: ClassVar[tuple[str, ...]] = ("panels",)
    kind: Literal["footprints"] = Field(description="footprints: which leg is on the ground when")
    panels: Text | None = Field(default="row", description="column of which each value gets a panel")
    titles: list[Text] | None = Field(default=None, description="titles of the panels, in order")
    guides: Flag = Field(
        default=True, description="whether swings of neighbouring legs that follow each other are joined"
    )
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        if "contact_1" not in table.columns:
            yield self.needs(table, "the signals contact_1, contact_2, ...")


class SpeedGaits(FigureKind):
    """Gaits over speed."""

    draw: ClassVar = staticmethod(speed_gaits)
    runs: ClassVar[tuple[str, ...]] = ("fixed_time", "settle")
    column_fields: ClassVar[tuple[str, ...]] = ("y", "panels")
    observable_fields: ClassVar[tuple[str, ...]] = ("speed",)
    kind: Literal["speed_gaits"] = Field(description="speed_gaits: which gait at which speed")
    y: Text = Field(default="gait", description="column whose values are bands: gait, or a parameter")
    panels: Text | None = Field(default=None, description="column of which each value gets a panel")
    speed: Text = Field(default="speed", description="observable along the horizontal axis")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        yield from _check_gaits(self, table)
        if self.y != "gait" and self.y in TEXT_COLUMNS:
            yield ("y",), f"is {self.y}, which has no numbers: take gait, or what varies."


class GaitSeries(FigureKind):
    """Flexors, footfalls and pitch over time."""

    draw: ClassVar = staticmethod(gait_series)
    runs: ClassVar[tuple[str, ...]] = ("trace",)
    kind: Literal["gait_series"] = Field(description="gait_series: flexors, footfalls and pitch over time")
    row: CountOrZero | None = Field(default=None, description="the only row to show; all if not given")
    window: list[Real] | None = Field(
        default=None, min_length=2, max_length=2, description="begin and end of what is shown, in s"
    )
    strip: Positive | None = Field(
        default=None, description="length of a strip, in s; gaits are then named along time"
    )
    loads: Flag = Field(default=False, description="whether the loads on the feet are drawn too")
    titles: list[Text] | None = Field(default=None, description="titles of the strips, in order")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        needed = ["pitch", *(f"u_f_{leg}" for leg in _LEGS), *_contacts()]
        needed += [f"F_{leg}" for leg in _LEGS if self.loads]
        if (name := table.missing(needed)) is not None:
            yield self.needs(table, f"the signal {name}")
        if self.row is not None and self.row >= table.rows.n_rows:
            yield ("row",), f"is {self.row}, but the job has rows 0 to {table.rows.n_rows - 1}."
        if self.window is not None and not self.window[0] < self.window[1]:
            yield ("window",), f"is {found(self.window)}, but its begin comes before its end."
        if self.strip is not None and isinstance(table.run, Trace):
            strips = table.run.duration / self.strip
            if strips > 10_000 or math.isinf(strips):
                text = f"is {self.strip:g} s, which makes {strips:.3g} strips of {table.run.duration:g} s."
                yield ("strip",), text


class GaitRamp(FigureKind):
    """Gaits while a parameter rises and falls."""

    draw: ClassVar = staticmethod(gait_ramp)
    runs: ClassVar[tuple[str, ...]] = ("ramp", "trace")
    column_fields: ClassVar[tuple[str, ...]] = ("panels",)
    kind: Literal["gait_ramp"] = Field(description="gait_ramp: gaits while a parameter rises and falls")
    panels: Text | None = Field(default=None, description="column of which each value gets a panel")
    cycles: Count = Field(default=3, description="cycles that give one reading of the gait")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        if table.run.moved is None:
            text = "is gait_ramp, but this run moves nothing: name its run.parameter, with path and rate."
            yield ("kind",), text
        else:
            yield from _check_gaits(self, table)


class NineGaits(FigureKind):
    """The 3 x 3 table of gaits with an example of each."""

    draw: ClassVar = staticmethod(nine_gaits)
    runs: ClassVar[tuple[str, ...]] = ("trace",)
    kind: Literal["nine_gaits"] = Field(
        description="nine_gaits: the 3 x 3 table of gaits, an example in each"
    )
    cycles: Positive = Field(default=2.5, description="cycles that an example shows")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        needed = [*(f"u_f_{leg}" for leg in _LEGS), *_contacts()]
        if (name := table.missing(needed)) is not None:
            yield self.needs(table, f"the signal {name}")


class LoadingRule(FigureKind):
    """Shifts of diagonal pairs against loads and tilts."""

    draw: ClassVar = staticmethod(loading_rule)
    runs: ClassVar[tuple[str, ...]] = ("fixed_time", "settle", "trace")
    column_fields: ClassVar[tuple[str, ...]] = ("only",)
    kind: Literal["loading_rule"] = Field(
        description="loading_rule: shifts of diagonal pairs against loads and tilt in stance"
    )
    measures: list[Text] | None = Field(default=None, description="what is shown; all that the table tells")
    only: Text | None = Field(default=None, description="column of which one value is shown")
    value: Real | None = Field(default=None, description="that value")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        if not _has_swing_onsets(table):
            yield from _check_gaits(self, table)
            return
        settled = table.missing(["late_load_LF_end"]) is None
        traced = ["pitch", *(f"u_f_{leg}" for leg in _LEGS), *(f"F_{leg}" for leg in _LEGS)]
        if not settled and (name := table.missing(traced)) is not None:
            yield self.needs(table, f"the signal {name}, or loads where rows end")
        told = [name for name in MEASURES if not settled or not name.endswith("together")]
        for at, name in enumerate(self.measures or []):
            if name not in told:
                text = f"is {name}, which this job's table does not tell{near_miss.suggestion(name, told)}"
                yield ("measures", at), text
        if (self.only is None) != (self.value is None):
            field, other = ("only", "value") if self.only is None else ("value", "only")
            yield (field,), f"is missing, but {other} is given: they go together."
        elif self.only in TEXT_COLUMNS:
            yield ("only",), f"is {self.only}, which has no numbers: take what varies."


def _check_gaits(figure: FigureKind, table: PlannedTable) -> Iterator[Refusal]:
    """Why gaits cannot be read of a table."""
    if not _has_swing_onsets(table):
        what = "when each of four legs begins to swing (planar_quadruped tells it)"
        yield figure.needs(table, what)


def _has_swing_onsets(table: PlannedTable) -> bool:
    """Whether a table says when legs begin to swing, as `analysis.gait_tables` reads it."""
    averages = ("delta_1_mean", "delta_2_mean", "period", "variation", "antiphase", "length")
    return (
        table.missing([f"{name}_end" for name in averages]) is None
        or table.missing([f"since_{leg}_n" for leg in _LEGS]) is None
        or table.missing([f"u_f_{leg}" for leg in _LEGS]) is None
    )


def _contacts() -> list[str]:
    return [f"contact_{number}" for number in range(1, len(_LEGS) + 1)]
