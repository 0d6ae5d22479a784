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
from gaitsweep.engine.solver.methods import euler_update
from gaitsweep.engine.trial_step import Precomputed

# Stages of the next evaluation: `FIRST` to `LAST` are those after the rates at the state, then the trial
# follows.
FIRST, LAST, TRIAL = 1, 3, 4


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Stages:
    """The progress of an attempt.

    Attributes:
        stage: the stage of the next evaluation of the flow.
        at: the continuous fields of that evaluation.
        first: the rates at the state.
        total: the weighted sum of the rates so far.
    """

    stage: Int[Array, ""]
    at: Rates
    first: Rates
    total: Rates


Pair = tuple[Carry, Stages]


def begin(model: HybridModel, params: Params, carry: Carry) -> Pair:
    """The carry and stages of a new trajectory, whose first attempt has zero length.

    Args:
        model: the model.
        params: its parameters.
        carry: the trajectory at its start.
    """
    at = {name: getattr(carry.state, name) for name in jax.eval_shape(model.flow, params, carry.state)}
    unknown = {name: jnp.zeros_like(value) for name, value in at.items()}
    return carry, Stages(jnp.full_like(carry.halt, TRIAL), at, unknown, unknown)


def stagewise(model: HybridModel, numerics: ResolvedNumerics) -> Callable[[Params, Pair], Pair]:
    """The function of one stage; forward-mode derivatives include those of located event times.

    Args:
        model: the model.
        numerics: the tolerances of the method rk4.
    """

    def evaluate(params: Params, pair: Pair) -> Pair:
        carry, stages = pair
        stage_state = dataclasses.replace(carry.state, **stages.at)
        rates = model.flow(params, stage_state)
        tried = stages.stage == TRIAL
        precomputed = Precomputed(lambda *_: stage_state, lambda *_: stages.first, lambda *_: rates)
        conclude = advance(model, numerics, sensitivities=True, precomputed=precomputed)
        fired = jnp.any(model.guards(params, stage_state) >= 0.0)
        after = conclude(params, carry)
        # a step may be rejected without an event: it is tried again from the same state
        accepted = tried & ~fired & ((after.t > carry.t) | (carry.h == 0.0))
        carry = select(tried, after, carry)

        first = select(accepted, rates, stages.first)
        weight = jnp.where(stages.stage == LAST, 1.0, 2.0)
        summed = {name: total + weight * rates[name] for name, total in stages.total.items()}
        total = select(tried, first, summed)
        next_stage = jnp.where(tried, FIRST, stages.stage + 1)
        h = jnp.minimum(carry.h, jnp.maximum(carry.stop - carry.t, 0.0))
        share = jnp.where(next_stage == TRIAL, 1.0 / 6.0, jnp.where(next_stage == LAST, 1.0, 0.5))
        along = select(next_stage == TRIAL, total, select(tried, first, rates))
        # the attempt after a jump has zero length, and its rates are not known yet
        jumped = tried & (carry.h == 0.0)
        along = {name: jnp.where(jumped, 0.0, rate) for name, rate in along.items()}
        next_state = euler_update(carry.state, along, h * share)
        at = {name: getattr(next_state, name) for name in stages.at}
        stage = jnp.where(jumped, TRIAL, next_stage).astype(stages.stage.dtype)
        return carry, Stages(stage, at, first, total)

    return evaluate
