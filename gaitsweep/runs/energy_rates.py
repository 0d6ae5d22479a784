"""Rates of a model's energies along its flow, which show whether the flow keeps them between events.

The rate is that of the flow at states of a trajectory, not a difference of two states, so it includes neither
events nor integration errors. It is relative to the power that the energy's terms exchange: the sum of the
magnitudes of their rates, at its largest along the row.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from gaitsweep.contract import HybridModel, Model, Params, Quantity, State
from gaitsweep.engine.stored_traces import shapes_of

# An energy whose rate is below this share of the power that its terms exchange is kept.
KEPT = 1e-9
# Ends of the names of signals: the rate of an energy, and the power that its terms exchange.
_RATE = "_rate_of_change"
_POWER = "_power"


def with_rates(model_class: type[Model]) -> type[Model]:
    """A class whose signals include the rate of each energy, and the power that its terms exchange."""

    def signals(self: HybridModel) -> tuple[Quantity, ...]:
        params, state = shapes_of(self)
        names = jax.eval_shape(self.energies, params, state)
        more = (Quantity(name + end, "1", "rate of an energy") for name in names for end in (_RATE, _POWER))
        base: Any = super(watched, self)
        return (*base.signals, *more)

    def signal(self: HybridModel, params: Params, state: State) -> dict[str, jax.Array]:
        with_rates = model_class.signal(self, params, state)
        rates = self.flow(params, state)
        at = {name: getattr(state, name) for name in rates}
        gradients = jax.jacrev(lambda x: self.energies(params, dataclasses.replace(state, **x)))(at)
        for name, gradient in gradients.items():
            terms = jnp.concatenate([jnp.ravel(gradient[key] * rate) for key, rate in rates.items()])
            with_rates |= {name + _RATE: jnp.sum(terms), name + _POWER: jnp.sum(jnp.abs(terms))}
        return with_rates

    members = {"signals": property(signals), "signal": signal, "name": model_class.name}
    watched: type[Any] = type(model_class.__name__, (model_class,), members)
    return watched


def energies_of(watched: Model) -> list[str]:
    """The names of the energies of a model of such a class."""
    return [q.name.removesuffix(_RATE) for q in watched.signals if q.name.endswith(_RATE)]


def change_of_energy(table: pd.DataFrame, name: str) -> str:
    """A sentence about the rate of an energy, from traces of such a class."""
    rates = table[name + _RATE].to_numpy(float)
    most = table.groupby("row")[name + _POWER].transform("max").to_numpy(float)
    shares = np.divide(rates, most, out=np.zeros_like(rates), where=most > 0.0)[np.isfinite(rates)]
    change = _direction_of_change(float(shares.min(initial=0.0)), float(shares.max(initial=0.0)))
    return f"The energy {name} {change} the power that its terms exchange ({shares.size} states)."


def _direction_of_change(low: float, high: float) -> str:
    """Words for the lowest and the highest rate of an energy, shares of the power that its terms exchange."""
    largest = max(-low, high)
    if largest < KEPT:
        return f"is kept between events: its rate of change is at most {largest:.1e} of"
    if high < KEPT:
        direction = "only falls"
    elif -low < KEPT:
        direction = "only rises"
    else:
        direction = "rises and falls"
    return f"is not kept between events: it {direction}, by up to {largest:.2g} of"
