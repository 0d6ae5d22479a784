"""Means over a part of each leg's cycle, and averages over the last cycles."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from gaitsweep.dynamics import TWO_PI

STILL = 1.0e-6  # rad; a pitch with a smaller root mean square does not oscillate


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Sums:
    """Integrals over a part of each leg's cycle: `time` (4,) s, `load` (4,) N s, `pitch` (4,) rad s."""

    time: jax.Array
    load: jax.Array
    pitch: jax.Array

    def with_step(self, part: jax.Array, load: jax.Array, pitch: jax.Array, dt: jax.Array) -> Sums:
        """The integrals after a step of `dt` (s), for the legs in this part (4,)."""
        h = jnp.where(part, dt, 0.0)
        return Sums(self.time + h, self.load + h * load, self.pitch + h * pitch)

    def without(self, legs: jax.Array) -> Sums:
        """The integrals with zeros for these legs (4,)."""
        return jax.tree.map(lambda sum_: jnp.where(legs, 0.0, sum_), self)

    def means(self) -> tuple[jax.Array, jax.Array]:
        """Mean load (4,) N and pitch (4,) rad; 0 if the time is 0."""
        per_time = jnp.where(self.time > 0.0, 1.0 / jnp.where(self.time > 0.0, self.time, 1.0), 0.0)
        return self.load * per_time, self.pitch * per_time


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Average:
    """Exponentially weighted averages over the last cycles; weights decay by 1/memory a cycle.

    `weight` is the sum of all weights, which tends to 1; `cosines` and `sines` (2, 3) are those of delta_1,
    delta_2 and the fore legs' shift, by swing onsets and by touchdowns; `period` s; `square` s2, of the
    period; `pitch` (6,) the means of the pitch (rad), of its square (rad2), and of its products (rad) with
    the cosine and the sine of the phase in LF's cycle and of twice that phase.
    """

    weight: jax.Array
    cosines: jax.Array
    sines: jax.Array
    period: jax.Array
    square: jax.Array
    pitch: jax.Array

    def with_cycle(
        self, shifts: jax.Array, counts: jax.Array, period: jax.Array, pitch: jax.Array, share: jax.Array
    ) -> Average:
        """Add a cycle of weight `share` to the averages.

        Its `shifts` (2, 3), in cycles, count 1 or 0 times, by `counts` (2, 1); `period` in s;
        `pitch` (6,) are its means.
        """
        new = Average(jnp.ones_like(period), counts * jnp.cos(TWO_PI * shifts),
                      counts * jnp.sin(TWO_PI * shifts), period, period * period, pitch)  # fmt: skip
        return jax.tree.map(lambda old, now: old + share * (now - old), self, new)

    def _per_weight(self) -> jax.Array:
        return jnp.where(self.weight > 0.0, 1.0 / jnp.where(self.weight > 0.0, self.weight, 1.0), 0.0)

    def lengths(self) -> jax.Array:
        """Resultant lengths (2, 3) of the shifts, 0 to 1."""
        squared = self.cosines * self.cosines + self.sines * self.sines
        return self._per_weight() * jnp.sqrt(squared)

    def shifts(self) -> jax.Array:
        """Mean shifts (2, 3), cycles in [-0.5, 0.5)."""
        return jnp.arctan2(self.sines, self.cosines) / TWO_PI

    def variation(self) -> jax.Array:
        """Coefficient of variation of the period."""
        mean, square = self._per_weight() * self.period, self._per_weight() * self.square
        begun = mean > 0.0
        spread = jnp.sqrt(jnp.maximum(square - mean * mean, 0.0))
        return jnp.where(begun, spread / jnp.where(begun, mean, 1.0), 0.0)

    def pitch_shares(self) -> jax.Array:
        """Shares (2,) of the pitch's variance that go once and twice a cycle, at the same phase in each.

        An oscillation that is not locked to the cycles, or goes round in several of them, has no share. A
        body at rest has none either.
        """
        mean, square, *waves = self._per_weight() * self.pitch
        variance = square - mean * mean
        cosines, sines = jnp.stack(waves[::2]), jnp.stack(waves[1::2])
        powers = 2.0 * (cosines * cosines + sines * sines)
        moves = variance > STILL * STILL
        # the sum of a cycle has an error of a step, by which a share may exceed 1
        return jnp.where(moves, jnp.minimum(powers / jnp.where(moves, variance, 1.0), 1.0), 0.0)
