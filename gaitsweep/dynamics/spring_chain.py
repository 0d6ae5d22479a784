"""A chain of point masses that move vertically, neighbours joined by a spring and a damper."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def neighbour_force(x: jax.Array, v: jax.Array, kappa: jax.Array, sigma: jax.Array) -> jax.Array:
    """Force of the springs and dampers on each mass, N, shape (n,); natural length zero.

    Args:
        x, v: heights (m) and velocities (m/s) of the masses, shape (n,).
        kappa: spring between neighbours, N/m, shape (n-1,) or one for all.
        sigma: damper between neighbours, N s/m, shape (n-1,) or one for all.

    Source: Ambe et al. 2021, eq. (1).
    """
    # the pull on mass i+1 towards mass i, which is the pull on i towards i+1 with the other sign
    pull = kappa * (x[:-1] - x[1:]) + sigma * (v[:-1] - v[1:])
    end = jnp.zeros_like(pull[:1])
    return jnp.concatenate([end, pull]) - jnp.concatenate([pull, end])
