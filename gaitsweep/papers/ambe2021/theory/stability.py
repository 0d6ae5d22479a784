"""Stability of the analytic solutions: the linear map of a cycle, and its characteristic polynomial.

A perturbation u (N+1,) is the phase advance of each leg relative to the solution. At the touchdown of leg i,
eq. (12) gives the advance of the touchdown from u_i and from the u of neighbours in takeoff; after the reset
this is the advance of the leg. So every touchdown is one row of a matrix, and a cycle is the product of these
matrices in touchdown order. Differences of u are the perturbations of psi.
"""

from __future__ import annotations

import functools

import jax
import numpy as np
import scipy
from jaxtyping import Float, Inexact

from gaitsweep import ArgumentError
from gaitsweep.papers.ambe2021.theory.chain import TABLE_1, Chain, amplitudes, springs, touchdown_phase
from gaitsweep.papers.ambe2021.theory.order import order_of_places
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch, LagRule, branches, places, rule_of

ROUNDING_ERROR = 1e-12  # an element of a linear map below this is a rounding error


def multipliers(N: int, branch: Branch) -> Float[np.ndarray, " springs"]:
    """Eigenvalues of the Poincare map on one set of solutions, for uniform springs and amplitudes.

    Source: eq. (22) for the sets A and B, eq. (26) for the direct wave.
    """
    if branch not in branches(N):
        raise ArgumentError(f"{branch} is not among the sets of a chain of {N + 1} legs.")
    values = np.full(N, 2.0 / 3.0)
    values[0] = 1.0
    if branch.kind == "A":
        values[1] = 0.5
    return values


def characteristic_polynomial(matrix: Float[np.ndarray, "n n"]) -> Float[np.ndarray, " n+1"]:
    """Coefficients of det(lambda - matrix), highest power first.

    By the Faddeev-LeVerrier recursion, without eigenvalues: the block of 2/3 is defective, so computed
    eigenvalues scatter (by 0.02 for N = 9), while these coefficients are exact up to rounding.
    """
    n = len(matrix)
    coefficients = np.ones(n + 1)
    power = np.eye(n)
    for i in range(1, n + 1):
        power = matrix @ power
        coefficients[i] = -np.trace(power) / i
        power = power + coefficients[i] * np.eye(n)
    return coefficients


def eigenvalues(matrix: Float[np.ndarray, "n n"]) -> Inexact[np.ndarray, " n"]:
    """Eigenvalues of a linear map, largest first, each as exact as the matrix's elements.

    In a wave a touchdown depends on one neighbour only, so P_k is block triangular but for the order of its
    rows, with blocks of one or two rows. The eigenvalues are those of the blocks, which do not scatter as
    those of the whole matrix do, whose 2/3 is defective.
    """
    _, block = scipy.sparse.csgraph.connected_components(
        np.abs(matrix) > ROUNDING_ERROR, directed=True, connection="strong"
    )
    of_blocks = [np.linalg.eigvals(matrix[np.ix_(block == i, block == i)]) for i in np.unique(block)]
    values = np.concatenate(of_blocks)
    return values[np.argsort(-np.abs(values), kind="stable")]


def linear_map(
    N: int, branch: Branch, s: float, chain: Chain = TABLE_1, section: int | None = None
) -> Float[np.ndarray, "springs springs"]:
    """P_k of eq. (21): the linear map of a perturbation of psi on a section over a cycle.

    It is valid between the jumps of the set and away from the ends of leg segments.

    Args:
        N: springs; the chain has N + 1 legs.
        branch: one of the sets, `branches(N)`.
        s: the free phase, rad.
        chain: its parameters; Table 1's if not given.
        section: the leg whose section is used; by default the set's k.

    Source: eqs. (12), (14), (21).
    """
    theta, circle, k, a = map(np.asarray, _of_cycle(N, rule_of(N, branch, chain), s, chain))
    ahead = np.eye(N + 1)
    for leg in order_of_places(theta, float(circle), section or branch.k):
        phi = circle - np.mod(theta[leg - 1] - theta, circle)
        pull = np.zeros(N + 1)
        neighbour_springs = {i: k[min(i, leg - 1)] for i in (leg - 2, leg) if 0 <= i <= N}
        for i, spring in neighbour_springs.items():
            share = spring * a[i] / (sum(neighbour_springs.values()) * a[leg - 1])
            pull[i] = _slope(float(phi[i]), chain) * share
        ahead[leg - 1] = (ahead[leg - 1] - pull @ ahead) / (1.0 - pull.sum())
    differences = np.diff(np.eye(N + 1), axis=0)
    # psi does not determine a common shift: the advance of leg 1 is set to zero
    from_psi = np.tril(np.ones((N + 1, N)), -1)
    return differences @ ahead @ from_psi


@functools.partial(jax.jit, static_argnums=0)
def _of_cycle(N: int, rule: LagRule, s: float, chain: Chain) -> tuple[jax.Array, ...]:
    """Places of the legs, touchdown phase, stiffness of the springs, and amplitudes of the legs."""
    return places(rule, s), touchdown_phase(chain), springs(N, chain), amplitudes(N, chain)


def _slope(phi: float, chain: Chain) -> float:
    """Derivative of a leg's length by its phase, in units of that in landing; eq. (3)."""
    if phi <= 2.0 * float(chain.beta) * np.pi:
        return 0.0  # stance
    if phi < (1.0 + float(chain.beta)) * np.pi:
        return -1.0  # takeoff
    return 1.0
