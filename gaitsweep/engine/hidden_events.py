"""Detection of events that may begin and end inside one step, with the guard below zero at both ends.

A short contact inside a step is not visible in the guard at the ends of the step. So a step is rejected if a
guard that is below zero at its end could have reached zero inside: the tangent at the beginning crosses zero
within the step, and at the end the guard is so far below the tangent that it may have passed a maximum. Half
the step is tried then. For a guard that is concave, the tangent is an upper bound, so no event is missed.

A guard may also be faster than the flow (the teeth of a wheel), so that a step which is accurate for the flow
passes several of its zeros. So methods with step control evaluate the guards inside the step too, and reject
it if a guard is above zero there, or far from the cubic through its values and slopes at both ends.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaitsweep.contract import HybridModel, Params, Rates, State
from gaitsweep.engine.carry import Flag, Guards, Number, unlikely
from gaitsweep.engine.solver.runge_kutta import euler_update

# A guard may have passed a maximum if the parabola through its values at both ends, with its slope at the
# beginning, has its maximum within this many steps. The value is above 1, since the maximum of a curve that
# falls steeply and then flattens is before that of the parabola.
TOP_WITHIN = 2.0

# Shares of a step at which guards are evaluated inside it. They are no simple fractions: a guard whose
# period is a fraction of the step could have the same value there as at the ends.
PROBES = (0.29, 0.63)
# Largest distance of a guard from its cubic, as a share of its largest value in the step.
MAX_CUBIC_ERROR = 0.1


def guard_slopes(model: HybridModel, params: Params, state: State, rates: Rates) -> Guards:
    """Time derivatives of the guards along a flow (their units per s), without derivatives of their own.

    Args:
        model: the model.
        params: its parameters.
        state: a state.
        rates: the flow's rates there.
    """
    params = jax.lax.stop_gradient(params)
    return slopes_along(lambda s: model.guards(params, s), state, rates)


def slopes_along(
    function: Callable[[State], Float[Array, " values"]], state: State, rates: Rates
) -> Float[Array, " values"]:
    """Time derivatives of a function of the state along a flow, without derivatives of their own.

    Args:
        function: from a state to values (n,).
        state: a state.
        rates: the flow's rates there.
    """
    constant_state = jax.lax.stop_gradient(state)
    constant_rates = {name: jax.lax.stop_gradient(rate) for name, rate in rates.items()}
    zero = jnp.zeros_like(jax.tree.leaves(constant_rates)[0], shape=())

    def after(t: Number) -> Float[Array, " values"]:
        return function(euler_update(constant_state, constant_rates, t))

    return jax.jvp(after, (zero,), (jnp.ones_like(zero),))[1]


def may_hide(near: Guards, slopes: Guards, end: Guards, h: Number) -> Flag:
    """Whether a guard may be above zero inside a step and is below zero at both ends.

    Args:
        near: the guards at the step's beginning.
        slopes: their time derivatives there.
        end: the guards at its end.
        h: its length (s).
    """
    rise = slopes * h
    tangent = near + rise
    may_reach = unlikely(jnp.any(tangent >= 0.0))
    passes = (tangent >= 0.0) & (end < 0.0) & (tangent - end > rise / (2.0 * TOP_WITHIN))
    return may_reach & jnp.any(passes)


def interpolated(state: State, rates: Rates, end: State, end_rates: Rates, h: Number, share: float) -> State:
    """The state at a share of a step, on the cubic through its ends.

    Args:
        state: the state at the step's beginning.
        rates: the flow's rates there.
        end: the state at the step's end.
        end_rates: the flow's rates there.
        h: its length (s).
        share: the share, 0 to 1.
    """
    inside = {
        name: _cubic(getattr(state, name), rate, getattr(end, name), end_rates[name], h, share)
        for name, rate in rates.items()
    }
    return dataclasses.replace(state, **inside)


def unresolved(
    near: Guards, slopes: Guards, end: Guards, end_slopes: Guards, inside: list[Guards], h: Number
) -> Flag:
    """Whether a step is too long for one of its guards.

    Args:
        near: the guards at the step's beginning.
        slopes: their time derivatives there.
        end: the guards at the step's end.
        end_slopes: their time derivatives there.
        inside: the guards at the shares `PROBES` of the step.
        h: its length (s).
    """
    if near.size == 0:
        return jnp.zeros((), bool)
    size = jnp.maximum(jnp.abs(near), jnp.abs(end))
    for probe in inside:
        size = jnp.maximum(size, jnp.abs(probe))
    suspect = jnp.zeros(near.shape, bool)
    for share, probe in zip(PROBES, inside, strict=True):
        deviation = jnp.abs(probe - _cubic(near, slopes, end, end_slopes, h, share))
        suspect = suspect | (probe >= 0.0) | (deviation > MAX_CUBIC_ERROR * size)
    return jnp.any(suspect & (near < 0.0) & (end < 0.0))


def _cubic(
    a: Float[Array, " ..."],
    a_rate: Float[Array, " ..."],
    b: Float[Array, " ..."],
    b_rate: Float[Array, " ..."],
    h: Number,
    s: float,
) -> Float[Array, " ..."]:
    """The cubic Hermite polynomial at the share `s` of a step, from values and rates at its ends a and b."""
    left = 1.0 - s
    return (
        (1.0 + 2.0 * s) * left**2 * a
        + (3.0 - 2.0 * s) * s**2 * b
        + h * (s * left**2 * a_rate - s**2 * left * b_rate)
    )
