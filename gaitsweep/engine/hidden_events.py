"""Events that may begin and end inside one step: at both of its ends the guard is below zero.

A leg that grazes the ground between two ends of a step would leave no trace there. So a step is not taken
while a guard that stays below zero at its end could have reached zero on the way: the tangent at the step's
beginning crosses zero within the step, and the guard has fallen so far below that tangent at the end that it
may have turned. Half the step is tried then. A guard whose curve lies below that tangent (one that rises ever
more slowly, then falls) is never missed by the tangent itself.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from gaitsweep.contract import HybridModel, Params, Rates, State
from gaitsweep.engine.propose import move

# The parabola through the guard at both ends, with its slope at the beginning, has its top within this many
# steps. One step would be the top itself; a curve that falls steeply and then flattens has its top before
# that of the parabola.
TOP_WITHIN = 2.0


def guard_slopes(model: HybridModel, params: Params, state: State, rates: Rates) -> jax.Array:
    """How fast each guard rises along a flow (1/s times its unit), as numbers without a derivative."""
    still, params = jax.lax.stop_gradient((state, params))
    along = {name: jax.lax.stop_gradient(rate) for name, rate in rates.items()}
    zero = jnp.zeros_like(jax.tree.leaves(along)[0], shape=())
    _, slopes = jax.jvp(
        lambda s: model.guards(params, move(still, along, s)), (zero,), (jnp.ones_like(zero),)
    )
    return slopes


def may_hide(near: jax.Array, slopes: jax.Array, end: jax.Array, h: jax.Array) -> jax.Array:
    """Whether any guard may have been above zero within a step and is below it at both ends.

    Args:
        near, slopes: the guards at the step's beginning and how fast they rise there.
        end: the guards at its end.
        h: its length (s).
    """
    rise = slopes * h
    tangent = near + rise
    return jnp.any((tangent >= 0.0) & (end < 0.0) & (tangent - end > rise / (2.0 * TOP_WITHIN)))
