"""The gait of a settled state, by the nearest analytic solution on section 1."""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaitsweep.analyses import wrapped_difference
from gaitsweep.dynamics import TWO_PI
from gaitsweep.papers.ambe2021.theory.chain import TABLE_1, Chain, amplitudes, shift, springs, touchdown_phase
from gaitsweep.papers.ambe2021.theory.order import meetings
from gaitsweep.papers.ambe2021.theory.solution_sets import (
    Branch,
    LagRule,
    branches,
    lag_rules,
    solution,
)

WAVES = ("direct", "source", "retrograde")
GAITS = (*WAVES, "locked", "none")
DIRECT, SOURCE, RETROGRADE, LOCKED, NONE = range(len(GAITS))
LOCKED_WITHIN = 0.05  # rad, from the locked state (N = 3), or of some psi_i from 0 (other N)
NONE_BEYOND = 0.2  # rad, from every analytic solution
SHORTEST_PIECE = 1e-9  # rad: shorter pieces are rounding errors between equal cuts
# rad: a state beside a corner in which two sets end is equally far from both, and rounding must not decide
EQUALLY_FAR = 1e-9


class Segments(NamedTuple):
    """Straight pieces of the solution sets on a section: middle + t * direction, |t| <= half.

    `middle`, `direction` (sets, pieces, N), rad, with directions of length 1; `half` (sets, pieces), rad, is
    about 0 for a piece that does not exist for these parameters. The sets are in the order of `branches(N)`.
    """

    middle: jax.Array
    direction: jax.Array
    half: jax.Array


def gait_of(branch: Branch) -> int:
    """Index into GAITS: both sets of the boundary leg k = 2 are the retrograde wave."""
    if branch.kind == "direct":
        return DIRECT
    return RETROGRADE if branch.k == 2 else SOURCE


@functools.partial(jax.jit, static_argnums=0)
def segments(N: int, chain: Chain = TABLE_1) -> Segments:
    """All solution sets of a chain of N + 1 legs on section 1, cut at their jumps."""
    return jax.vmap(lambda rule: pieces(rule, touchdown_phase(chain)))(lag_rules(N, chain))


def pieces(rule: LagRule, circle: jax.Array) -> Segments:
    """The N + 2 pieces of one set on section 1, without the leading axis.

    A set jumps by m_B b where a leg touches down at the same time as leg 1.

    Args:
        rule: lag rule of the set.
        circle: the touchdown phase, rad.
    """
    cuts = meetings(rule, circle, 1)
    ends = jnp.concatenate([rule.low[None], jnp.sort(cuts), rule.high[None]])
    middle = jax.vmap(lambda s: solution(rule, s, circle, 1))(0.5 * (ends[1:] + ends[:-1]))
    length = jnp.sqrt(jnp.sum(rule.slope**2))
    direction = jnp.broadcast_to((rule.slope / length)[None, :], middle.shape)
    return Segments(middle, direction, 0.5 * length * (ends[1:] - ends[:-1]))


def distance_from(lines: Segments, psi: jax.Array) -> jax.Array:
    """Distance on the torus of psi (N,) from the pieces of one set, rad; inf if it has none.

    It is exact up to about 2 rad; above, inclined pieces of set A may have a nearer periodic image.
    """
    away = wrapped_difference(psi[None, :] - lines.middle)
    along = jnp.sum(away * lines.direction, axis=1)
    nearest = jnp.clip(along, -lines.half, lines.half)
    apart = jnp.sqrt(jnp.sum((away - nearest[:, None] * lines.direction) ** 2, axis=1))
    return jnp.min(jnp.where(lines.half > SHORTEST_PIECE, apart, jnp.inf))


def distances(N: int, chain: Chain, psi: jax.Array) -> jax.Array:
    """Distance on the torus of a state on section 1 from each of `branches(N)`, rad, shape (2 N - 1,).

    Args:
        N: springs; the chain has N + 1 legs.
        chain: parameters; may be traced.
        psi: relative phases on section 1, rad, shape (N,).
    """
    circle = touchdown_phase(chain)
    # sequential, so that memory for the pieces is needed for one set at a time
    return jax.lax.map(lambda rule: distance_from(pieces(rule, circle), psi), lag_rules(N, chain))


