"""The kinds of figures of four-legged models whose gaits are the nine of `analysis.nine_gaits`."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from gaitsweep.job.figure_part import NAME, TITLE, FigurePart
from gaitsweep.kinds.numbers import Count, CountOrZero, Flag, Positive, Real, Stem, Text


class SpeedGaits(FigurePart):
    """Gaits over speed."""

    runs: ClassVar[tuple[str, ...]] = ("hold", "settle")
    column_fields: ClassVar[tuple[str, ...]] = ("y", "panels")
    observable_fields: ClassVar[tuple[str, ...]] = ("speed",)
    kind: Literal["speed_gaits"] = Field(description="speed_gaits: which gait at which speed")
    y: Text = Field(default="gait", description="column whose values are bands: gait, or a parameter")
    panels: Text | None = Field(default=None, description="column of which each value gets a panel")
    speed: Text = Field(default="speed", description="observable along the horizontal axis")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)


class GaitSeries(FigurePart):
    """Flexors, footfalls and pitch over time."""

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


class GaitRamp(FigurePart):
    """Gaits while a parameter rises and falls."""

    runs: ClassVar[tuple[str, ...]] = ("ramp", "trace")
    column_fields: ClassVar[tuple[str, ...]] = ("panels",)
    kind: Literal["gait_ramp"] = Field(description="gait_ramp: gaits while a parameter rises and falls")
    panels: Text | None = Field(default=None, description="column of which each value gets a panel")
    cycles: Count = Field(default=3, description="cycles that give one reading of the gait")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)


class NineGaits(FigurePart):
    """The 3 x 3 table of gaits with an example of each."""

    runs: ClassVar[tuple[str, ...]] = ("trace",)
    kind: Literal["nine_gaits"] = Field(
        description="nine_gaits: the 3 x 3 table of gaits, an example in each"
    )
    cycles: Positive = Field(default=2.5, description="cycles that an example shows")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)


class LoadingRule(FigurePart):
    """Shifts of diagonal pairs against loads and tilts."""

    runs: ClassVar[tuple[str, ...]] = ("hold", "settle", "trace")
    column_fields: ClassVar[tuple[str, ...]] = ("only",)
    kind: Literal["loading_rule"] = Field(
        description="loading_rule: shifts of diagonal pairs against loads and tilt in stance"
    )
    measures: list[Text] | None = Field(default=None, description="what is shown; all that the table tells")
    only: Text | None = Field(default=None, description="column of which one value is shown")
    value: Real | None = Field(default=None, description="that value")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)
