"""The polynomials of `gaitsweep.engine.solver.exponential`, fitted anew.

R(z) = 1 + z + .. + z^p/p! + z^(p+1) Q(z) is to be as near as can be to exp(z) on [-reach, 0], in the
largest error. Q is found by least squares over and over, each point weighted by its error so far (Lawson),
in Chebyshev polynomials. `python -m tests.reference.exponential_polynomial` prints the shares.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial, chebyshev
from numpy.typing import NDArray

Array = NDArray[np.float64]


def remainder(z: Array, order: int) -> Array:
    """(exp(z) - its Taylor polynomial of this order) / z^(order + 1), z < 0."""
    near = np.abs(z) < order + 2
    small, large = np.where(near, z, 0.0), np.where(near, -1.0, z)
    term = np.full_like(z, 1.0 / math.factorial(order + 1))
    series = term.copy()
    for k in range(1, 60):
        term = term * small / (order + 1 + k)
        series += term
    taylor = sum(large**k / math.factorial(k) for k in range(order + 1))
    return np.where(near, series, (np.exp(large) - taylor) / large ** (order + 1))


def shares(order: int, degree: int, reach: float, rounds: int = 300) -> list[float]:
    """Share of each Taylor term z^k/k! that is kept, k = 1..degree."""
    z = -reach * (1.0 - np.cos(np.linspace(0.0, np.pi, 1500)[1:])) / 2.0
    goal, scale = remainder(z, order), np.abs(z) ** (order + 1)
    basis = chebyshev.chebvander(2.0 * z / reach + 1.0, degree - order - 1)
    weight = np.full_like(z, 1.0 / z.size)
    least, best = np.inf, np.zeros(degree - order)
    for _ in range(rounds):
        root = np.sqrt(weight) * scale
        result = np.linalg.lstsq(basis * root[:, None], goal * root, rcond=None)[0]
        error = np.abs(basis @ result - goal) * scale
        if error.max() < least:
            least, best = float(error.max()), result
        weight = weight * error
        weight /= weight.sum()
    rest = Chebyshev(best, domain=[-reach, 0.0]).convert(kind=Polynomial, domain=[-1, 1]).coef
    return [1.0] * order + [float(c) * math.factorial(order + 1 + k) for k, c in enumerate(rest)]


def value(kept: list[float] | tuple[float, ...], z: Array) -> Array:
    """R(z) of these shares, z real or complex."""
    total, term = np.ones_like(z), np.ones_like(z)
    for k, share in enumerate(kept, start=1):
        term = term * z / k
        total = total + share * term
    return total


if __name__ == "__main__":
    for name, order, degree in (("PROPAGATOR6", 6, 14), ("PROPAGATOR", 8, 20)):
        print(name, shares(order, degree, 20.0))
