"""The reduced chain (Ambe 2021, sections 3.1 and 3.2), event by event: rigid legs, tau = 0.

Heights come from the obstacle problem alone, not from eqs. (12) to (20), so that those can be tested by it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from gaitsweep.papers.ambe2021.multilegged.forces import obstacle_problem
from gaitsweep.papers.ambe2021.theory.chain import Chain, amplitudes, springs, touchdown_phase

Array = NDArray[np.float64]
TURN = 2.0 * np.pi


@cache
def _gaps(N: int, chain: Chain) -> Callable[[Array], tuple[jax.Array, jax.Array]]:
    """Jitted: phases (n, N+1) to x - l (m) of each leg, and whether it is in the landing segment."""
    masses = jnp.array([chain.m_1, *[chain.m] * (N - 1), chain.m_end])
    slope = amplitudes(N, chain) / ((1 - chain.beta) * jnp.pi)
    kappa = springs(N, chain)

    def gap(phi: jax.Array) -> tuple[jax.Array, jax.Array]:
        swing = jnp.minimum(phi - 2 * chain.beta * jnp.pi, TURN - phi)
        length = 1.0 - slope * jnp.clip(swing, 0.0, None)
        x, _ = obstacle_problem(length, masses, kappa, jnp.asarray(chain.g))
        return x - length, (phi >= (1 + chain.beta) * jnp.pi) & (phi < TURN)

    return jax.jit(jax.vmap(gap))


def next_touchdown(N: int, chain: Chain, phi: Array, tie: float = 0.0) -> tuple[float, NDArray[np.bool_]]:
    """Phase until the next leg touches, rad, to rounding, and which legs do, those less than `tie` (m) up."""
    low, high = 0.0, TURN
    while True:
        ahead = np.linspace(low, high, 257)
        gap, landing = _gaps(N, chain)((phi[None, :] + ahead[:, None]) % TURN)
        touching = np.asarray((gap <= tie) & landing)
        first = int(np.argmax(touching.any(axis=1)))
        if not touching[first].any():
            raise AssertionError("no leg touches within a turn")
        if first == 0 or ahead[first] - ahead[first - 1] < 2e-16:
            return float(ahead[first]), touching[first]
        low, high = ahead[first - 1], ahead[first]
        if high - low < 4e-15:
            return float(high), touching[first]


def cycle(
    N: int, chain: Chain, psi: Array, touchdown: float | None = None, tie: float = 0.0
) -> tuple[Array, list[float]]:
    """Psi on section 1 a cycle later, and the phases at which legs touched on the way, that of leg 1 last.

    Args:
        psi: relative phases on section 1, rad, shape (N,).
        touchdown: phase of leg 1 at the start, rad; that of the theory if not given.
        tie: gap in m below which legs land together.
    """
    start = float(touchdown_phase(chain)) if touchdown is None else touchdown
    phi = (start + np.concatenate([[0.0], np.cumsum(psi)])) % TURN
    phi[np.abs(phi - start) < 1e-12] = 0.0
    met: list[float] = []
    for _ in range(3 * (N + 1)):
        ahead, touching = next_touchdown(N, chain, phi, tie)
        phi = (phi + ahead) % TURN
        met += phi[touching].tolist()
        if touching[0]:
            return (phi[1:] - phi[:-1]) % TURN, met
        phi[touching] = 0.0
    raise AssertionError("leg 1 does not touch")
