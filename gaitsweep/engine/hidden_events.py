"""Detection of events that may begin and end inside one step, with the guard below zero at both ends.

A short contact inside a step is not visible in the guard at the ends of the step. So a step is rejected if a
guard that is below zero at its end could have reached zero inside: the tangent at the beginning crosses zero
within the step, and at the end the guard is so far below the tangent that it may have passed a maximum. Half
the step is tried then. For a guard that is concave, the tangent is an upper bound, so no event is missed.

A guard may also be faster than the flow (the teeth of a wheel), so that a step which is accurate for the flow
passes several of its zeros. So methods with step control look at the guards inside the step too, and reject
it if a guard is above zero there, or far from the cubic through its values and slopes at both ends.

A flow may switch at an instant: `jnp.where(clock > 1.0, ...)`. Comparisons of moving variables are read off
its program, and a step across which one of them changes is shortened, so that no pulse is stepped over.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Literal, jaxpr_as_fun

from gaitsweep.contract import HybridModel, Params, Rates, State
from gaitsweep.engine.propose import move
from gaitsweep.engine.rarity import rarely

# A guard may have passed a maximum if the parabola through its values at both ends, with its slope at the
# beginning, has its maximum within this many steps. The value is above 1, since the maximum of a curve that
# falls steeply and then flattens is before that of the parabola.
TOP_WITHIN = 2.0

# Where guards are looked at inside a step, as shares of it: no simple fractions, which multiples of a
# period meet.
LOOKS = (0.29, 0.63)
# Largest distance of a guard from its cubic, as a share of its largest value in the step.
RESOLVED = 0.1
# Comparisons whose change within a step switches a flow.
_COMPARISONS = ("lt", "le", "gt", "ge")


def guard_slopes(model: HybridModel, params: Params, state: State, rates: Rates) -> jax.Array:
    """Time derivatives of the guards along a flow (their units per s), without derivatives of their own."""
    still, params = jax.lax.stop_gradient((state, params))
    along = {name: jax.lax.stop_gradient(rate) for name, rate in rates.items()}
    zero = jnp.zeros_like(jax.tree.leaves(along)[0], shape=())
    _, slopes = jax.jvp(
        lambda s: model.guards(params, move(still, along, s)), (zero,), (jnp.ones_like(zero),)
    )
    return slopes


def may_hide(near: jax.Array, slopes: jax.Array, end: jax.Array, h: jax.Array) -> jax.Array:
    """Whether a guard may be above zero inside a step and is below zero at both ends.

    Args:
        near, slopes: the guards and their time derivatives at the step's beginning.
        end: the guards at its end.
        h: its length (s).
    """
    rise = slopes * h
    tangent = near + rise
    may_reach = rarely(jnp.any(tangent >= 0.0))
    passes = (tangent >= 0.0) & (end < 0.0) & (tangent - end > rise / (2.0 * TOP_WITHIN))
    return may_reach & jnp.any(passes)


def between(state: State, rates: Rates, end: State, end_rates: Rates, h: jax.Array, share: float) -> State:
    """The state at a share of a step, on the cubic through its ends."""
    inside = {
        name: _cubic(getattr(state, name), rate, getattr(end, name), end_rates[name], h, share)
        for name, rate in rates.items()
    }
    return dataclasses.replace(state, **inside)


def unresolved(
    near: jax.Array,
    slopes: jax.Array,
    end: jax.Array,
    end_slopes: jax.Array,
    looks: list[jax.Array],
    h: jax.Array,
) -> jax.Array:
    """Whether a step is too long for one of its guards.

    Args:
        near, slopes: the guards and their time derivatives at the step's beginning.
        end, end_slopes: the same at its end.
        looks: the guards inside, at `LOOKS`.
        h: its length (s).
    """
    if near.size == 0:
        return jnp.zeros((), bool)
    size = jnp.maximum(jnp.abs(near), jnp.abs(end))
    for look in looks:
        size = jnp.maximum(size, jnp.abs(look))
    apart = jnp.zeros(near.shape, bool)
    for share, look in zip(LOOKS, looks, strict=True):
        off = jnp.abs(look - _cubic(near, slopes, end, end_slopes, h, share))
        apart = apart | (look >= 0.0) | (off > RESOLVED * size)
    return jnp.any(apart & (near < 0.0) & (end < 0.0))


def switches(flow: Callable[[Params, State], Rates], params: Params, state: State) -> jax.Array:
    """The truth (n,) of the comparisons by which a flow switches as its variables move."""
    closed, rates = jax.make_jaxpr(flow, return_shape=True)(params, state)
    program, given = closed.jaxpr, jax.tree.leaves((params, state))
    held = len(jax.tree.leaves(params))
    # a state that is registered without names of its fields counts as moving as a whole
    fields = [getattr(path[0], "name", None) for path, _ in jax.tree_util.tree_leaves_with_path(state)]
    moving = {v for v, name in zip(program.invars[held:], fields, strict=True) if name in (None, *rates)}
    found = []
    for equation in program.eqns:
        if moving.intersection(v for v in equation.invars if not isinstance(v, Literal)):
            moving.update(equation.outvars)
            if equation.primitive.name in _COMPARISONS:
                found += equation.outvars
    if not found:
        return jnp.zeros((0,), bool)
    compared = ClosedJaxpr(program.replace(outvars=found, debug_info=None), closed.consts)
    told = jaxpr_as_fun(compared)(*given)
    return jnp.concatenate([jnp.ravel(each) for each in told])


def _cubic(
    a: jax.Array, a_rate: jax.Array, b: jax.Array, b_rate: jax.Array, h: jax.Array, s: float
) -> jax.Array:
    """The cubic Hermite polynomial at the share s of a step."""
    rest = 1.0 - s
    return (
        (1.0 + 2.0 * s) * rest**2 * a
        + (3.0 - 2.0 * s) * s**2 * b
        + h * (s * rest**2 * a_rate - s**2 * rest * b_rate)
    )
