"""The table of a block of an atlas: gaits searched, and branches followed.

The search begins at random starts and at those of rows.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from gaitsweep.analysis.atlas.atlas import BranchAtlas
from gaitsweep.analysis.atlas.atlas_tables import atlas_table
from gaitsweep.analysis.atlas.periodic_orbits import OrbitSearch, OrbitSearchOptions, rows_of
from gaitsweep.design import Design
from gaitsweep.engine.poincare.maps import Points
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.kinds.fixed_points import MappedRows, starts_with
from gaitsweep.kinds.run_kind import BlockProgress

if TYPE_CHECKING:
    from gaitsweep.kinds.atlas import Atlas


Rows = Int[np.ndarray, " starts"]


@dataclasses.dataclass(frozen=True)
class DrawnStarts:
    """Random starts of some rows, each of which depends on its row, the seed and the starts before it alone.

    Attributes:
        mapped: the rows.
        ranges: [lowest, highest] of start values, or of coordinates of the section, by name.
        seed: the seed.
    """

    mapped: MappedRows
    ranges: Mapping[str, Sequence[float]]
    seed: int

    def points(self, row_of_start: Rows, drawn_before: int, count: int, cycles: int = 0) -> Points:
        """Starts (n,), `count` of each row.

        Args:
            row_of_start: the row of each start (n,).
            drawn_before: the number of starts of each row that were drawn before.
            count: starts of each row.
            cycles: cycles that are simulated; a start that does not come so far is NaN.
        """
        mapping, values = self.mapped.mapping, rows_of(self.mapped.values, row_of_start)
        columns = self._columns(row_of_start, drawn_before, count)
        names = [quantity.name for quantity in mapping.model.initial_conditions]
        drawn_starts = {name: column for name, column in columns.items() if name in names}
        starts = {name: np.asarray(column)[row_of_start] for name, column in self.mapped.starts.items()}
        starts = starts_with(mapping, self.mapped.design, drawn_starts, {**starts, **drawn_starts}, values)
        if cycles and len(drawn_starts) == len(columns):
            points, status = mapping.settled(starts, values, cycles)
            crossed = (status == ReturnStatus.crossed)[:, None]
            return Points(np.where(crossed, points.at, np.nan), points.modes)
        points, _ = mapping.settled(starts, values, 0)
        outside = np.flatnonzero(~mapping.covers(points, values))
        if outside.size:
            points = points.merged(outside, mapping.settled(starts, values, 1)[0][outside])
        moved = points.at.copy()
        for k, quantity in enumerate(mapping.coordinates):
            if quantity.name in columns and quantity.name not in drawn_starts:
                moved[:, k] = columns[quantity.name]
        if cycles:
            images = mapping.iterated(cycles).images(Points(moved, points.modes), values)
            moved, points = np.where(images.sound[:, None], images.points.at, np.nan), images.points
        return Points(moved, points.modes)

    def _columns(
        self, row_of_start: Rows, drawn_before: int, count: int
    ) -> dict[str, Float[np.ndarray, " starts"]]:
        """Random numbers (n,) in each of `ranges`, `count` for each row."""
        low, high = np.array(list(self.ranges.values())).T
        drawn = []
        for row in dict.fromkeys(row_of_start.tolist()):
            generator = np.random.default_rng([self.seed, int(self.mapped.numbers[row]), drawn_before])
            drawn.append(generator.uniform(low, high, (count, len(low))))
        return dict(zip(self.ranges, np.concatenate(drawn).T, strict=True))

    def levels(self, fix: Sequence[str]) -> dict[str, Float[np.ndarray, " rows"]]:
        """The value (n,) of each conserved quantity that is held: that of the row's own start."""
        if not fix:
            return {}
        conserved = self.mapped.mapping.images(self.mapped.settled(0), self.mapped.values).conserved_values
        names = [quantity.name for quantity in self.mapped.mapping.conserved]
        return {name: conserved[:, names.index(name)] for name in fix}


# The columns of whole numbers.
_WHOLE = ("number", "period", "depth", "begins", "point", "unstable", "found", "corrections", "drawn_starts")
# The columns of text that has few values.
_TEXTS = ("part", "symmetry", "events", "change", "special", "end", "gait", "status")


