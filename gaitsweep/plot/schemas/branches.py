"""Kinds of figures: return maps, their fixed points, and parameters that move."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from gaitsweep import near_miss
from gaitsweep.kinds.numbers import Positive, Real, Stem, Text, word
from gaitsweep.plot.branches.branches import branches
from gaitsweep.plot.branches.continuation import continuation
from gaitsweep.plot.branches.cycles import cycles
from gaitsweep.plot.branches.hysteresis import hysteresis
from gaitsweep.plot.branches.return_map import return_map
from gaitsweep.plot.branches.stable_ranges import stable_ranges
from gaitsweep.plot.figure_kind import (
    BANDWIDTH,
    HUE,
    NAME,
    TEXT_COLUMNS,
    TITLE,
    FigureKind,
    PlannedTable,
    Refusal,
)


class Cycles(FigureKind):
    """Section observables against the number of the crossing."""

    draw: ClassVar = staticmethod(cycles)
    runs: ClassVar[tuple[str, ...]] = ("return_map", "ramp")
    column_fields: ClassVar[tuple[str, ...]] = ("x", "hue")
    observable_fields: ClassVar[tuple[str, ...]] = ("y",)
    axis_fields: ClassVar[tuple[str, ...]] = ("x",)
    kind: Literal["cycles"] = Field(description="cycles: observables against crossings")
    y: list[Text] = Field(min_length=1, description="observables of the model, a panel each")
    x: Text = Field(default="crossing", description="column along the horizontal axis")
    hue: Text = Field(default="row", description=HUE)
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)


class Hysteresis(FigureKind):
    """An observable while a parameter rises and falls, the jumps on both ways marked."""

    draw: ClassVar = staticmethod(hysteresis)
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
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        if self.parameter not in (None, table.run.moved):
            yield ("parameter",), f"is {self.parameter}, but this run moves {table.run.moved}: leave it out."


class ReturnMaps(FigureKind):
    """How an observable changes from one crossing to the next, with the fixed points."""

    draw: ClassVar = staticmethod(return_map)
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
    bandwidth: Positive | None = Field(default=None, description=BANDWIDTH)
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)


class Branches(FigureKind):
    """The fixed points of return maps over a parameter."""

    draw: ClassVar = staticmethod(branches)
    runs: ClassVar[tuple[str, ...]] = ("return_map",)
    column_fields: ClassVar[tuple[str, ...]] = ("x",)
    observable_fields: ClassVar[tuple[str, ...]] = ("y",)
    axis_fields: ClassVar[tuple[str, ...]] = ("x",)
    kind: Literal["branches"] = Field(description="branches: fixed points of return maps over a parameter")
    x: Text = Field(description="column of the parameter, which varies")
    y: Text = Field(description="observable of the model")
    bandwidth: Positive | None = Field(default=None, description=BANDWIDTH)
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        if self.x not in table.varied and self.x not in TEXT_COLUMNS:
            yield ("x",), f"is {self.x}, which does not vary between rows. {near_miss.allowing(table.varied)}"


class Continuation(FigureKind):
    """Branches of steady gaits over a parameter, stable and unstable, with their folds."""

    draw: ClassVar = staticmethod(continuation)
    runs: ClassVar[tuple[str, ...]] = ("continuation",)
    column_fields: ClassVar[tuple[str, ...]] = ("hue",)
    observable_fields: ClassVar[tuple[str, ...]] = ("y",)
    kind: Literal["continuation"] = Field(
        description="continuation: branches of steady gaits, and their folds"
    )
    y: Text = Field(description="observable of the model")
    hue: Text | None = Field(
        default=None, description="column of another parameter, or of the gait, shown by colour"
    )
    intervals: dict[Text, Annotated[list[Real], Field(min_length=2, max_length=2)]] = Field(
        default_factory=dict, description="ranges of the parameter to show beside, by name, two numbers each"
    )
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)


class StableRanges(FigureKind):
    """Where each gait is stable along the parameter, over another that differs between branches."""

    draw: ClassVar = staticmethod(stable_ranges)
    runs: ClassVar[tuple[str, ...]] = ("continuation",)
    column_fields: ClassVar[tuple[str, ...]] = ("y", "hue")
    axis_fields: ClassVar[tuple[str, ...]] = ("y",)
    kind: Literal["stable_ranges"] = Field(
        description="stable_ranges: where gaits are stable, over two parameters"
    )
    y: Text = Field(description="column of the parameter that differs between branches")
    hue: Text = Field(default="gait", description="column of the gait")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)
