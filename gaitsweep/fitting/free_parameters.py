"""Free constants of a search: ranges, whole numbers, and choices of structure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
from jaxtyping import Float, Shaped
from pydantic import Field, model_validator

from gaitsweep.schema.numbers import Flag, Real, wrong_value
from gaitsweep.schema.strict_model import StrictModel

# Constants and choices of structure of n sets, (n,) by name.
Sets = Mapping[str, Shaped[np.ndarray, " sets"]]
Shares = Float[np.ndarray, " sets"]  # of the range of a constant, from 0 to 1


def is_number(value: Any) -> bool:
    """Whether a value is a number, and no truth value."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def number_of_sets(number: int, kind: str = "set") -> str:
    """Format a number of sets, or of some `kind` of sets."""
    return f"{number} {kind}{'s' * (number != 1)}"


class FreeParameter(StrictModel, title="Free"):  # its name in the JSON schema of jobs
    """A free constant: within a range, or one of some choices."""

    low: Real | None = Field(default=None, description="least value")
    high: Real | None = Field(default=None, description="largest value")
    log: Flag = Field(default=False, description="whether equal ratios count, not equal differences")
    whole: Flag = Field(default=False, description="whether it is a whole number")
    choices: list[Any] | None = Field(
        default=None, min_length=2, description="values of which one is taken, of a constant or a structure"
    )

    @model_validator(mode="after")
    def _check_fields(self) -> Self:
        """Refuse fields that do not fit together."""
        if self.choices is not None:
            if self.low is not None or self.high is not None or self.log or self.whole:
                raise wrong_value("has choices, and a range as well: give one of the two.")
            (text, count), *_ = Counter(map(str, self.choices)).most_common(1)
            if count > 1:
                raise wrong_value(f"has the choice {text} twice.")
            return self
        if self.low is None or self.high is None:
            raise wrong_value("needs low and high, or choices.")
        if not self.low < self.high:
            raise wrong_value(f"goes from {self.low:g} to {self.high:g}: low is below high.")
        if self.log and self.whole:
            raise wrong_value("has log and whole, but whole numbers are chosen by equal differences.")
        if self.log and self.low <= 0.0:
            raise wrong_value(f"has low {self.low:g}, but equal ratios need a value above 0.")
        if math.isinf(self.high / self.low if self.log else self.high - self.low):
            span = "ratio" if self.log else "difference"
            raise wrong_value(f"goes from {self.low:g} to {self.high:g}, whose {span} is no finite number.")
        if self.whole and math.floor(self.high) <= math.ceil(self.low):
            raise wrong_value(f"has fewer than two whole numbers from {self.low:g} to {self.high:g}.")
        return self

    @property
    def ordered(self) -> FreeParameter:
        """The same constant, with its choices in ascending order if all are numbers."""
        if self.choices is None or not all(map(is_number, self.choices)):
            return self
        return self.model_copy(update={"choices": sorted(self.choices)})

    @property
    def _choice_array(self) -> Shaped[np.ndarray, " choices"]:
        """Choices as an array of numbers, or of objects."""
        assert self.choices is not None
        if all(map(is_number, self.choices)):
            return np.array(self.choices)
        choices = np.empty(len(self.choices), object)
        choices[:] = self.choices
        return choices

    @property
    def _range(self) -> tuple[float, float]:
        """Both ends of its range; only a constant without choices has them."""
        assert self.low is not None
        assert self.high is not None
        return self.low, self.high

    @property
    def _whole_range(self) -> tuple[int, int]:
        """Least and largest whole number of its range."""
        low, high = self._range
        return math.ceil(low), math.floor(high)

    @property
    def ends(self) -> tuple[Any, ...]:
        """Values that bound it: the ends of a range, or all choices."""
        return self._range if self.choices is None else tuple(self.choices)

    def outside(self, value: Any) -> str | None:
        """Return the end of a sentence why a value is not allowed; None if it is allowed."""
        if self.choices is not None:
            if value in self.choices:
                return None
            return f"which is not one of its choices {', '.join(map(str, self.choices))}."
        low, high = self._range
        if not low <= value <= high:
            return f"outside of its range, {low:g} to {high:g}."
        if self.whole and value != int(value):
            return "which is not a whole number."
        return None

    def at(self, share: Shares) -> Shaped[np.ndarray, " sets"]:
        """Return its values at shares of its range; choices are equal parts of the range.

        Args:
            share: the shares (n,), from 0 to 1; others are clipped.

        Returns:
            The values (n,): numbers are float64, choices of a structure are objects.
        """
        share = np.clip(share, 0.0, 1.0)
        if self.choices is not None:
            number = np.minimum((share * len(self.choices)).astype(int), len(self.choices) - 1)
            return self._choice_array[number]
        low, high = self._range
        if self.whole:
            least, most = self._whole_range
            return np.minimum(least + np.floor(share * (most - least + 1)), most).astype(float)
        if self.log:
            value = np.exp(math.log(low) + share * math.log(high / low))
            return np.clip(value, low, high)  # rounding goes past the ends
        return low + share * (high - low)

    def written(self, values: Sequence[Any]) -> list[Any]:
        """Convert values of a table to those of the job: a table has choices of structure as text."""
        if self.choices is None:
            return list(values)
        by_text = {str(choice): choice for choice in self.choices}
        return [value if value in self.choices else by_text.get(str(value), value) for value in values]

    def column(self, values: Sequence[Any]) -> Shaped[np.ndarray, " sets"]:
        """Convert values (n,) of a table to those that `at` returns."""
        if self.choices is None:
            return np.asarray(values, float)
        return self._choice_array[[self.choices.index(value) for value in self.written(values)]]

    def share(self, values: Sequence[Any] | Shaped[np.ndarray, " sets"]) -> Shares:
        """Return the shares (n,) of its range at these values: the inverse of `at`."""
        if self.choices is not None:
            return np.array([(self.choices.index(value) + 0.5) / len(self.choices) for value in values])
        low, high = self._range
        numbers = np.asarray(values, float)
        if self.whole:
            least, most = self._whole_range
            return (numbers - least + 0.5) / (most - least + 1)
        if self.log:
            return np.log(numbers / low) / math.log(high / low)
        return (numbers - low) / (high - low)


def sets_at(
    free: Mapping[str, FreeParameter], shares: Float[np.ndarray, "sets constants"]
) -> dict[str, Shaped[np.ndarray, " sets"]]:
    """Return the constants of sets at points of the unit cube.

    Args:
        free: the free constants by name.
        shares: the points (n, constants).

    Returns:
        The values (n,) by name.
    """
    return {name: parameter.at(shares[:, i]) for i, (name, parameter) in enumerate(free.items())}