def nearest_set(N: int, chain: Chain, psi: Float[np.ndarray, " springs"]) -> tuple[Branch, float]:
    """The set of analytic solutions nearest to a state on section 1, and its distance, rad.

    Of sets that are equally far it is the first of `branches(N)`.

    Args:
        N, chain, psi: as in `distances`.
    """
    away = _distances(N, chain, psi)
    nearest = int(_first_nearest(away))
    return branches(N)[nearest], float(away[nearest])


_distances = jax.jit(distances, static_argnums=0)


def _first_nearest(away: jax.Array) -> jax.Array:
    """The index of the first of the nearest sets, of which several may be equally far."""
    return jnp.argmax(away <= jnp.min(away) + EQUALLY_FAR)


def free_link(N: int, branch: Branch) -> int:
    """The link i, between legs i and i + 1, whose lag is free along a set of solutions."""
    return N if branch.kind == "direct" else branch.k - 1


def locked_state(chain: Chain) -> jax.Array:
    """Psi on section 1 of the locked state for N = 3, in which legs 2 and 3 stay in phase, rad, shape (3,).

    Legs 2 and 3 land together between legs 1 and 4, which are in phase too. Legs 2 and 3 carry only their own
    weights, so they touch down at 2 pi - m b. Legs 1 and 4 touch down at the same phase, which requires that
    legs 2 and 3 are in takeoff, at 2 beta pi + (m - m_B) b. Unequal ends are replaced by their means, since
    legs 2 and 3 then do not stay in phase; legs 2 and 3 of a profile likewise.
    """
    k = springs(3, chain)
    a = amplitudes(3, chain)
    if chain.has_profile:
        chain = chain._replace(m=jnp.mean(jnp.asarray(chain.m)), a=jnp.mean(jnp.asarray(chain.a)))
    ends = chain._replace(kappa=0.5 * (k[0] + k[-1]))
    D, end_mass = chain.m * shift(ends), 0.5 * (jnp.asarray(chain.m_1) + chain.m_end)
    taking_off = 0.5 * (a[0] + a[-1]) / chain.a * D - end_mass * shift(ends)
    psi_1 = 2.0 * chain.beta * jnp.pi + D + taking_off
    return jnp.stack([psi_1, jnp.zeros_like(psi_1), TWO_PI - psi_1])


def _locking(N: int, chain: Chain, psi: jax.Array) -> jax.Array:
    """Distance of psi from a locked state, rad: the known one if N = 3, else any two neighbours in phase."""
    if N == 3:
        return jnp.sqrt(jnp.sum(wrapped_difference(psi - locked_state(chain)) ** 2))
    return jnp.min(jnp.abs(wrapped_difference(psi)))


class GaitOfState(NamedTuple):
    """The gait of a state on section 1, scalars.

    `gait` is an index into GAITS; `k` the boundary leg of a source wave, 0 for other gaits; `distance` that
    to the nearest analytic solution, rad.
    """

    gait: jax.Array
    k: jax.Array
    distance: jax.Array


def classify(N: int, psi: jax.Array, chain: Chain = TABLE_1) -> GaitOfState:
    """The gait of a state on section 1: that of the nearest analytic solution on the torus.

    Of sets that are equally far the first of `branches(N)` counts, as beside a corner in which two of them
    end. The gait is `locked` if psi is within `LOCKED_WITHIN` of the locked state (of two neighbouring legs
    in phase where there are not three springs), and nearer to that than to any solution; else it is `none`
    if psi is farther than `NONE_BEYOND` from all solutions, or NaN.

    Args:
        N: springs; the chain has N + 1 legs.
        psi: relative phases on section 1, rad, any turns, shape (N,).
        chain: parameters; may be traced.
    """
    sets = branches(N)
    apart = distances(N, chain, psi)
    nearest = _first_nearest(apart)
    distance = apart[nearest]
    gait = jnp.asarray([gait_of(branch) for branch in sets])[nearest]
    locking = _locking(N, chain, psi)
    gait = jnp.where(distance <= NONE_BEYOND, gait, NONE)
    gait = jnp.where((locking <= LOCKED_WITHIN) & (locking < distance), LOCKED, gait)
    k = jnp.where(gait == SOURCE, jnp.asarray([branch.k for branch in sets])[nearest], 0)
    return GaitOfState(gait, k, distance)
