"""The axes of a job, as written (`values`, `linspace`, ...) and as rows read them, point by point."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal, get_args

import numpy as np
import scipy
from pydantic import BeforeValidator, Field

from gaitsweep.expression import ExpressionError, evaluate, names_in
from gaitsweep.kinds.diagnostics import found
from gaitsweep.kinds.numbers import InvalidValue, Number, PointCount, Seed, Text, checked, word
from gaitsweep.kinds.part import Part

MOST_LISTED = 10**6  # points that a list has one by one; more are better said by their rule
_SOBOL_BITS = 30
_SOBOL_CHUNK = 2**16  # points drawn at a time: a power of two, as the sequence asks


def _of_length(value: Any, length: int, words: str) -> Any:
    if not isinstance(value, (list, tuple)) or len(value) != length:
        raise InvalidValue(f"is {found(value)}, but takes {words}.")
    return value


_THREE = BeforeValidator(checked(_of_length, length=3, words="[first, last, number of points]"))
_TWO = BeforeValidator(checked(_of_length, length=2, words="[low, high]"))
Ends = Annotated[tuple[Number, Number, PointCount], _THREE]
At = Annotated[Literal["ends", "centre"], word("ends", "centre")]
_AT = "ends: both ends are points; centre: the points are the middles of equal cells"
_SEED = "seed of the points, with the name of what varies"


class Values(Part):
    """Points one by one."""

    values: list[Number] = Field(min_length=1, max_length=MOST_LISTED, description="the points")


class Linspace(Part):
    """Points at equal distances."""

    linspace: Ends = Field(description="[first, last, number of points]")
    at: At = Field(default="ends", description=_AT)


class Logspace(Part):
    """Points at equal ratios, the ends given as values above 0."""

    logspace: Ends = Field(description="[first, last, number of points], the ends above 0")
    at: At = Field(default="ends", description=_AT)


class Random(Part):
    """Independent uniform points."""

    random: Ends = Field(description="[low, high, number of points]")
    seed: Seed = Field(default=0, description=_SEED)


class Sobol(Part):
    """Points of a shifted Sobol sequence."""

    sobol: Ends = Field(description="[low, high, number of points]")
    seed: Seed = Field(default=0, description=_SEED)


class Sample(Part):
    """Points of a box, drawn together."""

    n: PointCount = Field(description="number of points")
    seed: Seed = Field(default=0, description=_SEED)
    method: Annotated[Literal["random", "sobol"], word("random", "sobol")] = Field(
        default="random", description="random: independent uniform points; sobol: one joint Sobol sequence"
    )
    of: dict[Text, Annotated[tuple[Number, Number], _TWO]] = Field(
        min_length=1, description="[low, high] of each name that varies"
    )


Axis = Values | Linspace | Logspace | Random | Sobol
AXIS_KINDS: dict[str, type[Part]] = {part.__name__.lower(): part for part in get_args(Axis)}


@dataclass(frozen=True)
class Listed:
    """Points given one by one, numbers or expressions."""

    numbers: tuple[float | str, ...]

    @property
    def length(self) -> int:
        return len(self.numbers)

    @cached_property
    def formulas(self) -> tuple[str, ...]:
        """The expressions among its numbers."""
        return tuple(number for number in self.numbers if isinstance(number, str))

    def at(self, index: np.ndarray, names: Mapping[str, Any]) -> np.ndarray:
        """Points `index` (n,); `names` has a float or (n,) for each name that the formulas use."""
        result = self._plain[index]
        for place in np.intersect1d(index, self._written):
            number, here = self.numbers[place], index == place
            some = {name: names[name] for name in names_in(number)}
            used = {name: value if np.ndim(value) == 0 else value[here] for name, value in some.items()}
            result[here] = evaluate(number, used)
        return result

    @cached_property
    def _plain(self) -> np.ndarray:
        """The numbers (length,), NaN where one is a formula."""
        return np.array([np.nan if isinstance(number, str) else number for number in self.numbers])

    @cached_property
    def _written(self) -> np.ndarray:
        """The places of the formulas."""
        return np.flatnonzero([isinstance(number, str) for number in self.numbers])


@dataclass(frozen=True)
class Steps:
    """Equal steps over [0, 1]: both ends included, or the middles of equal cells."""

    count: int
    at: str

    def __call__(self, index: np.ndarray) -> np.ndarray:
        return (index + 0.5) / self.count if self.at == "centre" else index / max(self.count - 1, 1)


@dataclass(frozen=True)
class Box:
    """The points of a sample, drawn together when the first of them is asked for."""

    names: tuple[str, ...]
    count: int
    seed: int
    method: str

    @cached_property
    def points(self) -> dict[str, np.ndarray]:
        """Points of [0, 1) by name, (count,)."""
        if self.method == "random":
            # 53 bits of each word, as a float of [0, 1) has
            shift = np.uint64(11)
            return {name: (_bits(self.seed, name, self.count) >> shift) * 2.0**-53 for name in self.names}
        return _sobol(self.seed, list(self.names), self.count)


@dataclass(frozen=True)
class Drawn:
    """Points of [0, 1) that are drawn: one name's of a box, (length,)."""

    box: Box
    name: str

    def __call__(self, index: np.ndarray) -> np.ndarray:
        return self.box.points[self.name][index]


