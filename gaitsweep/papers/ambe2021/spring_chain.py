"""A chain of point masses that move vertically, with a spring and a damper between neighbours."""

from __future__ import annotations

import itertools

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
    m, none = masses, jnp.zeros_like(masses[:1])
    before = jnp.concatenate([none, kappa]), jnp.concatenate([none, jnp.broadcast_to(sigma, kappa.shape)])
    after = tuple(jnp.concatenate([each[1:], none]) for each in before)
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
