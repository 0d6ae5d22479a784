"""Online measurement of gait cycles: swing onsets, touchdowns, and mean loads and pitch in stance.

A leg's cycle is from one swing onset to the next: u_f crosses 0 upwards after `MIN_SILENCE` or more below it;
shorter breaks of activity belong to one swing. A leg touches down where its foot bears load after
`MIN_AIR_TIME` or more in the air; shorter breaks of contact belong to one stance. Where it does so twice in a
cycle, or not at all, it has no phase by touchdowns. Late stance is the stance in the last share `LATE_STANCE`
of a cycle, whose length is taken to be that of the cycle before it: so no history of loads has to be stored.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from gaitsweep.dynamics import TWO_PI
from gaitsweep.dynamics.matsuoka import FLEXOR
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS, PAIRS

STEADY_PITCH = 1.0e-6  # rad; a pitch with a smaller root mean square does not oscillate
LATE_STANCE = 0.15  # of a cycle
MIN_AIR_TIME = 0.06  # s
# s; a foot that unloads or touches down silences a flexor for up to 15 ms, stance for 90 ms or more
MIN_SILENCE = 0.02
RECENT_CYCLES = 1.5  # cycles of LF for which an irregular touchdown keeps a cycle out of the averages
LF = LEGS.index("LF")
(FORE_1, HIND_1), (FORE_2, HIND_2) = ((LEGS.index(fore), LEGS.index(hind)) for fore, hind in PAIRS)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Sums:
    """Integrals over a part of each leg's cycle: `time` (4,) s, `load` (4,) N s, `pitch` (4,) rad s."""

    time: jax.Array
    load: jax.Array
    pitch: jax.Array

    def with_step(self, part: jax.Array, load: jax.Array, pitch: jax.Array, dt: jax.Array) -> Sums:
        """The integrals after a step.

        Args:
            part: whether each leg is in this part of its cycle, (4,).
            load: loads on the feet during the step, (4,) N.
            pitch: pitch of the torso, rad.
            dt: duration of the step, s.
        """
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
        """The averages with one more cycle.

        Args:
            shifts: its shifts by swing onsets and by touchdowns, (2, 3) cycles.
            counts: how often the shifts of each kind count, 1 or 0, (2, 1).
            period: its duration, s.
            pitch: its means, (6,), as in `Average.pitch`.
            share: its weight, 0 to 1.
        """
        new = Average(
            weight=jnp.ones_like(period),
            cosines=counts * jnp.cos(TWO_PI * shifts),
            sines=counts * jnp.sin(TWO_PI * shifts),
            period=period,
            square=period * period,
            pitch=pitch,
        )
        return jax.tree.map(lambda old, now: old + share * (now - old), self, new)

    def _per_weight(self) -> jax.Array:
        """The factor by which a weighted sum is a mean; 0 before the first cycle."""
        return jnp.where(self.weight > 0.0, 1.0 / jnp.where(self.weight > 0.0, self.weight, 1.0), 0.0)

    def lengths(self) -> jax.Array:
        """Resultant lengths (2, 3) of the shifts, 0 to 1."""
        squared = self.cosines * self.cosines + self.sines * self.sines
        return self._per_weight() * jnp.sqrt(squared)

    def shifts(self) -> jax.Array:
        """Mean shifts (2, 3), cycles from -0.5 to 0.5."""
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
        moves = variance > STEADY_PITCH * STEADY_PITCH
        # the sum of a cycle has an error of a step, by which a share may exceed 1
        return jnp.where(moves, jnp.minimum(powers / jnp.where(moves, variance, 1.0), 1.0), 0.0)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Cycle:
    """The measurements so far; legs are in the order of `LEGS`.

    `clock` s. For each leg (4,): `onset` s of its last swing, `period` s of its last cycle; `active` s when
    its flexor was active last, `loaded` s when its foot bore load last, `landed` s of the last touchdown that
    was the first in a cycle, `irregular` s when a second one or the end of a cycle without any came last; the
    integrals `stance` and `late` of its current cycle; the means `stance_load`, `late_load` (N),
    `stance_pitch`, `late_pitch` (rad) of its last cycle. For LF's current cycle: `begin_x` m, `pitch_sum` rad
    s, `pitch_low`, `pitch_high` rad, `pitch_sums` (6,) of `_pitch_products`, `aloft` s without a foot on the
    ground; for its last cycle: `speed` m/s, `flight` (a share), `pitch_mean`, `pitch_range` rad; the
    `average` over its last cycles; `closed`: LF's cycle ended in the last step. `work` (2,) J is the positive
    work of hips and of knees in LF's current cycle, `power` (2,) W its mean rate in the last one.
    """

    clock: jax.Array
    onset: jax.Array
    period: jax.Array
    active: jax.Array
    loaded: jax.Array
    landed: jax.Array
    irregular: jax.Array
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
    pitch_sums: jax.Array
    aloft: jax.Array
    speed: jax.Array
    flight: jax.Array
    pitch_mean: jax.Array
    pitch_range: jax.Array
    average: Average
    closed: jax.Array
    work: jax.Array
    power: jax.Array

    def shifts(self) -> jax.Array:
        """delta_1, delta_2 and the fore legs' shift, cycles in [-0.5, 0.5), at the end of LF's cycle.

        The first of (2, 3) are by swing onsets, the second by touchdowns.
        """
        pairs = ((HIND_1, FORE_1), (HIND_2, FORE_2), (FORE_2, FORE_1))
        by_onsets = jnp.stack([self.onset[i] - self.onset[j] for i, j in pairs])
        by_touchdowns = jnp.stack([self.landed[i] - self.landed[j] for i, j in pairs])
        delays = jnp.stack([by_onsets, by_touchdowns])
        period = self.period[LF]
        shift = delays / jnp.where(period > 0.0, period, 1.0)
        return shift - jnp.floor(shift + 0.5)


