"""Run kind `folds`: follows the fold next to each row's gait in the plane of two parameters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from jaxtyping import Int
from pydantic import Field

from gaitsweep import near_miss
from gaitsweep.analysis.continuation.fold_curves import fold_curves
from gaitsweep.analysis.continuation.newton import NewtonOutcome
from gaitsweep.contract import Model
from gaitsweep.design import Design
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.kinds.columns import Column, observed_at_crossings
from gaitsweep.kinds.fixed_points import BeginsWhereRowsSettle, beginning_within, rising, unknowns
from gaitsweep.kinds.run_kind import BlockProgress, Cost, Movement
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.numbers import Count, Positive, Real, Text

# Points of a curve are this many times as many as the longest steps over a range: both parameters move, and
# the curve is followed in both directions.
POINTS_SHARE = 2.0
# Derivatives taken for a point, each of as many cycles as the map has coordinates: of its corrections, and of
# the equations' second derivatives.
DERIVATIVES_A_POINT = 12


class Folds(BeginsWhereRowsSettle):
    """Find the fold next to each row's gait, and follow it in the plane of two parameters."""

    kind: Literal["folds"] = Field(
        init=False,
        description="folds: follow the fold at which a gait is lost, and its cusps, in the plane of "
        "two parameters",
    )
    parameters: list[Text] = Field(
        min_length=2,
        max_length=2,
        description="two of the model's parameters; a row begins at its own values of both, and its gait is "
        "followed along the first parameter in both directions to the nearest fold",
    )
    within: dict[Text, Annotated[list[Real], Field(min_length=2, max_length=2)]] = Field(
        description="range of each of the two parameters: [lowest, highest]"
    )
    longest: Positive = Field(default=0.1, description="length of the longest step")
    shortest: Positive = Field(
        default=1e-3, description="shortest length of a step; below it a leap is tried"
    )
    most: Count = Field(
        default=100, description="largest number of points of a curve in each of its two directions"
    )

    @property
    def movements(self) -> tuple[Movement, ...]:
        return tuple(
            Movement(
                name, tuple(self.within.get(name, ())), ("run", "parameters", k), ("run", "within", name)
            )
            for k, name in enumerate(self.parameters)
        )

    def columns(self, model: Model) -> list[Column]:
        columns = [
            Column("point"),
            *(_fold_column(model, name) for name in self.parameters),
            *observed_at_crossings(model),
            Column("gait"),
            Column("time", repeats=False),
            Column("multiplier", repeats=False),
            *map(Column, ("unstable", "side")),
            Column("curvature", repeats=False),
            *map(Column, ("special", "corrections", "end", "status")),
        ]
        return self.own_columns(columns)

    def check_ranges(self, rows: Design) -> list[Diagnostic]:
        return [*self._check_within()] or [*beginning_within(rows, self.within, ("run", "within"))]

    def _check_within(self) -> Iterator[Diagnostic]:
        """Diagnostics of the two parameters and their ranges."""
        first, second = self.parameters
        if first == second:
            text = f"is {second}, like the first; a curve of folds needs two different parameters."
            yield Diagnostic(("run", "parameters", 1), text)
            return
        for name in self.within:
            if name not in self.parameters:
                text = f"is not one of run.parameters{near_miss.suggestion(name, self.parameters)}"
                yield Diagnostic(("run", "within", name), text)
        for name in self.parameters:
            if name not in self.within:
                text = f"has no range for {name}: add {name}: [lowest, highest]."
                yield Diagnostic(("run", "within"), text)
            else:
                yield from rising(("run", "within", name), self.within[name])

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        """A row's curve likely crosses its ranges once, with at most `most` points in each direction."""
        points = POINTS_SHARE * (1.0 / self.longest + math.log2(self.longest / self.step))
        points, most = min(points, 2.0 * self.most), 2.0 * self.most
        cycles_a_point = DERIVATIVES_A_POINT * (unknowns(rows) + 1)
        likely, longest = ((self.settle + count * cycles_a_point) * cycle for count in (points, most))
        return Cost(likely, longest, max(points, 1.0))

    def followed_again(
        self,
        rows: Design,
        spec: SweepSpec,
        numbers: Int[np.ndarray, " sampled"],
        table: pd.DataFrame,
        on_progress: BlockProgress,
    ) -> None:
        return None

    def block_table(
        self, rows: Design, spec: SweepSpec, first: int, last: int, on_progress: BlockProgress
    ) -> pd.DataFrame:
        """The curves of rows first..last-1; `on_progress` is called before each of their steps."""
        mapped = self.mapped_rows(rows, spec, np.arange(first, last))
        points = mapped.settled(self.settle)
        curves = []
        for row in range(last - first):
            row_values = {name: column[[row]] for name, column in mapped.values.items()}

            def on_step(points: Sequence[int], shares: Sequence[float], row: int = row) -> None:
                note = f"{points[0]} points of its curve" if points[0] else "searching its fold"
                on_progress(f"row {first + row}: {note}", (row + shares[0]) / (last - first))

            curve = fold_curves(
                mapped.mapping,
                points[np.array([row])],
                {name: column for name, column in row_values.items() if name not in self.parameters},
                parameters=self.parameters,
                within=self.within,
                begin={name: row_values[name] for name in self.parameters},
                fix=self.fix,
                steps=self.steps(on_step),
            )
            curves.append(curve.assign(row=row))
        table = pd.concat(curves, ignore_index=True)
        has_fold = table["special"].notna().to_numpy() if "special" in table else np.zeros(len(table), bool)
        failed = table["end"].isin([outcome.name for outcome in NewtonOutcome]).to_numpy(bool)
        renamed = {name: f"{name}_fold" for name in self.parameters}
        table = self.records(rows, mapped, table, has_fold, ~failed, renamed)
        # without a fold, the parameters are those at which the row begins
        table.loc[~has_fold, list(renamed.values())] = np.nan
        counts = ("unstable", "side", "corrections")
        return table.assign(**{name: table[name].astype(float).fillna(0).astype(np.int64) for name in counts})


def _fold_column(model: Model, name: str) -> Column:
    """Column of the parameter's value at the fold."""
    quantity = next((q for q in model.parameters if q.name == name), None)
    if quantity is not None:
        quantity = dataclasses.replace(
            quantity, name=f"{name}_fold", meaning=f"{quantity.meaning}, at the fold"
        )
    return Column(f"{name}_fold", quantity=quantity, repeats=False)
