"""Location of an event by a bracket, and its derivative.

The near end of the bracket is the state itself (every accepted step moves it forward), its far end is the
shortest step known to fire a guard. The next trial is where the secant through both ends crosses zero (regula
falsi with the Illinois weights, which keep both ends moving), and the jump is applied at a trial past the
root by a quarter of the event tolerance to a whole one: the far side of the bracket, where the guard has
changed sign and the mode that the jump sets is already armed. The distance from the root is above rounding,
so guards whose roots are the same instant fire in the same trial.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from gaitsweep.contract import Rates, State
from gaitsweep.engine.carry import Carry, Flag, GuardFlags, Guards, Integer, Number, likely
from gaitsweep.engine.solver.methods import euler_update

# A guard's value before a step is limited to this multiple of its value after it: a model may disarm a guard
# by a large negative number, with which the secant would locate nothing.
MAX_NEAR_RATIO = 1e9
# Trials before the location of an event falls back to bisection: superlinear location takes 5 to 8.
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


def first_to_fire(near: Guards, far: Guards) -> tuple[Number, Number]:
    """The distances from zero of the guard that fires at the far end and whose secant crosses zero first.

    The smallest quotient below / above is found without division.

    Args:
        near: the guards at the near end of the bracket.
        far: the guards at its far end.

    Returns:
        The distance below zero at the near end and above zero at the far end, both >= 0; (1, 0) if no guard
        fires.
    """
    if near.size == 0:  # a flow without events
        none = jnp.zeros((), near.dtype)
        return none + 1.0, none
    fires = far >= 0.0
    above = jnp.where(fires, far, 0.0)
    steepest = MAX_NEAR_RATIO * above
    below = jnp.where(fires, jnp.where(-near > steepest, steepest, -near), 1.0)
    # pairs of guards are compared until one is left, the second half with the first
    while below.size > 1:
        half = below.size // 2
        below1 = below[:half]
        below2 = below[half : 2 * half]
        above1 = above[:half]
        above2 = above[half : 2 * half]
        is_second = below2 * above1 < below1 * above2
        below = jnp.concatenate([jnp.where(is_second, below2, below1), below[2 * half :]])
        above = jnp.concatenate([jnp.where(is_second, above2, above1), above[2 * half :]])
    return below[0], above[0]


def secant_root(below: Number, above: Number) -> Number:
    """The zero of the secant, as a share of the bracket from its near end.

    Args:
        below: the distance of a guard below zero at the near end, from `first_to_fire`.
        above: its distance above zero at the far end.
    """
    rise = below + above
    return jnp.where(rise > 0.0, below / jnp.where(rise > 0.0, rise, 1.0), 0.0)


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


def next_trial(bracket: Bracket, below: Number, above: Number, tolerance: Number) -> Number:
    """The next trial (s) inside the bracket: the weighted secant, half a tolerance past its root.

    Args:
        bracket: the bracket, from `next_bracket`.
        below: the distance below zero, at the near end, of the guard that fires first (`first_to_fire`).
        above: its distance above zero at the far end.
        tolerance: of the event time (s).
    """
    weight = bracket.weight
    below = below * jnp.where(weight > 0.0, weight, 1.0)
    above = above * jnp.where(weight < 0.0, -weight, 1.0)
    far = jnp.where(bracket.far < jnp.inf, bracket.far, 0.0)
    secant = far * secant_root(below, above) + 0.5 * tolerance
    guess = jnp.where(bracket.trials > BISECTION_AFTER, 0.5 * far, secant)
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
