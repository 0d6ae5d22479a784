"""Robustness of a set of constants: the share of its random neighbours that keep targets of a search."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from pydantic import Field

from gaitsweep import near_miss
from gaitsweep.contract import Model, Quantity
from gaitsweep.fitting.free_parameters import FreeParameter, Sets
from gaitsweep.fitting.measure import Conditions, FieldError, Measure
from gaitsweep.fitting.search_and_sensitivity_job import FitJob, expressions_left_behind
from gaitsweep.fitting.targets import Target, TargetValue
from gaitsweep.kinds import RunKind
from gaitsweep.schema.diagnostics import Diagnostic, refuse
from gaitsweep.schema.numbers import Count, Positive, Seed, Text

# The name of the target, and of its column.
ROBUST = "robust"


class Robust(TargetValue):
    """Target of the share of a set's random neighbours that keep some targets."""

    within: Positive = Field(description="largest change of each constant, as a share of its value, below 1")
    targets: list[Text] = Field(
        min_length=1, description="targets that a neighbour keeps, within their error"
    )
    sets: Count = Field(default=24, description="neighbours of each set")
    constants: list[Text] = Field(
        default=[],
        description="constants of the job that change too; those that are free always do, but for choices "
        "and whole numbers",
    )
    seed: Seed = Field(default=0, description="seed of the changes, which are the same for all sets")


class ShareKept(Measure):
    """Share of a set's neighbours that keep some targets; `share_kept` computes it."""

    kind: Literal["robust"] = Field(description="robust: the share of neighbours that keep the targets named")
    at: Conditions = Field(default_factory=dict, description="no rows of its own")

    @property
    def own_run(self) -> RunKind | None:
        return None

    def field_error(self, columns: Sequence[str], model: Model) -> FieldError:
        return None


def check_robust(
    robust: Robust, free: Mapping[str, FreeParameter], targets: Mapping[str, Target]
) -> list[Diagnostic]:
    """Check the field `robust` of a search; return the diagnostics.

    Args:
        robust: the field.
        free: the free constants by name.
        targets: the other targets by name.
    """
    path = ("search", ROBUST)
    wrong = []
    if robust.within >= 1.0:
        wrong.append(Diagnostic((*path, "within"), f"is {robust.within:g}, but is a share below 1."))
    for number, name in enumerate(robust.targets):
        if name not in targets:
            text = f"is {name}, which is not a target{near_miss.suggestion(name, targets)}"
            wrong.append(Diagnostic((*path, "targets", number), text))
    for number, name in enumerate(robust.constants):
        if name in free:
            wrong.append(Diagnostic((*path, "constants", number), f"is {name}, which is free and changes."))
    if ROBUST in targets:
        text = "has the name of the column of search.robust: take another."
        wrong.append(Diagnostic(("search", "targets", ROBUST), text))
    return wrong


def own_constants(robust: Robust, fit: FitJob) -> dict[str, float]:
    """Return the values of the job's own constants that change, by name.

    Args:
        robust: the field that names them.
        fit: the job.

    Raises:
        JobError: the model does not have a name, it takes whole numbers only, or its value is a formula or 0.
    """
    job = fit.job_of(fit.structures[0])
    parameters = {quantity.name: quantity for quantity in job.design.model.parameters}
    values: dict[str, float] = {}
    wrong = []
    for number, name in enumerate(robust.constants):
        path = ("search", ROBUST, "constants", number)
        if name not in parameters:
            text = f"is {name}, which is not a parameter{near_miss.suggestion(name, parameters)}"
            wrong.append(Diagnostic(path, text))
            continue
        if parameters[name].whole:
            text = f"is {name}, which takes whole numbers only and cannot change by a share of itself."
            wrong.append(Diagnostic(path, text))
            continue
        setting = job.design.settings.get(name, parameters[name].default)
        if isinstance(setting, int | float) and setting != 0:
            values[name] = float(setting)
        else:
            numbers = "only a number other than 0 can change by a share of itself."
            text = f"is {name}, whose value is {setting}: {numbers}"
            wrong.append(Diagnostic(path, text))
        wrong += expressions_left_behind(job, {name: path})
    refuse(wrong)
    return values


def share_kept(
    robust: Robust,
    sets: Sets,
    *,
    own: Mapping[str, float],
    free: Mapping[str, FreeParameter],
    quantities: Mapping[str, Quantity],
    keeps: Callable[[Sets], Bool[np.ndarray, " neighbours"]],
) -> Float[np.ndarray, " sets"]:
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
    neighbours = {name: np.repeat(column, robust.sets) for name, column in sets.items()}
    neighbours |= {name: np.full(n * robust.sets, value) for name, value in own.items()}
    changing = [name for name, parameter in free.items() if parameter.choices is None and not parameter.whole]
    for name in [*changing, *own]:
        quantity = quantities[name]
        factor = 1.0 + robust.within * rng.uniform(-1.0, 1.0, robust.sets)
        changed = neighbours[name] * np.tile(factor, n)
        low, high = quantity.low, quantity.high
        if quantity.open_ends:
            low, high = np.nextafter(low, np.inf), np.nextafter(high, -np.inf)
        neighbours[name] = np.clip(changed, low, high)
    return keeps(neighbours).reshape(n, robust.sets).mean(axis=1)
