"""Run kind `atlas`: all periodic gaits of each row, their branches along a parameter, and what joins them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
import pandas as pd
from jaxtyping import Int
from pydantic import Field

from gaitsweep import near_miss
from gaitsweep.analysis.atlas.atlas_tables import atlas_tables
from gaitsweep.analysis.atlas.branch import point_of
from gaitsweep.analysis.atlas.periodic_orbits import OrbitSearch, OrbitSearchOptions
from gaitsweep.column_meanings import time_column
from gaitsweep.contract import HybridModel, Model, Quantity
from gaitsweep.design import Design
from gaitsweep.engine.poincare.maps import MIN_SCALE, Points, Values
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.kinds.atlas_block import AtlasBlock, DrawnStarts
from gaitsweep.kinds.columns import Column, changing, observed_at_crossings
from gaitsweep.kinds.fixed_points import (
    LISTED,
    FollowsFixedPoints,
    MappedRows,
    bifurcations_found,
    starts_with,
    unknowns,
)
from gaitsweep.kinds.run_kind import BlockProgress, Cost, Movement
from gaitsweep.schema.diagnostics import Diagnostic, Path
from gaitsweep.schema.numbers import Count, CountOrZero, Real, Text

# For the estimate of a run's time: Newton steps of a search, branches, and points of a branch.
STEPS_OF_SEARCH, BRANCHES, POINTS = 8.0, 6.0, 60.0
# Directions of a derivative for a point of a curve in two parameters.
DERIVATIVES_A_POINT = 10.0
# Starts of the self-check.
CHECKED = 16
Range = Annotated[list[Real], Field(min_length=2, max_length=2)]


class Atlas(FollowsFixedPoints):
    """Find all periodic gaits, stable or not, and follow them and what they meet along one parameter."""

    programs: ClassVar = 10.0
    beside_observables: ClassVar = frozenset({"period"})
    point_names: ClassVar = ("number", "point")

    kind: Literal["atlas"] = Field(
        init=False,
        description="atlas: find all periodic gaits, stable and unstable, follow them along a parameter, and "
        "what they meet at bifurcations",
    )
    parameter: Text = Field(description="the model's parameter along which branches are followed")
    path: Range = Field(description="range of the parameter: [lowest, highest]")
    at: Real | None = Field(
        default=None,
        description="value of the parameter at which gaits are searched; by default the first of `path`",
    )
    ranges: dict[Text, Range] = Field(
        min_length=1,
        description="ranges from which the starts of the search are drawn: [lowest, highest] of start "
        "values, or of coordinates of the section",
    )
    second: dict[Text, Range] = Field(
        default={},
        max_length=1,
        description="a second parameter and its range, {name: [lowest, highest]}: bifurcations are followed "
        "in the plane of both",
    )
    periods: Count = Field(default=2, description="largest number of section crossings of a gait")
    depth: CountOrZero = Field(
        default=2, description="largest number of bifurcations between a branch and a gait that was found"
    )
    budget: Count = Field(default=1024, description="largest number of starts of the search")
    batch: Count = Field(default=64, description="starts in a round; the first round is also simulated")
    patience: Count = Field(default=3, description="rounds without a new gait after which the search ends")
    seed: CountOrZero = Field(default=0, description="seed of the starts")
    branches: Count = Field(default=200, description="largest number of branches")

    def columns(self, model: Model) -> list[Column]:
        times = {} if self.stationary else _event_times(model)
        of_search = ("found", "symmetry", "reached", "error", "missing", "corrections", "end", "status")
        columns = [
            *map(Column, ("part", "number", "period", "depth", "begins", "point")),
            *changing(self.parameter, *self.second),
            *observed_at_crossings(model),
            Column("gait"),
            *changing("time"),
            *self.drifts(model),
            *changing("multiplier", "multiplier_re", "multiplier_im"),
            *map(Column, ("unstable", "stable", "special")),
            *changing("coefficient"),
            *map(Column, (*of_search, "events", "change", "left_out", "drawn_starts")),
            *(Column(name, None, quantity, False) for name, quantity in times.items()),
            *changing("stored_point"),
        ]
        return self.own_columns(columns)

    @property
    def columns_of_findings(self) -> tuple[str, ...]:
        read = ("row", "part", "number", "period", "stable", "found", "missing", "left_out", "special", "end")
        return (self.parameter, *read, *self.second)

    def findings(self, table: pd.DataFrame) -> list[str]:
        branch = (table["part"] == "branch").to_numpy(bool)
        on_branches = table.iloc[np.flatnonzero(branch)]
        of_rows = table.drop_duplicates("row")
        sentences = [self._gaits_found(on_branches, of_rows), bifurcations_found(on_branches, self.parameter)]
        if left_out := np.sum(of_rows["left_out"].to_numpy(int)):
            were_not = "1 branch was" if left_out == 1 else f"{left_out} branches were"
            sentences.append(f"{were_not} not followed: run.branches is {self.branches}.")
        if stopped := np.count_nonzero(on_branches["end"].astype(str) == "most"):
            places = f"{stopped} place{'s' * (int(stopped) != 1)}"
            text = f"Branches ended at {places} after run.most, {self.most} points: raise it, or run.longest."
            sentences.append(text)
        curves = table.iloc[np.flatnonzero(~branch & (table["part"] != "").to_numpy(bool))]
        return [*sentences, *(self._curves_found(curves, second) for second in self.second)]

    def _gaits_found(self, on_branches: pd.DataFrame, of_rows: pd.DataFrame) -> str:
        """A sentence with the numbers of gaits by period, and an estimate of those that were not found."""
        gaits = on_branches.iloc[np.flatnonzero((on_branches["found"] >= 0).to_numpy(bool))]
        kind = "at rest" if self.stationary else "of period {}"
        counts = [
            f"{len(of_period)} {kind.format(period)}, {np.count_nonzero(of_period['stable'])} of them stable"
            for period, of_period in gaits.groupby("period")
        ]
        rows = f", in {len(of_rows)} rows" if len(of_rows) > 1 else ""
        text = f"At {self.parameter} = {self.place:g}{rows}: {'; '.join(counts) or 'no gait'}"
        missing = np.sum(of_rows["missing"].to_numpy(float))
        return f"{text}; the estimated number of others is {missing:.0f}." if missing >= 0.5 else f"{text}."

    def _curves_found(self, curves: pd.DataFrame, second: str) -> str:
        """A sentence with the numbers of curves over a second parameter, and the points marked on them."""
        orders = curves.iloc[np.flatnonzero(curves["part"].isin(["order_change", "corner"]).to_numpy(bool))]
        total, of_order = (part.groupby(["row", "number"]).ngroups for part in (curves, orders))
        text = f"{total - of_order} curve{'s' * (total - of_order != 1)} of bifurcations"
        text += f" and {of_order} of the order of events" if of_order else ""
        unnamed = np.isin(curves["special"].astype(str).to_numpy(str), ["", "nan", "kink"])
        points = curves.iloc[np.flatnonzero(~unnamed)]
        places = zip(points["special"], points[self.parameter], points[second], strict=True)
        named = [f"{str(kind).replace('_', ' ')} at ({x:.5g}, {y:.5g})" for kind, x, y in places]
        more = f" and {len(named) - LISTED} more" if len(named) > LISTED else ""
        listed = f": {'; '.join(named[:LISTED])}{more}" if named else ""
        return f"Over {self.parameter} and {second}: {text}{listed}."

    def tables(self, table: pd.DataFrame) -> dict[str, pd.DataFrame]:
        return atlas_tables(table, self.parameter)

    def wider(self) -> Atlas:
        """The run with twice the starts, patience and branches, one bifurcation deeper."""
        fields = {name: 2 * getattr(self, name) for name in ("budget", "patience", "branches")}
        return self.model_copy(update={**fields, "depth": self.depth + 1})

    @property
    def movements(self) -> tuple[Movement, ...]:
        paths = {name: ("run", "second", name) for name in self.second}
        second = (Movement(name, tuple(self.second[name]), path, path) for name, path in paths.items())
        return (*super().movements, *second)

    @property
    def place(self) -> float:
        """The value of the parameter at which gaits are searched."""
        return self.path[0] if self.at is None else self.at

    def check_ranges(self, rows: Design) -> list[Diagnostic]:
        return [*self._check_path(), *self._check_starts(rows), *self._check_second(rows)]

    def _check_path(self) -> Iterator[Diagnostic]:
        """Diagnostics of the range of the parameter, and of the value at which gaits are searched."""
        low, high = self.path
        if not low < high:
            yield Diagnostic(("run", "path", 1), f"is {high:g}, but must be above {low:g}.")
        elif not low <= self.place <= high:
            text = f"is {self.place:g}, but must lie in run.path, from {low:g} to {high:g}."
            yield Diagnostic(("run", "at"), text)

    def _check_starts(self, rows: Design) -> Iterator[Diagnostic]:
        """Diagnostics of the ranges from which starts are drawn."""
        chart = rows.model.chart()
        coordinates = () if chart is None else chart.coordinates
        names = [quantity.name for quantity in (*rows.model.initial_conditions, *coordinates)]
        for name, bounds in self.ranges.items():
            if name in names:
                yield from _falling(("run", "ranges", name), bounds)
            else:
                near = near_miss.suggestion(name, names)
                text = f"is no start value and no coordinate of {rows.model.name}{near}"
                yield Diagnostic(("run", "ranges", name), text)

    def _check_second(self, rows: Design) -> Iterator[Diagnostic]:
        """Diagnostics of the second parameter and its range."""
        for name, bounds in self.second.items():
            field = ("run", "second", name)
            if name == self.parameter:
                yield Diagnostic(field, "is run.parameter; name another parameter.")
            elif name in rows.derived:
                text = f"is a formula of other parameters here: {rows.derived[name]}; give a number."
                yield Diagnostic(field, text)
            else:
                yield from [*_falling(field, bounds)] or _beginning_outside(rows, field, bounds)

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        """Searches with all periods, and some branches; at most all starts and branches that are allowed."""
        slopes = 2.0 + 3.0 * unknowns(rows)
        search = STEPS_OF_SEARCH * slopes * cycle * self.periods * (self.periods + 1) / 2.0
        point = slopes * cycle * (DERIVATIVES_A_POINT if self.second else 1.0)
        points = min(BRANCHES, self.branches) * min(POINTS, self.most)
        starts = min(self.budget, (self.patience + 1) * self.batch)
        settling = self.settle * cycle * self.batch
        return Cost(
            likely=settling + starts * search + points * point,
            most=settling + self.budget * search + self.branches * self.most * point,
            records=points,
        )

    def near_fixed_points(self, mapped: MappedRows) -> tuple[Points, Values]:
        mapped = self.at_place(mapped)
        count = len(mapped.numbers)
        row_of_start = np.repeat(np.arange(count), CHECKED)
        starts = DrawnStarts(mapped, self.ranges, self.seed)
        drawn = starts.points(row_of_start, 0, CHECKED)
        search = OrbitSearch(mapped.mapping, mapped.values, starts.levels(self.fix), OrbitSearchOptions())
        search.add(drawn, row_of_start)
        first = [search.of_row(row)[:1] for row in range(count)]
        points = [
            orbits[0].points[[0]] if orbits else drawn[[row * CHECKED]] for row, orbits in enumerate(first)
        ]
        return Points.joined(points), mapped.values

    def at_place(self, mapped: MappedRows) -> MappedRows:
        """The rows at the value of the parameter at which gaits are searched.

        A coordinate whose range lies closer to 0 than `MIN_SCALE` is scaled by the largest size in its range.
        """
        sizes = {name.removesuffix("_0"): np.max(np.abs(bounds)) for name, bounds in self.ranges.items()}
        coordinates = mapped.mapping.coordinates
        sizes |= {quantity.name: MIN_SCALE for quantity in coordinates if quantity.circular}
        least = np.array([min(MIN_SCALE, sizes.get(quantity.name, MIN_SCALE)) for quantity in coordinates])
        mapped = dataclasses.replace(mapped, mapping=dataclasses.replace(mapped.mapping, least=least))
        mapped = mapped.with_values(**{self.parameter: np.full(len(mapped.numbers), self.place)})
        starts = starts_with(mapped.mapping, mapped.design, [self.parameter], mapped.starts, mapped.values)
        return dataclasses.replace(mapped, starts=starts)

    def block_table(
        self, rows: Design, spec: SweepSpec, first: int, last: int, on_progress: BlockProgress
    ) -> pd.DataFrame:
        """The atlas of rows first..last-1; `on_progress` is called before each of its steps."""
        return AtlasBlock(self, rows, spec, np.arange(first, last), on_progress).table()

    def followed_again(
        self,
        rows: Design,
        spec: SweepSpec,
        numbers: Int[np.ndarray, " sampled"],
        table: pd.DataFrame,
        on_progress: BlockProgress,
    ) -> tuple[MappedRows, pd.DataFrame]:
        mapped = self.at_place(self.mapped_rows(rows, spec, numbers))
        like = mapped.settled(0)[:1]
        places = dict(zip(numbers.tolist(), range(len(numbers)), strict=True))
        on_branches = (table["part"].astype(str) == "branch") & table["row"].isin(places)
        points = table.loc[on_branches & (table["stored_point"] != ""), [*self.point_names, self.parameter]]
        rows_of_points = table.loc[points.index, "row"].map(places)
        at = [point_of(text, like) for text in table.loc[points.index, "stored_point"]]
        stored = points.assign(row=rows_of_points, at=pd.Series(at, points.index, dtype=object))
        return mapped.without(self.parameter), stored.reset_index(drop=True)


def _falling(field: Path, bounds: Sequence[float]) -> Iterator[Diagnostic]:
    """A diagnostic of a range whose first number is not lower than its second."""
    low, high = bounds
    if not low < high:
        text = f"is from {low:g} to {high:g}, but the first number must be lower than the second."
        yield Diagnostic(field, text)


def _beginning_outside(rows: Design, field: Path, bounds: Sequence[float]) -> Iterator[Diagnostic]:
    """A diagnostic of rows that begin outside the range of the second parameter."""
    name = str(field[-1])
    low, high = bounds
    begins = rows.settings.get(name, low)  # names that vary or are unknown are reported elsewhere
    if not low <= float(begins) <= high:
        text = f"is from {low:g} to {high:g}, but {name} begins at {begins:g}: rows must begin within the "
        yield Diagnostic(field, f"{text}range.")


def _event_times(model: Model) -> dict[str, Quantity]:
    """The columns with the times of a model's events."""
    names = dict.fromkeys(model.guard_names) if isinstance(model, HybridModel) else ()
    meaning = "first time in the cycle: {}"
    return {time_column(name): Quantity(time_column(name), "s", meaning.format(name)) for name in names}
