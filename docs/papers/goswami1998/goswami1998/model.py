"""The compass gait: two stiff legs with point masses and a hip, which walk down a slope by gravity alone.

Symbols are the paper's. Angles are those of the legs from the vertical, counterclockwise, while the walker
goes to the right: theta_s is positive where the hip is behind the stance foot. The swing foot passes
through the ground while the legs pass each other, as in the paper.

Source: Goswami, Thuilot and Espiau 1998, Int. J. Robotics Research 17(12):1282.
"""

import jax.numpy as jnp

import gaitsweep as gs

# Starts near the symmetric gait: least squares through it from 0.25 to 6.5 degrees at mu = 2, beta = 1,
# within 0.0002 rad, 0.004 rad/s and 0.012 rad/s. Angles of legs grow as the cube root of a small slope.
_THETA_S = "0.186*phi**(1/3) - 0.0165*phi"
_THETA_S_DOT = "sqrt(g/(9.81*l))*(-1.0045*phi**(1/3) + 0.0839*phi**(2/3) + 0.0605*phi)"
_THETA_NS_DOT = "sqrt(g/(9.81*l))*(-1.1469*phi**(1/3) + 0.3976*phi**(2/3) + 0.1495*phi)"


class CompassGait(gs.DeclaredModel):
    """The compass gait; the section is a heel strike, just after it.

    With `steps` = 2 every second strike is one of the section: a gait whose two steps differ is then a fixed
    point of the return map, which run kind `continuation` follows.
    """

    source = "Goswami, Thuilot and Espiau 1998, Int. J. Robotics Research 17(12):1282"
    section_coordinates = ("theta_s", "theta_s_dot", "theta_ns_dot")

    phi = gs.parameter("deg", "slope of the ground, downwards", 3.0, low=0.0, high=20.0, symbol=r"\varphi")
    mu = gs.parameter("1", "mass of the hip over that of a leg", 2.0, low=0.0, symbol=r"\mu")
    beta = gs.parameter(
        "1", "b over a: where the mass of a leg is", 1.0, low=0.0, open_ends=True, symbol=r"\beta"
    )
    m = gs.parameter("kg", "mass of a leg", 5.0, low=0.0, open_ends=True)
    l = gs.parameter("m", "length of a leg", 1.0, low=0.0, open_ends=True)  # noqa: E741 - the paper's symbol
    m_H = gs.parameter("kg", "mass of the hip", "mu*m", low=0.0, symbol="m_H")
    a = gs.parameter("m", "from the foot to the mass of a leg", "l/(1+beta)", low=0.0, open_ends=True)
    b = gs.parameter("m", "from the mass of a leg to the hip", "beta*a", low=0.0, open_ends=True)
    g = gs.parameter("m/s2", "gravitational acceleration", 9.81, low=0.0, open_ends=True)

    steps = gs.parameter("1", "heel strikes from section to section, a whole number", 1.0, low=1.0)

    theta_s = gs.variable("rad", "angle of the stance leg", _THETA_S, symbol=r"\theta_s")
    theta_ns = gs.variable("rad", "angle of the swing leg", symbol=r"\theta_{ns}")
    theta_s_dot = gs.variable("rad/s", "rate of the stance leg", _THETA_S_DOT, symbol=r"\dot\theta_s")
    theta_ns_dot = gs.variable("rad/s", "rate of the swing leg", _THETA_NS_DOT, symbol=r"\dot\theta_{ns}")
    step_time = gs.variable("s", "time since the last heel strike")
    T = gs.variable("s", "step period: time of the last step", observed=True)
    loss = gs.variable("J", "energy that the last heel strike dissipated", observed=True)
    left = gs.mode(0, "heel strikes before that of the section")

    def complete(self, p, s):
        """Both feet are on the ground, at the start and on the section."""
        return s.replace(theta_ns=-2.0 * jnp.deg2rad(p.phi) - s.theta_s, left=strikes_before(p))

    def flow(self, p, s):
        (m11, m12), (_, m22) = inertia(p, s)
        bend = p.m * (p.a + p.b) * p.b * jnp.sin(s.theta_s - s.theta_ns)
        ns = -bend * s.theta_s_dot**2 - p.m * p.b * p.g * jnp.sin(s.theta_ns)
        st = bend * s.theta_ns_dot**2 + weight(p) * jnp.sin(s.theta_s)
        determinant = m11 * m22 - m12**2
        return {
            "theta_s": s.theta_s_dot,
            "theta_ns": s.theta_ns_dot,
            "theta_s_dot": (m11 * st - m12 * ns) / determinant,
            "theta_ns_dot": (m22 * ns - m12 * st) / determinant,
            "step_time": 1.0,
            "T": 0.0,
            "loss": 0.0,
        }

    @gs.event("heel strikes", during=lambda s: s.left == 0, section=True)
    def last_strike(self, p, s):
        return swing_foot_below(p, s)

    @last_strike.jump
    def end_cycle(self, p, s):
        return exchanged(p, s).replace(left=strikes_before(p))

    @gs.event("heel strikes, and the cycle goes on", during=lambda s: s.left > 0)
    def strike(self, p, s):
        return swing_foot_below(p, s)

    @strike.jump
    def exchange(self, p, s):
        return exchanged(p, s).replace(left=s.left - 1)

    @gs.observable("deg", "half the angle between the legs", symbol=r"\alpha")
    def alpha(self, p, s):
        return jnp.rad2deg(0.5 * jnp.abs(s.theta_ns - s.theta_s))

    @gs.observable("m", "length of the last step", symbol="L")
    def step_length(self, p, s):
        return 2.0 * (p.a + p.b) * jnp.sin(0.5 * jnp.abs(s.theta_ns - s.theta_s))

    @gs.energy("J", "energy of both legs and the hip, from the stance foot", symbol="E")
    def E(self, p, s):
        return kinetic(p, s) + weight(p) * jnp.cos(s.theta_s) - p.m * p.b * p.g * jnp.cos(s.theta_ns)

    def failed(self, p, s):
        return (jnp.abs(s.theta_s) > 0.5 * jnp.pi) | (jnp.abs(s.theta_ns) > jnp.pi)

    def period(self, p):
        return 2.5 * p.steps * jnp.sqrt((p.a + p.b) / p.g)


