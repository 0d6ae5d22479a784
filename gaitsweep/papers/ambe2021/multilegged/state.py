"""The parameters and the state of the chain, and the segments of a leg's length."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaitsweep.dynamics import TWO_PI

STANCE, TAKEOFF, LANDING = 0, 1, 2
# m. Leg 1 is initially compressed by a picometre (1e-7 N), so that it touches in spite of rounding. Another
# leg that is compressed by less is in the air, so that it touches down at once if it is landing.
CONTACT_DEPTH = 1e-12


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Params:
    """Parameters as in the equations; units as in `PARAMETERS`, arrays from head to tail.

    `kappa` (N,) is that of each spring; `masses` and `a` (N+1,) are those of each leg; `m` is the mass of an
    inner leg, with a profile the mass to which those of the inner legs refer.
    """

    beta: jax.Array
    kappa: jax.Array
    sigma: jax.Array
    masses: jax.Array
    m: jax.Array
    a: jax.Array
    L: jax.Array
    K: jax.Array
    D: jax.Array
    omega: jax.Array
    tau: jax.Array
    g: jax.Array
    clamp: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class State:
    """Heights x (m), velocities v (m/s), phases phi (rad), lags y (rad/s), each (N+1,), and the modes.

    `contact` (N+1,) bool; `segment` (N+1,) is the segment of each leg's length: stance, takeoff or landing;
    `landed`: leg 1 has had its landing contact in this cycle.
    """

    x: jax.Array
    v: jax.Array
    phi: jax.Array
    y: jax.Array
    contact: jax.Array
    segment: jax.Array
    landed: jax.Array


def corner_of(p: Params, segment: jax.Array) -> jax.Array:
    """Phase at the end of each leg's segment, rad."""
    takeoff = jnp.where(segment == TAKEOFF, (1.0 + p.beta) * jnp.pi, TWO_PI)
    return jnp.where(segment == STANCE, 2.0 * p.beta * jnp.pi, takeoff)


def first_touchdown(p: Params) -> jax.Array:
    """Touchdown phase of leg 1 with its neighbour in stance, rad, eq. (31); NaN if it has none in landing."""
    b = (1.0 - p.beta) * p.g * jnp.pi / (p.kappa[0] * p.a[0])  # below eq. (17)
    touchdown = TWO_PI - p.masses[0] * b
    # outside the model's conditions (m g/kappa < a) leg 1 has no touchdown in its landing segment
    return jnp.where(touchdown > (1.0 + p.beta) * jnp.pi, touchdown, jnp.nan)


def segment_of(p: Params, phi: jax.Array) -> jax.Array:
    """The segment of each leg's length at phases from 0 to 2 pi, rad."""
    return jnp.where(
        phi <= 2.0 * p.beta * jnp.pi, STANCE, jnp.where(phi < (1.0 + p.beta) * jnp.pi, TAKEOFF, LANDING)
    )


def leg_lengths(p: Params, phi: jax.Array, segment: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Length of each leg (m) and its derivative by the phase (m/rad), eq. (3).

    Each segment is a straight line, `origin + rate * phi`. `origin` and `rate` are selected independently
    of the phase, so once for all stages of a step.

    Args:
        p: parameters.
        phi: phases of the legs, (N+1,) rad.
        segment: segments of the legs, (N+1,).
    """
    slope = p.a / ((1.0 - p.beta) * jnp.pi)
    takeoff = p.L + slope * (2.0 * p.beta * jnp.pi)
    landing = p.L - slope * TWO_PI
    origin = jnp.where(segment == STANCE, p.L, jnp.where(segment == TAKEOFF, takeoff, landing))
    rate = jnp.where(segment == STANCE, 0.0, jnp.where(segment == TAKEOFF, -slope, slope))
    return origin + rate * phi, rate


def lagged_reset(phi: Float[Array, " ..."], tau: Float[Array, " ..."]) -> Float[Array, " ..."]:
    """The jump of the lag variable y (rad/s) that finally moves the phase phi (rad) to 2 pi.

    The lag tau y' = -y + u responds to the impulse u = (2 pi - phi) delta(t) by a jump of y; phi is
    continuous (eq. (5), (6)).

    Args:
        phi: the phase at touchdown, rad.
        tau: the time constant of the lag, s.
    """
    return (TWO_PI - phi) / tau
