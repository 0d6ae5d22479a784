"""Classic Runge-Kutta with located events, one evaluation of the flow at a time.

The arithmetic is that of an attempt of `rk4`, split into stages: the rates at two mid-points, at the end, and
at the trial state, where the event logic follows. The program is a fifth as long, which matters when it is
differentiated and compiled as straight-line code. No evaluation is repeated: the rates at an accepted trial
are those at the next state, and after a rejected trial the rates at the state are kept.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from gaitsweep.contract import HybridModel, Params, Rates
from gaitsweep.engine.advance import advance
from gaitsweep.engine.carry import Carry, select
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.solver import euler_update
from gaitsweep.engine.trial import Precomputed

# Stages of the next evaluation: 1 to 3 are those after the first stage of a step, then the trial follows.
LAST, TRIAL = 3, 4


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Stages:
    """The progress of an attempt.

    `stage` is the stage of the next evaluation of the flow; `at` the continuous fields of that evaluation;
    `first` the rates at the state; `total` the weighted sum of the rates so far.
    """

    stage: Int[Array, ""]
    at: Rates
    first: Rates
    total: Rates


Pair = tuple[Carry, Stages]


def begin(model: HybridModel, params: Params, carry: Carry) -> Pair:
    """The carry and stages of a new trajectory, whose first attempt has zero length."""
    at = {name: getattr(carry.state, name) for name in jax.eval_shape(model.flow, params, carry.state)}
    unknown = {name: jnp.zeros_like(value) for name, value in at.items()}
    return carry, Stages(jnp.full_like(carry.halt, TRIAL), at, unknown, unknown)


def stagewise(model: HybridModel, numerics: ResolvedNumerics) -> Callable[[Params, Pair], Pair]:
    """The function of one stage; forward-mode derivatives include those of located event times."""

    def evaluate(params: Params, pair: Pair) -> Pair:
        carry, s = pair
        stage_state = dataclasses.replace(carry.state, **s.at)
        rates = model.flow(params, stage_state)
        tried = s.stage == TRIAL
        precomputed = Precomputed(lambda *_: stage_state, lambda *_: s.first, lambda *_: rates)
        conclude = advance(model, numerics, sensitivities=True, precomputed=precomputed)
        fired = jnp.any(model.guards(params, stage_state) >= 0.0)
        after = conclude(params, carry)
        # a step may be rejected without an event: it is tried again from the same state
        accepted = tried & ~fired & ((after.t > carry.t) | (carry.h == 0.0))
        carry = select(tried, after, carry)

        first = select(accepted, rates, s.first)
        weight = jnp.where(s.stage == LAST, 1.0, 2.0)
        summed = {name: total + weight * rates[name] for name, total in s.total.items()}
        total = select(tried, first, summed)
        follows = jnp.where(tried, 1, s.stage + 1)
        h = jnp.minimum(carry.h, jnp.maximum(carry.stop - carry.t, 0.0))
        share = jnp.where(follows == TRIAL, 1.0 / 6.0, jnp.where(follows == LAST, 1.0, 0.5))
        along = select(follows == TRIAL, total, select(tried, first, rates))
        # the attempt after a jump has zero length, and its rates are not known yet
        jumped = tried & (carry.h == 0.0)
        along = {name: jnp.where(jumped, 0.0, rate) for name, rate in along.items()}
        next_state = euler_update(carry.state, along, h * share)
        at = {name: getattr(next_state, name) for name in s.at}
        stage = jnp.where(jumped, TRIAL, follows).astype(s.stage.dtype)
        return carry, Stages(stage, at, first, total)

    return evaluate
