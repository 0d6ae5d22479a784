"""The simplest walking model: two stiff legs with light feet, that walk down a slope by gravity alone.

Source: Garcia, Chatterjee, Ruina and Coleman 1998, J. Biomech. Eng. 120:281: eq. (1), (2) of the swing, (4)
of the heel strike. Its long-period gait takes two steps to repeat from a slope of about .0151 rad on, then
four, and is chaotic before it is lost at .019. (The compass gait, whose feet have mass, doubles at 4.39
degrees: Goswami, Thuilot and Espiau 1998.)
"""

from __future__ import annotations

import jax.numpy as jnp

from gaitsweep.contract import Quantity
from gaitsweep.dynamics.plane_section import Plane
from gaitsweep.dynamics.smooth_flow import SmoothFlow, State

# The fixed point at a slope of .009 rad, printed in the paper: stance angle and its rate after heel strike.
SLOPE, ANGLE, RATE = 0.009, 0.200310900544287, -0.199832473004977


class SimplestWalker(SmoothFlow):
    """Time in units of sqrt(leg / g); the section is the heel strike, where phi is twice theta."""

    name = "simplest_walker"
    source = "Garcia, Chatterjee, Ruina, Coleman 1998, J. Biomech. Eng. 120:281"
    variables = (
        Quantity("theta", "rad", "stance leg to the slope's normal", ANGLE),
        Quantity("theta_rate", "rad", "its rate", RATE),
        Quantity("phi", "rad", "angle between the legs", 2.0 * ANGLE),
        Quantity("phi_rate", "rad", "its rate", (1.0 - 0.92082) * RATE),
    )
    parameters = (Quantity("gamma", "rad", "slope", SLOPE),)  # pyright: ignore[reportAssignmentType]

    def rates(self, params, at):
        theta, theta_rate, phi, phi_rate = at
        fall = jnp.sin(theta - params["gamma"])
        swing = fall + (theta_rate**2 - jnp.cos(theta - params["gamma"])) * jnp.sin(phi)
        return jnp.stack([theta_rate, fall, phi_rate, swing])

    def plane(self, params):
        # the feet pass each other downwards, which arms it
        return Plane(jnp.array([-2.0, 0.0, 1.0, 0.0]), jnp.zeros(()))

    def jump(self, params, state, fired):
        theta, theta_rate, _, _ = state.x
        kept = jnp.cos(2.0 * theta)
        struck = jnp.stack([-theta, kept * theta_rate, -2.0 * theta, kept * (1.0 - kept) * theta_rate])
        after = super().jump(params, state, fired)
        return State(jnp.where(fired[0], struck, state.x), after.armed)

    def failed(self, params, state):
        return jnp.abs(state.x[0]) > 1.0

    def period(self, params):
        return 4.0 + 0.0 * params["gamma"]
