"""Runge-Kutta methods, for every flow: Euler's, the classic one, and the pair of Tsitouras with step control.

Ch. Tsitouras, Runge-Kutta pairs of order 5(4) satisfying only the first column simplifying assumption,
Comput. Math. Appl. 62 (2011) 770-775.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from gaitsweep.contract import HybridModel, Params, Rates, State
from gaitsweep.engine.carry import Number

# The state after a time h (s), with unchanged modes.
Step = Callable[[Params, State, Number], State]
# The same, with an estimate of the local error by field.
Estimate = Callable[[Params, State, Number], tuple[State, Rates]]

# a_ij, one row for each stage after the first; the last row has the weights of the solution of order 5.
STAGES: tuple[tuple[float, ...], ...] = (
    (0.161,),
    (-0.008480655492356989, 0.335480655492357),
    (2.8971530571054935, -6.359448489975075, 4.3622954328695815),
    (5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525),
    (5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383),
    (0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774),
)
# Weights of the difference between the solutions of order 5 and 4.
DIFFERENCE = (
    -0.00178001105222577714,
    -0.0008164344596567469,
    0.007880878010261995,
    -0.1447110071732629,
    0.5823571654525552,
    -0.45808210592918697,
    1.0 / 66.0,
)


def euler_update(state: State, rates: Rates, h: Number | float) -> State:
    """The state after a time at constant rates; fields without a rate are unchanged.

    Args:
        state: the state.
        rates: the rates by field (1/s times the field's unit).
        h: the time (s).
    """
    moved = {name: getattr(state, name) + h * rate for name, rate in rates.items()}
    return dataclasses.replace(state, **moved)


def rk4(model: HybridModel) -> Step:
    """The classic Runge-Kutta step of order 4; stable if dt times the fastest rate is below 2.6."""

    def step(params: Params, state: State, h: Number) -> State:
        k1 = model.flow(params, state)
        k2 = model.flow(params, euler_update(state, k1, 0.5 * h))
        k3 = model.flow(params, euler_update(state, k2, 0.5 * h))
        k4 = model.flow(params, euler_update(state, k3, h))
        sixfold = {name: k1[name] + 2.0 * (k2[name] + k3[name]) + k4[name] for name in k1}
        return euler_update(state, sixfold, h * (1.0 / 6.0))

    return step


def tsit5(model: HybridModel) -> Estimate:
    """The step of order 5 of Tsitouras, with an estimate of its error."""

    def step(params: Params, state: State, h: Number) -> tuple[State, Rates]:
        rates = [model.flow(params, state)]
        end = state
        for weights in STAGES:
            end = euler_update(state, _sum(weights, rates), h)
            rates.append(model.flow(params, end))
        error = {name: h * rate for name, rate in _sum(DIFFERENCE, rates).items()}
        return end, error

    return step


def _sum(weights: tuple[float, ...], rates: list[Rates]) -> Rates:
    """The weighted sum of the rates of some stages, by field."""
    total = {name: weights[0] * rate for name, rate in rates[0].items()}
    for weight, rates_of_stage in zip(weights[1:], rates[1:], strict=True):
        total = {name: total[name] + weight * rate for name, rate in rates_of_stage.items()}
    return total
