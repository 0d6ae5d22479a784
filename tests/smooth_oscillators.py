"""Smooth flows with a section by a plane: Lorenz's and Van der Pol's; and one without any event."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from gaitsweep.contract import Quantity
from gaitsweep.dynamics.plane_section import Plane
from gaitsweep.dynamics.smooth_flow import SmoothFlow


class Lorenz(SmoothFlow):
    """Crossed downwards where z = rho - 1, the plane of both fixed points that the attractor goes round."""

    name = "lorenz"
    source = "Lorenz 1963, J. Atmos. Sci. 20:130"
    variables = tuple(Quantity(name, "1", name, 1.0) for name in "xyz")
    parameters = (  # pyright: ignore[reportAssignmentType]
        Quantity("sigma", "1", "Prandtl number", 10.0),
        Quantity("rho", "1", "Rayleigh number over the critical one", 28.0),
        Quantity("b", "1", "aspect of the rolls", "8/3"),
    )

    def rates(self, params, at):
        x, y, z = at
        p = params
        return jnp.stack([p["sigma"] * (y - x), x * (p["rho"] - z) - y, x * y - p["b"] * z])

    def plane(self, params):
        return Plane(jnp.array([0.0, 0.0, -1.0]), 1.0 - params["rho"])

    def period(self, params):
        return 0.75 + 0.0 * params["rho"]


class VanDerPol(SmoothFlow):
    """Crossed upwards where v = 0, at the least x of a cycle."""

    name = "van_der_pol"
    variables = (Quantity("x", "1", "position", 2.0), Quantity("v", "1/s", "velocity", 0.0, scale=1.0))
    parameters = (Quantity("mu", "1", "damping", 1.0, low=0.0),)  # pyright: ignore[reportAssignmentType]

    def rates(self, params, at):
        x, v = at
        return jnp.stack([v, params["mu"] * (1.0 - x * x) * v - x])

    def plane(self, params):
        return Plane(jnp.array([0.0, 1.0]), jnp.zeros(()))

    def period(self, params):
        return 2.0 * jnp.pi + params["mu"]


class Spring(SmoothFlow):
    """A harmonic oscillator without any event."""

    name = "spring"
    variables = (Quantity("x", "m", "position", 1.0), Quantity("v", "m/s", "velocity", 0.0))
    parameters = (Quantity("k", "1/s2", "stiffness over mass", 4.0, low=0.0),)  # pyright: ignore

    def rates(self, params, at):
        return jnp.stack([at[1], -params["k"] * at[0]])

    def period(self, params: dict[str, jax.Array]) -> jax.Array:
        return 2.0 * jnp.pi / jnp.sqrt(params["k"])
