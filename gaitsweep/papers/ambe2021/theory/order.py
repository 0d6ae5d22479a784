"""The touchdown order of legs along a solution, and the stability that follows from it.

Orders: the sets T_1, T_2 and S_1 to S_8, and jumps between orders. Stability: a perturbation u (N+1,) is the
phase advance of each leg relative to the solution. At the touchdown of leg i, eq. (12) gives the advance of
the touchdown from u_i and from the u of neighbours in takeoff; after the reset this is the advance of the
leg. So every touchdown is one row of a matrix, and a cycle is the product of these matrices in touchdown
order. Differences of u are the perturbations of psi.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float, Inexact

from gaitsweep import ArgumentError
from gaitsweep.analyses import wrapped_difference
from gaitsweep.papers.ambe2021.theory.chain import (
    TABLE_1,
    Chain,
    amplitudes,
    leg_length,
    reset,
    shift,
    springs,
    touchdown_phase,
)
from gaitsweep.papers.ambe2021.theory.solution_sets import (
    Branch,
    LagRule,
    Leg,
    index_of,
    phases_on_section,
    places,
    rule_of,
    solution,
    touches_early,
)

JUMP_MARGIN = 1e-6  # rad of the free phase, distance from a jump at which psi is evaluated on both sides


class Jump(NamedTuple):
    """A jump of a set of solutions on a section, where two legs exchange their order of touchdown.

    `s` is the free phase, rad; `leg` the leg whose touchdown passes that of the section's leg; `change`
    the change of psi with rising s, rad.
    """

    s: float
    leg: int
    change: Float[np.ndarray, " springs"]


def touchdown_order(
    N: int, branch: Branch, s: float, chain: Chain = TABLE_1, section: int | None = None
) -> tuple[int, ...]:
    """The legs, 1 .. N+1, in their order of touchdown in a cycle.

    Args:
        N, branch, chain: as in `rule_of`.
        s: the free phase, rad.
        section: the leg whose touchdown begins the cycle; by default the set's k.

    Raises:
        ArgumentError: the chain has no leg `section`.

    Source: Fig. 9.
    """
    leg = _leg_of_section(N, branch, section)
    theta = np.asarray(_places(rule_of(N, branch, chain), s))
    circle = float(touchdown_phase(chain))
    return order_of_places(theta, circle, leg)


def _leg_of_section(N: int, branch: Branch, section: int | None) -> int:
    """The leg whose section is used; refuses one that the chain does not have."""
    leg = branch.k if section is None else section
    if not 1 <= leg <= N + 1:
        raise ArgumentError(f"section is {leg}, but must be a leg from 1 to {N + 1}.")
    return leg


def order_of_places(theta: Float[np.ndarray, " legs"], circle: float, leg: int) -> tuple[int, ...]:
    """The touchdown order of the legs, 1 .. N+1, beginning with `leg`, from their places on the circle.

    Args:
        theta: places, rad.
        circle: the touchdown phase, rad.
        leg: 1 .. N+1.
    """
    behind = np.mod(theta[leg - 1] - theta, circle)
    return tuple(int(i) + 1 for i in np.argsort(behind, kind="stable"))


def order_sets(
    N: int, branch: Branch, s: float, chain: Chain = TABLE_1
) -> tuple[frozenset[int], frozenset[int]]:
    """T_1 and T_2: legs in front of and behind the boundary leg that touch down before both neighbours.

    Of other chains take the legs of `reset_sets` that touch down first, without the boundary leg.

    Args:
        N, branch, chain: as in `rule_of`.
        s: the free phase, rad.

    Raises:
        ArgumentError: springs or amplitudes are not uniform.

    Source: eq. (18).
    """
    chain.require_uniform("The threshold of eq. (18)")
    circle = touchdown_phase(chain)
    psi = _solution(rule_of(N, branch, chain), jnp.asarray(s), circle, branch.k)
    threshold = 2.0 * chain.beta * jnp.pi + 2.0 * reset(chain) - chain.m * shift(chain)
    early = np.flatnonzero(np.asarray(_touches_early(psi, circle, jnp.asarray(threshold), branch.k))) + 1
    return frozenset(early[early < branch.k].tolist()), frozenset(early[early > branch.k].tolist())


def meetings(rule: LagRule, circle: jax.Array, section: Leg) -> jax.Array:
    """The free phase at which each leg touches down together with the section's leg, rad, shape (N+1,).

    A leg's place on the circle moves relative to that of the section's leg at the rate 0, 1 or 2 with s, and
    so meets it at most once; `rule.high` if it does not.

    Args:
        rule: lag rule of the set.
        circle: the touchdown phase, rad.
        section: leg, 1 .. N+1.
    """
    start = places(rule, jnp.zeros_like(rule.low))
    rate = jnp.concatenate([jnp.zeros_like(rule.slope[:1]), jnp.cumsum(rule.slope)])
    ahead, rate = start - start[section - 1], rate - rate[section - 1]
    moving = jnp.where(rate == 0.0, 1.0, rate)
    meeting = rule.low + jnp.mod(-ahead / moving - rule.low, circle / jnp.abs(moving))
    return jnp.where(rate == 0.0, rule.high, jnp.minimum(meeting, rule.high))


# as one program each: operation by operation, JAX would compile every one by itself
_meetings, _places, _solution, _touches_early = map(jax.jit, (meetings, places, solution, touches_early))


def jumps(N: int, branch: Branch, chain: Chain = TABLE_1, section: int | None = None) -> tuple[Jump, ...]:
    """The jumps of a set, in order of rising free phase.

    Args:
        N, branch, chain: as in `rule_of`.
        section: the leg whose section is used; by default the set's k.

    Raises:
        ArgumentError: the chain has no leg `section`.

    Source: Fig. 11 and the text above it; each jump has the size m_B b.
    """
    leg = _leg_of_section(N, branch, section)
    rule = rule_of(N, branch, chain)
    circle = touchdown_phase(chain)
    exchanges = []
    for number, s in enumerate(np.asarray(_meetings(rule, circle, leg)), start=1):
        if float(rule.low) + JUMP_MARGIN < s < float(rule.high) - JUMP_MARGIN:
            above = _solution(rule, jnp.asarray(s + JUMP_MARGIN), circle, leg)
            below = _solution(rule, jnp.asarray(s - JUMP_MARGIN), circle, leg)
            change = np.asarray(above - below) - 2.0 * JUMP_MARGIN * np.asarray(rule.slope)
            exchanges.append(Jump(float(s), number, wrapped_difference(change)))
    return tuple(sorted(exchanges, key=operator.attrgetter("s")))


# whether the neighbours in front (i - 1) and behind (i + 1) are reset; None where there is no such leg
TABLE_2: dict[tuple[bool | None, bool | None], int] = {
    (None, False): 1,
    (None, True): 2,
    (False, False): 3,
    (True, True): 4,
    (False, True): 5,
    (True, False): 6,
    (False, None): 7,
    (True, None): 8,
}


class ResetSet(NamedTuple):
    """The set S of a leg: its number 1 .. 8, and whether its neighbours are reset before it touches down."""

    number: int
    front: bool | None
    rear: bool | None

    @property
    def is_first(self) -> bool:
        """Whether the leg touches down before its neighbours, as the boundary leg, T_1 and T_2 do."""
        return not self.front and not self.rear


def reset_sets(N: int, branch: Branch, s: float, chain: Chain = TABLE_1) -> tuple[ResetSet, ...]:
    """The set of each leg, 1 .. N+1, at the free phase s, in a cycle from the touchdown of leg k on.

    Args:
        N, branch, chain: as in `rule_of`.
        s: the free phase, rad.

    Source: Table 2, and the definitions below eq. (14).
    """
    return sets_of_order(touchdown_order(N, branch, s, chain))


def sets_of_order(order: Sequence[int]) -> tuple[ResetSet, ...]:
    """The set of each leg, 1 .. N+1, for legs that touch down in this order."""
    turn = {leg: place for place, leg in enumerate(order)}

    def is_reset_before(neighbour: int, leg: int) -> bool | None:
        return turn[neighbour] < turn[leg] if neighbour in turn else None

    sets = []
    for leg in sorted(order):
        front, rear = is_reset_before(leg - 1, leg), is_reset_before(leg + 1, leg)
        sets.append(ResetSet(TABLE_2[front, rear], front, rear))
    return tuple(sets)


def touchdown_residuals(
    N: int, branch: Branch, s: float, chain: Chain = TABLE_1
) -> Float[np.ndarray, " legs"]:
    """The left side minus the right side of eq. (14) for each leg of a solution, m.

    The neighbours' phases are those that psi on section k gives with the resets of each leg's set S.

    Args:
        N, branch, s, chain: as in `reset_sets`.

    Raises:
        ArgumentError: springs or amplitudes are not uniform.

    Source: eqs. (3), (13), (14).
    """
    chain.require_uniform("The balance of eq. (14)")
    circle = float(touchdown_phase(chain))
    theta = _places(rule_of(N, branch, chain), s)
    phi = np.asarray(phases_on_section(theta, touchdown_phase(chain), branch.k))  # on section k
    residuals = []
    for i, reset_set in enumerate(reset_sets(N, branch, s, chain), start=1):
        delay = circle - phi[i - 1]  # from the touchdown of leg k to that of leg i, rad
        neighbour_phases = [
            (phi[j - 1] + delay - (circle if is_reset else 0.0))
            for j, is_reset in ((i - 1, reset_set.front), (i + 1, reset_set.rear))
            if is_reset is not None
        ]
        mass = {1: chain.m_1, N + 1: chain.m_end}.get(i, chain.m)
        mean = sum(leg_length(np.array(neighbour_phases), chain)) / len(neighbour_phases)
        sag = float(mass) * float(chain.g) / len(neighbour_phases) / float(chain.kappa)
        residuals.append(leg_length(np.array(circle), chain) - (mean - sag))
    return np.array(residuals)


ROUNDING_ERROR = 1e-12  # an element of a linear map below this is a rounding error


def multipliers(N: int, branch: Branch) -> Float[np.ndarray, " springs"]:
    """Eigenvalues of the Poincare map on one set of solutions, for uniform springs and amplitudes.

    Args:
        N: springs; the chain has N + 1 legs.
        branch: one of the sets, `branches(N)`.

    Raises:
        ArgumentError: the chain does not have this set.

    Source: eq. (22) for the sets A and B, eq. (26) for the direct wave.
    """
    index_of(N, branch)
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

    Raises:
        ArgumentError: the chain has no leg `section`.

    Source: eqs. (12), (14), (21).
    """
    section_leg = _leg_of_section(N, branch, section)
    theta, circle, k, a = map(np.asarray, _of_cycle(N, rule_of(N, branch, chain), s, chain))
    ahead = np.eye(N + 1)
    for leg in order_of_places(theta, float(circle), section_leg):
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
