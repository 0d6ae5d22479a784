"""Rest of a located body on the ground, under constant targets of its actuators.

A start is followed down the potential, along the overdamped motion q' = a(q) with the acceleration a at no
velocity, by implicit Euler steps that grow to Newton's steps for a(q) = 0 (pseudo-transient continuation:
Kelley and Keyes 1998, SIAM J. Numer. Anal. 35:508). Friction has no force at no slip, so a rest needs none.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaitsweep.dynamics.tree import integrate

if TYPE_CHECKING:
    from gaitsweep.dynamics.body.mechanics import LocatedBody

# Largest acceleration (m/s2, rad/s2) of a rest, and the one below which no further step is taken.
AT_REST = 1e-9
_EXACT = 1e-10
_STEPS = 400
_DIFFERENCE = 1e-6  # of positions (m, rad), for the derivative of accelerations
# The first step (s2) of the overdamped motion, and the factors by which steps may change.
_FIRST = 1e-3
_SHRINK = 0.25
_GROW = 4.0
_LONGEST = 1e12
_FARTHEST = 0.02  # largest change (m, rad) of a position in a step
_UNSTABLE = 1e-3  # rate of growth squared (1/s2) from which a rest is unstable; others are rounding
_TOPPLED = 1.0  # turn (rad) of the first body from its start


class Standing(enum.IntEnum):
    """Whether a body stands, or why not."""

    stands = 0
    no_rest = 1
    unstable = 2
    toppled = 3


WHY_NOT = (
    "the body does not stand still on the ground near its start: it has no rest there, or an unstable one, "
    "or it falls over"
)


class Rest(NamedTuple):
    """Positions (nq,) at rest, their largest acceleration (m/s2, rad/s2), and whether the body stands."""

    q: Float[Array, " nq"]
    residual: Float[Array, ""]
    standing: Int[Array, ""]


class _Progress(NamedTuple):
    """A point of the overdamped motion, and the next one.

    `q`, `a` and `stiffness` are the positions, their accelerations, and minus the derivative (nv, nv) of the
    accelerations by the positions, 1/s2; `ahead` are the next positions, `step` (s2) the step to them, `cut`
    whether it was cut to `_FARTHEST`; `steps` is their number.
    """

    q: Float[Array, " nq"]
    a: Float[Array, " nv"]
    stiffness: Float[Array, "nv nv"]
    ahead: Float[Array, " nq"]
    step: Float[Array, ""]
    cut: Bool[Array, ""]
    steps: Int[Array, ""]


def rest(
    body: LocatedBody,
    acceleration: Callable[[Float[Array, " nq"]], Float[Array, " nv"]],
    inverse_inertia: Callable[[Float[Array, " nq"]], Float[Array, "nv nv"]],
    q: Float[Array, " nq"],
) -> Rest:
    """The rest to which an overdamped body moves.

    Args:
        body: the body.
        acceleration: the accelerations (nv,) at positions (nq,) without velocities.
        inverse_inertia: the inverse of the joint-space inertia (nv, nv) at positions (nq,).
        q: the positions (nq,) of the start.
    """
    n = body.nv
    # the accelerations are written out once in the compiled program, for all of these points
    displacements = _DIFFERENCE * np.concatenate([np.zeros((1, n)), np.eye(n), -np.eye(n)])

    def moved(q: Float[Array, " nq"], change: Float[Array, " nv"]) -> Float[Array, " nq"]:
        return jnp.asarray(integrate(body.tree, q, change, 1.0))

    def goes_on(at: _Progress) -> Bool[Array, ""]:
        return (at.steps < _STEPS) & (_largest(at.a) > _EXACT)

    def next_of(at: _Progress) -> _Progress:
        q = at.ahead
        a, *others = jax.vmap(lambda change: acceleration(moved(q, change)))(displacements)
        stiffness = (jnp.stack(others[n:]) - jnp.stack(others[:n])).T / (2.0 * _DIFFERENCE)
        ratio = jnp.clip(_largest(at.a) / _largest(a), _SHRINK, _GROW)
        step = jnp.where(at.cut, at.step, jnp.minimum(at.step * ratio, _LONGEST))
        change = jnp.linalg.solve(jnp.eye(n) / step + stiffness, a)
        far = _largest(change) / _FARTHEST
        return _Progress(
            q, a, stiffness, moved(q, change / jnp.maximum(far, 1.0)), step, far > 1.0, at.steps + 1
        )

    unknown = jnp.full(n, jnp.inf)
    first = jnp.asarray(_FIRST, float)
    start = _Progress(q, unknown, jnp.eye(n), q, first, jnp.asarray(True), jnp.asarray(0))
    end = jax.lax.while_loop(goes_on, next_of, start)
    # in these coordinates the stiffness is symmetric, as that of a potential
    root = jnp.linalg.cholesky(inverse_inertia(end.q))
    lowest = jnp.min(jnp.linalg.eigvalsh(jnp.linalg.solve(root, end.stiffness @ root)))
    residual = _largest(end.a)
    standing = jnp.where(_turn(body, q, end.q) > _TOPPLED, Standing.toppled, Standing.stands)
    standing = jnp.where(lowest < -_UNSTABLE, Standing.unstable, standing)
    standing = jnp.where(residual < AT_REST, standing, Standing.no_rest)
    return Rest(end.q, residual, standing)


def _largest(values: Float[Array, " n"]) -> Float[Array, ""]:
    return jnp.max(jnp.abs(values), initial=0.0)


def _turn(body: LocatedBody, q: Float[Array, " nq"], after: Float[Array, " nq"]) -> Float[Array, ""]:
    """The angle (rad) by which the first body has turned by its free joint, or the largest by a hinge."""
    turns = [jnp.zeros(())]
    for i in body.elements.links_of_body(1):
        at = body.tree.q_of[i]
        if body.tree.links[i].kind == "free":
            turns.append(2.0 * jnp.arccos(jnp.clip(jnp.abs(q[at][3:] @ after[at][3:]), 0.0, 1.0)))
        elif body.tree.links[i].kind == "hinge":
            turns.append(jnp.abs(after[at][0] - q[at][0]))
    return jnp.max(jnp.stack(turns))
