"""Rows of sets of constants at the conditions of measures: their parameters and starts, and refusals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Shaped

from gaitsweep.design.design import inside
from gaitsweep.job.step_lengths import too_long_steps
from gaitsweep.runs.prepare import RunContext

# Parameters and starts that a row sets, by name, in the order of their names.
Condition = tuple[tuple[str, float], ...]
Values = dict[str, Shaped[np.ndarray, " ..."]]
Reasons = Shaped[np.ndarray, " sets"]  # why a set is refused, or ""


def condition_of(values: Mapping[str, float]) -> Condition:
    """Return the condition that sets these values."""
    return tuple(sorted(values.items()))


def take(columns: Mapping[str, Shaped[np.ndarray, " n"]], index: Int[np.ndarray, " some"] | slice) -> Values:
    """Return the entries of columns (n,) at some places."""
    return {name: column[index] for name, column in columns.items()}


def group_by_names(conditions: Sequence[Condition]) -> dict[tuple[str, ...], list[int]]:
    """Group the numbers of conditions by the names that they set; other names have the job's own value."""
    numbers_by_names: dict[tuple[str, ...], list[int]] = {}
    for number, condition in enumerate(conditions):
        numbers_by_names.setdefault(tuple(name for name, _ in condition), []).append(number)
    return numbers_by_names


class RowsOfSets(NamedTuple):
    """Parameters and starts of the rows of sets, set by set, and the reasons why sets are refused, or ""."""

    params: Values
    starts: Values
    refused: Reasons


def row_values_of(
    context: RunContext, constants: Values, conditions: Sequence[Condition], n: int
) -> RowsOfSets:
    """Return parameters and starts of the rows of n sets.

    Args:
        context: context of the job of a set.
        constants: constants (n,) of the sets by name.
        conditions: the conditions, each a row of every set.
        n: the number of sets.
    """
    per_set = len(conditions)
    model = context.model
    params = {quantity.name: np.empty(n * per_set) for quantity in model.parameters}
    starts = {quantity.name: np.empty(n * per_set) for quantity in model.initial_conditions}
    refused = np.full(n, "", object)
    for names, numbers in group_by_names(conditions).items():
        columns = {name: np.repeat(column.astype(float), len(numbers)) for name, column in constants.items()}
        # a condition that sets a free constant takes precedence
        for name in names:
            of_conditions = np.array([dict(conditions[number])[name] for number in numbers], float)
            columns[name] = np.tile(of_conditions, n)
        design = context.design.with_columns(columns)
        row_values = design.at(np.arange(design.n_rows), [*params, *starts])
        rows = (np.arange(n)[:, None] * per_set + np.array(numbers)).ravel()
        for by_name in (params, starts):
            for name, column in by_name.items():
                column[rows] = row_values[name]
        for quantity in (*model.parameters, *model.initial_conditions):
            is_outside = ~inside(row_values[quantity.name], quantity)
            _refuse_sets(refused, is_outside, len(numbers), f"{quantity.name} out of range")
        too_long = too_long_steps(design, context.job.run, context.spec.numerics)
        _refuse_sets(refused, too_long, len(numbers), "steps too long")
    return RowsOfSets(params, starts, refused)


def _refuse_sets(refused: Reasons, wrong: Bool[np.ndarray, " rows"], per_set: int, why: str) -> None:
    """Set the reason of sets with a wrong row (n * per_set,), if they have no reason yet."""
    is_refused = wrong.reshape(-1, per_set).any(axis=1)
    refused[is_refused & (refused == "")] = why
