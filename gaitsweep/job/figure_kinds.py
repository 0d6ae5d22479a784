"""The kinds of figures that a job may ask for: their fields, and the columns and observables they name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from gaitsweep.job.branch_figures import Continuation, StableRanges
from gaitsweep.job.figure_part import NAME as _NAME
from gaitsweep.job.figure_part import TITLE as _TITLE
from gaitsweep.job.figure_part import FigurePart as _Figure
from gaitsweep.job.gait_figures import GaitRamp, GaitSeries, LoadingRule, NineGaits, SpeedGaits
from gaitsweep.job.multilegged_figures import DriftLaw, GaitShares
from gaitsweep.kinds.numbers import Flag, Positive, Real, Stem, Text, word
from gaitsweep.kinds.runs import Part

_HUE = "column that colours the points"
_BANDWIDTH = "half the window of the smoothing, in the unit of y; 0.05 rad for an angle if not given"


class Basin(_Figure):
    """Which gait each start leads to, over two varied quantities."""

    runs: ClassVar[tuple[str, ...]] = ("settle", "hold")
    column_fields: ClassVar[tuple[str, ...]] = ("x", "y", "hue", "panels")
    kind: Literal["basin"] = Field(description="basin: the gait that each start leads to")
    x: Text = Field(description="column along the horizontal axis")
    y: Text = Field(description="column along the vertical axis")
    hue: Text = Field(default="gait", description=_HUE)
    panels: Text | None = Field(default=None, description="column of which each value gets a panel")
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)


class SolutionSet(_Figure):
    """The settled states in three dimensions, the analytic solutions over them."""

    runs: ClassVar[tuple[str, ...]] = ("settle",)
    column_fields: ClassVar[tuple[str, ...]] = ("hue",)
    observable_fields: ClassVar[tuple[str, ...]] = ("axes",)
    kind: Literal["solution_set"] = Field(description="solution_set: settled states in three dimensions")
    axes: list[Text] = Field(min_length=3, max_length=3, description="three observables of the model")
    hue: Text = Field(default="gait", description=_HUE)
    theory: Flag = Field(default=True, description="whether the analytic solutions are drawn over it")
    points: dict[Text, Annotated[list[Real], Field(min_length=3, max_length=3)]] = Field(
        default_factory=dict, description="points to mark, by name, three numbers each"
    )
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)


class Cycles(_Figure):
    """Section observables against the number of the crossing."""

    runs: ClassVar[tuple[str, ...]] = ("return_map", "ramp")
    column_fields: ClassVar[tuple[str, ...]] = ("x", "hue")
    observable_fields: ClassVar[tuple[str, ...]] = ("y",)
    kind: Literal["cycles"] = Field(description="cycles: observables against crossings")
    y: list[Text] = Field(min_length=1, description="observables of the model, a panel each")
    x: Text = Field(default="crossing", description="column along the horizontal axis")
    hue: Text = Field(default="row", description=_HUE)
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)


class Footprints(_Figure):
    """Which leg is on the ground when."""

    runs: ClassVar[tuple[str, ...]] = ("trace",)
    column_fields: ClassVar[tuple[str, ...]] = ("panels",)
    kind: Literal["footprints"] = Field(description="footprints: which leg is on the ground when")
    panels: Text | None = Field(default="row", description="column of which each value gets a panel")
    titles: list[Text] | None = Field(default=None, description="titles of the panels, in order")
    guides: Flag = Field(
        default=True, description="whether swings of neighbouring legs that follow each other are joined"
    )
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)


class Hysteresis(_Figure):
    """An observable while a parameter rises and falls, the jumps on both ways marked."""

    runs: ClassVar[tuple[str, ...]] = ("ramp", "staircase")
    column_fields: ClassVar[tuple[str, ...]] = ("panels",)
    observable_fields: ClassVar[tuple[str, ...]] = ("y",)
    kind: Literal["hysteresis"] = Field(
        description="hysteresis: an observable as a parameter rises and falls"
    )
    y: Text = Field(description="observable of the model")
    parameter: Text | None = Field(
        default=None, description="the parameter that the run moves; it need not be said"
    )
    panels: Text | None = Field(default=None, description="column of which each value gets a panel")
    with_table: Text | None = Field(
        default=None, description="a second result directory to show beside, by its path or its job's name"
    )
    least: Positive = Field(default=0.15, description="change of y that counts as a jump, in its unit")
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)


class ReturnMaps(_Figure):
    """How an observable changes from one crossing to the next, with the fixed points."""

    runs: ClassVar[tuple[str, ...]] = ("return_map",)
    column_fields: ClassVar[tuple[str, ...]] = ("panels",)
    observable_fields: ClassVar[tuple[str, ...]] = ("y",)
    kind: Literal["return_map"] = Field(
        description="return_map: an observable's change from crossing to crossing"
    )
    y: Text = Field(description="observable of the model")
    panels: Text | None = Field(default=None, description="column of which each value gets a panel")
    form: Annotated[Literal["change", "next"], word("change", "next")] = Field(
        default="change", description="change: y's change over y; next: the next y over y"
    )
    bandwidth: Positive | None = Field(default=None, description=_BANDWIDTH)
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)


class Branches(_Figure):
    """The fixed points of return maps over a parameter."""

    runs: ClassVar[tuple[str, ...]] = ("return_map",)
    column_fields: ClassVar[tuple[str, ...]] = ("x",)
    observable_fields: ClassVar[tuple[str, ...]] = ("y",)
    kind: Literal["branches"] = Field(description="branches: fixed points of return maps over a parameter")
    x: Text = Field(description="column of the parameter, which varies")
    y: Text = Field(description="observable of the model")
    bandwidth: Positive | None = Field(default=None, description=_BANDWIDTH)
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)


class GaitMap(_Figure):
    """Which gaits are stable over two varied quantities, each from several starts."""

    runs: ClassVar[tuple[str, ...]] = ("settle", "hold")
    column_fields: ClassVar[tuple[str, ...]] = ("x", "y", "hue")
    kind: Literal["gait_map"] = Field(description="gait_map: the gaits that several starts settle in")
    x: Text = Field(description="column along the horizontal axis")
    y: Text = Field(description="column along the vertical axis")
    hue: Text = Field(default="gait", description="column of the gait")
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)


class BasinMeasures(_Figure):
    """Shares of starts with intervals, entropies, and uncertain starts over their error."""

    runs: ClassVar[tuple[str, ...]] = ("settle", "hold")
    column_fields: ClassVar[tuple[str, ...]] = ("hue", "panels")
    kind: Literal["basin_measures"] = Field(description="basin_measures: basins of attraction in numbers")
    axes: list[Text] | None = Field(
        default=None,
        min_length=1,
        description="columns of the starts; what varies besides panels if not given",
    )
    hue: Text = Field(
        default="gait", description="column of what starts come to; attractor groups the settled states"
    )
    panels: Text | None = Field(default=None, description="column of which each value is measured by itself")
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)

    def columns(self) -> dict[str, str]:
        """The columns that it names, by field; `attractor` is worked out, and in no table."""
        named = {field: name for field, name in super().columns().items() if name != "attractor"}
        return named | {f"axes[{number}]": name for number, name in enumerate(self.axes or [])}


class Shock(_Figure):
    """How far each start is from one that comes out otherwise, over two varied quantities."""

    runs: ClassVar[tuple[str, ...]] = ("settle", "hold")
    column_fields: ClassVar[tuple[str, ...]] = ("x", "y", "hue", "panels")
    kind: Literal["shock"] = Field(
        description="shock: the smallest change of a start that changes its outcome"
    )
    x: Text = Field(description="column along the horizontal axis")
    y: Text = Field(description="column along the vertical axis, in the unit of x")
    hue: Text = Field(default="gait", description="column of what starts come to")
    panels: Text | None = Field(default=None, description="column of which each value gets a panel")
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)


Figure = Annotated[
    Basin
    | SolutionSet
    | Cycles
    | Footprints
    | Hysteresis
    | ReturnMaps
    | Branches
    | Continuation
    | StableRanges
    | GaitMap
    | DriftLaw
    | GaitShares
    | BasinMeasures
    | Shock
    | SpeedGaits
    | GaitSeries
    | GaitRamp
    | NineGaits
    | LoadingRule,
    Field(discriminator="kind"),
]
FIGURES: Mapping[str, type[Part]] = MappingProxyType(
    {
        "basin": Basin,
        "solution_set": SolutionSet,
        "cycles": Cycles,
        "footprints": Footprints,
        "hysteresis": Hysteresis,
        "return_map": ReturnMaps,
        "branches": Branches,
        "continuation": Continuation,
        "stable_ranges": StableRanges,
        "gait_map": GaitMap,
        "drift_law": DriftLaw,
        "gait_shares": GaitShares,
        "basin_measures": BasinMeasures,
        "shock": Shock,
        "speed_gaits": SpeedGaits,
        "gait_series": GaitSeries,
        "gait_ramp": GaitRamp,
        "nine_gaits": NineGaits,
        "loading_rule": LoadingRule,
    }
)
