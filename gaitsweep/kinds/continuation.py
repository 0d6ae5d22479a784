"""Run kind `continuation`: the fixed points of each row's return map are followed along a parameter."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Literal

import jax
import numpy as np
import pandas as pd
from pydantic import Field

from gaitsweep import near_miss
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.continuation import continuation
from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.contract import Model, Status
from gaitsweep.engine.poincare.maps import Values
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.engine.propose import own_steps
from gaitsweep.engine.recorders.crossings import CrossingRecorder
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.kinds.columns import STATUSES, Column, gaits, observed
from gaitsweep.kinds.diagnostics import Diagnostic
from gaitsweep.kinds.numbers import Count, CountOrZero, Positive, Real, Text
from gaitsweep.kinds.run_kind import Cost, Rows, RunKind, StartingPoints, path_values, table_columns

# Points of a branch are this many times as many as the longest steps over its range: steps begin short, are
# cut where a branch bends, and a fold turns it round.
POINTS_SHARE = 1.5
# Cycles flown for each number of a point: to predict it, to correct it, and to see whether it is stable.
CYCLES_A_NUMBER = 5


class Continuation(RunKind):
    """Follow the fixed points of each row's return map along one parameter, stable or not."""

    compared: ClassVar = "starting_points"
    own_blocks: ClassVar[bool] = True

    kind: Literal["continuation"] = Field(
        init=False,
        description="continuation: the steady gaits along a parameter, stable and unstable, around folds",
    )
    parameter: Text = Field(description="the model's parameter along which a branch is followed")
    path: list[Real] = Field(
        min_length=2, max_length=2, description="where the branch starts, and the other end of its range"
    )
    settle: CountOrZero = Field(
        default=100, description="cycles before the search for the first fixed point begins"
    )
    fix: list[Text] = Field(
        default=[], description="conserved quantities to hold as they are after `settle` cycles"
    )
    step: Positive = Field(
        default=0.02, description="length of the first step, as a share of the range where only that moves"
    )
    longest: Positive = Field(default=0.08, description="length of the longest step")
    shortest: Positive = Field(
        default=1e-4, description="length below which a step is given up, and a leap tried"
    )
    most: Count = Field(default=300, description="points of a branch")

    def values_between(self) -> Iterator[float]:
        return path_values(sorted(self.path))

    def recorder(self, model: Model) -> CrossingRecorder:
        # the rows are followed to where their branches begin; `block_table` does the rest
        return CrossingRecorder(model, 1, self.settle)

    def columns(self, model: Model) -> list[Column]:
        return [
            Column("point"),
            Column(self.parameter, repeats=False),
            *observed(model, "n"),
            Column("gait"),
            Column("time", repeats=False),
            *(Column(f"drift_{name}", repeats=False) for name in self.fix),
            Column("multiplier", repeats=False),
            Column("multiplier_re", repeats=False),
            *map(Column, ("multiplier_im", "unstable", "stable", "special", "corrections", "end", "status")),
        ]

    def check(self, rows: Rows, method: str) -> list[Diagnostic]:
        return [*self._check_steps(), *self._check_map(rows.model, method)]

    def _check_steps(self) -> list[Diagnostic]:
        if self.path[0] == self.path[1]:
            return [Diagnostic(("run", "path", 1), f"is {self.path[1]:g}, as where the branch starts.")]
        if not self.shortest <= self.step <= self.longest:
            text = (
                f"is {self.step:g}, but must lie between run.shortest, {self.shortest:g}, and run.longest, "
            )
            return [Diagnostic(("run", "step"), f"{text}{self.longest:g}.")]
        return []

    def _check_map(self, model: Model, method: str) -> list[Diagnostic]:
        """Diagnostics about a map that has no derivative, and about what it does not conserve."""
        wrong = []
        chart = model.chart()
        names = [] if chart is None else [quantity.name for quantity in chart.conserved]
        for index, name in enumerate(self.fix):
            if name not in names:
                near = near_miss.suggestion(name, names) if names else "."
                text = f"is {name}, which {model.name} does not conserve{near}"
                wrong.append(Diagnostic(("run", "fix", index), text))
        try:
            steps = own_steps(method, model)
        except ValueError:  # the check of the method says so
            return wrong
        if steps is not None:
            text = (
                f"is {method}, steps of fixed length, through which a return map has no derivative: use rk4."
            )
            wrong.append(Diagnostic(("numerics", "method"), text))
        return wrong

    def cost(self, rows: Rows, cycle: float, period: float) -> Cost:
        """A row's branch is likely followed along its whole range, at most to `most` points."""
        chart = rows.model.chart()
        size = len(chart.coordinates) if chart is not None else _state_size(rows)
        points = min(POINTS_SHARE / self.longest + math.log2(self.longest / self.step), float(self.most))
        likely, most = (
            (self.settle + count * CYCLES_A_NUMBER * (size + 1)) * cycle
            for count in (points, float(self.most))
        )
        return Cost(likely, most, max(points, 1.0))

    def block_table(
        self, rows: Rows, work: SweepSpec, first: int, last: int, between: Callable[[], None]
    ) -> pd.DataFrame:
        """The branches of rows first..last-1; `between` is called before each of their steps."""
        mapping, values, starts = self._map(rows, work, np.arange(first, last))
        begin, end = self.path
        points, _ = mapping.settled(starts, {**values, self.parameter: begin}, self.settle)
        table = continuation(
            mapping,
            points,
            values,
            parameter=self.parameter,
            within=self.path,
            begin=begin,
            towards=1 if end > begin else -1,
            fix=self.fix,
            steps=ArclengthSteps(self.step, self.longest, self.shortest, self.most, between),
            shown=(),
        )
        row = table["row"].to_numpy(np.int64)
        axes = {name: each[row] for name, each in rows.columns(first, last).items()}
        renamed = {q.name: f"{q.name}_n" for q in rows.model.observables}
        found = table["stable"].notna().to_numpy() if "stable" in table else np.zeros(len(table), bool)
        moved = {name: np.broadcast_to(each, (last - first,))[row] for name, each in values.items()}
        moved[self.parameter] = table[self.parameter].to_numpy(float)
        table["gait"] = _gaits(mapping, moved, table, found)
        status = np.where(found, Status.complete.name, Status.no_fixed_point.name)
        table = table.rename(columns=renamed).assign(row=row + first, **axes)
        table["status"] = pd.Categorical(status, categories=STATUSES)
        for name in ("special", "end"):
            table[name] = pd.Categorical(table[name].fillna(""))
        return table.reindex(columns=table_columns(rows, self))

    def starting_points(
        self, rows: Rows, work: SweepSpec, sample: np.ndarray
    ) -> tuple[StartingPoints, StartingPoints]:
        """The fixed points at which branches begin, found again at half the step."""
        mapping, values, starts = self._map(rows, work, sample)
        values = {**values, self.parameter: self.path[0]}

        def found(one: BatchedReturnMap) -> StartingPoints:
            points, _ = one.settled(starts, values, self.settle)
            fixed = newton(one, points, values, fix=self.fix)
            seen = [fixed.images.observed[q.name] for q in rows.model.observables]
            return StartingPoints(fixed.converged, np.stack(seen, axis=1))

        return found(mapping), found(mapping.refined())

    def _map(
        self, rows: Rows, work: SweepSpec, numbers: np.ndarray
    ) -> tuple[BatchedReturnMap, Values, Values]:
        """The return map of rows (n,), their parameters but for the one that moves, and their starts."""
        parameters, starts = rows.values_in(numbers)
        following = rows.following(self.parameter)
        mapping = BatchedReturnMap(rows.model, tuple(following.items()), work.numerics, work.engine)
        away = {*following, self.parameter}
        return mapping, {name: each for name, each in parameters.items() if name not in away}, starts


def _gaits(
    mapping: BatchedReturnMap, values: dict[str, np.ndarray], table: pd.DataFrame, found: np.ndarray
) -> pd.Categorical:
    """The gait of each record; it is not read where there is no fixed point."""
    model = mapping.model
    codes = np.full(len(table), -1)
    if found.any():
        held = mapping.complete({name: each[found] for name, each in values.items()}, int(found.sum()))
        seen = {q.name: table.loc[found, q.name].to_numpy(float) for q in model.observables}
        label = jax.jit(jax.vmap(lambda v, o: model.label(mapping.params(v), o)["gait"]))
        codes[found] = np.asarray(label(held, seen))
    return gaits(model, codes)


def _state_size(rows: Rows) -> int:
    def begin(values: Any, start: Any) -> Any:
        return rows.model.init(rows.model.params(values), start)

    first = [{name: each[0] for name, each in part.items()} for part in rows.values_in(np.zeros(1, np.int64))]
    return sum(int(np.size(leaf)) for leaf in jax.tree.leaves(jax.eval_shape(begin, *first)))
