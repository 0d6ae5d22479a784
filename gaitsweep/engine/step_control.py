"""The lengths of steps, which meet the tolerances on the local error, or grow after an event."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from gaitsweep.contract import Rates, State
from gaitsweep.engine.carry import Carry, Flag, Number
from gaitsweep.engine.numerics import ORDER, ResolvedNumerics, tolerance_scale
from gaitsweep.engine.solver import Method

# The safety factor of a step, and the smallest factor by which a step that missed the tolerance is
# shortened.
SAFETY_FACTOR = 0.9
MIN_FACTOR = 0.2
# The smallest step, as a share of the longest, which is accepted with any error (a state that diverges is
# then reported as diverged).
MIN_STEP = 1e-9


@dataclasses.dataclass(frozen=True)
class StepLengths:
    """The upper bound of the next steps (`Carry.h_max`, s), and the next step `h` (s)."""

    h_max: Number
    h: Number


def fitting_change(
    error: Rates, carry: Carry, trial: State, numerics: ResolvedNumerics, order: int
) -> Number:
    """The factor on a step with which its error would meet the tolerance, times SAFETY_FACTOR.

    It is at least SAFETY_FACTOR if the step itself meets the tolerance, and 0 if the error is NaN.

    Args:
        error: the estimated error of each field.
        carry: the trajectory before the step.
        trial: the state at the end of the step.
        numerics: the tolerances.
        order: the power of the step's length with which the error grows.
    """
    assert numerics.rtol is not None
    assert numerics.atol is not None
    finer = tolerance_scale(carry.step_factor)
    worst = jnp.zeros_like(carry.t)
    for name, error_of_field in error.items():
        size = jnp.maximum(jnp.abs(getattr(carry.state, name)), jnp.abs(getattr(trial, name)))
        worst = jnp.maximum(
            worst, jnp.max(jnp.abs(error_of_field) / (finer * (numerics.atol + numerics.rtol * size)))
        )
    worst = jax.lax.stop_gradient(worst)
    floor = (SAFETY_FACTOR / 10.0) ** order
    worst = jnp.maximum(worst, floor)
    # of tsit5 the fourth root instead of the fifth: two square roots are far cheaper, and the tolerance is
    # met as well
    root = jnp.sqrt(jnp.sqrt(worst)) if order == ORDER - 1 else jnp.exp(jnp.log(worst) / order)
    change = SAFETY_FACTOR / root
    return jnp.where(worst >= 0.0, change, 0.0)


def growing_step(
    method: Method,
    carry: Carry,
    *,
    land: Flag,
    still: Flag,
    hit: Flag,
    locating: Flag,
    guess: Number,
) -> StepLengths:
    """The lengths of the next steps of a method without step control, which grow after an event.

    Args:
        method: the method.
        carry: the trajectory before the attempt.
        land, hit: whether the trial is an event, and whether a guard fired there.
        still: whether the trial has zero length.
        locating: whether an event is being located.
        guess: the next trial of that location (s).
    """
    # a step shortened by a stop or an event does not limit the next step
    grown = jnp.minimum(carry.dt, method.growth * carry.h_max)
    first = method.first_step * carry.dt
    h_max = jnp.where(land | still, first, jnp.where(hit | locating, carry.h_max, grown))
    return StepLengths(h_max, jnp.where(land, 0.0, jnp.where(locating, guess, h_max)))


def controlled_step(
    method: Method,
    carry: Carry,
    h: Number,
    change: Number,
    *,
    failed: Flag,
    land: Flag,
    hit: Flag,
    locating: Flag,
    guess: Number,
) -> StepLengths:
    """The lengths of the next steps of a method with step control.

    Args:
        method: the method.
        carry: the trajectory before the attempt.
        h: the length of the trial (s).
        change: its `fitting_change`.
        failed: whether the step missed the tolerance.
        land, hit: whether the trial is an event, and whether a guard fired there.
        locating: whether an event is being located.
        guess: the next trial of that location (s).
    """
    dt = carry.dt
    shortest = MIN_STEP * carry.dt
    # at the start the time scale of the flow is unknown
    first = jnp.maximum(jnp.where(carry.h_max > 0.0, method.first_step * carry.h_max, 1e-3 * dt), shortest)
    shorter = jnp.maximum(h * jnp.maximum(change, MIN_FACTOR), shortest)
    # a step shortened by a stop or an event only shows that its length is accurate
    longer = jnp.maximum(carry.h_max, h * jnp.minimum(change, method.growth))
    met = jnp.where(h < carry.h_max, longer, h * jnp.minimum(change, method.growth))
    h_max = jnp.where(hit | locating, carry.h_max, jnp.minimum(dt, jnp.maximum(met, shortest)))
    h_max = jnp.where(failed, shorter, jnp.where(land, carry.h_max, jnp.where(h == 0.0, first, h_max)))
    next_h = jnp.where(land, 0.0, jnp.where(failed, shorter, jnp.where(locating, guess, h_max)))
    return StepLengths(h_max, next_h)
