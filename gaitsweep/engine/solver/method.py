"""The definition of an integration method, and the update of a state by rates."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from gaitsweep.contract import Params, Rates, State
from gaitsweep.engine.shapes import Number

# The state after a time h (s), with unchanged modes.
Step = Callable[[Params, State, Number], State]
# The same, with an estimate of the local error by field.
Estimate = Callable[[Params, State, Number], tuple[State, Rates]]


@dataclasses.dataclass(frozen=True)
class Method:
    """An integration method, its steps after an event, and its longest step.

    `step` returns the function that steps a model, None if the model has its own; `first_step` is the first
    step after an event, as a share of the longest step (of the last one if `adaptive`), and `growth` the
    factor by which each accepted step may exceed the one before, up to the longest. Short steps are needed
    since an event excites stiff modes (a foot on hard ground), which decay within a few steps, and since feet
    may lift off and touch down again within milliseconds. `linear_only`: accurate only for
    `HybridModel.linear`; `adaptive`: an `Estimate` with step control; `series`: its steps are expansions, of
    the order that the tolerance asks for. `limits` are pairs of a damping ratio, in rising order, and the
    largest accurate dt times rate of a motion with that damping ratio.
    """

    step: Callable[..., Any] | None
    first_step: float
    growth: float
    linear_only: bool = False
    adaptive: bool = False
    series: bool = False
    limits: tuple[tuple[float, float], ...] = ()


def euler_update(state: State, rates: Rates, h: Number | float) -> State:
    """The state after a time `h` (s) at constant `rates`; fields without a rate are unchanged."""
    moved = {name: getattr(state, name) + h * rate for name, rate in rates.items()}
    return dataclasses.replace(state, **moved)
