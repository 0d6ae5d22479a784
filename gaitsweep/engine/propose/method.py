"""What a method of stepping is, and moving a state along its rates."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax

from gaitsweep.contract import HybridModel, Params, Rates, State

# The state a time h (s) later, with the discrete modes as they are.
Propose = Callable[[Params, State, jax.Array], State]
# The same with an estimate of the step's error, by field.
Estimate = Callable[[Params, State, jax.Array], tuple[State, Rates]]


@dataclasses.dataclass(frozen=True)
class Method:
    """A way to step, how steps begin after an event, and how long they may be.

    `step` makes the function that steps a model, None where the model brings its own; `first_step` the first
    step after an event, as a share of the longest one (of the last one, where the method is `adaptive`), and
    `growth` the factor by which each step that is accepted lets the next one grow, up to the longest: what an
    event sets in motion in a stiff mode (a foot on hard ground) dies away within a few steps, and feet leave
    and touch again within milliseconds; `linear_only`: right only for `HybridModel.linear`; `adaptive`: an
    `Estimate`, whose steps follow from the tolerances. `limits`: pairs of a damping ratio, in rising order,
    and the largest dt times rate that is right for a motion of that damping ratio.
    """

    step: Callable[[HybridModel], Any] | None
    first_step: float
    growth: float
    linear_only: bool = False
    adaptive: bool = False
    limits: tuple[tuple[float, float], ...] = ()


def move(state: State, rates: Rates, h: jax.Array | float) -> State:
    """`state` after a time `h` (s) along `rates`; fields without a rate stay."""
    moved = {name: getattr(state, name) + h * rate for name, rate in rates.items()}
    return dataclasses.replace(state, **moved)
