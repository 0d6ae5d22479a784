"""Steps of a linear flow, x' = A x + b, by a polynomial that approximates the propagator exp(h A).

A step is x + sum of s_k h^k/k! A^(k-1) x' over k = 1..n. With all s_k = 1 this is the Taylor series, which is
accurate only if h times the fastest rate is well below n. Here s_k = 1 up to the order of the method, and the
other s_k are fitted: the polynomial R(z), z = h lambda, is the best approximation of exp(z) on -20 <= z <= 0.
So a stiff damped mode (a foot on hard ground) is not only stable: its transient is accurate, with steps many
times as long as those of `rk4`. Only products of A with a vector are needed.

`tests/reference/exponential_polynomial.py` reproduces the fit.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import jax

from gaitsweep.contract import HybridModel, Params, Rates, State
from gaitsweep.engine.carry import Number
from gaitsweep.engine.solver.runge_kutta import Step, euler_update

# The factors of the Taylor terms, s_1, s_2, ...
Shares = tuple[float, ...]

# Order 6, 14 products: within 2.1e-3 of exp(z) on [-20, 0], |R| <= 1 down to z = -21.4; with z off the
# negative axis by 15, 30 and 45 degrees while |z| < 17, 12, 8.9.
PROPAGATOR6: Shares = (
    *(1.0,) * 6,
    0.9837727362578907,
    0.9075049629828137,
    0.7339329699395952,
    0.48702659640781065,
    0.2491066550724977,
    0.09124456955919891,
    0.02123629771632427,
    0.002359290641775199,
)

# Order 8, 20 products: within 8.1e-7 of exp(z) on [-20, 0], |R| <= 1 down to z = -23.2. What is left of
# the error on the multi-legged chain is that of locating events to 1e-12 s.
PROPAGATOR: Shares = (
    *(1.0,) * 8,
    0.9997009633863908,
    0.9968399635972519,
    0.9832720295345129,
    0.9414095260361924,
    0.8483827264913743,
    0.69231779512539,
    0.4905025912232307,
    0.288551609845606,
    0.13383892796663702,
    0.04559201755274714,
    0.010105059182706266,
    0.001091453059734371,
)


def exponential(shares: Shares) -> Callable[[HybridModel], Step]:
    """The method with some factors of the Taylor terms: it returns the step of a model.

    A nonlinear flow is linearised at the beginning of each step, which is accurate to second order. Powers of
    rates are not scaled, so float64 is required.

    Args:
        shares: the factors s_1, s_2, ...
    """

    def method(model: HybridModel) -> Step:
        def step(params: Params, state: State, h: Number) -> State:
            def flow(moving: Rates) -> Rates:
                return model.flow(params, dataclasses.replace(state, **moving))

            names = list(jax.eval_shape(model.flow, params, state))
            term, times_a = jax.linearize(flow, {name: getattr(state, name) for name in names})
            end = euler_update(state, term, h)
            power = h
            for k, share in enumerate(shares[1:], start=2):
                term = times_a(term)
                power = power * h
                end = euler_update(end, term, power * (share / math.factorial(k)))
            return end

        return step

    return method
