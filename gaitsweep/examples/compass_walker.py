"""A compass walker: two stiff legs with masses and a hip, which walk down a slope by gravity alone.

Angles are those of the legs from the vertical, positive where the hip is in front of the foot. The swing foot
scuffs through the ground when the legs pass each other, as in the source. On uneven ground (the key `ground`
of a job), whose heights add to the slope, the foot strikes where the line between the feet is down on it.

Source: Goswami, Thuilot and Espiau 1998, Int. J. Robotics Research 17:1282. Its gait takes two steps to
repeat from a slope of about 4.39 degrees on, and then four.
"""

import dataclasses

import jax.numpy as jnp

from gaitsweep import DeclaredModel, energy, event, ground_field, observable, parameter, variable

# Least distance (m) of the feet for the slope of the line between them, which needs two points.
CLOSE = 1e-6


@dataclasses.dataclass(frozen=True)
class CompassWalker(DeclaredModel):
    """The walker; the section is the heel strike, just after it."""

    source = "Goswami, Thuilot and Espiau 1998, Int. J. Robotics Research 17:1282"
    section_coordinates = ("stance", "stance_rate", "swing_rate")

    ground: str = ground_field()

    slope = parameter("deg", "slope of the ground, downwards", 3.0, low=0.0, high=20.0, symbol=r"\phi")
    m = parameter("kg", "mass of a leg", 5.0, low=0.0, open_ends=True)
    m_H = parameter("kg", "mass of the hip", 10.0, low=0.0, symbol="m_H")
    a = parameter("m", "from the foot to the leg's mass", 0.5, low=0.0, open_ends=True)
    b = parameter("m", "from the leg's mass to the hip", 0.5, low=0.0, open_ends=True)
    g = parameter("m/s2", "gravitational acceleration", 9.81, low=0.0, open_ends=True)

    stance = variable("rad", "angle of the stance leg", -0.2187, symbol=r"\theta_s")
    swing = variable("rad", "angle of the swing leg", symbol=r"\theta_{ns}")
    stance_rate = variable("rad/s", "rate of the stance leg", 1.0918, symbol=r"\dot\theta_s")
    swing_rate = variable("rad/s", "rate of the swing leg", 0.3772, symbol=r"\dot\theta_{ns}")

    foot = variable("m", "place of the stance foot, horizontally", signal=False, held=True)

    def complete(self, p, s):
        return s.replace(swing=2.0 * jnp.deg2rad(p.slope) - s.stance)  # both feet are on the ground

    def flow(self, p, s):
        stance_inertia, coupling = _inertia(p, s.stance - s.swing)
        centrifugal = p.m * (p.a + p.b) * p.b * jnp.sin(s.stance - s.swing)
        stance_torque = _stance_weight(p) * jnp.sin(s.stance) + centrifugal * s.swing_rate**2
        swing_torque = -p.m * p.b * p.g * jnp.sin(s.swing) - centrifugal * s.stance_rate**2
        stance_acceleration, swing_acceleration = _solved(
            stance_inertia, coupling, coupling, p.m * p.b**2, stance_torque, swing_torque
        )
        return {
            "stance": s.stance_rate,
            "swing": s.swing_rate,
            "stance_rate": stance_acceleration,
            "swing_rate": swing_acceleration,
        }

    # behind the stance foot the swing foot may rise out of the ground, where it scuffs through
    @event("heel strikes", section=True, when=lambda p, s: _ahead(p, s) > 0.0)
    def strike(self, p, s):
        if self.ground == "even":
            return s.stance + s.swing - 2.0 * jnp.deg2rad(p.slope)
        ahead = _ahead(p, s)
        distance = jnp.where(jnp.abs(ahead) > CLOSE, ahead, CLOSE)
        rise = p.ground(s.foot + distance) - p.ground(s.foot)
        return s.stance + s.swing - 2.0 * jnp.arctan(jnp.tan(jnp.deg2rad(p.slope)) - rise / distance)

    @strike.jump
    def exchange(self, p, s):
        """Exchange the legs; momentum about the new foot, and of the old leg about the hip, is conserved."""
        length = p.a + p.b
        cosine = jnp.cos(s.stance - s.swing)
        mass_moment = p.m * p.a * p.b
        about_foot = (p.m_H * length**2 + 2.0 * p.m * p.a * length) * cosine * s.stance_rate
        about_foot = about_foot - mass_moment * (s.stance_rate + s.swing_rate)
        about_hip = -mass_moment * s.stance_rate
        stance_inertia, coupling = _inertia(p, s.stance - s.swing)
        leg_inertia = p.m * p.b**2
        stance_rate, swing_rate = _solved(
            stance_inertia + coupling, coupling + leg_inertia, coupling, leg_inertia, about_foot, about_hip
        )
        return s.replace(
            stance=s.swing,
            swing=s.stance,
            stance_rate=stance_rate,
            swing_rate=swing_rate,
            foot=s.foot + _ahead(p, s),
        )

    @observable("m", "length of the last step")
    def step_length(self, p, s):
        return 2.0 * (p.a + p.b) * jnp.sin(0.5 * jnp.abs(s.swing - s.stance))

    @energy("J", "energy of both legs and the hip, from the stance foot")
    def energy(self, p, s):
        stance_inertia, coupling = _inertia(p, s.stance - s.swing)
        kinetic = 0.5 * (stance_inertia * s.stance_rate**2 + p.m * p.b**2 * s.swing_rate**2)
        potential = _stance_weight(p) * jnp.cos(s.stance) - p.m * p.b * p.g * jnp.cos(s.swing)
        return kinetic + coupling * s.stance_rate * s.swing_rate + potential

    def failed(self, p, s):
        """Return whether the stance leg is beyond the horizontal, or the swing leg beyond the vertical."""
        return (jnp.abs(s.stance) > 0.5 * jnp.pi) | (jnp.abs(s.swing) > jnp.pi)

    def period(self, p):
        return 2.5 * jnp.sqrt((p.a + p.b) / p.g)


def _ahead(p, s):
    """Horizontal distance (m) of the swing foot ahead of the stance foot."""
    return (p.a + p.b) * (jnp.sin(s.stance) - jnp.sin(s.swing))


def _inertia(p, between):
    """Inertia of the stance leg with its load, and coupling of the legs (kg m2) at an angle between them."""
    length = p.a + p.b
    stance_inertia = (p.m_H + p.m) * length**2 + p.m * p.a**2
    return stance_inertia, -p.m * length * p.b * jnp.cos(between)


def _stance_weight(p):
    """Moment (N m) of the weights that the stance leg carries, where it is horizontal."""
    return (p.m_H * (p.a + p.b) + p.m * (2.0 * p.a + p.b)) * p.g


def _solved(a11, a12, a21, a22, b1, b2):
    """Solve the equations a11 x + a12 y = b1 and a21 x + a22 y = b2."""
    determinant = a11 * a22 - a12 * a21
    return (a22 * b1 - a12 * b2) / determinant, (a11 * b2 - a21 * b1) / determinant
