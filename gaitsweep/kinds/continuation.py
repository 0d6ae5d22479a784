"""Run kind `continuation`: follows the fixed points of each row's return map along a parameter."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from pydantic import Field

from gaitsweep.analysis.continuation.branch_follower import LONGER, STRAIGHT
from gaitsweep.analysis.continuation.continuation import continuation
from gaitsweep.analysis.continuation.newton import NewtonOutcome
from gaitsweep.contract import Model
from gaitsweep.design import Design
from gaitsweep.engine.poincare.maps import Points, Values
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.kinds.columns import Column, changing, observed_at_crossings
from gaitsweep.kinds.fixed_points import (
    FollowsFixedPoints,
    MappedRows,
    bifurcations_found,
    listed,
    unknowns,
)
from gaitsweep.kinds.run_kind import BlockProgress, Cost
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.numbers import Flag, Real, Text

# Images and derivatives of the map for each point of a branch: without folds; and with folds, where steps are
# tried again and bifurcations are located. Measured on two models.
PLAIN, FOLDED = (4.0, 1.2), (13.0, 2.0)
# Time of an image with its derivative along one direction, as a multiple of that of an image alone.
DERIVATIVE = 3.0
# Points that a fold takes, whatever the longest step is: a branch turns by at most acos(STRAIGHT) in a step.
POINTS_OF_FOLD = math.pi / math.acos(STRAIGHT)
# A branch with a kink, or that is lost, is followed again with half the time step.
FOLLOWED_AGAIN = 3.0
# Reasons for which a branch ends before its parameter leaves the range.
ENDS = {
    "lost": "no step, short or long, finds a fixed point beyond: the map has a jump or a corner there, for "
    "example where an event begins or ceases to happen, or the gait itself ends",
    "closed": "it came back to its first point",
    "most": "it has run.most points, {most}: raise run.most or run.longest to follow it further",
    "not_found": "this half of a crossing branch was not found",
}


class Continuation(FollowsFixedPoints):
    """Follow the stable and unstable fixed points of each row's return map along one parameter."""

    stores_starting_points: ClassVar[bool] = True
    idle_without: ClassVar = {"crossing": ("crossing",), **FollowsFixedPoints.idle_without}

    kind: Literal["continuation"] = Field(
        init=False,
        description="continuation: follow steady gaits, stable and unstable, along a parameter and "
        "around folds",
    )
    parameter: Text = Field(description="the model's parameter along which a branch is followed")
    path: list[Real] = Field(
        min_length=2,
        max_length=2,
        description="value at which the branch starts, and the other end of its range",
    )

    crossing: Flag = Field(
        default=False,
        description="whether to follow the branches that cross at branch points too, in both directions",
    )

    def columns(self, model: Model) -> list[Column]:
        columns = [
            Column("point"),
            *changing(*(["branch"] if self.crossing else []), self.parameter),
            *observed_at_crossings(model),
            Column("gait"),
            *changing("time"),
            *self.drifts(model),
            *changing("multiplier", "multiplier_re"),
            *map(Column, ("multiplier_im", "unstable", "stable", "special", "corrections", "end", "status")),
        ]
        return self.own_columns(columns)

    def check_ranges(self, rows: Design) -> list[Diagnostic]:
        if self.path[0] != self.path[1]:
            return []
        text = f"is {self.path[1]:g}, like the start of the branch; give another end."
        return [Diagnostic(("run", "path", 1), text)]

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        """A row's branch goes once along its range, or folds twice and is followed again; at most to `most`.

        With `crossing` it likely has one branch point, from which two halves of another branch lead on.
        """
        branches = 3.0 if self.crossing else 1.0
        along = 1.0 / self.longest
        plain = along + math.log(self.longest / self.step, LONGER)
        folded = plain + along + 2.0 * POINTS_OF_FOLD
        points, longer, most = (branches * min(count, self.most) for count in (plain, folded, self.most))
        # cycles of a derivative, which has a direction for each coordinate and one for the parameter
        slopes = 1.0 + DERIVATIVE * (unknowns(rows) + 1)
        settling = self.settle * cycle
        again = FOLLOWED_AGAIN * cycle * (FOLDED[0] + FOLDED[1] * slopes)
        return Cost(
            likely=settling + points * cycle * (PLAIN[0] + PLAIN[1] * slopes),
            most=settling + most * again,
            records=max(points, 1.0),
            longer=settling + longer * again,
            longer_records=longer,
        )

    def block_table(
        self, rows: Design, spec: SweepSpec, first: int, last: int, on_progress: BlockProgress
    ) -> pd.DataFrame:
        """The branches of rows first..last-1; `on_progress` is called before each of their steps."""
        mapped, table = self.followed(rows, spec, np.arange(first, last), on_progress)
        has_point = table["stable"].notna().to_numpy()
        table = self.records(rows, mapped, table, has_point)
        # missing numbers would be read as such, and those of other blocks are flags
        return table if has_point.any() else table.assign(stable=pd.Series([None] * len(table), dtype=object))

    def near_fixed_points(self, mapped: MappedRows) -> tuple[Points, Values]:
        return mapped.settled(self.settle), mapped.values

    @property
    def columns_of_findings(self) -> tuple[str, ...]:
        return self.parameter, "special", "end"

    def findings(self, table: pd.DataFrame) -> list[str]:
        return [bifurcations_found(table, self.parameter), *branch_ends(table, self.parameter, self.most)]

    def followed_again(
        self,
        rows: Design,
        spec: SweepSpec,
        numbers: Int[np.ndarray, " sampled"],
        table: pd.DataFrame,
        on_progress: BlockProgress,
    ) -> tuple[MappedRows, pd.DataFrame]:
        return self.followed(rows, spec, numbers, on_progress, with_points=True)

    def followed(
        self,
        rows: Design,
        spec: SweepSpec,
        numbers: Int[np.ndarray, " sampled"],
        on_progress: BlockProgress,
        with_points: bool = False,
    ) -> tuple[MappedRows, pd.DataFrame]:
        """The branches of the rows `numbers` (n,), as `analysis.continuation` gives them.

        Returns:
            The rows, without the parameter that moves, and the table, whose `row` counts from 0.
        """
        mapped = self.mapped_rows(rows, spec, numbers)
        begin, end = self.path

        def on_step(points: Int[np.ndarray, " branches"], shares: Float[np.ndarray, " branches"]) -> None:
            unended = np.sum(shares < 1.0)
            text = f"{points.sum()} points of {points.size} branches, {unended} not at their ends"
            on_progress(text, max(1.0 - float(np.sum(1.0 - shares)) / len(numbers), 0.0))

        on_progress(f"settling for {self.settle} cycles")
        points = mapped.settled(self.settle)
        mapped = mapped.without(self.parameter)
        table = continuation(
            mapped.mapping,
            points,
            mapped.values,
            parameter=self.parameter,
            within=self.path,
            begin=begin,
            towards=1 if end > begin else -1,
            fix=self.fix,
            steps=self.steps(on_step),
            shown=(),
            with_points=with_points,
            crossing=self.crossing,
        )
        return mapped, table


def branch_ends(table: pd.DataFrame, parameter: str, most: int) -> list[str]:
    """Sentences about branches that end before the parameter leaves its range, with the reason.

    Args:
        table: the branches.
        parameter: the parameter along which they are followed.
        most: the largest number of points of a branch.
    """
    ends = table["end"].astype(str).to_numpy()
    sentences = []
    for end in dict.fromkeys(ends):
        values = table[parameter].to_numpy(float)[ends == end]
        subject = "the branch" if len(values) == 1 else f"{len(values)} branches"
        at = f"at {parameter} = {listed(values)}"
        if end in ENDS:
            reason = ENDS[end].format(most=most)
            sentences.append(f"{subject[0].upper()}{subject[1:]} ended as {end} {at}, because {reason}.")
        elif end in NewtonOutcome.__members__:
            reason = NewtonOutcome[end].sentence
            sentences.append(f"No fixed point for {subject} to begin from {at}: {reason}")
    return sentences
