"""The lengths of steps that meet the tolerances on the local error."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from gaitsweep.contract import Rates, State
from gaitsweep.engine.carry import Carry
from gaitsweep.engine.numerics import ORDER, ResolvedNumerics, tolerance_scale
from gaitsweep.engine.shapes import Flag, Number
from gaitsweep.engine.solver import Method

# Step control: the safety factor of a step, the smallest factor by which a failed step is shortened, and the
# smallest step as a share of the longest, which is accepted with any error (a state that diverges is then
# reported as diverged).
CAUTION = 0.9
STEEPEST_CUT = 0.2
LEAST_SHARE = 1e-9


def fitting_change(
    error: Rates, carry: Carry, trial: State, numerics: ResolvedNumerics, order: int
) -> Number:
    """The factor on a step with which its error would meet the tolerance, with the safety factor CAUTION.

    It is at least CAUTION if the step itself meets the tolerance, and 0 if the error is NaN.

    Args:
        error: the estimated error of each field.
        carry: the trajectory before the step.
        trial: the state at the end of the step.
        numerics: the tolerances.
        order: the power of the step's length with which the error grows.
    """
    assert numerics.rtol is not None
    assert numerics.atol is not None
    finer = tolerance_scale(carry.share)
    worst = jnp.zeros_like(carry.t)
    for name, error_of_field in error.items():
        size = jnp.maximum(jnp.abs(getattr(carry.state, name)), jnp.abs(getattr(trial, name)))
        worst = jnp.maximum(
            worst, jnp.max(jnp.abs(error_of_field) / (finer * (numerics.atol + numerics.rtol * size)))
        )
    worst = jax.lax.stop_gradient(worst)
    floor = (CAUTION / 10.0) ** order
    worst = jnp.maximum(worst, floor)
    # of tsit5 the fourth root instead of the fifth: two square roots are far cheaper, and the tolerance is
    # met as well
    root = jnp.sqrt(jnp.sqrt(worst)) if order == ORDER - 1 else jnp.exp(jnp.log(worst) / order)
    change = CAUTION / root
    return jnp.where(worst >= 0.0, change, 0.0)


def controlled(
    method: Method,
    carry: Carry,
    h: Number,
    change: Number,
    failed: Flag,
    land: Flag,
    hit: Flag,
    locating: Flag,
    guess: Number,
) -> tuple[Number, Number]:
    """`Carry.h_max` and the next step (s) after an attempt, for methods with step control.

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
    dt, least = carry.dt, LEAST_SHARE * carry.dt
    # at the start the time scale of the flow is unknown
    begun = jnp.maximum(jnp.where(carry.h_max > 0.0, method.first_step * carry.h_max, 1e-3 * dt), least)
    shorter = jnp.maximum(h * jnp.maximum(change, STEEPEST_CUT), least)
    # a step shortened by a stop or an event only shows that its length is accurate
    longer = jnp.maximum(carry.h_max, h * jnp.minimum(change, method.growth))
    met = jnp.where(h < carry.h_max, longer, h * jnp.minimum(change, method.growth))
    h_max = jnp.where(hit | locating, carry.h_max, jnp.minimum(dt, jnp.maximum(met, least)))
    h_max = jnp.where(failed, shorter, jnp.where(land, carry.h_max, jnp.where(h == 0.0, begun, h_max)))
    next_h = jnp.where(land, 0.0, jnp.where(failed, shorter, jnp.where(locating, guess, h_max)))
    return h_max, next_h
