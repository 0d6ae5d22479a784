"""Run kind `atlas`: all periodic gaits of each row, their branches along a parameter, and what joins them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from pydantic import Field, PrivateAttr

from gaitsweep import near_miss
from gaitsweep.analysis.atlas.atlas import BranchAtlas
from gaitsweep.analysis.atlas.atlas_tables import atlas_tables
from gaitsweep.analysis.atlas.periodic_orbits import (
    Orbit,
    OrbitSearch,
    SearchOptions,
    orbits_of,
    rows_of,
)
from gaitsweep.analysis.atlas.stored_points import points_of
from gaitsweep.contract import HybridModel, Model, Quantity
from gaitsweep.design import Design
from gaitsweep.engine.poincare.maps import Points, Values
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.kinds.columns import Column, observed_at_crossings
from gaitsweep.kinds.fixed_points import (
    LISTED,
    FollowsFixedPoints,
    MappedRows,
    beginning_within,
    bifurcations_found,
    rising,
    unknowns,
)
from gaitsweep.kinds.run_kind import BlockProgress, Cost
from gaitsweep.run_columns import time_column
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.numbers import Count, CountOrZero, Real, Text
from gaitsweep.table import load

# Newton steps of a search, and points of a branch with their derivatives, for the estimate of a run's time.
STEPS_OF_SEARCH, BRANCHES, POINTS = 8.0, 6.0, 60.0
# Directions of a derivative for a point of a curve in two parameters.
DERIVATIVES_A_POINT = 10.0
# Starts of the self-check.
CHECKED = 16
Rows = Int[np.ndarray, " rows"]
Range = Annotated[list[Real], Field(min_length=2, max_length=2)]


class Atlas(FollowsFixedPoints):
    """Find all periodic gaits, stable or not, and follow them and what they meet along one parameter."""

    programs: ClassVar = 10.0
    beside_observables: ClassVar = frozenset({"period"})
    idle_without: ClassVar = {"after": ("after",), **FollowsFixedPoints.idle_without}
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
    after: Text | None = Field(
        default=None,
        description="result directory of an atlas that this one continues: what it found is not searched or "
        "followed again (`gaitsweep atlas DIR --more` sets it)",
    )
    _before: pd.DataFrame | None = PrivateAttr(None)  # the table to continue, where it is in memory

    def columns(self, model: Model) -> list[Column]:
        times = {} if self.stationary else _event_times(model)
        columns = [
            Column("part"),
            *map(Column, ("number", "period", "depth", "begins", "point")),
            *(Column(name, repeats=False) for name in (self.parameter, *self.second)),
            *observed_at_crossings(model),
            Column("gait"),
            Column("time", repeats=False),
            *(Column(f"drift_{name}", repeats=False) for name in self.fix),
            *(Column(name, repeats=False) for name in ("multiplier", "multiplier_re", "multiplier_im")),
            *map(Column, ("unstable", "stable", "special")),
            Column("coefficient", repeats=False),
            *map(
                Column, ("found", "symmetry", "reached", "error", "missing", "corrections", "end", "status")
            ),
            *map(Column, ("events", "change", "left_out", "drawn_starts")),
            *(Column(name, None, quantity, False) for name, quantity in times.items()),
            Column("stored_point", repeats=False),
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
        sentences = [
            self._gaits_found(on_branches, of_rows),
            bifurcations_found(on_branches, self.parameter),
        ]
        if left_out := np.sum(of_rows["left_out"].to_numpy(int)):
            were_not = "1 branch was" if left_out == 1 else f"{left_out} branches were"
            sentences.append(f"{were_not} not followed: run.branches is {self.branches}.")
        if stopped := np.count_nonzero(on_branches["end"].astype(str) == "most"):
            sentences.append(
                f"Branches ended at {stopped} places after run.most, {self.most} points: raise it, or "
                "run.longest."
            )
        curves = table.iloc[np.flatnonzero(~branch & (table["part"] != "").to_numpy(bool))]
        return [*sentences, *(self._curves_found(curves, second) for second in self.second)]

    def _gaits_found(self, on_branches: pd.DataFrame, of_rows: pd.DataFrame) -> str:
        """The sentence with the numbers of gaits by period, and an estimate of those that were not found."""
        gaits = on_branches.iloc[np.flatnonzero((on_branches["found"] >= 0).to_numpy(bool))]
        kind = "at rest" if self.stationary else "of period {}"
        counts = [
            f"{len(of_period)} {kind.format(period)}, {np.count_nonzero(of_period['stable'])} of them stable"
            for period, of_period in gaits.groupby("period")
        ]
        rows = f", in {len(of_rows)} rows" if len(of_rows) > 1 else ""
        text = f"At {self.parameter} = {self.place:g}{rows}: {'; '.join(counts) or 'no gait'}"
        missing = np.sum(of_rows["missing"].to_numpy(float))
        return f"{text}; an estimate of {missing:.0f} more were not found." if missing >= 0.5 else f"{text}."

    def _curves_found(self, curves: pd.DataFrame, second: str) -> str:
        """The sentence with the numbers of curves over a second parameter, and the points marked on them."""
        orders = curves.iloc[np.flatnonzero(curves["part"].isin(["order_change", "corner"]).to_numpy(bool))]
        both, of_order = (part.groupby(["row", "number"]).ngroups for part in (curves, orders))
        text = f"{both - of_order} curves of bifurcations"
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

    def wider(self, table: pd.DataFrame) -> Atlas:
        """The run that continues a table: twice the starts, patience and branches, one bifurcation deeper.

        Args:
            table: the table of this run; one in memory is kept.
        """
        fields = {name: 2 * getattr(self, name) for name in ("budget", "patience", "branches")}
        path, fields["depth"] = table.attrs.get("path"), self.depth + 1
        wider = self.model_copy(
            update={**fields, "after": None if path is None else str(Path(path).resolve())}
        )
        if path is None:
            wider._before = table
        return wider

    @property
    def place(self) -> float:
        """The value of the parameter at which gaits are searched."""
        return self.path[0] if self.at is None else self.at

    def check_ranges(self, rows: Design) -> list[Diagnostic]:
        return [*self._check_path(), *self._check_starts(rows), *self._check_second(rows)]

    def _check_path(self) -> Iterator[Diagnostic]:
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
                yield from rising(("run", "ranges", name), bounds)
            else:
                near = near_miss.suggestion(name, names)
                text = f"is no start value and no coordinate of {rows.model.name}{near}"
                yield Diagnostic(("run", "ranges", name), text)

    def _check_second(self, rows: Design) -> Iterator[Diagnostic]:
        """Diagnostics of the second parameter and its range."""
        for name, bounds in self.second.items():
            if name == self.parameter:
                yield Diagnostic(("run", "second", name), "is run.parameter; name another parameter.")
            elif name in rows.derived:
                text = f"is a formula of other parameters here: {rows.derived[name]}; give a number."
                yield Diagnostic(("run", "second", name), text)
            else:
                wrong = [*rising(("run", "second", name), bounds)]
                yield from wrong or beginning_within(rows, {name: bounds}, ("run", "second"))

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        """Searches with all periods, and some branches; at most all starts and branches that are allowed."""
        slopes = 2.0 + 3.0 * unknowns(rows)
        search = STEPS_OF_SEARCH * slopes * cycle * self.periods * (self.periods + 1) / 2.0
        points = POINTS * slopes * cycle * (DERIVATIVES_A_POINT if self.second else 1.0)
        starts = min(self.budget, (self.patience + 1) * self.batch)
        begun = self.settle * cycle * self.batch
        return Cost(
            likely=begun + starts * search + BRANCHES * points,
            most=begun + self.budget * search + self.branches * self.most * slopes * cycle,
            records=BRANCHES * POINTS,
        )

    def near_fixed_points(self, mapped: MappedRows) -> tuple[Points, Values]:
        mapped = self._at_place(mapped)
        count = len(mapped.numbers)
        row_of_start = np.repeat(np.arange(count), CHECKED)
        drawn = self._drawn(mapped, row_of_start, 0, CHECKED)
        search = OrbitSearch(mapped.mapping, mapped.values, self._levels(mapped), SearchOptions())
        search.add(drawn, row_of_start)
        first = [search.of_row(row)[:1] for row in range(count)]
        points = [
            orbits[0].points[[0]] if orbits else drawn[[row * CHECKED]] for row, orbits in enumerate(first)
        ]
        return Points.joined(points), mapped.values

    def _at_place(self, mapped: MappedRows) -> MappedRows:
        """The rows at the value of the parameter at which gaits are searched."""
        return mapped.with_values(**{self.parameter: np.full(len(mapped.numbers), self.place)})

    def _levels(self, mapped: MappedRows) -> dict[str, Any]:
        """The value (n,) of each conserved quantity that is held: that of the row's own start."""
        if not self.fix:
            return {}
        conserved = mapped.mapping.images(mapped.settled(0), mapped.values).conserved_values
        names = [quantity.name for quantity in mapped.mapping.conserved]
        return {name: conserved[:, names.index(name)] for name in self.fix}

    def _drawn(
        self, mapped: MappedRows, row_of_start: Rows, begun: int, count: int, cycles: int = 0
    ) -> Points:
        """Random starts (n,), `count` of each row, which depend on the row and `begun` alone.

        With `cycles`, where the starts are after so many cycles; NaN if they did not come so far.
        """
        mapping, values = mapped.mapping, rows_of(mapped.values, row_of_start)
        columns = self._drawn_columns(mapped, row_of_start, begun, count)
        names = [quantity.name for quantity in mapping.model.initial_conditions]
        drawn_starts = {name: column for name, column in columns.items() if name in names}
        starts = {name: np.asarray(column)[row_of_start] for name, column in mapped.starts.items()}
        starts |= drawn_starts
        if cycles and len(drawn_starts) == len(columns):
            points, status = mapping.settled(starts, values, cycles)
            return Points(
                np.where((status == ReturnStatus.crossed)[:, None], points.at, np.nan), points.modes
            )
        points, _ = mapping.settled(starts, values, 0)
        outside = np.flatnonzero(~mapping.covers(points, values))
        if outside.size:
            points = points.merged(outside, mapping.settled(starts, values, 1)[0][outside])
        moved = points.at.copy()
        for place, quantity in enumerate(mapping.coordinates):
            if quantity.name in columns and quantity.name not in drawn_starts:
                moved[:, place] = columns[quantity.name]
        if cycles:
            images = mapping.iterated(cycles).images(Points(moved, points.modes), values)
            moved, points = np.where(images.sound[:, None], images.points.at, np.nan), images.points
        return Points(moved, points.modes)

    def _drawn_columns(
        self, mapped: MappedRows, row_of_start: Rows, begun: int, count: int
    ) -> dict[str, Float[np.ndarray, " starts"]]:
        """Random numbers (n,) in each of `ranges`, `count` for each row."""
        low, high = np.array(list(self.ranges.values())).T
        drawn = [
            np.random.default_rng([self.seed, int(mapped.numbers[row]), begun]).uniform(
                low, high, (count, len(low))
            )
            for row in dict.fromkeys(row_of_start.tolist())
        ]
        return dict(zip(self.ranges, np.concatenate(drawn).T, strict=True))

    def block_table(
        self, rows: Design, spec: SweepSpec, first: int, last: int, on_progress: BlockProgress
    ) -> pd.DataFrame:
        """The atlas of rows first..last-1; `on_progress` is called before each of its steps."""
        before = self._earlier(first, last)
        mapped, search, atlas = self._followed(rows, spec, np.arange(first, last), on_progress, before)
        branches = atlas.table(search, self.place)
        is_kept = (
            branches["earlier"].notna().to_numpy() if before is not None else np.zeros(len(branches), bool)
        )
        kept, new = (branches.iloc[np.flatnonzero(mask)] for mask in (is_kept, ~is_kept))
        table = self._joined_parts(mapped, search, atlas, new, before)
        if len(table):
            table = self._records_of(rows, mapped, table)
        if before is not None:
            old = before.assign(row=before["row"] + first)
            of_kept = kept[["found", "point", "missing"]].to_numpy(float)
            old.loc[kept["earlier"].to_numpy(int), ["found", "point", "missing"]] = of_kept
            old["drawn_starts"] = [search.drawn(row) for row in before["row"]]
            table = pd.concat([old, table], ignore_index=True) if len(table) else old
            of_curve = (table["part"].astype(str) != "branch").to_numpy(bool)
            order = np.lexsort([table["point"], table["number"], of_curve, table["row"]])
            table = table.iloc[order].reset_index(drop=True)
        left_out = np.array([atlas.left_out(row) for row in range(last - first)], np.int64)
        return _typed(table.assign(left_out=left_out[table["row"].to_numpy(int) - first]))

    def _records_of(self, rows: Design, mapped: MappedRows, table: pd.DataFrame) -> pd.DataFrame:
        """The records of a job's table from those of branches and curves."""
        for name in self.second:
            of_branch = mapped.values[name][table["row"].to_numpy(int)]
            table[name] = np.where(table["part"] == "branch", of_branch, table.get(name, np.nan))
        observed = {f"{quantity.name}_n" for quantity in rows.model.observables}
        named = [c.name for c in self.columns(rows.model) if c.name not in observed]
        table = table.reindex(columns=list(dict.fromkeys([*table, *named])))
        has_point = table["special"].notna().to_numpy()
        return self.records(rows, mapped.without(self.parameter), table, has_point, has_point)

    def _earlier(self, first: int, last: int) -> pd.DataFrame | None:
        """The records of rows first..last-1 of the run that this one continues; `row` counts from 0."""
        if self.after is None and self._before is None:
            return None
        table = self._before if self.after is None else load(self.after, rows=range(first, last))
        assert table is not None
        table = table[table["row"].between(first, last - 1)]
        return table.assign(row=table["row"] - first).reset_index(drop=True)

    def _joined_parts(
        self,
        mapped: MappedRows,
        search: OrbitSearch,
        atlas: BranchAtlas,
        branches: pd.DataFrame,
        before: pd.DataFrame | None,
    ) -> pd.DataFrame:
        """The points of branches, those of curves over the second parameter, and rows without a gait."""
        parts = [branches.assign(part="branch").rename(columns={"branch": "number"})]
        curves_before: dict[int, int] = {}
        if before is not None:
            of_curves = before[~before["part"].astype(str).isin(["branch", ""])]
            curves_before = of_curves.groupby("row")["number"].nunique().to_dict()
        for second, within in self.second.items():
            curves = atlas.follow_curves(second, within, atlas.steps, curves_before)
            if len(curves):
                parts.append(curves.rename(columns={"curve": "number", "kind": "part"}))
        without = set(range(len(mapped.numbers))) - {branch.row for branch in atlas.branches}
        parts.append(pd.DataFrame([self._without_gait(row, search) for row in sorted(without)]))
        parts = [part for part in parts if len(part)]
        if not parts:
            return branches
        table = pd.concat(parts, ignore_index=True)
        drawn = np.array([search.drawn(row) for row in range(len(mapped.numbers))])
        table = table.assign(drawn_starts=drawn[table["row"].to_numpy(int)])
        return table.sort_values("row", kind="stable", ignore_index=True)

    def _followed(
        self,
        rows: Design,
        spec: SweepSpec,
        numbers: Rows,
        on_progress: BlockProgress,
        before: pd.DataFrame | None,
    ) -> tuple[MappedRows, OrbitSearch, BranchAtlas]:
        """Some rows at the place of the search, the search of their gaits, and their branches.

        What the run `before` has found is neither searched nor followed again.
        """
        mapped = self._at_place(self.mapped_rows(rows, spec, numbers))

        def on_step(points: Any, shares: Any) -> None:
            on_progress(f"{np.sum(points)} points of {len(points)} branches", float(np.mean(shares)))

        atlas = BranchAtlas(
            mapped.mapping,
            mapped.values,
            parameter=self.parameter,
            within=self.path,
            fix=self.fix,
            steps=dataclasses.replace(self.steps(on_step), through=(self.place,)),
            most_branches=self.branches,
        )
        like = mapped.settled(0)[:1]
        if before is not None:
            with_points = (before["part"].astype(str) == "branch") & (before["point"] >= 0)
            atlas.restore(before.loc[with_points], like, self.depth_before)
        search = self._searched(mapped, on_progress, before, like)
        atlas.follow(search, self.place, self.depth)
        return mapped, search, atlas

    @property
    def depth_before(self) -> int:
        """The depth of the run that this one continues."""
        return self.depth - 1

    def followed_again(
        self,
        rows: Design,
        spec: SweepSpec,
        numbers: Int[np.ndarray, " sampled"],
        table: pd.DataFrame,
        on_progress: BlockProgress,
    ) -> tuple[MappedRows, pd.DataFrame]:
        if "stored_point" not in table:  # of an older version
            mapped, search, atlas = self._followed(rows, spec, numbers, on_progress, None)
            again = atlas.table(search, self.place).rename(columns={"branch": "number"})
            at = [branch.point(place) for branch in atlas.branches for place in range(len(branch.records))]
            return mapped.without(self.parameter), again.assign(at=pd.Series(at, again.index, dtype=object))
        mapped = self._at_place(self.mapped_rows(rows, spec, numbers))
        like = mapped.settled(0)[:1]
        places = dict(zip(numbers.tolist(), range(len(numbers)), strict=True))
        on_branches = (table["part"].astype(str) == "branch") & table["row"].isin(places)
        points = table.loc[on_branches & (table["stored_point"] != ""), [*self.point_names, self.parameter]]
        rows_of_points = table.loc[points.index, "row"].map(places)
        at = [points_of(text, like)[0] for text in table.loc[points.index, "stored_point"]]
        stored = points.assign(row=rows_of_points, at=pd.Series(at, points.index, dtype=object))
        return mapped.without(self.parameter), stored.reset_index(drop=True)

    def _searched(
        self, mapped: MappedRows, on_progress: BlockProgress, before: pd.DataFrame | None, like: Points
    ) -> OrbitSearch:
        """The search of the rows' gaits, from drawn starts and from where those of the first round settle.

        Args:
            mapped: the rows.
            on_progress: progress callback.
            before: the records of an earlier run; its starts are neither drawn nor simulated again.
            like: a point (1,) of the map, for the structure of its modes.
        """

        def on_round(count: int, orbits: int) -> None:
            on_progress(f"{orbits} gaits from {count} starts of a row", 0.5 * count / self.budget)

        def draw(row_of_start: Rows, begun: int) -> Points:
            count = int(np.sum(row_of_start == row_of_start[0]))
            return self._drawn(mapped, row_of_start, begun, count)

        periods = 1 if self.stationary else self.periods  # a point at rest has no other
        options = SearchOptions(periods, self.budget, self.batch, self.patience, on_round)
        search = OrbitSearch(mapped.mapping, mapped.values, self._levels(mapped), options)
        if before is not None:
            starts = before.groupby("row")["drawn_starts"].first().to_dict()
            search.restore(_orbits_of_table(mapped, before, like), starts)
            search.run(draw, range(len(mapped.numbers)))
            return search
        row_of_start = np.repeat(np.arange(len(mapped.numbers)), self.batch)
        ends = self._drawn(mapped, row_of_start, 0, self.batch, max(self.settle, 1))
        sound = np.asarray(np.isfinite(ends.at).all(axis=1))
        settled = np.flatnonzero(sound)
        if settled.size:
            search.add(ends[settled], row_of_start[settled], drawn=False)
        search.run(draw, range(len(mapped.numbers)))
        if not self.fix:  # else the drawn starts lead to gaits with other values of what is conserved
            search.mark_reached(ends, row_of_start, sound)
        return search

    def _without_gait(self, row: int, search: OrbitSearch) -> dict[str, Any]:
        """The record of a row in which the search found no gait."""
        return {
            "row": row,
            "part": "branch",
            self.parameter: self.place,
            "missing": search.missing(row),
            "end": "no_gait",
            "stored_point": "",
        }


