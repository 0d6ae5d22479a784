"""The chain at rest on its legs: the rigid obstacle problem."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def obstacle_problem(
    l: jax.Array,  # noqa: E741
    m: jax.Array,
    kappa: jax.Array,
    g: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Lowest heights of the masses at or above their leg tips, and the load that each leg carries.

    Let q be the chain that hangs free, and let a leg's place be the compliance of the springs before it. Over
    these places z = x - q bends only where a leg pushes, and there downwards, so z is the lowest concave
    sequence above l - q whose first slope is at most 0 and whose last slope is at least -(total weight): a
    greatest of chords, of level rays from the right, and of rays of the last slope from the left.

    Args:
        l: leg lengths, m, shape (n,), n >= 2.
        m: masses, kg, shape (n,).
        kappa: springs between neighbours, N/m, natural length zero, shape (n-1,) or one for all.
        g: gravitational acceleration, m/s2.

    Returns:
        x (m) and R (N), shape (n,): x >= l, R >= 0, and R exactly 0 where a leg does not touch.

    Source: eq. (8), with the complementarity below it.
    """
    kappa, unit, compliance = _springs(kappa, l.shape[0])
    slopes = jnp.cumsum(m * g / unit)
    q = _from_the_first(slopes[:-1] * compliance)
    h = l - q

    place = _from_the_first(compliance)
    run = place[None, :] - place[:, None]  # run[i, j]: from i to j
    level = jnp.max(jnp.where(run >= 0, h[None, :], -jnp.inf), axis=1)
    falling = jnp.max(jnp.where(run <= 0, h[None, :] + run * slopes[-1], -jnp.inf), axis=1)
    z = jnp.maximum(jnp.maximum(level, falling), _highest_chord(h, run))

    touches = z <= h
    x = jnp.where(touches, l, jnp.maximum(q + z, l))
    pull = kappa * (x[1:] - x[:-1])  # of the next mass on each, upwards
    end = jnp.zeros_like(pull[:1])
    load = m * g - jnp.concatenate([pull, end]) + jnp.concatenate([end, pull])
    return x, jnp.where(touches, jnp.maximum(load, 0.0), 0.0)


def _springs(kappa: jax.Array, n: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The springs (n-1,), N/m, the middle one, and their compliances in units of its own.

    In these units chains of one spring have compliances of exactly 1.
    """
    kappa = jnp.broadcast_to(kappa, (n - 1,))
    unit = kappa[(n - 1) // 2]
    return kappa, unit, unit / kappa


def _from_the_first(steps: jax.Array) -> jax.Array:
    """0 and the sums of the steps (n-1,), shape (n,)."""
    return jnp.concatenate([jnp.zeros_like(steps[:1]), jnp.cumsum(steps)])


def _highest_chord(h: jax.Array, run: jax.Array) -> jax.Array:
    """For each i, the greatest value at i of the chords of h from j < i to k > i; -inf at both ends."""
    ahead = run[:, None, :]  # (i, 1, k): from i to k
    behind = -run[:, :, None]  # (i, j, 1): from j to i
    inside = (ahead > 0) & (behind > 0)
    chord = (h[None, :, None] * ahead + h[None, None, :] * behind) / jnp.where(inside, ahead + behind, 1.0)
    return jnp.max(jnp.where(inside, chord, -jnp.inf), axis=(1, 2))


def balance(
    l: jax.Array,  # noqa: E741
    m: jax.Array,
    kappa: jax.Array,
    g: jax.Array,
) -> jax.Array:
    """Load on each leg over the middle spring (m), shape (n,); negative for a leg in the air, by how far.

    The load in the form of a guard: it changes its sign where a leg touches or leaves the ground.

    Args:
        l, m, kappa, g: as in `obstacle_problem`.

    Source: eq. (8), with the complementarity below it.
    """
    return balance_and_rate(l, m, kappa, g, jnp.zeros_like(l))[0]


def balance_and_rate(
    l: jax.Array,  # noqa: E741
    m: jax.Array,
    kappa: jax.Array,
    g: jax.Array,
    rate: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """`balance`, and how it changes while the legs' lengths change at `rate` (n,).

    Leg i touches where the least slope of z = x - q to a leg before it is above the greatest slope to a leg
    behind it, the level ray to the front and the steepest one to the rear among them; the difference is its
    load, since z bends there by as much. Of several extreme slopes any one's rate is given.

    Args:
        l, m, kappa, g: as in `obstacle_problem`.
        rate: of each leg's length, m in any unit of time or phase, shape (n,).
    """
    _, unit, compliance = _springs(kappa, l.shape[0])
    weights = jnp.cumsum(m * g / unit)
    hang, place = _from_the_first(weights[:-1] * compliance), _from_the_first(compliance)
    front, rear = jnp.zeros_like(l), jnp.zeros_like(l) - weights[-1]
    front_rate, rear_rate = jnp.zeros_like(rate), jnp.zeros_like(rate)
    for apart in range(1, l.shape[0]):
        share = 1.0 / (place[apart:] - place[:-apart])
        slope = (l[apart:] - l[:-apart]) * share - (hang[apart:] - hang[:-apart]) * share
        slope_rate = (rate[apart:] - rate[:-apart]) * share
        less, more = slope < front[apart:], slope > rear[:-apart]
        front = jnp.concatenate([front[:apart], jnp.where(less, slope, front[apart:])])
        front_rate = jnp.concatenate([front_rate[:apart], jnp.where(less, slope_rate, front_rate[apart:])])
        rear = jnp.concatenate([jnp.where(more, slope, rear[:-apart]), rear[-apart:]])
        rear_rate = jnp.concatenate([jnp.where(more, slope_rate, rear_rate[:-apart]), rear_rate[-apart:]])
    return front - rear, front_rate - rear_rate
