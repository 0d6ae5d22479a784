"""Kinds of figures: basins of attraction."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field

from gaitsweep.kinds.numbers import Stem, Text
from gaitsweep.plot.basins.basin import basin
from gaitsweep.plot.basins.basin_measures import basin_measures
from gaitsweep.plot.basins.gait_map import gait_map
from gaitsweep.plot.basins.shock import shock
from gaitsweep.plot.figure_kind import (
    HUE,
    NAME,
    TEXT_COLUMNS,
    TITLE,
    FigureKind,
    PlannedTable,
    Refusal,
)


class Basin(FigureKind):
    """Which gait each start leads to, over two varied quantities."""

    draw: ClassVar = staticmethod(basin)
    runs: ClassVar[tuple[str, ...]] = ("settle", "fixed_time")
    column_fields: ClassVar[tuple[str, ...]] = ("x", "y", "hue", "panels")
    axis_fields: ClassVar[tuple[str, ...]] = ("x", "y")
    kind: Literal["basin"] = Field(description="basin: the gait that each start leads to")
    x: Text = Field(description="column along the horizontal axis")
    y: Text = Field(description="column along the vertical axis")
    hue: Text = Field(default="gait", description=HUE)
    panels: Text | None = Field(default=None, description="column of which each value gets a panel")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        yield from _check_cells(self, table)


class GaitMap(FigureKind):
    """Which gaits are stable over two varied quantities, each from several starts."""

    draw: ClassVar = staticmethod(gait_map)
    runs: ClassVar[tuple[str, ...]] = ("settle", "fixed_time")
    column_fields: ClassVar[tuple[str, ...]] = ("x", "y", "hue")
    axis_fields: ClassVar[tuple[str, ...]] = ("x", "y")
    kind: Literal["gait_map"] = Field(description="gait_map: the gaits that several starts settle in")
    x: Text = Field(description="column along the horizontal axis")
    y: Text = Field(description="column along the vertical axis")
    hue: Text = Field(default="gait", description="column of the gait")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)


class BasinMeasures(FigureKind):
    """Shares of starts with intervals, entropies, and uncertain starts over their error."""

    draw: ClassVar = staticmethod(basin_measures)
    runs: ClassVar[tuple[str, ...]] = ("settle", "fixed_time")
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
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def columns(self) -> dict[str, str]:
        """The columns that it names, by field; `attractor` is worked out, and in no table."""
        named = {field: name for field, name in super().columns().items() if name != "attractor"}
        return named | {f"axes[{number}]": name for number, name in enumerate(self.axes or [])}

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        if self.panels == "attractor":
            yield ("panels",), "is attractor, which is worked out, and no column of this job's table."
        axes = self.axes
        if axes is None:
            axes = [name for name in table.varied if name != self.panels]
            if not axes:
                yield ("axes",), "is missing: besides panels nothing varies that could be the starts."
        for at, name in enumerate(axes):
            if name in TEXT_COLUMNS:
                yield ("axes", at), f"is {name}, which has no numbers: take what varies."
            elif name in axes[:at] or name == self.panels:
                yield ("axes", at), f"is {name}, which is named twice."
        units = {name: table.unit(name) for name in axes if name not in TEXT_COLUMNS}
        if len(set(units.values())) > 1:
            shown = ", ".join(f"{name} in {unit or '1'}" for name, unit in units.items())
            yield ("axes",), f"needs one unit for the distance between starts, but there are {shown}."
        if self.hue == "attractor" and table.run.refined(table.rows) is not None:
            yield ("hue",), "is attractor, but run.refine infers rows, which have no state to tell one by."


class Shock(FigureKind):
    """How far each start is from one that comes out otherwise, over two varied quantities."""

    draw: ClassVar = staticmethod(shock)
    runs: ClassVar[tuple[str, ...]] = ("settle", "fixed_time")
    column_fields: ClassVar[tuple[str, ...]] = ("x", "y", "hue", "panels")
    axis_fields: ClassVar[tuple[str, ...]] = ("x", "y")
    kind: Literal["shock"] = Field(
        description="shock: the smallest change of a start that changes its outcome"
    )
    x: Text = Field(description="column along the horizontal axis")
    y: Text = Field(description="column along the vertical axis, in the unit of x")
    hue: Text = Field(default="gait", description="column of what starts come to")
    panels: Text | None = Field(default=None, description="column of which each value gets a panel")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        units = {column: table.unit(column) for column in (self.x, self.y)}
        if not TEXT_COLUMNS & set(units) and len(set(units.values())) > 1:
            shown = " and ".join(f"{column} in {unit or '1'}" for column, unit in units.items())
            yield ("y",), f"is {self.y}, but a shock is a distance, which needs one unit: {shown}."
        else:
            yield from _check_cells(self, table)


def _check_cells(figure: Basin | Shock, table: PlannedTable) -> Iterator[Refusal]:
    """Why a figure of cells would have several rows in one cell."""
    if figure.x == figure.y or not {figure.x, figure.y} <= set(table.varied):
        return  # cells that only the table has
    if figure.panels not in (None, *table.varied):
        return
    shown = {figure.x, figure.y, figure.panels}
    others = [axis for axis in table.rows.axes if axis.length > 1 and not shown & set(axis.names)]
    if others and table.rows.in_cells(figure.x) and table.rows.in_cells(figure.y):
        name = others[0].names[0]
        field = "params" if name in [q.name for q in table.model.parameters] else "start"
        near = f"name it as panels, or fix its value under {field}"
        yield (
            ("panels",),
            f"leaves {name} out, which varies too: a cell of {figure.x} and {figure.y} would have "
            f"several rows; {near}.",
        )
