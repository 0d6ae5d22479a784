"""The definition of an integration method, and the update of a state by rates."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from gaitsweep.contract import Params, Rates, State
from gaitsweep.engine.carry import Number

# The state after a time h (s), with unchanged modes.
Step = Callable[[Params, State, Number], State]
# The same, with an estimate of the local error by field.
Estimate = Callable[[Params, State, Number], tuple[State, Rates]]


@dataclasses.dataclass(frozen=True)
class Method:
    """An integration method, its steps after an event, and its longest step.

    Short steps are needed after an event, which excites stiff modes (a foot on hard ground) that decay within
    a few steps, and since feet may lift off and touch down again within milliseconds.

    Attributes:
        step: returns the function that steps a model; None if the model has its own.
        first_step: the first step after an event, as a share of the longest step (of the last one if
            `adaptive`).
        growth: the factor by which each accepted step may exceed the one before, up to the longest.
        linear_only: whether it is accurate only for `HybridModel.linear`.
        adaptive: whether its step is an `Estimate`, with step control.
        series: whether its steps are expansions, of the order that the tolerance asks for.
        limits: pairs of a damping ratio, in rising order, and the largest accurate dt times rate of a motion
            with that damping ratio.
    """

    step: Callable[..., Any] | None
    first_step: float
    growth: float
    linear_only: bool = False
    adaptive: bool = False
    series: bool = False
    limits: tuple[tuple[float, float], ...] = ()


def euler_update(state: State, rates: Rates, h: Number | float) -> State:
    """The state after a time at constant rates; fields without a rate are unchanged.

    Args:
        state: the state.
        rates: the rates by field (1/s times the field's unit).
        h: the time (s).
    """
    moved = {name: getattr(state, name) + h * rate for name, rate in rates.items()}
    return dataclasses.replace(state, **moved)
