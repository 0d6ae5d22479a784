"""Steps of one trajectory: the state a time `h` later, with the discrete modes as they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax

from gaitsweep.contract import HybridModel, Params, Rates, State

Propose = Callable[[Params, State, jax.Array], State]


def move(state: State, rates: Rates, h: jax.Array | float) -> State:
    """`state` after a time `h` (s) along `rates`; fields without a rate stay."""
    moved = {name: getattr(state, name) + h * rate for name, rate in rates.items()}
    return dataclasses.replace(state, **moved)


def rk4(model: HybridModel) -> Propose:
    """The classic Runge-Kutta step of fourth order."""

    def propose(params: Params, state: State, h: jax.Array) -> State:
        k1 = model.flow(params, state)
        k2 = model.flow(params, move(state, k1, 0.5 * h))
        k3 = model.flow(params, move(state, k2, 0.5 * h))
        k4 = model.flow(params, move(state, k3, h))
        mean = {name: (k1[name] + 2.0 * (k2[name] + k3[name]) + k4[name]) / 6.0 for name in k1}
        return move(state, mean, h)

    return propose


METHODS: dict[str, Callable[[HybridModel], Propose]] = {"rk4": rk4}