def initial_cycle(x: jax.Array, pitch: jax.Array) -> Cycle:
    """The initial measurements, with the torso at `x` (m) and its `pitch` (rad)."""
    zero = jnp.zeros_like(x)
    four = jnp.zeros((4,), x.dtype)
    two, six = jnp.zeros((2,), x.dtype), jnp.zeros((6,), x.dtype)
    shifts = jnp.zeros((2, 3), x.dtype)
    none = Sums(four, four, four)
    return Cycle(
        clock=zero, onset=four, period=four, active=four - MIN_SILENCE,
        loaded=four - MIN_AIR_TIME, landed=four - MIN_AIR_TIME, irregular=four - 1.0,
        stance=none, late=none, stance_load=four, stance_pitch=four, late_load=four, late_pitch=four,
        begin_x=x, pitch_sum=zero, pitch_low=pitch, pitch_high=pitch,
        pitch_sums=six, aloft=zero, speed=zero, flight=zero, pitch_mean=zero, pitch_range=zero,
        average=Average(zero, shifts, shifts, zero, zero, six),
        closed=jnp.zeros((), bool), work=two, power=two,
    )  # fmt: skip


def after_step(
    cycle: Cycle,
    u: tuple[jax.Array, jax.Array],
    load: jax.Array,
    x: jax.Array,
    pitch: jax.Array,
    work: jax.Array,
    memory: jax.Array,
    dt: jax.Array,
) -> Cycle:
    """The measurements after a step of `dt` (s).

    Args:
        cycle: the measurements before it.
        u: potentials (2, 4) before and after the step.
        load: loads (4,) N during the step.
        x, pitch: position (m) of the torso after the step, its pitch (rad) before.
        work: positive work (2,) J of hips and of knees in the step.
        memory: memory of the averages, cycles.
    """
    before, after = u[0][FLEXOR], u[1][FLEXOR]
    complete = cycle.onset[LF] > 0.0  # the first cycle is incomplete
    c = _with_step(cycle, before <= 0.0, load, pitch, work, dt)
    c = _with_onsets(c, before, after, dt)
    return _closed(c, x, pitch, jnp.where(complete, 1.0 / memory, 0.0))


