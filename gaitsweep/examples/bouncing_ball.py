"""A ball that bounces on a shaking table: the simplest system that hops periodically.

Lengths are in units of g / omega^2 and times in 1 / omega, so that the table's acceleration, in units of
gravity, is the only number of the shaking. A ball that stays n periods of the table in flight bounces at the
phase where cos(phase) = n pi (1 - e) / ((1 + e) G).

Source: Holmes 1982, J. Sound Vib. 84:173; Luck and Mehta 1993, Phys. Rev. E 48:3988 (without the assumption
of high flight).
"""

import jax.numpy as jnp

from gaitsweep import DeclaredModel, event, parameter, variable


class BouncingBall(DeclaredModel):
    """A ball on a shaking table; the section is the impact, just after it."""

    source = "Holmes 1982, J. Sound Vib. 84:173"
    section_coordinates = ("phase", "speed")

    G = parameter("1", "acceleration of the table, in units of gravity", 1.2, low=0.0)
    restitution = parameter("1", "coefficient of restitution", 0.5, low=0.0, high=1.0, symbol="e")

    phase = variable("rad", "phase of the table", 0.5, circular=True)
    speed = variable("1", "speed upwards; at an impact that after it", 3.0)
    height = variable("1", "height above the middle of the table")

    def flow(self, p, s):
        return {"phase": 1.0, "speed": -1.0, "height": s.speed}

    @event("ball hits the table", section=True)
    def impact(self, p, s):
        return p.G * jnp.sin(s.phase) - s.height

    @impact.jump
    def bounce(self, p, s):
        table_speed = p.G * jnp.cos(s.phase)
        speed = table_speed - p.restitution * (s.speed - table_speed)
        return s.replace(height=p.G * jnp.sin(s.phase), speed=speed, phase=jnp.mod(s.phase, 2.0 * jnp.pi))

    def complete(self, p, s):
        return s.replace(height=p.G * jnp.sin(s.phase))  # on the table

    def period(self, p):
        return jnp.asarray(2.0 * jnp.pi)
