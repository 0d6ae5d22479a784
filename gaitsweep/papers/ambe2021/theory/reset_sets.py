"""The sets S_1 to S_8: the neighbours that are reset between the touchdowns of leg k and of a leg."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gaitsweep.papers.ambe2021.theory.chain import TABLE_1, Chain, touchdown_phase
from gaitsweep.papers.ambe2021.theory.order import touchdown_order
from gaitsweep.papers.ambe2021.theory.section import phases_on_section
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch, places, rule_of

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


def reset_sets(
    N: int, branch: Branch, s: float, chain: Chain = TABLE_1, section: int | None = None
) -> tuple[ResetSet, ...]:
    """The set of each leg, 1 .. N+1, at the free phase s.

    Args:
        N, branch, chain: as in `solution_set`.
        s: the free phase, rad.
        section: the leg at whose touchdown the cycle begins; by default the set's k.

    Source: Table 2, and the definitions below eq. (14).
    """
    leg = branch.k if section is None else section
    order = touchdown_order(N, branch, s, chain, leg)
    turn = {each: place for place, each in enumerate(order)}
    sets = []
    for i in range(1, N + 2):
        front = None if i == 1 else turn[i - 1] < turn[i]
        rear = None if i == N + 1 else turn[i + 1] < turn[i]
        sets.append(ResetSet(TABLE_2[front, rear], front, rear))
    return tuple(sets)


def touchdown_residuals(N: int, branch: Branch, s: float, chain: Chain = TABLE_1) -> np.ndarray:
    """The left side minus the right side of eq. (14) for each leg of a solution, m, shape (N+1,).

    The neighbours' phases are those that psi on section k gives with the resets of each leg's set S.

    Args:
        N, branch, s, chain: as in `reset_sets`; springs and amplitudes of the chain have to be uniform.

    Raises:
        ArgumentError: the chain has a profile.

    Source: eqs. (3), (13), (14).
    """
    chain.equal_inner_legs("the balance of eq. (14)")
    circle = float(touchdown_phase(chain))
    theta = places(rule_of(N, branch, chain), s)
    phi = np.asarray(phases_on_section(theta, touchdown_phase(chain), branch.k))  # on section k
    found = []
    for i, each in enumerate(reset_sets(N, branch, s, chain), start=1):
        gone = circle - phi[i - 1]  # from the touchdown of leg k to that of leg i, rad
        beside = [
            (phi[j - 1] + gone - (circle if reset else 0.0))
            for j, reset in ((i - 1, each.front), (i + 1, each.rear))
            if reset is not None
        ]
        mass = chain.m_1 if i == 1 else chain.m_end if i == N + 1 else chain.m
        mean = sum(_length(phase, chain) for phase in beside) / len(beside)
        found.append(
            _length(circle, chain) - (mean - float(mass) * float(chain.g) / len(beside) / float(chain.kappa))
        )
    return np.array(found)


def _length(phi: float, chain: Chain) -> float:
    """A leg's length less the longest, m; eq. (3)."""
    beta, a = float(chain.beta), float(chain.a)
    if phi <= 2.0 * beta * np.pi:
        return 0.0
    past = phi - 2.0 * beta * np.pi if phi < (1.0 + beta) * np.pi else 2.0 * np.pi - phi
    return -a * past / ((1.0 - beta) * np.pi)
