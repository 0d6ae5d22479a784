"""A parameter that moves at a constant rate along a path."""

from __future__ import annotations

import dataclasses
import itertools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

# Parts of a pass at whose ends the length of steps is looked at; it changes smoothly with a parameter.
PARTS = 4


@dataclasses.dataclass(frozen=True)
class RampSchedule:
    """Straight passes between the `values` at `rate` (units of the parameter per second).

    The first value is kept for `initial_dwell` s before the first pass.
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
        return float(self.knots[-1])

    @property
    def times(self) -> tuple[float, ...]:
        """The knots, and instants that divide each pass in `PARTS` equal ones."""
        inner = [np.linspace(since, until, PARTS + 1) for since, until in itertools.pairwise(self.knots)]
        return tuple(float(t) for t in np.unique(np.concatenate(inner)))

    def at(self, t: Float[Array, " *times"]) -> Float[Array, " *times"]:
        """The parameter at time `t` (s); the ends are kept before and after."""
        knots = self.knots
        value = jnp.full_like(t, self.values[0])
        # a sum of clipped straight lines: a search over the knots would not be straight-line code
        for (a, b), since, until in zip(itertools.pairwise(self.values), knots[:-1], knots[1:], strict=True):
            value = value + np.sign(b - a) * self.rate * jnp.clip(t - since, 0.0, until - since)
        return value

    def passes(self, t: Float[np.ndarray, " *times"]) -> Int[np.ndarray, " *times"]:
        """The pass (0, 1, ...) in which each time falls; the initial dwell belongs to pass 0."""
        return np.clip(np.searchsorted(self.knots[1:-1], t, side="right"), 0, len(self.values) - 2)
