"""Lorenz's flow with the section that shows its map.

The section is the plane z = rho - 1, which contains both fixed points inside the attractor's wings, crossed
downwards.

Source: Lorenz 1963, J. Atmos. Sci. 20:130, eq. (25) to (27).
"""

import jax.numpy as jnp

from gaitsweep import DeclaredModel, event, parameter, symmetry, variable


class Lorenz(DeclaredModel):
    """The flow, without units."""

    source = "Lorenz 1963, J. Atmos. Sci. 20:130"

    sigma = parameter("1", "Prandtl number", 10.0, symbol=r"\sigma")
    rho = parameter("1", "Rayleigh number over the critical one", 28.0, symbol=r"\rho")
    b = parameter("1", "aspect of the rolls", "8/3")

    x = variable("1", "speed of the rolls", 1.0)
    y = variable("1", "difference of temperature", 1.0)
    z = variable("1", "distortion of the profile of temperature", 1.0)

    def flow(self, p, s):
        return {"x": p.sigma * (s.y - s.x), "y": s.x * (p.rho - s.z) - s.y, "z": s.x * s.y - p.b * s.z}

    @event("z falls through rho - 1", section=True)
    def falls(self, p, s):
        return p.rho - 1.0 - s.z

    @symmetry("half a turn about the z axis")
    def turned(self, p, s):
        return s.replace(x=-s.x, y=-s.y)

    def period(self, p):
        return jnp.full_like(p.rho, 0.75)  # about one turn around a wing
