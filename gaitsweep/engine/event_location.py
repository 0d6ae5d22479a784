"""Location of an event by a bracket, and its derivative.

The near end of the bracket is the state itself (every accepted step moves it forward), its far end is the
shortest step known to fire a guard. The next trial is at the zero of the cubic that gives the time as a
function of the guard's value, through both ends of the bracket and with their slopes. Where the guard does
not rise at the ends, or after some trials, it is at the zero of the secant (regula falsi with the Illinois
weights, which keep both ends moving). The jump is applied at a trial past the root by a quarter of the event
tolerance to a whole one: the far side of the bracket, where the guard has changed sign and the mode that the
jump sets is already armed. The distance from the root is above rounding, so guards whose roots are the same
instant fire in the same trial.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaitsweep.contract import Rates, State
from gaitsweep.engine.carry import Carry, Flag, GuardFlags, Guards, Integer, Number, likely
from gaitsweep.engine.solver.methods import euler_update

# A guard's value before a step is limited to this multiple of its value after it: a model may disarm a guard
# by a large negative number, with which the secant would locate nothing.
MAX_NEAR_RATIO = 1e9
# Trials with slopes before the location of an event goes on with secants alone: most take 2 to 4.
SLOPES_UNTIL = 8
# Trials before it falls back to bisection: secants take 5 to 8.
BISECTION_AFTER = 24
# Trials before its tolerance begins to grow: bisection of a whole step to 1e-12 s takes another 31.
PATIENT_TRIALS = 60
# Least time of an event's trial past the root, as a share of the tolerance.
MIN_OVERSHOOT = 0.25
# The largest time past a guard's root by its own rate, as a multiple of the tolerance: a guard that jumps
# to a small number above zero looks nearer to its root by the secant than it is.
MAX_OVERSHOOT = 4.0


@dataclasses.dataclass(frozen=True)
class Bracket:
    """The fields of `Carry` that locate an event."""

    near: Guards
    far: Number
    far_guards: Guards
    weight: Number
    trials: Integer


@dataclasses.dataclass(frozen=True)
class Rise:
    """The guard that fires first, at the ends of a bracket.

    Attributes:
        below: its distance below zero at the near end, >= 0.
        above: its distance above zero at the far end, >= 0.
        slopes: its time derivatives at the near and at the far end; 0 where it is not known.
    """

    below: Number
    above: Number
    slopes: tuple[Number, Number]


def first_to_fire(near: Guards, far: Guards, slopes: tuple[Guards, Guards] | None = None) -> Rise:
    """The guard that fires at the far end of a bracket and whose secant crosses zero first.

    The smallest quotient below / above is found without division.

    Args:
        near: the guards at the near end of the bracket.
        far: the guards at its far end.
        slopes: their time derivatives at both ends, if these are needed.

    Returns:
        That guard; if none fires, one that is 1 below zero at the near end and 0 above it at the far end.
    """
    none = jnp.zeros((), near.dtype)
    if near.size == 0:  # a flow without events
        return Rise(none + 1.0, none, (none, none))
    fires = far >= 0.0
    above = jnp.where(fires, far, 0.0)
    below = jnp.where(fires, -near, 1.0)
    numbers = [_limited(below, above), above, below, *(slopes or ())]
    # pairs of guards are compared until one is left, the second half with the first
    while numbers[0].size > 1:
        half = numbers[0].size // 2
        first = [number[:half] for number in numbers]
        second = [number[half : 2 * half] for number in numbers]
        is_second = second[0] * first[1] < first[0] * second[1]
        chosen = [jnp.where(is_second, two, one) for one, two in zip(first, second, strict=True)]
        left = [number[2 * half :] for number in numbers]
        numbers = [jnp.concatenate(parts) for parts in zip(chosen, left, strict=True)]
    _, above, below, *rest = (number[0] for number in numbers)
    return Rise(below, above, (rest[0], rest[1]) if rest else (none, none))


def _limited(below: Float[Array, " ..."], above: Float[Array, " ..."]) -> Float[Array, " ..."]:
    """Distances below zero before a step, limited by those above it after the step, where these are not 0."""
    steepest = MAX_NEAR_RATIO * above
    return jnp.where((below > steepest) & (above > 0.0), steepest, below)


def secant_root(below: Number, above: Number) -> Number:
    """The zero of the secant, as a share of the bracket from its near end.

    Args:
        below: the distance of a guard below zero at the near end, from `first_to_fire`.
        above: its distance above zero at the far end.
    """
    below = _limited(below, above)
    height = below + above
    return jnp.where(height > 0.0, below / jnp.where(height > 0.0, height, 1.0), 0.0)


def cubic_root(rise: Rise, far: Number) -> tuple[Number, Flag]:
    """The zero (s) of a guard, by the cubic through the times of its values at both ends of a bracket.

    Args:
        rise: the guard.
        far: the far end of the bracket (s).

    Returns:
        The time from the near end, and whether the cubic is known to increase (Fritsch and Carlson 1980),
        which holds where the guard rises fast enough at both ends, or at one of them.
    """
    height = rise.below + rise.above
    share = rise.below / jnp.where(height > 0.0, height, 1.0)
    # 1 / slope is at most three times that of the secant
    steep_near, steep_far = (3.0 * slope * far >= height for slope in rise.slopes)
    leaving, arriving = (
        height / jnp.where(steep, slope, 1.0)
        for slope, steep in zip(rise.slopes, (steep_near, steep_far), strict=True)
    )
    # without one of them it is a parabola
    leaving = jnp.where(steep_near, leaving, 2.0 * far - arriving)
    arriving = jnp.where(steep_far, arriving, 2.0 * far - leaving)
    increases = (height > 0.0) & (steep_near | steep_far) & (leaving >= 0.0) & (arriving >= 0.0)
    rest = 1.0 - share
    root = share * (share * (3.0 - 2.0 * share) * far + rest * (rest * leaving - share * arriving))
    return root, increases


def next_bracket(
    carry: Carry,
    h: Number,
    guards: Guards,
    *,
    accepted: Flag,
    hit: Flag,
    land: Flag,
    keeps: GuardFlags,
) -> Bracket:
    """The bracket after an attempt: the trial becomes its near end, or its far end if a guard fired there.

    Args:
        carry: the trajectory before the attempt.
        h: the length of the trial (s).
        guards: the guards there.
        accepted: whether the trial is accepted without an event.
        hit: whether a guard fired at the trial.
        land: whether the trial is the event.
        keeps: the guards whose values at the trial are kept: at an instant with jumps only that which jumps.
    """
    shortens = hit & ~land
    is_new = likely(carry.far == jnp.inf)
    remaining = carry.far - h
    # an accepted step that reaches the far end without firing (rounding) ends the location
    advanced = jnp.where(accepted & (remaining > 0.0), remaining, jnp.inf)
    far = jnp.where(shortens, h, jnp.where(is_new, jnp.inf, advanced))
    stayed_near = jnp.where(carry.weight > 0.0, 0.5 * carry.weight, 1.0)
    stayed_far = jnp.where(carry.weight < 0.0, 0.5 * carry.weight, -1.0)
    weight = jnp.where(is_new, 1.0, jnp.where(shortens, stayed_near, stayed_far))
    # a location that ended without an event is continued: only an accepted step resets its trials
    trials = jnp.where(land | (accepted & is_new), 0, carry.trials + 1)
    waits = ~(accepted | hit)
    return Bracket(
        near=jnp.where(accepted, guards, carry.near),
        far=jnp.where(waits, carry.far, far),
        far_guards=jnp.where(keeps, guards, carry.far_guards),
        weight=jnp.where(waits, carry.weight, weight),
        trials=jnp.where(waits, carry.trials, trials),
    )


def next_trial(bracket: Bracket, rise: Rise, tolerance: Number) -> Number:
    """The next trial (s) inside the bracket, half a tolerance past the root of the cubic or of the secant.

    Args:
        bracket: the bracket, from `next_bracket`.
        rise: the guard that fires first at its far end (`first_to_fire`).
        tolerance: of the event time (s).
    """
    weight = bracket.weight
    below = rise.below * jnp.where(weight > 0.0, weight, 1.0)
    above = rise.above * jnp.where(weight < 0.0, -weight, 1.0)
    far = jnp.where(bracket.far < jnp.inf, bracket.far, 0.0)
    cubic, is_increasing = cubic_root(rise, far)
    by_slopes = is_increasing & (bracket.trials <= SLOPES_UNTIL)
    root = jnp.where(by_slopes, cubic, far * secant_root(below, above))
    guess = jnp.where(bracket.trials > BISECTION_AFTER, 0.5 * far, root + 0.5 * tolerance)
    # so short a bracket is stepped as a whole: if rounding hides the event, the step reaches the far end
    # without firing and the location ends, instead of bisecting without end
    return jnp.where((far <= tolerance) | (guess > far), far, guess)


def implicit_event_time(
    trial: State, rates: Rates, guards: Guards, speed: Guards, rooted: GuardFlags
) -> tuple[State, Number]:
    """State at the event, and the shift (s) of its time: zero, with the derivative of the event time.

    g(x(t)) = 0 along every neighbouring trajectory, so dt = -dg/g' for the guard that jumps (`rooted`).

    Args:
        trial: the state at the trial.
        rates: the flow's rates there.
        guards: the guards there.
        speed: their time derivatives.
        rooted: the guard that jumps at its root, at most one.
    """
    if guards.size == 0:
        return trial, jnp.zeros(())
    speed = jnp.where(rooted & (speed != 0.0), speed, 1.0)
    drift = (guards - jax.lax.stop_gradient(guards)) / speed
    shift = -jnp.sum(jnp.where(rooted, drift, 0.0))
    return euler_update(trial, rates, shift), shift


def first_of(flags: GuardFlags) -> GuardFlags:
    """The first flag that is set, alone."""
    earlier = jnp.zeros((), bool)  # whether a flag before this one is set
    first = []
    for i in range(flags.size):
        first.append(flags[i] & ~earlier)
        earlier = earlier | flags[i]
    return jnp.stack(first) if first else flags
