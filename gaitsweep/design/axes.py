"""Axes: their forms in a job (`values`, `linspace`, `random`, ...), and the points of grids by index.

`samples` draws random, Latin hypercube and Sobol points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from jaxtyping import Float, Int
from pydantic import BeforeValidator, Field

from gaitsweep.design.samples import RandomAxis, SampleBox, SampleMethod
from gaitsweep.expression import ExpressionError, evaluate, names_used
from gaitsweep.schema.diagnostics import quoted
from gaitsweep.schema.numbers import InvalidValue, Number, PointCount, Seed, Text, Word, checked
from gaitsweep.schema.strict_model import StrictModel

MAX_LISTED = 10**6  # points of a list; more follow from a rule


def _check_length(value: Any, length: int, words: str) -> Any:
    """Return a list of this length; raises InvalidValue, with the form in words, for other values."""
    if not isinstance(value, (list, tuple)) or len(value) != length:
        raise InvalidValue(f"is {quoted(value)}, but must be {words}.")
    return value


_ENDS_AND_COUNT = BeforeValidator(checked(_check_length, length=3, words="[first, last, number of points]"))
_ENDS = BeforeValidator(checked(_check_length, length=2, words="[low, high]"))
EndsAndCount = Annotated[tuple[Number, Number, PointCount], _ENDS_AND_COUNT]
Ends = Annotated[tuple[Number, Number], _ENDS]
At = Annotated[Literal["ends", "centre"], Word()]
_AT_WORDS = "ends: both ends are points; centre: the points are the centres of equal cells"
_SEED = "seed of the points, combined with the name of the axis"


class Values(StrictModel):
    """Points listed one by one."""

    values: list[Number] = Field(min_length=1, max_length=MAX_LISTED, description="the points")

    def axis(self, name: str) -> ListAxis:
        """Return the axis; its name does not matter."""
        return ListAxis(tuple(self.values))


class Linspace(StrictModel):
    """Equally spaced points."""

    linspace: EndsAndCount = Field(description="[first, last, number of points]")
    at: At = Field(default="ends", description=_AT_WORDS)

    def axis(self, name: str) -> RangeAxis:
        """Return the axis; its name does not matter."""
        return RangeAxis(*self.linspace, LinearSpacing(self.linspace[2], self.at))


class Logspace(StrictModel):
    """Points with equal ratios, between two ends above 0."""

    logspace: EndsAndCount = Field(description="[first, last, number of points], the ends above 0")
    at: At = Field(default="ends", description=_AT_WORDS)

    def axis(self, name: str) -> RangeAxis:
        """Return the axis; its name does not matter."""
        return RangeAxis(*self.logspace, LinearSpacing(self.logspace[2], self.at), logarithmic=True)


class Random(StrictModel):
    """Independent uniform points."""

    random: EndsAndCount = Field(description="[low, high, number of points]")
    seed: Seed = Field(default=0, description=_SEED)

    def axis(self, name: str) -> RangeAxis:
        """Return the axis of a name, with which its points are drawn."""
        box = SampleBox((name,), self.random[2], self.seed, "random")
        return RangeAxis(*self.random, RandomAxis(box, name))


class Sobol(StrictModel):
    """Points of a shifted Sobol sequence."""

    sobol: EndsAndCount = Field(description="[low, high, number of points]")
    seed: Seed = Field(default=0, description=_SEED)

    def axis(self, name: str) -> RangeAxis:
        """Return the axis of a name, with which its points are drawn."""
        box = SampleBox((name,), self.sobol[2], self.seed, "sobol")
        return RangeAxis(*self.sobol, RandomAxis(box, name))


class Sample(StrictModel):
    """Points of a box that are drawn together."""

    n: PointCount = Field(description="number of points")
    seed: Seed = Field(default=0, description=_SEED)
    method: Annotated[SampleMethod, Word()] = Field(
        default="random",
        description="random: independent uniform points; latin_hypercube: one point in each of n equal parts "
        "of each range; sobol: one joint Sobol sequence, which covers the box evenly",
    )
    of: dict[Text, Ends] = Field(min_length=1, description="[low, high] by name")

    def axes(self) -> dict[str, RangeAxis]:
        """Return the axis of each name; all share one box, whose points are drawn once."""
        box = SampleBox(tuple(self.of), self.n, self.seed, self.method)
        return {name: RangeAxis(*ends, self.n, RandomAxis(box, name)) for name, ends in self.of.items()}


WrittenAxis = Values | Linspace | Logspace | Random | Sobol
AXIS_KINDS: dict[str, type[WrittenAxis]] = {kind.__name__.lower(): kind for kind in get_args(WrittenAxis)}


@dataclass(frozen=True)
class ListAxis:
    """Points listed one by one: numbers or expressions, or an array (length,) of numbers."""

    numbers: tuple[float | str, ...] | Float[np.ndarray, " points"]
    drawn: ClassVar[bool] = False

    @property
    def length(self) -> int:
        """Number of points."""
        return len(self.numbers)

    @property
    def formulas(self) -> tuple[str, ...]:
        """Expressions among its numbers."""
        return tuple(self._formula_at.values())

    def at(self, index: Int[np.ndarray, " rows"], names: Mapping[str, Any]) -> Float[np.ndarray, " rows"]:
        """Return points of the axis in some rows.

        Args:
            index: the numbers of the points (n,).
            names: a float or (n,) for each name in the formulas.

        Raises:
            ExpressionError: a formula has no value.
        """
        points = self._plain[index]
        for place in np.intersect1d(index, list(self._formula_at)) if self._formula_at else ():
            formula = self._formula_at[place]
            mask = index == place
            used = {}
            for name in names_used(formula):
                value = names[name]
                used[name] = value if np.ndim(value) == 0 else value[mask]
            points[mask] = evaluate(formula, used)
        return points

    @cached_property
    def _formula_at(self) -> dict[int, str]:
        """Formulas by their places in the list."""
        if isinstance(self.numbers, np.ndarray) or str not in set(map(type, self.numbers)):
            return {}
        return {place: number for place, number in enumerate(self.numbers) if isinstance(number, str)}

    @cached_property
    def _plain(self) -> Float[np.ndarray, " points"]:
        """Numbers (length,), with NaN for formulas."""
        if isinstance(self.numbers, np.ndarray):
            return self.numbers.astype(np.float64)
        if not self._formula_at:
            return np.array(self.numbers, np.float64)
        return np.array([np.nan if isinstance(number, str) else number for number in self.numbers])


@dataclass(frozen=True)
class LinearSpacing:
    """Equal steps over [0, 1]: both ends included, or the centres of equal cells."""

    count: int
    at: Literal["ends", "centre"]

    def __call__(self, index: Int[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
        """Return the positions (n,) of points in [0, 1]."""
        if self.at == "centre":
            return (index + 0.5) / self.count
        return index / max(self.count - 1, 1)


@dataclass(frozen=True)
class RangeAxis:
    """Points between two ends, linearly or by their logarithms; `fraction` maps indices (n,) to [0, 1]."""

    low: float | str
    high: float | str
    length: int
    fraction: LinearSpacing | RandomAxis
    logarithmic: bool = False

    @property
    def drawn(self) -> bool:
        """Whether its points are drawn from a sample; others have equal steps or ratios."""
        return isinstance(self.fraction, RandomAxis)

    @property
    def formulas(self) -> tuple[str, ...]:
        """Expressions among its ends."""
        return tuple(number for number in (self.low, self.high) if isinstance(number, str))

    def at(self, index: Int[np.ndarray, " rows"], names: Mapping[str, Any]) -> Float[np.ndarray, " rows"]:
        """Return points of the axis in some rows.

        Args:
            index: the numbers of the points (n,).
            names: a float or (n,) for each name in the ends.

        Raises:
            ExpressionError: an end of a logarithmic axis is not above 0.
        """
        low = evaluate(self.low, {name: names[name] for name in names_used(self.low)})
        high = evaluate(self.high, {name: names[name] for name in names_used(self.high)})
        fraction = self.fraction(index)
        if not self.logarithmic:
            between = low + (high - low) * fraction
            if isinstance(self.fraction, LinearSpacing) and self.fraction.at == "ends":
                # a seed of 12.999999999999998 would be another one
                step = np.asarray(high - low) / max(self.length - 1, 1)
                is_whole = (step == np.round(step)) & (low == np.round(low))
                between = np.where(is_whole, low + step * index, between)
        elif np.any(np.less_equal(low, 0.0)) or np.any(np.less_equal(high, 0.0)):
            raise ExpressionError("the ends of a logspace must be above 0.")
        else:
            between = np.exp(np.log(low) + (np.log(high) - np.log(low)) * fraction)
        # the ends exactly as written, although low + (high - low) may be rounded
        return np.where(fraction == 0.0, low, np.where(fraction == 1.0, high, between))


Axis = ListAxis | RangeAxis