def _with_step(
    c: Cycle, stands: jax.Array, load: jax.Array, pitch: jax.Array, work: jax.Array, dt: jax.Array
) -> Cycle:
    """The measurements with the sums of a step, in which some legs stand, `stands` (4,)."""
    down = load > 0.0
    now = c.clock + dt
    lands = down & (c.clock - c.loaded >= MIN_AIR_TIME)
    first = c.landed < c.onset
    # in the last part of a cycle that is as long as the one before
    late = c.clock >= c.onset + (1.0 - LATE_STANCE) * c.period
    return dataclasses.replace(
        c,
        clock=now,
        active=jnp.where(stands, c.active, now),
        loaded=jnp.where(down, now, c.loaded),
        landed=jnp.where(lands & first, now, c.landed),
        irregular=jnp.where(lands & ~first, now, c.irregular),
        stance=c.stance.with_step(stands, load, pitch, dt),
        late=c.late.with_step(stands & late, load, pitch, dt),
        pitch_sum=c.pitch_sum + dt * pitch,
        pitch_low=jnp.minimum(c.pitch_low, pitch),
        pitch_high=jnp.maximum(c.pitch_high, pitch),
        pitch_sums=c.pitch_sums + dt * _pitch_products(c, pitch),
        aloft=c.aloft + jnp.where(jnp.max(load) > 0.0, 0.0, dt),
        work=c.work + work,
    )


def _with_onsets(c: Cycle, before: jax.Array, after: jax.Array, dt: jax.Array) -> Cycle:
    """The measurements after the swing onsets of a step, in which flexors' potentials (4,) change."""
    rises = (before <= 0.0) & (after > 0.0)
    onset = c.clock - dt * jnp.where(rises, after / jnp.where(rises, after - before, 1.0), 0.0)
    begins = rises & (onset - c.active >= MIN_SILENCE)
    stance_load, stance_pitch = c.stance.means()
    late_load, late_pitch = c.late.means()
    return dataclasses.replace(
        c,
        irregular=jnp.where(begins & (c.landed < c.onset), c.clock, c.irregular),
        onset=jnp.where(begins, onset, c.onset),
        period=jnp.where(begins, onset - c.onset, c.period),
        stance=c.stance.without(begins),
        late=c.late.without(begins),
        stance_load=jnp.where(begins, stance_load, c.stance_load),
        stance_pitch=jnp.where(begins, stance_pitch, c.stance_pitch),
        late_load=jnp.where(begins, late_load, c.late_load),
        late_pitch=jnp.where(begins, late_pitch, c.late_pitch),
        closed=begins[LF],
    )


def _pitch_products(c: Cycle, pitch: jax.Array) -> jax.Array:
    """Products (6,) of the pitch less the last cycle's mean, at the beginning of a step.

    They are those with 1, with itself, and with the cosine and the sine of the phase in LF's cycle and of
    twice that phase, for a cycle as long as the last one. A cycle is not a whole number of steps, so sums of
    a large mean would not cancel.
    """
    period = jnp.where(c.period[LF] > 0.0, c.period[LF], 1.0)
    angle = TWO_PI * (c.clock - c.onset[LF]) / period
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    twice = (cosine * cosine - sine * sine, 2.0 * cosine * sine)
    deviation = pitch - c.pitch_mean
    return deviation * jnp.stack([jnp.ones_like(deviation), deviation, cosine, sine, *twice])


def _closed(c: Cycle, x: jax.Array, pitch: jax.Array, share: jax.Array) -> Cycle:
    """The measurements of LF's cycle at its end; `share` is its weight in the averages."""
    period = jnp.where(c.closed & (c.period[LF] > 0.0), c.period[LF], 1.0)
    deviation, square, *waves = c.pitch_sums / period
    mean = c.pitch_mean  # the mean of `pitch_sums`
    regular = jnp.all(c.irregular < c.clock - RECENT_CYCLES * period)
    counts = jnp.stack([jnp.ones_like(period), jnp.where(regular, 1.0, 0.0)])[:, None]
    pitch_means = jnp.stack([mean + deviation, mean * mean + 2.0 * mean * deviation + square, *waves])
    ended = dataclasses.replace(
        c,
        begin_x=x,
        pitch_sum=jnp.zeros_like(x),
        pitch_low=pitch,
        pitch_high=pitch,
        pitch_sums=jnp.zeros_like(c.pitch_sums),
        aloft=jnp.zeros_like(x),
        speed=(x - c.begin_x) / period,
        flight=c.aloft / period,
        pitch_mean=c.pitch_sum / period,
        pitch_range=c.pitch_high - c.pitch_low,
        average=c.average.with_cycle(c.shifts(), counts, period, pitch_means, share),
        work=jnp.zeros_like(c.work),
        power=c.work / period,
    )
    return jax.tree.map(lambda new, old: jnp.where(c.closed, new, old), ended, c)
