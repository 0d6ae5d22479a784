"""Targets of a search: measures with target values, misses and scores of sets, and conflicts."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from pydantic import Field, PlainValidator, WithJsonSchema

from gaitsweep.analysis.records import names_in
from gaitsweep.angles import wrapped_difference
from gaitsweep.contract import Model
from gaitsweep.errors import ArgumentError
from gaitsweep.fitting.measure import Measure, Measured
from gaitsweep.near_miss import suggestion
from gaitsweep.schema.diagnostics import quoted
from gaitsweep.schema.numbers import Flag, InvalidValue, Positive, checked, read_real
from gaitsweep.schema.strict_model import StrictModel

PerSet = Float[np.ndarray, " sets"]  # a number for each set
# The miss of a target without a value, in reading errors: more than that of any meaningful value.
FAILED_MISS = 1.0e4
MISS = "miss_"  # prefix of the columns of misses


def _read_value_or_range(value: Any) -> tuple[float, float]:
    """Read a number, or [low, high]; a number is a range of its own."""
    if isinstance(value, list | tuple):
        if len(value) != 2:
            raise InvalidValue(f"is {quoted(value)}, but takes a number, or [low, high].")
        low, high = (read_real(end) for end in value)
        if low > high:
            raise InvalidValue(f"is {quoted(value)}, but low must not be above high.")
        return low, high
    number = read_real(value)
    return number, number


ValueOrRange = Annotated[
    tuple[float, float],
    PlainValidator(checked(_read_value_or_range)),
    WithJsonSchema({"type": ["number", "string", "array"]}),
]


class TargetValue(StrictModel):
    """Target value of a measure."""

    wanted: ValueOrRange = Field(description="the value, or [low, high] between which all are right")
    error: Positive = Field(description="the reading error, by which misses are divided")
    held_back: Flag = Field(
        default=False, description="measured, but not part of the score: kept to judge what was found"
    )


@dataclasses.dataclass(frozen=True)
class Target:
    """A measure with its target value."""

    measure: Measure
    value: TargetValue

    def shown(self, values: PerSet, model: Model) -> PerSet:
        """Return values (n,) for the table: angles within half a turn of the target value."""
        if not self.measure.circular(model):
            return values
        middle = 0.5 * sum(self.value.wanted)
        return middle + wrapped_difference(values - middle)

    def misses(self, measured: Measured, model: Model) -> PerSet:
        """Return the distance of values (n,) from the target, in reading errors; at most FAILED_MISS."""
        values = self.shown(measured.values, model)
        low, high = self.value.wanted
        beyond = values - np.clip(values, low, high)
        misses = np.clip(beyond / self.value.error, -FAILED_MISS, FAILED_MISS)
        return np.where(np.isnan(values), FAILED_MISS, misses)


def scores(misses: Mapping[str, PerSet], targets: Mapping[str, Target]) -> PerSet:
    """Compute the score of each set: the root mean square of its misses that count, in reading errors.

    Args:
        misses: misses (n,) by target.
        targets: the targets by name.
    """
    counted = [misses[name] for name, target in targets.items() if not target.value.held_back]
    return np.sqrt(np.mean(np.square(counted), axis=0))


@dataclasses.dataclass(frozen=True)
class Conflicts:
    """Targets that are met together.

    `sets` is the number of sets; `together` (targets, targets) the number of sets that meet both of two
    targets, or one on the diagonal; `nearest` (targets, targets) the least miss of the column's target, in
    reading errors, among the sets that meet the row's, NaN where no set has a value of both; `most` the
    targets met by the sets that meet most of them, and `most_sets` the number of these sets.
    """

    sets: int
    together: pd.DataFrame
    nearest: pd.DataFrame
    most: tuple[str, ...]
    most_sets: int


def conflicts(
    tables: pd.DataFrame | Sequence[pd.DataFrame],
    within: float = 1.0,
    targets: str | Sequence[str] | None = None,
) -> Conflicts:
    """Count the sets of searches for the same targets that meet one, two or more of them.

    Args:
        tables: the table of a search, or those of several.
        within: the miss up to which a target counts as met, in reading errors; one without a value is not.
        targets: names of the targets to compare; all of the tables by default, also those held back.

    Raises:
        ArgumentError: the tables are not those of searches, or have different targets, or `within` is not
            above 0.
    """
    if not within > 0.0:
        raise ArgumentError(f"within is {within:g}, but must be above 0.")
    tables = [tables] if isinstance(tables, pd.DataFrame) else tables
    names = _target_names(tables, names_in(targets or ()))
    columns = [f"{MISS}{name}" for name in names]
    misses = np.concatenate([np.abs(table[columns]) for table in tables])
    has_value = misses < FAILED_MISS
    met = has_value & (misses <= within)
    counts = met.T.astype(np.int64) @ met
    with_value = np.where(has_value, misses, np.inf)
    nearest = np.array([with_value[meets_row].min(axis=0, initial=np.inf) for meets_row in met.T])
    most, most_sets = _most_met(met)
    return Conflicts(
        sets=len(met),
        together=pd.DataFrame(counts, index=names, columns=names),
        nearest=pd.DataFrame(np.where(np.isfinite(nearest), nearest, np.nan), index=names, columns=names),
        most=tuple(name for name, is_met in zip(names, most, strict=True) if is_met),
        most_sets=most_sets,
    )


def _most_met(met: Bool[np.ndarray, "sets targets"]) -> tuple[Bool[np.ndarray, " targets"], int]:
    """Return the largest combination of targets that a set meets, the most frequent one, and its sets."""
    targets_met = met.sum(axis=1)
    largest = met[targets_met == targets_met.max(initial=0)]
    if not len(largest):
        return np.zeros(met.shape[1], bool), 0
    combinations, sets = np.unique(largest, axis=0, return_counts=True)
    most_frequent = int(sets.argmax())
    return combinations[most_frequent], int(sets[most_frequent])


def _target_names(tables: Sequence[pd.DataFrame], chosen: Sequence[str]) -> list[str]:
    """Return the chosen targets of searches, by default all; refuse tables with different targets."""
    target_names = [
        [str(column).removeprefix(MISS) for column in table.columns if str(column).startswith(MISS)]
        for table in tables
    ]
    if not target_names or not all(target_names):
        raise ArgumentError("This is not the table of a search: it has no columns miss_NAME of targets.")
    for names in target_names[1:]:
        if set(names) != set(target_names[0]):
            raise ArgumentError(
                f"The searches have different targets: {', '.join(target_names[0])} and {', '.join(names)}."
            )
    if not chosen:
        return target_names[0]
    for name in chosen:
        if name not in target_names[0]:
            raise ArgumentError(f"{name} is not a target of the search{suggestion(name, target_names[0])}")
    return list(chosen)
