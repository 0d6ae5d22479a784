"""Targets of a search: measures with target values, robustness among them, and the misses of a set.

The robustness of a set is the share of its random neighbours that keep targets.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PlainValidator, WithJsonSchema

from gaitsweep import near_miss
from gaitsweep.angle_difference import wrapped_difference
from gaitsweep.contract import Model, Quantity
from gaitsweep.fitting.fit_job import FitJob
from gaitsweep.fitting.free_parameters import FreeParameter, Sets
from gaitsweep.fitting.measure import Conditions, FieldError, Measure, Measured
from gaitsweep.kinds import RunKind
from gaitsweep.schema.diagnostics import Diagnostic, JobError, quoted
from gaitsweep.schema.numbers import Count, Flag, InvalidValue, Positive, Seed, Text, checked, read_real
from gaitsweep.schema.strict_model import StrictModel

# The miss of a target without a value, in reading errors: more than that of any meaningful value.
FAILED_MISS = 1.0e4

# Names of the columns of misses.
MISS = "miss_"


def _read_value_or_range(value: Any) -> tuple[float, float]:
    """Read a number, or [low, high]; a number is a range of its own."""
    if isinstance(value, list | tuple):
        if len(value) != 2:
            raise InvalidValue(f"is {quoted(value)}, but takes a number, or [low, high].")
        low, high = (read_real(end) for end in value)
        if low > high:
            raise InvalidValue(f"is {quoted(value)}, but low is not above high.")
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


class Target:
    """A measure with its target value.

    Args:
        name: name of the target.
        measure: the measure.
        value: its target value.
    """

    def __init__(self, name: str, measure: Measure, value: TargetValue) -> None:
        self.name, self.measure, self.value = name, measure, value

    def shown(self, values: np.ndarray, model: Model) -> np.ndarray:
        """Return values (n,) for the table: angles within half a turn of the target value."""
        if not self.measure.circular(model):
            return values
        middle = 0.5 * sum(self.value.wanted)
        return middle + wrapped_difference(values - middle)

    def misses(self, measured: Measured, model: Model) -> np.ndarray:
        """Return the distance of values (n,) from the target, in reading errors; at most FAILED_MISS."""
        values = self.shown(measured.values, model)
        low, high = self.value.wanted
        beyond = values - np.clip(values, low, high)
        misses = np.clip(beyond / self.value.error, -FAILED_MISS, FAILED_MISS)
        return np.where(np.isnan(values), FAILED_MISS, misses)


def scores(misses: Mapping[str, np.ndarray], targets: Mapping[str, Target]) -> np.ndarray:
    """Compute the root mean squares (n,) of the misses that count, in reading errors."""
    counted = [misses[name] for name, target in targets.items() if not target.value.held_back]
    return np.sqrt(np.mean(np.square(counted), axis=0))


# The name of the target, and of its column.
ROBUST = "robust"


class Robust(TargetValue):
    """The share of a set's random neighbours that should keep some targets."""

    within: Positive = Field(description="largest change of each constant, as a share of its value, below 1")
    targets: list[Text] = Field(
        min_length=1, description="targets that a neighbour keeps, within their error"
    )
    sets: Count = Field(default=24, description="neighbours of each set")
    constants: list[Text] = Field(
        default=[],
        description="constants of the job that change too; those that are free, but for choices, always do",
    )
    seed: Seed = Field(default=0, description="seed of the changes, which are the same for all sets")


class ShareKept(Measure):
    """The share of a set's neighbours that keep some targets."""

    kind: Literal["robust"] = Field(description="robust: the share of neighbours that keep the targets named")
    at: Conditions = Field(default_factory=dict, description="no rows of its own")

    def unit(self, model: Model) -> str:
        return "1"

    @property
    def own_run(self) -> RunKind | None:
        return None

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        return None


def robust_target(robust: Robust) -> Target:
    """Return the target of the field `robust` of a search."""
    return Target(ROBUST, ShareKept(kind="robust"), robust)


def check_robust(
    robust: Robust, free: Mapping[str, FreeParameter], targets: Mapping[str, Target]
) -> list[Diagnostic]:
    """Check the field against the search's constants and targets."""
    path, wrong = ("search", ROBUST), []
    if robust.within >= 1.0:
        wrong.append(Diagnostic((*path, "within"), f"is {robust.within:g}, but is a share below 1."))
    for place, name in enumerate(robust.targets):
        if name not in targets:
            text = f"is {name}, which is not a target{near_miss.suggestion(name, targets)}"
            wrong.append(Diagnostic((*path, "targets", place), text))
    for place, name in enumerate(robust.constants):
        if name in free:
            wrong.append(Diagnostic((*path, "constants", place), f"is {name}, which is free and changes."))
    if ROBUST in targets:
        text = "has the name of the column of search.robust: take another."
        wrong.append(Diagnostic(("search", "targets", ROBUST), text))
    return wrong


def own_constants(robust: Robust, fit: FitJob) -> dict[str, float]:
    """Return the values of the job's own constants that change.

    Raises:
        JobError: the model does not have a name, or its value is a formula.
    """
    job = fit.job_of(fit.structures[0])
    parameters = {q.name: q for q in job.design.model.parameters}
    values: dict[str, float] = {}
    wrong = []
    for place, name in enumerate(robust.constants):
        setting = job.design.settings.get(name, parameters[name].default if name in parameters else None)
        if name not in parameters:
            text = f"is {name}, which is not a parameter{near_miss.suggestion(name, parameters)}"
        elif not isinstance(setting, int | float):
            text = f"is {name}, whose value is {setting}: only a number can change by a share of itself."
        else:
            values[name] = float(setting)
            continue
        wrong.append(Diagnostic(("search", ROBUST, "constants", place), text))
    if wrong:
        raise JobError(wrong)
    return values


def share_kept(
    robust: Robust,
    sets: Sets,
    own: Mapping[str, float],
    free: Mapping[str, FreeParameter],
    quantities: Mapping[str, Quantity],
    keeps: Callable[[Sets], np.ndarray],
) -> np.ndarray:
    """Compute the share (n,) of each set's neighbours that keep the targets.

    Args:
        robust: number and range of the neighbours.
        sets: constants and choices of structure, (n,) by name.
        own: values of the job's constants that change as well.
        free: the free constants; those with choices, and whole numbers, do not change.
        quantities: the model's parameters and starts by name, within whose limits neighbours stay.
        keeps: returns whether each of m sets keeps the targets, (m,).
    """
    n = next(iter(sets.values())).size
    rng = np.random.default_rng(robust.seed)
    near = {name: np.repeat(column, robust.sets) for name, column in sets.items()}
    near |= {name: np.full(n * robust.sets, value) for name, value in own.items()}
    changing = [name for name, parameter in free.items() if parameter.choices is None and not parameter.whole]
    for name in [*changing, *own]:
        quantity = quantities[name]
        factor = 1.0 + robust.within * rng.uniform(-1.0, 1.0, robust.sets)
        near[name] = np.clip(near[name] * np.tile(factor, n), quantity.low, quantity.high)
    return keeps(near).reshape(n, robust.sets).mean(axis=1)
