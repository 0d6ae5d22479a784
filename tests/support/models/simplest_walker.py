"""The simplest walking model: two stiff legs with light feet, that walk down a slope by gravity alone.

Source: Garcia, Chatterjee, Ruina and Coleman 1998, J. Biomech. Eng. 120:281: eq. (1), (2) of the swing, (4)
of the heel strike. Its long-period gait takes two steps to repeat from a slope of about 0.0151 rad on, then
four, and is chaotic before it is lost at .019. (The compass gait, whose feet have mass, doubles at 4.39
degrees: Goswami, Thuilot and Espiau 1998.)
"""

from __future__ import annotations

import jax.numpy as jnp

from gaitsweep import DeclaredModel, event, parameter, variable

# The fixed point at a slope of 0.009 rad, printed in the paper: stance angle and its rate after heel strike.
SLOPE, ANGLE, RATE = 0.009, 0.200310900544287, -0.199832473004977


class SimplestWalker(DeclaredModel):
    """Time in units of sqrt(leg / g); the section is the heel strike, where phi is twice theta."""

    source = "Garcia, Chatterjee, Ruina, Coleman 1998, J. Biomech. Eng. 120:281"

    gamma = parameter("rad", "slope", SLOPE)
    theta = variable("rad", "stance leg to the slope's normal", ANGLE)
    theta_rate = variable("rad", "its rate", RATE)
    phi = variable("rad", "angle between the legs", 2.0 * ANGLE)
    phi_rate = variable("rad", "its rate", (1.0 - 0.92082) * RATE)

    def flow(self, p, s):
        fall = jnp.sin(s.theta - p.gamma)
        swing = fall + (s.theta_rate**2 - jnp.cos(s.theta - p.gamma)) * jnp.sin(s.phi)
        return {"theta": s.theta_rate, "theta_rate": fall, "phi": s.phi_rate, "phi_rate": swing}

    @event("heel strikes", section=True)
    def strike(self, p, s):
        # the feet pass each other downwards, which arms it
        return s.phi - 2.0 * s.theta

    @strike.jump
    def exchange(self, p, s):
        kept = jnp.cos(2.0 * s.theta)
        rate = kept * s.theta_rate
        return s.replace(theta=-s.theta, theta_rate=rate, phi=-2.0 * s.theta, phi_rate=(1.0 - kept) * rate)

    def failed(self, p, s):
        return jnp.abs(s.theta) > 1.0

    def period(self, p):
        return 4.0 + 0.0 * p.gamma
