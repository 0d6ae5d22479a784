"""The registry of measures: functions from tables to what a claim is about."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, TypeVar

from pydantic import AfterValidator

from gaitsweep.expression import read_condition

# Selects the records of a table; a claim's is checked when its list is read.
Condition = Annotated[str, AfterValidator(read_condition)]
Value = float | str | Sequence[float] | Sequence[str]
Measure = TypeVar("Measure", bound=Callable[..., Value])

MEASURES: dict[str, Callable[..., Value]] = {}


def measure(function: Measure) -> Measure:
    """Register a function as a measure, under its name; a decorator.

    A measure takes the tables of a claim's jobs by position and the fields of `with` by keyword. It returns
    a number, a text, or a list of either. It raises UserError where the tables do not show what it measures.

    Raises:
        ValueError: another function has this name.
    """
    name = function.__name__
    if MEASURES.setdefault(name, function) is not function:
        raise ValueError(f"There is a measure named {name}: give this one another name.")
    return function