@dataclasses.dataclass(frozen=True)
class AtlasBlock:
    """Some rows of an atlas.

    Attributes:
        run: the fields of the run.
        rows: the job's rows.
        spec: how they are simulated.
        numbers: the rows of the block (n,).
        on_progress: progress callback.
    """

    run: Atlas
    rows: Design
    spec: SweepSpec
    numbers: Int[np.ndarray, " rows"]
    on_progress: BlockProgress

    @functools.cached_property
    def mapped(self) -> MappedRows:
        """The rows at the value of the parameter at which gaits are searched."""
        return self.run.at_place(self.run.mapped_rows(self.rows, self.spec, self.numbers))

    def table(self) -> pd.DataFrame:
        """The records of the rows."""
        search, atlas = self._followed()
        branches = atlas_table(atlas, search, self.run.place)
        table = self._records(search, atlas, branches)
        left_out = np.array([atlas.left_out(row) for row in range(len(self.numbers))], np.int64)
        return _typed(table.assign(left_out=left_out[table["row"].to_numpy(int) - int(self.numbers[0])]))

    def _records(self, search: OrbitSearch, atlas: BranchAtlas, branches: pd.DataFrame) -> pd.DataFrame:
        """The records of a job's table from those of branches, and of curves over the second parameter."""
        table = self._joined_parts(search, atlas, branches)
        for name in self.run.second:
            of_branch = self.mapped.values[name][table["row"].to_numpy(int)]
            table[name] = np.where(table["part"] == "branch", of_branch, table.get(name, np.nan))
        observed = {f"{quantity.name}_n" for quantity in self.rows.model.observables}
        named = [c.name for c in self.run.columns(self.rows.model) if c.name not in observed]
        table = table.reindex(columns=list(dict.fromkeys([*table, *named])))
        has_point = table["special"].notna().to_numpy()
        mapped = self.mapped.without(self.run.parameter)
        return self.run.records(self.rows, mapped, table, has_point)

    def _joined_parts(self, search: OrbitSearch, atlas: BranchAtlas, branches: pd.DataFrame) -> pd.DataFrame:
        """The points of branches, those of curves over the second parameter, and rows without a gait."""
        parts = [branches.assign(part="branch").rename(columns={"branch": "number"})]
        for second, within in self.run.second.items():
            curves = atlas.follow_curves(second, within)
            if len(curves):
                parts.append(curves.rename(columns={"curve": "number", "kind": "part"}))
        without = set(range(len(self.numbers))) - {branch.row for branch in atlas.branches}
        parts.append(pd.DataFrame([self._without_gait(row, search) for row in sorted(without)]))
        table = pd.concat([part for part in parts if len(part)], ignore_index=True)
        drawn = np.array([search.drawn(row) for row in range(len(self.numbers))])
        table = table.assign(drawn_starts=drawn[table["row"].to_numpy(int)])
        return table.sort_values("row", kind="stable", ignore_index=True)

    def _followed(self) -> tuple[OrbitSearch, BranchAtlas]:
        """The search of the rows' gaits, and their branches."""
        run, mapped = self.run, self.mapped

        def on_step(points: Any, shares: Any) -> None:
            done = 0.5 + 0.5 * float(np.mean(shares))  # after the search of gaits
            self.on_progress(f"{np.sum(points)} points of {len(points)} branches", done)

        atlas = BranchAtlas(
            mapped.mapping,
            mapped.values,
            parameter=run.parameter,
            within=run.path,
            fix=run.fix,
            steps=dataclasses.replace(run.steps(on_step), through=(run.place,)),
            most_branches=run.branches,
        )
        search = self._searched()
        atlas.follow(search, run.place, run.depth)
        return search, atlas

    def _searched(self) -> OrbitSearch:
        """The search of the rows' gaits, from drawn starts and from where those of the first round settle."""
        run, mapped = self.run, self.mapped
        drawn = DrawnStarts(mapped, run.ranges, run.seed)

        def on_round(count: int, orbits: int) -> None:
            self.on_progress(f"{orbits} gaits from {count} starts of a row", 0.5 * count / run.budget)

        def draw(row_of_start: Rows, drawn_before: int) -> Points:
            count = int(np.sum(row_of_start == row_of_start[0]))
            return drawn.points(row_of_start, drawn_before, count)

        periods = 1 if run.stationary else run.periods  # a point at rest has no other
        options = OrbitSearchOptions(periods, run.budget, run.batch, run.patience, on_round)
        search = OrbitSearch(mapped.mapping, mapped.values, drawn.levels(run.fix), options)
        row_of_start = np.repeat(np.arange(len(mapped.numbers)), run.batch)
        settled = drawn.points(row_of_start, 0, run.batch, max(run.settle, 1))
        sound = np.asarray(np.isfinite(settled.at).all(axis=1))
        if sound.any():
            search.add(settled[np.flatnonzero(sound)], row_of_start[sound], drawn=False)
        search.run(draw, range(len(mapped.numbers)))
        if not run.fix:  # else the drawn starts lead to gaits with other values of what is conserved
            search.mark_reached(settled, row_of_start, sound)
        return search

    def _without_gait(self, row: int, search: OrbitSearch) -> dict[str, Any]:
        """The record of a row in which the search found no gait."""
        return {
            "row": row,
            "part": "branch",
            self.run.parameter: self.run.place,
            "missing": search.missing(row),
            "end": "no_gait",
            "stored_point": "",
        }


def _typed(table: pd.DataFrame) -> pd.DataFrame:
    """A table with whole numbers, flags and texts in the types of its columns."""
    integers = {name: table[name].astype(float).fillna(-1).astype(np.int64) for name in _WHOLE}
    stable = table["stable"].astype("boolean").fillna(False).astype(bool)
    texts = {name: pd.Categorical(table[name].astype(object).fillna("")) for name in _TEXTS}
    stored = table["stored_point"].astype(object).fillna("")
    return table.assign(stable=stable, stored_point=stored, **texts, **integers)