def _typed(table: pd.DataFrame) -> pd.DataFrame:
    """A table with whole numbers, flags and texts in the types of its columns."""
    whole = (
        "number",
        "period",
        "depth",
        "begins",
        "point",
        "unstable",
        "found",
        "corrections",
        "drawn_starts",
    )
    integers = {name: table[name].astype(float).fillna(-1).astype(np.int64) for name in whole}
    stable = table["stable"].astype("boolean").fillna(False).astype(bool)
    names = ("part", "symmetry", "events", "change", "special", "end", "gait", "status")
    texts = {name: pd.Categorical(table[name].astype(object).fillna("")) for name in names}
    return table.assign(
        stable=stable, stored_point=table["stored_point"].astype(object).fillna(""), **texts, **integers
    )


def _orbits_of_table(mapped: MappedRows, table: pd.DataFrame, like: Points) -> Iterator[Orbit]:
    """The gaits of an earlier run's records, each with the place of its record."""
    gaits = table.loc[(table["part"].astype(str) == "branch") & (table["found"] >= 0)]
    for place, record in zip(gaits.index, gaits.to_dict("records"), strict=True):
        point = points_of(record["stored_point"], like)[0].points
        values = rows_of(mapped.values, np.array([record["row"]]))
        (orbit,) = orbits_of(mapped.mapping, point, values, int(record["period"]))
        if orbit is not None:
            numbers = int(record["row"]), orbit, float(record["error"]), int(record["found"])
            symmetry = tuple(filter(None, str(record["symmetry"]).split(", ")))
            yield Orbit(*numbers, symmetry, float(record["reached"]), (int(place),))


def _event_times(model: Model) -> dict[str, Quantity]:
    """The columns with the times of a model's events."""
    names = dict.fromkeys(model.guard_names) if isinstance(model, HybridModel) else ()
    meaning = "first time in the cycle: {}"
    return {time_column(name): Quantity(time_column(name), "s", meaning.format(name)) for name in names}
