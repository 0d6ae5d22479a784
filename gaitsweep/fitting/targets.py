"""Targets of a search: measures with target values, and the misses and scores of sets."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import Field, PlainValidator, WithJsonSchema

from gaitsweep.angles import wrapped_difference
from gaitsweep.contract import Model
from gaitsweep.fitting.measure import Measure, Measured
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
    WithJsonSchema({"type": ["number", "array"]}),
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
