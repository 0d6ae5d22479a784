"""Step control: whether a step is accurate enough to be accepted, and the lengths of the next steps."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from gaitsweep.contract import Rates, State
from gaitsweep.engine.carry import Carry, Flag, Number
from gaitsweep.engine.numerics import ORDER, ResolvedNumerics, tolerance_scale
from gaitsweep.engine.solver.methods import Method

# The safety factor of a step, and the smallest factor by which a step that missed the tolerance is
# shortened.
SAFETY_FACTOR = 0.9
MIN_FACTOR = 0.2
# The smallest step, as a share of the longest, which is accepted with any error (a state that diverges is
# then reported as diverged).
MIN_STEP = 1e-9
# The first step of a trajectory, as a share of the longest: the time scale of the flow is unknown.
FIRST_STEP = 1e-3


@dataclasses.dataclass(frozen=True)
class StepLengths:
    """The upper bound of the next steps (`Carry.h_max`, s), and the next step `h` (s)."""

    h_max: Number
    h: Number


@dataclasses.dataclass(frozen=True)
class EventSearch:
    """The search for an event after a trial.

    Attributes:
        hit: whether a guard fired at the trial.
        land: whether the trial is the event.
        locating: whether an event is still being located.
        guess: the next trial of that location (s).
    """

    hit: Flag
    land: Flag
    locating: Flag
    guess: Number


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
    scale = tolerance_scale(carry.step_factor)
    worst = jnp.zeros_like(carry.t)
    for name, error_of_field in error.items():
        size = jnp.maximum(jnp.abs(getattr(carry.state, name)), jnp.abs(getattr(trial, name)))
        tolerance = scale * (numerics.atol + numerics.rtol * size)
        worst = jnp.maximum(worst, jnp.max(jnp.abs(error_of_field) / tolerance))
    worst = jax.lax.stop_gradient(worst)
    floor = (SAFETY_FACTOR / 10.0) ** order
    worst = jnp.maximum(worst, floor)
    # for tsit5 the fourth root instead of the fifth: two square roots are far cheaper, and the tolerance is
    # met as well
    root = jnp.sqrt(jnp.sqrt(worst)) if order == ORDER - 1 else jnp.exp(jnp.log(worst) / order)
    change = SAFETY_FACTOR / root
    return jnp.where(worst >= 0.0, change, 0.0)


def is_accurate(h: Number, change: Number, dt: Number) -> Flag:
    """Whether a step meets the tolerance on its error; one that does not is rejected and tried shorter.

    Args:
        h: the length of the step (s).
        change: its `fitting_change`.
        dt: the longest step (s); those as short as `MIN_STEP` of it are accepted with any error.
    """
    return (change >= SAFETY_FACTOR) | (h <= MIN_STEP * dt)


def growing_step(method: Method, carry: Carry, search: EventSearch, *, still: Flag) -> StepLengths:
    """The lengths of the next steps of a method without step control, which grow after an event.

    Args:
        method: the method.
        carry: the trajectory before the attempt.
        search: the search for an event after it.
        still: whether the trial has zero length.
    """
    # a step shortened by a stop or an event does not limit the next step
    grown = jnp.minimum(carry.dt, method.growth * carry.h_max)
    first = method.first_step * carry.dt
    unchanged = search.hit | search.locating
    h_max = jnp.where(search.land | still, first, jnp.where(unchanged, carry.h_max, grown))
    next_h = jnp.where(search.land, 0.0, jnp.where(search.locating, search.guess, h_max))
    return StepLengths(h_max, next_h)


def controlled_step(
    method: Method, carry: Carry, search: EventSearch, *, h: Number, change: Number, failed: Flag
) -> StepLengths:
    """The lengths of the next steps of a method with step control.

    Args:
        method: the method.
        carry: the trajectory before the attempt.
        search: the search for an event after it.
        h: the length of the trial (s).
        change: its `fitting_change`.
        failed: whether it missed the tolerance.
    """
    dt = carry.dt
    shortest = MIN_STEP * dt
    first = jnp.where(carry.h_max > 0.0, method.first_step * carry.h_max, FIRST_STEP * dt)
    first = jnp.maximum(first, shortest)
    shorter = jnp.maximum(h * jnp.maximum(change, MIN_FACTOR), shortest)
    fitting = h * jnp.minimum(change, method.growth)
    # a step shortened by a stop or an event only shows that its length is accurate
    fitting = jnp.where(h < carry.h_max, jnp.maximum(carry.h_max, fitting), fitting)
    fitting = jnp.minimum(dt, jnp.maximum(fitting, shortest))
    h_max = jnp.where(search.hit | search.locating, carry.h_max, fitting)
    h_max = jnp.where(search.land, carry.h_max, jnp.where(h == 0.0, first, h_max))
    h_max = jnp.where(failed, shorter, h_max)
    next_h = jnp.where(failed, shorter, jnp.where(search.locating, search.guess, h_max))
    return StepLengths(h_max, jnp.where(search.land, 0.0, next_h))
