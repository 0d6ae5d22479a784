"""Online measurement of gait cycles: swing onsets, and mean loads and pitch in stance and late stance.

A leg's cycle is from one swing onset (u_f crosses 0 upwards) to the next. Late stance is its last part, of
the share `LATE`, if the cycle is as long as the one before it: so no history of loads has to be stored.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from gaitsweep.dynamics.matsuoka import FLEXOR
from gaitsweep.dynamics.phase_oscillator import TWO_PI
from gaitsweep.models.planar_quadruped.nine_gaits import LEGS, PAIRS

LATE = 0.15  # of a cycle
LF = LEGS.index("LF")
(FORE_1, HIND_1), (FORE_2, HIND_2) = ((LEGS.index(fore), LEGS.index(hind)) for fore, hind in PAIRS)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Sums:
    """Integrals over a part of each leg's cycle: `time` (4,) s, `load` (4,) N s, `pitch` (4,) rad s."""

    time: jax.Array
    load: jax.Array
    pitch: jax.Array

    def grown(self, part: jax.Array, load: jax.Array, pitch: jax.Array, dt: jax.Array) -> Sums:
        """The integrals after a step of `dt` (s), for the legs in this part (4,)."""
        h = jnp.where(part, dt, 0.0)
        return Sums(self.time + h, self.load + h * load, self.pitch + h * pitch)

    def cleared(self, legs: jax.Array) -> Sums:
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

    `weight` is the sum of all weights, which tends to 1; `cosines` and `sines` (3,) are those of delta_1,
    delta_2 and the fore legs' shift; `period` s; `square` s2, of the period.
    """

    weight: jax.Array
    cosines: jax.Array
    sines: jax.Array
    period: jax.Array
    square: jax.Array

    def with_cycle(self, shifts: jax.Array, period: jax.Array, share: jax.Array) -> Average:
        """The averages with one more cycle of weight `share`, with `shifts` (3,) cycles and `period` (s)."""
        new = Average(jnp.ones_like(period), jnp.cos(TWO_PI * shifts), jnp.sin(TWO_PI * shifts), period,
                      period * period)  # fmt: skip
        return jax.tree.map(lambda old, now: old + share * (now - old), self, new)

    def _per_weight(self) -> jax.Array:
        return jnp.where(self.weight > 0.0, 1.0 / jnp.where(self.weight > 0.0, self.weight, 1.0), 0.0)

    def lengths(self) -> jax.Array:
        """Resultant lengths (3,) of the shifts, 0 to 1."""
        squared = self.cosines * self.cosines + self.sines * self.sines
        return self._per_weight() * jnp.sqrt(squared)

    def shifts(self) -> jax.Array:
        """Mean shifts (3,), cycles in [-0.5, 0.5)."""
        return jnp.arctan2(self.sines, self.cosines) / TWO_PI

    def variation(self) -> jax.Array:
        """Coefficient of variation of the period."""
        mean, square = self._per_weight() * self.period, self._per_weight() * self.square
        known = mean > 0.0
        spread = jnp.sqrt(jnp.maximum(square - mean * mean, 0.0))
        return jnp.where(known, spread / jnp.where(known, mean, 1.0), 0.0)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Cycle:
    """The measurements so far; legs are in the order of `LEGS`.

    `clock` s. For each leg (4,): `onset` s of its last swing, `period` s of its last cycle; the integrals
    `stance` and `late` of its current cycle; the means `stance_load`, `late_load` (N), `stance_pitch`,
    `late_pitch` (rad) of its last cycle. For LF's current cycle: `begin_x` m, `pitch_sum` rad s, `pitch_low`,
    `pitch_high` rad, `aloft` s without a foot on the ground; for its last cycle: `speed` m/s, `flight` (a
    share), `pitch_mean`, `pitch_range` rad; the `average` over its last cycles; `closed`: LF's cycle ended in
    the last step.
    """

    clock: jax.Array
    onset: jax.Array
    period: jax.Array
    stance: Sums
    late: Sums
    stance_load: jax.Array
    stance_pitch: jax.Array
    late_load: jax.Array
    late_pitch: jax.Array
    begin_x: jax.Array
    pitch_sum: jax.Array
    pitch_low: jax.Array
    pitch_high: jax.Array
    aloft: jax.Array
    speed: jax.Array
    flight: jax.Array
    pitch_mean: jax.Array
    pitch_range: jax.Array
    average: Average
    closed: jax.Array

    def shifts(self) -> jax.Array:
        """delta_1, delta_2 and the fore legs' shift (3,), cycles in [-0.5, 0.5), at the end of LF's cycle."""
        late = jnp.stack(
            [
                self.onset[HIND_1] - self.onset[FORE_1],
                self.onset[HIND_2] - self.onset[FORE_2],
                self.onset[FORE_2] - self.onset[FORE_1],
            ]
        )
        lasted = self.period[LF]
        shift = late / jnp.where(lasted > 0.0, lasted, 1.0)
        return shift - jnp.floor(shift + 0.5)


def begun(x: jax.Array, pitch: jax.Array) -> Cycle:
    """The initial measurements, with the torso at `x` (m) and its `pitch` (rad)."""
    zero, four = jnp.zeros_like(x), jnp.zeros((4,), x.dtype)
    three = jnp.zeros((3,), x.dtype)
    none = Sums(four, four, four)
    return Cycle(
        clock=zero, onset=four, period=four, stance=none, late=none, stance_load=four, stance_pitch=four,
        late_load=four, late_pitch=four, begin_x=x, pitch_sum=zero, pitch_low=pitch, pitch_high=pitch,
        aloft=zero, speed=zero, flight=zero, pitch_mean=zero, pitch_range=zero,
        average=Average(zero, three, three, zero, zero), closed=jnp.zeros((), bool),
    )  # fmt: skip


def followed(
    cycle: Cycle,
    u: tuple[jax.Array, jax.Array],
    load: jax.Array,
    x: jax.Array,
    pitch: jax.Array,
    memory: jax.Array,
    dt: jax.Array,
) -> Cycle:
    """The measurements after a step of `dt` (s).

    Args:
        cycle: the measurements before it.
        u: potentials (2, 4) before and after the step.
        load: loads (4,) N during the step.
        x, pitch: position (m) of the torso after the step, its pitch (rad) before.
        memory: memory of the averages, cycles.
    """
    c, before, after = cycle, u[0][FLEXOR], u[1][FLEXOR]
    stands = before <= 0.0
    c = dataclasses.replace(
        c,
        clock=c.clock + dt,
        stance=c.stance.grown(stands, load, pitch, dt),
        late=c.late.grown(stands & (c.clock >= c.onset + (1.0 - LATE) * c.period), load, pitch, dt),
        pitch_sum=c.pitch_sum + dt * pitch,
        pitch_low=jnp.minimum(c.pitch_low, pitch),
        pitch_high=jnp.maximum(c.pitch_high, pitch),
        aloft=c.aloft + jnp.where(jnp.max(load) > 0.0, 0.0, dt),
    )
    begins = stands & (after > 0.0)
    rise = after - before
    whole = c.onset[LF] > 0.0  # the first cycle is incomplete
    onset = c.clock - dt * jnp.where(begins, after / jnp.where(begins, rise, 1.0), 0.0)
    stance_load, stance_pitch = c.stance.means()
    late_load, late_pitch = c.late.means()
    c = dataclasses.replace(
        c,
        onset=jnp.where(begins, onset, c.onset),
        period=jnp.where(begins, onset - c.onset, c.period),
        stance=c.stance.cleared(begins),
        late=c.late.cleared(begins),
        stance_load=jnp.where(begins, stance_load, c.stance_load),
        stance_pitch=jnp.where(begins, stance_pitch, c.stance_pitch),
        late_load=jnp.where(begins, late_load, c.late_load),
        late_pitch=jnp.where(begins, late_pitch, c.late_pitch),
        closed=begins[LF],
    )
    return _closed(c, x, pitch, jnp.where(whole, 1.0 / memory, 0.0))


def _closed(c: Cycle, x: jax.Array, pitch: jax.Array, share: jax.Array) -> Cycle:
    """The measurements of LF's cycle at its end; `share` is its weight in the averages."""
    lasted = jnp.where(c.closed, c.period[LF], 1.0)
    ended = dataclasses.replace(
        c,
        begin_x=x,
        pitch_sum=jnp.zeros_like(x),
        pitch_low=pitch,
        pitch_high=pitch,
        aloft=jnp.zeros_like(x),
        speed=(x - c.begin_x) / lasted,
        flight=c.aloft / lasted,
        pitch_mean=c.pitch_sum / lasted,
        pitch_range=c.pitch_high - c.pitch_low,
        average=c.average.with_cycle(c.shifts(), lasted, share),
    )
    return jax.tree.map(lambda new, old: jnp.where(c.closed, new, old), ended, c)