@dataclass(frozen=True)
class Spread:
    """Points between two ends, linearly or by their logarithms; `fraction` maps indices (n,) to [0, 1]."""

    low: float | str
    high: float | str
    length: int
    fraction: Steps | Drawn
    logarithmic: bool = False

    @property
    def formulas(self) -> tuple[str, ...]:
        """The expressions among its ends."""
        return tuple(number for number in (self.low, self.high) if isinstance(number, str))

    def at(self, index: np.ndarray, names: Mapping[str, Any]) -> np.ndarray:
        """Points `index` (n,); `names` has a float or (n,) for each name that the ends use.

        Raises:
            ExpressionError: an end of a logarithmic axis that is not above 0.
        """
        low, high = (
            evaluate(end, {name: names[name] for name in names_in(end)}) for end in (self.low, self.high)
        )
        part = self.fraction(index)
        if not self.logarithmic:
            between = low + (high - low) * part
        else:
            if np.any(np.less_equal(low, 0.0)) or np.any(np.less_equal(high, 0.0)):
                raise ExpressionError("the ends of a logspace must be above 0.")
            between = np.exp(np.log(low) + (np.log(high) - np.log(low)) * part)
        # The ends exactly as written, whatever rounding makes of low + (high - low).
        return np.where(part == 0.0, low, np.where(part == 1.0, high, between))


Points = Listed | Spread


def points_of(axis: Axis, name: str) -> Points:
    """The points of an axis that varies `name`."""
    if isinstance(axis, Values):
        return Listed(tuple(axis.values))
    if isinstance(axis, (Linspace, Logspace)):
        low, high, count = axis.linspace if isinstance(axis, Linspace) else axis.logspace
        return Spread(low, high, count, Steps(count, axis.at), isinstance(axis, Logspace))
    low, high, count = axis.random if isinstance(axis, Random) else axis.sobol
    method = "random" if isinstance(axis, Random) else "sobol"
    return sample_points(Sample(n=count, seed=axis.seed, method=method, of={name: (low, high)}))[name]


def sample_points(sample: Sample) -> dict[str, Spread]:
    """The points of each name of a sample, drawn once: a slice of rows sees what the whole sees."""
    box = Box(tuple(sample.of), sample.n, sample.seed, sample.method)
    return {name: Spread(*ends, sample.n, Drawn(box, name)) for name, ends in sample.of.items()}


def _bits(seed: int, name: str, count: int) -> np.ndarray:
    """Raw 64-bit words, of which NumPy promises that they never change; each name has a stream of its own."""
    key = int.from_bytes(hashlib.sha256(f"{seed} {name}".encode()).digest()[:16], "big")
    return np.asarray(np.random.Philox(key=key).random_raw(count))


def _sobol(seed: int, names: list[str], count: int) -> dict[str, np.ndarray]:
    """An unscrambled Sobol sequence under a digital shift of our own: SciPy's scrambling may change."""
    sequence = scipy.stats.qmc.Sobol(len(names), scramble=False, bits=_SOBOL_BITS)
    shifts = [_bits(seed, name, 1)[0] >> np.uint64(64 - _SOBOL_BITS) for name in names]
    points = np.empty((len(names), count))
    for first in range(0, count, _SOBOL_CHUNK):
        part = sequence.random(min(_SOBOL_CHUNK, 1 << (count - 1).bit_length()))[: count - first]
        cells = np.rint(part * 2.0**_SOBOL_BITS).astype(np.uint64)
        for column, shift in enumerate(shifts):
            drawn = ((cells[:, column] ^ shift) + 0.5) * 2.0**-_SOBOL_BITS
            points[column, first : first + len(part)] = drawn
    return dict(zip(names, points, strict=True))
