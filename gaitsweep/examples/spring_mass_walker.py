"""A spring-mass walker: a point mass on two massless springs, which walks and runs.

A leg off the ground is held at a fixed angle of attack. The section is the apex, where the mass begins to
fall; the energy is a parameter, as all gaits conserve it.

Source: Geyer, Seyfarth and Blickhan 2006, Proc. R. Soc. B 273:2861, eqs. (2.1) to (2.3).
"""

import jax.numpy as jnp

from gaitsweep import DeclaredModel, event, mode, observable, parameter, variable

FLIGHT, SINGLE, DOUBLE = range(3)


class SpringMassWalker(DeclaredModel):
    """The walker, whose steps have a flight or a double support; the section is the apex.

    `x` is measured from the foot on the ground, in double support from the rear one; in flight it is `l0`. A
    start whose distance from that foot is at least `l0` is in flight.
    """

    source = "Geyer, Seyfarth and Blickhan 2006, Proc. R. Soc. B 273:2861"
    gaits = ("none", "walking", "running")  # none: of a row that ends before its first apex
    section_coordinates = ("x", "z", "reach")

    alpha = parameter("deg", "angle of attack of the legs", 69.0, low=0.0, high=90.0, symbol=r"\alpha_0")
    k = parameter("N/m", "stiffness of a leg", 14000.0, low=0.0, open_ends=True)
    m = parameter("kg", "mass", 80.0, low=0.0, open_ends=True)
    l0 = parameter("m", "rest length of a leg", 1.0, low=0.0, open_ends=True, symbol="l_0")
    E = parameter("J", "energy", 816.0, low=0.0)
    g = parameter("m/s2", "gravitational acceleration", 9.81, low=0.0, open_ends=True)

    x = variable("m", "distance ahead of the foot on the ground", 0.0)
    z = variable("m", "height", 0.97, low=0.0)
    reach = variable("m", "distance between the feet in double support", 0.0, held=True)
    v_x = variable("m/s", "forward speed", observed=True)
    v_z = variable("m/s", "speed upwards")
    support = mode(SINGLE, "flight, single or double support")

    def complete(self, p, s):
        flies = (s.support < DOUBLE) & (jnp.hypot(s.x, s.z) >= p.l0)
        support = jnp.where(s.support == DOUBLE, DOUBLE, jnp.where(flies, FLIGHT, SINGLE))
        s = s.replace(support=support, x=jnp.where(flies, p.l0, s.x), v_z=0.0)
        s = s.replace(reach=jnp.where(support == DOUBLE, s.reach, 0.0))
        kinetic = p.E - p.m * p.g * s.z - self._stored(p, s)
        # a start with too little energy has no speed
        return s.replace(v_x=jnp.sqrt(2.0 * kinetic / p.m))

    def without_start(self, p, s):
        return {"height and springs take more than the energy E": jnp.isnan(s.v_x)}

    def _stored(self, p, s):
        """Energy (J) of the springs."""
        rear = p.l0 - jnp.hypot(s.x, s.z)
        front = p.l0 - jnp.hypot(s.x - s.reach, s.z)
        squares = jnp.where(s.support >= SINGLE, rear**2, 0.0)
        squares = squares + jnp.where(s.support == DOUBLE, front**2, 0.0)
        return 0.5 * p.k * squares

    def flow(self, p, s):
        acceleration_x = 0.0
        acceleration_z = -p.g
        for x, stands in ((s.x, s.support >= SINGLE), (s.x - s.reach, s.support == DOUBLE)):
            length = jnp.hypot(x, s.z)
            push = jnp.where(stands, p.k / p.m * (p.l0 - length) / length, 0.0)
            acceleration_x += push * x
            acceleration_z += push * s.z
        rate_x = jnp.where(s.support == FLIGHT, 0.0, s.v_x)
        return {"x": rate_x, "z": s.v_z, "v_x": acceleration_x, "v_z": acceleration_z}

    @event("foot lands", during=lambda s: s.support < DOUBLE)
    def touchdown(self, p, s):
        return p.l0 * jnp.sin(jnp.deg2rad(p.alpha)) - s.z

    @touchdown.jump
    def land(self, p, s):
        ahead = p.l0 * jnp.cos(jnp.deg2rad(p.alpha))
        flies = s.support == FLIGHT
        x = jnp.where(flies, -ahead, s.x)
        reach = jnp.where(flies, 0.0, s.x + ahead)
        return s.replace(x=x, reach=reach, support=s.support + 1)

    @event("rear foot lifts off", during=lambda s: s.support >= SINGLE)
    def liftoff(self, p, s):
        return jnp.hypot(s.x, s.z) - p.l0

    @liftoff.jump
    def lift(self, p, s):
        begins_flight = s.support == SINGLE
        return s.replace(x=jnp.where(begins_flight, p.l0, s.x - s.reach), reach=0.0, support=s.support - 1)

    @event("front foot lifts off", during=lambda s: s.support == DOUBLE)
    def front_liftoff(self, p, s):
        return jnp.hypot(s.x - s.reach, s.z) - p.l0

    @front_liftoff.jump
    def lift_front(self, p, s):
        return s.replace(reach=0.0, support=SINGLE)

    @event("apex", section=True)
    def apex(self, p, s):
        return -s.v_z

    def failed(self, p, s):
        """Return whether the mass is below 0.3 of the legs' rest length, or moves backwards."""
        return (s.z <= 0.3 * p.l0) | (s.v_x <= 0.0)

    def period(self, p):
        return 2.0 * jnp.pi * jnp.sqrt(p.m / p.k)

    @observable("1", "support at the apex: 0 flight, 1 single, 2 double")
    def support_of_apex(self, p, s):
        return 1.0 * s.support

    def label(self, params, observed):
        runs = observed["support_of_apex"] == FLIGHT
        return {"gait": jnp.where(runs, self.gaits.index("running"), self.gaits.index("walking"))}