def strikes_before(p):
    """The heel strikes of a cycle before that of the section."""
    return jnp.round(p.steps).astype(int) - 1


def inertia(p, s):
    """The matrix M (2, 2) of the rates of swing and stance leg (kg m2), as rows."""
    coupling = -p.m * (p.a + p.b) * p.b * jnp.cos(s.theta_s - s.theta_ns)
    whole = (p.m_H + p.m) * (p.a + p.b) ** 2 + p.m * p.a**2
    return (p.m * p.b**2, coupling), (coupling, whole)


def weight(p):
    """The torque of gravity on the stance leg and what it carries, by the sine of its angle (N m)."""
    return (p.m_H * (p.a + p.b) + p.m * (2.0 * p.a + p.b)) * p.g


def kinetic(p, s):
    """The kinetic energy (J)."""
    (m11, m12), (_, m22) = inertia(p, s)
    moving = m11 * s.theta_ns_dot**2 + m22 * s.theta_s_dot**2
    return 0.5 * moving + m12 * s.theta_s_dot * s.theta_ns_dot


def swing_foot_below(p, s):
    """Twice the angle by which the line from foot to foot is steeper than the slope (rad)."""
    return -(s.theta_s + s.theta_ns + 2.0 * jnp.deg2rad(p.phi))


def exchanged(p, s):
    """The state after a heel strike: the legs change their roles, Q+ theta_dot+ = Q- theta_dot-.

    The first row keeps the angular momentum of all masses about the new stance foot, the second that of the
    leg that leaves the ground about the hip.
    """
    length, c = p.a + p.b, jnp.cos(s.theta_s - s.theta_ns)
    mab = p.m * p.a * p.b
    whole = -mab * s.theta_ns_dot + (p.m_H * length**2 + 2.0 * p.m * p.a * length) * c * s.theta_s_dot
    whole = whole - mab * s.theta_s_dot
    swing = -mab * s.theta_s_dot
    (m11, m12), (_, m22) = inertia(p, s)
    q11, q12, q21, q22 = m11 + m12, m22 + m12, m11, m12
    determinant = q11 * q22 - q12 * q21
    after = s.replace(
        theta_s=s.theta_ns,
        theta_ns=s.theta_s,
        theta_ns_dot=(q22 * whole - q12 * swing) / determinant,
        theta_s_dot=(q11 * swing - q21 * whole) / determinant,
        step_time=0.0,
        T=s.step_time,
    )
    return after.replace(loss=kinetic(p, s) - kinetic(p, after))
