"""A MuJoCo biped on a boom, whose legs follow two oscillators with feedback of the loads on the feet.

Source of the feedback: Owaki, Kano, Nagasawa, Tero and Ishiguro 2013, J. R. Soc. Interface 10:20120669.
"""

import jax.numpy as jnp

from gaitsweep import BodyModel, event, footfalls, observable, parameter, variable


class BoomWalker(BodyModel):
    """The biped of boom_walker.xml; the section is the phase 0 of the left leg, the end of its swing."""

    source = "Owaki et al. 2013, J. R. Soc. Interface 10:20120669, for the feedback"
    body_file = "boom_walker.xml"
    section_coordinates = ("phase",)

    omega = parameter("rad/s", "frequency of the oscillators", 6.0, low=0.0, open_ends=True)
    sigma = parameter("rad/(N s)", "feedback of the load", 0.03)
    coupling = parameter("rad/s", "coupling of the oscillators towards antiphase", 4.0)
    stride = parameter("rad", "amplitude of the hips", 0.25)
    lift = parameter("rad", "flexion of the knees in swing", 1.0)

    phase = variable("rad", "phases of the left and the right leg", (1.0, 4.1), count=2, circular=True)
    clock = variable("s", "time since the section", observed=False, signal=False)
    begin = variable("m", "place of the trunk at the section", observed=False, signal=False, held=True)
    speed = variable("m/s", "mean speed of the last cycle, forward", observed=True, scale=1.0, held=True)

    def control(self, p, s):
        """Return target angles (rad) of hips and knees; a knee is flexed in swing, from the phase pi on."""
        hips = p.stride * jnp.cos(s.phase)
        knees = 0.15 + p.lift * jnp.maximum(-jnp.sin(s.phase), 0.0)
        return jnp.stack([hips[0], knees[0], hips[1], knees[1]])

    def rates(self, p, s):
        loads = jnp.stack([self.load(p, s, "foot_l"), self.load(p, s, "foot_r")])
        pull = p.coupling * jnp.sin(s.phase[::-1] - s.phase - jnp.pi)
        return {"phase": p.omega + p.sigma * loads * jnp.cos(s.phase) + pull, "clock": 1.0}

    @event("the left leg ends its swing", section=True)
    def turn(self, p, s):
        return s.phase[0] - 2.0 * jnp.pi

    @turn.jump
    def wrap(self, p, s):
        place = self.position(s, "x")
        speed = (place - s.begin) / s.clock
        return s.replace(phase=s.phase - 2.0 * jnp.pi, clock=0.0, begin=place, speed=speed)

    @observable("m", "height of the trunk over its rest", scale=0.1, signal=True)
    def height(self, p, s):
        return self.position(s, "z")

    @footfalls("clock", legs=("L", "R"))
    def feet(self, p, s):
        return jnp.stack([self.touches(s, "foot_l"), self.touches(s, "foot_r")])

    def failed(self, p, s):
        """Return whether the trunk is 0.4 m below its rest."""
        return self.position(s, "z") < -0.4

    def period(self, p):
        return 2.0 * jnp.pi / p.omega
