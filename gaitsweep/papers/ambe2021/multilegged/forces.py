"""Mechanics of the chain: forces between masses, its fastest motions, its static equilibrium on its legs."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp


def neighbour_force(x: jax.Array, v: jax.Array, kappa: jax.Array, sigma: jax.Array) -> jax.Array:
    """The force of the springs and dampers on each mass, N, shape (n,); natural length zero.

    Args:
        x, v: heights (m) and velocities (m/s) of the masses, shape (n,).
        kappa: springs between neighbours, N/m, shape (n-1,) or a scalar.
        sigma: dampers between neighbours, N s/m, shape (n-1,) or a scalar.

    Source: Ambe et al. 2021, eq. (1).
    """
    # the force on mass i+1 towards mass i; the force on mass i is its negative
    pull = kappa * (x[:-1] - x[1:]) + sigma * (v[:-1] - v[1:])
    end = jnp.zeros_like(pull[:1])
    return jnp.concatenate([end, pull]) - jnp.concatenate([pull, end])


def fastest_motions(
    masses: jax.Array, kappa: jax.Array, sigma: jax.Array, K: jax.Array, D: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Rates (1/s) and damping ratios that bound the chain's motions for every combination of contacts.

    With x = u exp(-r t) an eigenvector u makes u* (r^2 M - r C + K) u = 0. That matrix is diagonally
    dominant, hence positive definite, for each real r above all roots of
    r^2 m - r (D + 2 s) + K + 2 k = 0, with k and s the springs and dampers to both neighbours of a mass m, to
    one of them, or to none; and the modulus of a complex r is at most that of the largest (K + 2 k) / m
    (Gershgorin). A mass in the air has no K and D.

    Args:
        masses: (n,) kg, from one end to the other.
        kappa: (n - 1,) N/m, the springs between them.
        sigma: N s/m, of each damper between them.
        K, D: N/m and N s/m, of the ground under a mass.

    Returns:
        Two arrays of ten numbers for each mass, (10 n,): decaying motions, then oscillations on the ground
        and in the air.
    """
    m = masses
    none = jnp.zeros_like(masses[:1])
    before = jnp.concatenate([none, kappa]), jnp.concatenate([none, jnp.broadcast_to(sigma, kappa.shape)])
    after = tuple(jnp.concatenate([values[1:], none]) for values in before)
    rates, damping = [], []
    for k_ground, c_ground in ((K, D), (0.0 * K, 0.0 * D)):
        for with_before, with_after in itertools.product((0.0, 2.0), repeat=2):
            k = k_ground + with_before * before[0] + with_after * after[0]
            c = c_ground + with_before * before[1] + with_after * after[1]
            square = c * c - 4.0 * m * k
            decays = jnp.where(square >= 0.0, c + jnp.sqrt(jnp.maximum(square, 0.0)), 0.0)
            rates.append(0.5 * decays / m)
            damping.append(jnp.ones_like(m))
        oscillates = jnp.sqrt((k_ground + 2.0 * (before[0] + after[0])) / m)
        rates.append(oscillates)
        damping.append((c_ground + before[1] + after[1]) / (2.0 * m * oscillates))
    return jnp.concatenate(rates), jnp.concatenate(damping)


