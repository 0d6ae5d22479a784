"""Detection of events that may begin and end inside one step, with the guard below zero at both ends.

A short contact inside a step is not visible in the guard at the ends of the step. So a step is rejected if a
guard that is below zero at its end could have reached zero inside: the tangent at the beginning crosses zero
within the step, and at the end the guard is so far below the tangent that it may have passed a maximum. Half
the step is tried then. For a guard that is concave, the tangent is an upper bound, so no event is missed.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from gaitsweep.contract import HybridModel, Params, Rates, State
from gaitsweep.engine.propose import move
from gaitsweep.engine.rarity import rarely

# A guard may have passed a maximum if the parabola through its values at both ends, with its slope at the
# beginning, has its maximum within this many steps. The value is above 1, since the maximum of a curve that
# falls steeply and then flattens is before that of the parabola.
TOP_WITHIN = 2.0


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
