"""How trajectories are integrated: the method, its tolerances, and how long a step may be.

A model recommends its numerics (`Model.recommended`), and how long its steps may be follows from a row's
parameters. What a job leaves open is taken from there.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from gaitsweep.contract import HybridModel, Model, Params
from gaitsweep.engine.propose import METHODS, own_steps

# The start value, beside a model's own, by which a row's steps are shorter than its numerics say: 1, or less
# where a row is repeated to see how far its numbers depend on the step. No model's name has a dot.
SHARE = "numerics.share"
# Order of the step's error in its length, for methods whose steps follow from a tolerance.
ORDER = 5
# Of the longest step that is right, what is recommended.
SAFETY = 0.85
# Steps of an adaptive method that fit into its longest one before a row counts as having too many.
ADAPTIVE_STEPS = 64.0
# Steps with a tolerance are at most this share of a nominal period, so that few events begin and end inside
# one (`hidden_events`). A step of any method that is written in a job may be four times as long.
SHORTEST_CYCLE = 32.0
FEWEST_STEPS = 8.0


@dataclasses.dataclass(frozen=True)
class Numerics:
    """How trajectories are integrated; what is None or auto is what the model recommends.

    `dt` the longest step (s); `method` one of `METHODS`; `event_tolerance` of event times (s); `rtol`, `atol`
    the relative and absolute tolerance of a step's error, for methods that estimate it.
    `precision`: float64, float32, or mixed: all that a trajectory carries is float64, and a step's length
    reaches the model as float32, to tell it that forces may be worked out so.
    """

    dt: float | None = None
    method: str = "auto"
    precision: str = "float64"
    event_tolerance: float = 1.0e-12
    rtol: float | None = None
    atol: float | None = None

    def of(self, model: Model) -> Numerics:
        """The same with a model's recommendation in place of what is left open, but for `dt`."""
        recommended = model.recommended
        return dataclasses.replace(
            self,
            method=recommended.method if self.method == "auto" else self.method,
            rtol=recommended.rtol if self.rtol is None else self.rtol,
            atol=recommended.atol if self.atol is None else self.atol,
        )

    @property
    def adaptive(self) -> bool:
        """Whether steps follow from the tolerances; the method has to be known."""
        return METHODS[self.method].adaptive

    @property
    def steps_in_longest(self) -> float:
        """Steps that the limit on attempts allows for each longest one; the method has to be known."""
        return ADAPTIVE_STEPS if self.adaptive else 1.0

    @property
    def carried(self) -> str:
        """The dtype of rows' values, states and times."""
        return "float64" if self.precision == "mixed" else self.precision

    @property
    def stepped(self) -> str:
        """The dtype of the step that a model of steps is given."""
        return "float32" if self.precision == "mixed" else self.precision


def longest_step(model: Model, method: str, params: Params) -> jax.Array | None:
    """The longest step (s) that is right with a method and these parameters; None where it is not known.

    Args:
        model: the model.
        method: a name of `METHODS`, not auto.
        params: its parameters.
    """
    steps = own_steps(method, model)
    if steps is not None:
        return steps.longest_step(params)
    assert isinstance(model, HybridModel)
    if METHODS[method].adaptive:
        return model.period(params) / FEWEST_STEPS
    modes = model.fast_modes(params)
    if modes is None:
        return None
    rates, damping = modes
    ratios, limits = (jnp.asarray(column) for column in zip(*METHODS[method].limits, strict=True))
    allowed = jnp.interp(damping, ratios, limits)
    # where all motions are slow, steps still have to be short beside a cycle
    return jnp.minimum(jnp.min(allowed / rates), model.period(params) / FEWEST_STEPS)


def recommended_step(model: Model, numerics: Numerics, params: Params) -> jax.Array | None:
    """The longest step (s) that a row takes: that of the numerics, or the one its model recommends.

    None where the numerics leave it open and the model does not know it either.
    """
    resolved = numerics.of(model)
    if resolved.dt is not None:
        return jnp.full_like(model.period(params), resolved.dt)
    longest = longest_step(model, resolved.method, params)
    if longest is None or own_steps(resolved.method, model) is not None:
        return longest
    if METHODS[resolved.method].adaptive:
        return longest * (FEWEST_STEPS / SHORTEST_CYCLE)
    return SAFETY * longest


def step_of(model: Model, numerics: Numerics, params: Params) -> jax.Array:
    """As `recommended_step`, where it has to be known.

    Raises:
        ValueError: neither the numerics nor the model say how long a step may be.
    """
    dt = recommended_step(model, numerics, params)
    if dt is None:
        method = numerics.of(model).method
        raise ValueError(unknown_step(model, method))
    return dt


def unknown_step(model: Model, method: str) -> str:
    """The sentence about a step that neither the numerics nor the model know."""
    return f"{model.name} does not say how long a step of {method} may be: give numerics.dt."


def tolerance_scale(share: Any) -> Any:
    """How much finer the tolerances of a row with this share are: 1/32 at half the step."""
    return share**ORDER