def obstacle_problem(
    l: jax.Array, m: jax.Array, kappa: jax.Array, g: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Lowest heights of the masses at or above their leg tips, and the load on each leg.

    Let q be the shape of the freely hanging chain, and let a leg's coordinate be the compliance of the
    springs before it. As a function of this coordinate z = x - q is concave and bends only where a leg
    carries a load. So z is the lowest concave sequence above l - q whose first slope is at most 0 and whose
    last slope is at least -(total weight): the maximum of chords, of level rays from the right, and of rays
    of the last slope from the left.

    Args:
        l: leg lengths, m, shape (n,), n >= 2.
        m: masses, kg, shape (n,).
        kappa: springs between neighbours, N/m, natural length zero, shape (n-1,) or a scalar.
        g: gravitational acceleration, m/s2.

    Returns:
        x (m) and R (N), shape (n,): x >= l, R >= 0, and R exactly 0 for a leg without contact.

    Source: eq. (8), with the complementarity below it.
    """
    kappa, unit, compliance = _springs(kappa, l.shape[0])
    slopes = jnp.cumsum(m * g / unit)
    q = _cumulated(slopes[:-1] * compliance)
    h = l - q

    place = _cumulated(compliance)
    run = place[None, :] - place[:, None]  # run[i, j]: from i to j
    level = jnp.max(jnp.where(run >= 0, h[None, :], -jnp.inf), axis=1)
    falling = jnp.max(jnp.where(run <= 0, h[None, :] + run * slopes[-1], -jnp.inf), axis=1)
    z = jnp.maximum(jnp.maximum(level, falling), _highest_chord(h, run))

    touches = z <= h
    x = jnp.where(touches, l, jnp.maximum(q + z, l))
    pull = kappa * (x[1:] - x[:-1])  # force of the next mass on each mass, upwards
    end = jnp.zeros_like(pull[:1])
    load = m * g - jnp.concatenate([pull, end]) + jnp.concatenate([end, pull])
    return x, jnp.where(touches, jnp.maximum(load, 0.0), 0.0)


class _Springs(NamedTuple):
    """The springs of a chain.

    `kappa` (n-1,) N/m; `unit` is the middle one; `compliance` (n-1,) in its units: exactly 1 if all are
    equal.
    """

    kappa: jax.Array
    unit: jax.Array
    compliance: jax.Array


def _springs(kappa: jax.Array, n: int) -> _Springs:
    """The springs of a chain of n masses, from one value or from each spring's, N/m."""
    kappa = jnp.broadcast_to(kappa, (n - 1,))
    unit = kappa[(n - 1) // 2]
    return _Springs(kappa, unit, unit / kappa)


def _cumulated(steps: jax.Array) -> jax.Array:
    """Cumulative sums (n,) of the steps (n-1,), beginning with 0."""
    return jnp.concatenate([jnp.zeros_like(steps[:1]), jnp.cumsum(steps)])


def _highest_chord(h: jax.Array, run: jax.Array) -> jax.Array:
    """Maximum at each i of the chords of h from j < i to k > i; -inf at both ends."""
    ahead = run[:, None, :]  # (i, 1, k): from i to k
    behind = -run[:, :, None]  # (i, j, 1): from j to i
    inside = (ahead > 0) & (behind > 0)
    chord = (h[None, :, None] * ahead + h[None, None, :] * behind) / jnp.where(inside, ahead + behind, 1.0)
    return jnp.max(jnp.where(inside, chord, -jnp.inf), axis=(1, 2))


def balance(l: jax.Array, m: jax.Array, kappa: jax.Array, g: jax.Array) -> jax.Array:
    """The load on each leg divided by the middle spring (m), shape (n,); negative for a leg in the air.

    It is a guard function: its sign changes where a leg touches or leaves the ground.

    Args:
        l, m, kappa, g: as in `obstacle_problem`.

    Source: eq. (8), with the complementarity below it.
    """
    return balance_and_rate(l, m, kappa, g, jnp.zeros_like(l))[0]


def balance_and_rate(
    l: jax.Array, m: jax.Array, kappa: jax.Array, g: jax.Array, rate: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """`balance` and its rate of change if the legs' lengths change at `rate` (n,).

    Leg i is in contact if the smallest slope of z = x - q to a leg before it exceeds the largest slope to a
    leg behind it; the level ray to the front and the steepest ray to the rear are included. The difference is
    its load, since it is the bend of z there. If several slopes are extreme, the rate is that of one of them.

    Args:
        l, m, kappa, g: as in `obstacle_problem`.
        rate: rate of each leg's length, in m per unit of time or phase, shape (n,).
    """
    _, unit, compliance = _springs(kappa, l.shape[0])
    weights = jnp.cumsum(m * g / unit)
    hang = _cumulated(weights[:-1] * compliance)
    place = _cumulated(compliance)
    front = jnp.zeros_like(l)
    rear = jnp.zeros_like(l) - weights[-1]
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


def ground_force(
    gap: jax.Array, gap_rate: jax.Array, contact: jax.Array, K: jax.Array, D: jax.Array, clamp: jax.Array
) -> jax.Array:
    """The force of the ground on each leg, N, shape (n,); zero without contact.

    Args:
        gap, gap_rate: height of the body over the leg's length, x - l (m), and its rate (m/s), shape (n,).
        contact: the leg's contact flag, shape (n,).
        K, D: spring (N/m) and damper (N s/m) of the ground.
        clamp: if above zero, the ground cannot pull; else eq. (1) exactly, by which the ground pulls for
            less than a millisecond at the takeoff corner.

    Source: Ambe et al. 2021, eq. (1), (2).
    """
    # stiffness and damping are selected independently of the motion, so once for all stages of a step
    force = -(jnp.where(contact, K, 0.0) * gap + jnp.where(contact, D, 0.0) * gap_rate)
    least = jnp.where(clamp > 0.0, 0.0, -jnp.inf)
    return jnp.where(force < least, least, force)
