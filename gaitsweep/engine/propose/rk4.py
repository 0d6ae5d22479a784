"""The classic Runge-Kutta method, for every flow."""

from __future__ import annotations

import jax

from gaitsweep.contract import HybridModel, Params, State
from gaitsweep.engine.propose.method import Propose, move


def rk4(model: HybridModel) -> Propose:
    """The classic Runge-Kutta step of order 4; stable if dt times the fastest rate is below 2.7."""

    def propose(params: Params, state: State, h: jax.Array) -> State:
        k1 = model.flow(params, state)
        k2 = model.flow(params, move(state, k1, 0.5 * h))
        k3 = model.flow(params, move(state, k2, 0.5 * h))
        k4 = model.flow(params, move(state, k3, h))
        sixfold = {name: k1[name] + 2.0 * (k2[name] + k3[name]) + k4[name] for name in k1}
        return move(state, sixfold, h * (1.0 / 6.0))

    return propose
