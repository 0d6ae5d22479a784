"""A MuJoCo hopper, whose leg follows an oscillator with feedback of the load on the foot.

Source of the feedback: Owaki, Kano, Nagasawa, Tero and Ishiguro 2013, J. R. Soc. Interface 10:20120669.
"""

import jax.numpy as jnp

from gaitsweep import MjcfModel, event, observable, parameter, variable


class MujocoHopper(MjcfModel):
    """The hopper of mujoco_hopper.xml; the section is the oscillator's phase 0."""

    source = "Owaki et al. 2013, J. R. Soc. Interface 10:20120669, for the feedback"
    body_file = "mujoco_hopper.xml"

    omega = parameter("rad/s", "frequency of the oscillator", 15.0, low=0.0, open_ends=True)
    sigma = parameter("rad/(N s)", "feedback of the load", 0.1)
    stroke = parameter("m", "amplitude of the leg", 0.03, low=0.0)
    phi = variable("rad", "phase of the oscillator", 1.0, circular=True, observed=False)

    def control(self, p, s):
        return jnp.stack([-p.stroke * jnp.sin(s.phi)])

    def rates(self, p, s):
        return {"phi": p.omega - p.sigma * self.sensor(s, "load") * jnp.cos(s.phi)}

    @event("the oscillator begins a turn", section=True)
    def turn(self, p, s):
        return s.phi - 2.0 * jnp.pi

    @turn.jump
    def wrap(self, p, s):
        return s.replace(phi=s.phi - 2.0 * jnp.pi)

    @observable("m", "height of the trunk over its rest", scale=0.1, signal=True)
    def height(self, p, s):
        return s.body.q[0]

    @observable("m/s", "speed of the trunk upwards", scale=1.0)
    def speed(self, p, s):
        return s.body.v[0]

    def period(self, p):
        return 2.0 * jnp.pi / p.omega
