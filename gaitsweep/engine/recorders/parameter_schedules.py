"""Schedules of a parameter that moves along a path while a row runs: at a constant rate, or in steps."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

# Parts of a pass at whose ends the length of steps is evaluated; it changes smoothly with a parameter.
PARTS_OF_A_PASS = 4
# The share of a step by which a distance may be longer than its whole number of steps, from rounding.
_ROUNDING = 1e-9
# A time counts as a change if it is before the change by fewer resolutions of the longest time than this.
_EARLY = 16


@dataclasses.dataclass(frozen=True)
class RampSchedule:
    """Straight passes between values of a parameter at a constant rate.

    Args:
        values: the values at which passes begin and end, two at least.
        rate: the rate (units of the parameter per s), above 0.
        initial_dwell: the time for which the first value stays before the first pass (s).
    """

    values: tuple[float, ...]
    rate: float
    initial_dwell: float = 0.0

    @property
    def knots(self) -> Float[np.ndarray, " values"]:
        """Times (s) at which a pass begins or ends, one for each value."""
        lengths = [abs(b - a) / self.rate for a, b in itertools.pairwise(self.values)]
        return self.initial_dwell + np.concatenate([[0.0], np.cumsum(lengths)])

    @property
    def duration(self) -> float:
        """The end of the last pass (s)."""
        return float(self.knots[-1])

    @property
    def times(self) -> tuple[float, ...]:
        """The knots, and instants that divide each pass in `PARTS_OF_A_PASS` equal ones."""
        passes = itertools.pairwise(self.knots)
        inner = [np.linspace(since, until, PARTS_OF_A_PASS + 1) for since, until in passes]
        return tuple(float(t) for t in np.unique(np.concatenate(inner)))

    def at(self, t: Float[Array, " *times"] | Float[np.ndarray, " *times"]) -> Any:
        """The parameter at time `t` (s), which is constant before the first pass and after the last one.

        That of a NumPy array is computed by NumPy, which needs no JAX.
        """
        xp = np if isinstance(t, np.ndarray) else jnp
        knots = self.knots
        value = xp.full_like(t, self.values[0])
        # a sum of clipped straight lines: a search over the knots would not be straight-line code
        for (a, b), since, until in zip(itertools.pairwise(self.values), knots[:-1], knots[1:], strict=True):
            value = value + np.sign(b - a) * self.rate * xp.clip(t - since, 0.0, until - since)
        return value

    def passes(self, t: Float[np.ndarray, " *times"]) -> Int[np.ndarray, " *times"]:
        """The pass (0, 1, ...) in which each time falls; the initial dwell belongs to pass 0."""
        return np.searchsorted(self.knots[1:-1], t, side="right")


@dataclasses.dataclass(frozen=True)
class StepSchedule:
    """Stairs between values of a parameter.

    Each pass from one of `values` to the next is divided into equal stairs. A turning value is one stair and
    belongs to the pass that reaches it; the first value belongs to pass 0.

    Args:
        values: the values at which passes begin and end, two at least.
        step: the largest distance between two stairs, above 0.
        dwell: the time on each stair (s).
        first_dwell: the time on stair 0 (s); None: `dwell`.
    """

    values: tuple[float, ...]
    step: float
    dwell: float
    first_dwell: float | None = None

    @property
    def lengths(self) -> list[int]:
        """Stairs of each pass; pass 0 does not count the first value."""
        pairs = itertools.pairwise(self.values)
        return [max(1, math.ceil(abs(b - a) / self.step - _ROUNDING)) for a, b in pairs]

    @property
    def count(self) -> int:
        """The number of stairs."""
        return 1 + sum(self.lengths)

    @property
    def first(self) -> float:
        """The time on stair 0 (s)."""
        return self.dwell if self.first_dwell is None else self.first_dwell

    @property
    def duration(self) -> float:
        """The end of the last stair (s)."""
        return self.first + (self.count - 1) * self.dwell

    def end(self, stair: Real[Array, " *stairs"] | Real[np.ndarray, " *stairs"]) -> Float[Array, " *stairs"]:
        """The time (s) at which a stair ends; the dtype is that of `stair`."""
        return jnp.asarray(self.first + stair * self.dwell)

    def middle(self, stair: Real[np.ndarray, " *stairs"]) -> Float[np.ndarray, " *stairs"]:
        """A time (s) well inside a stair."""
        return np.where(stair == 0, 0.5 * self.first, self.first + (stair - 0.5) * self.dwell)

    def stair(self, t: Float[Array, " *times"]) -> Float[Array, " *times"]:
        """The stair at time `t` (s), a whole number in the dtype of `t`; at a change, the later one."""
        # the end of a stair is a product, so that this quotient may lie by rounding below the whole number
        slack = _EARLY * float(jnp.finfo(t.dtype).eps) * self.duration / self.dwell
        begun = jnp.floor((t - self.first) / self.dwell + slack)
        return jnp.clip(begun + 1.0, 0.0, self.count - 1.0)

    @property
    def times(self) -> tuple[float, ...]:
        """Instants on the stairs that divide each pass in `PARTS_OF_A_PASS` equal parts at most."""
        stairs: list[Float[np.ndarray, " stairs"]] = [np.zeros(1)]
        before = 0
        for length in self.lengths:
            stairs.append(np.unique(np.round(np.linspace(before, before + length, PARTS_OF_A_PASS + 1))))
            before += length
        return tuple(float(t) for t in self.middle(np.unique(np.concatenate(stairs))))

    def at(self, t: Float[Array, " *times"]) -> Float[Array, " *times"]:
        """The parameter at time `t` (s)."""
        return self.value(self.stair(t))

    def value(self, stair: Float[Array, " *stairs"]) -> Float[Array, " *stairs"]:
        """The parameter on a stair, a whole number in floating point; the path's own values exactly."""
        value = jnp.full_like(stair, self.values[0])
        before = 0
        # a choice for each pass: a search over them would not be straight-line code
        for (a, b), length in zip(itertools.pairwise(self.values), self.lengths, strict=True):
            # from the lower end in both directions, so that passes up and down have equal values
            low = min(a, b)
            high = max(a, b)
            from_low = (stair - before) if a <= b else (before + length - stair)
            share = from_low / length
            value = jnp.where(stair > before, low * (1.0 - share) + high * share, value)
            before += length
            # XLA multiplies by 1 / length, with which the share of the last stair may not be 1
            value = jnp.where(stair >= before, b, value)
        return value

    def passes(self, stair: Real[np.ndarray, " *stairs"]) -> Int[np.ndarray, " *stairs"]:
        """The pass (0, 1, ...) to which each stair belongs."""
        return np.searchsorted(np.cumsum(self.lengths)[:-1], stair, side="left")
