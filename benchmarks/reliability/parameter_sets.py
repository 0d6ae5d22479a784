"""Random parameter sets of a model, the job that runs them, and an independent integrator for each set."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

TESTS = Path(__file__).resolve().parents[2] / "tests"
if str(TESTS) not in sys.path:
    sys.path.insert(0, str(TESTS))

Values = dict[str, float]
TURN = 2.0 * np.pi


def between(random: np.random.Generator, low: float, high: float) -> float:
    """A number that is uniform between two others."""
    return float(random.uniform(low, high))


def times(random: np.random.Generator, value: float, low: float, high: float) -> float:
    """A value times a factor whose logarithm is uniform."""
    return value * float(np.exp(random.uniform(np.log(low), np.log(high))))


@dataclass(frozen=True)
class Found:
    """One integrator's outcome of one set: `complete`, `fell` or `failed`, and the section's observables."""

    status: str
    observed: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Observable:
    """Tolerance of an observable: `scale` is what counts as 1 rad, `period` that of a circular one.

    `scale` may follow from a set's values.
    """

    scale: float | Callable[[Values], float] = 1.0
    period: float | None = None

    def apart(self, one: float, other: float, values: Values) -> float:
        """The distance of two values, in rad."""
        scale = self.scale(values) if callable(self.scale) else self.scale
        gap = abs(one - other)
        if self.period is not None:
            gap = min(gap % self.period, self.period - gap % self.period)
        return gap / scale


@dataclass(frozen=True)
class Subject:
    """A model whose parameters are drawn.

    `draw(random, n)` gives n sets; `fixed` are values that all share; `starts` names those that are starts.
    `reference(values, nudge)` runs the independent integrator, as fine as it must be: with `nudge` from a
    start moved by 1e-9, and where it is right for any step at a finer tolerance. `same_steps`: the model is
    defined by its steps, and the independent integrator is given them, as `dt` (s) among the values.
    """

    model: str
    observables: Mapping[str, Observable]
    draw: Callable[[np.random.Generator, int], list[Values]]
    reference: Callable[[Values, bool], Found]
    starts: tuple[str, ...]
    fixed: Values = field(default_factory=dict)
    structure: Mapping[str, Any] = field(default_factory=dict)
    same_steps: bool = False
    ranges: str = ""
    about: str = ""

    def distance(self, one: Found, other: Found, values: Values) -> float:
        """The largest distance of any observable, rad; NaN where one of the two has none."""
        if not one.observed or not other.observed:
            return float("nan")
        gaps = [
            seen.apart(one.observed[name], other.observed[name], values)
            for name, seen in self.observables.items()
        ]
        return float(np.max(gaps))
