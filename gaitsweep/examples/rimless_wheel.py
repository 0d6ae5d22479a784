"""A rimless wheel that rolls down rough ground: the slope from each foothold to the next is drawn at random.

An impact keeps the share c = cos(2 alpha) of the rate, and the energy K = rate^2 / 2 + cos(angle) is constant
between impacts. So the energies after impacts on slopes g_1, g_2, ... are a Markov chain,

    K_n = c^2 (K_{n-1} - cos(g_n + alpha)) + cos(g_n - alpha).

Where a spoke lands before the vertical (g_n < alpha), the wheel falls back as soon as K_n < 1, since it does
not reach the vertical; a spoke that lands beyond it (g_n > alpha) rolls on. On even ground the wheel settles.

Source: Byl and Tedrake 2009, Int. J. Robotics Research 28:1040, of rough slopes and mean steps to a fall;
McGeer 1990, Int. J. Robotics Research 9:62, of the wheel.
"""

import jax.numpy as jnp

from gaitsweep import DeclaredModel, event, mode, normal, observable, parameter, variable


class RimlessWheel(DeclaredModel):
    """The wheel; the section is the impact of a spoke, just after it. Time is in units of sqrt(l / g)."""

    source = "Byl and Tedrake 2009, Int. J. Robotics Research 28:1040"
    section_coordinates = ("rate",)

    slope = parameter("rad", "mean slope of the ground, downwards", 0.14, low=-0.5, high=0.5)
    roughness = parameter("rad", "standard deviation of the slopes between footholds", 0.0, low=0.0, high=0.2)
    alpha = parameter("rad", "half the angle between spokes", 0.4, low=0.05, high=0.7)
    seed = parameter("1", "seed of the slopes: rows with the same seed have the same ground", 0.0, whole=True)

    angle = variable("rad", "angle of the spoke on the ground from the vertical", observed=False)
    rate = variable("1", "rate of the angle", 0.5)
    ahead = variable("rad", "slope to the next foothold", signal=False, held=True)
    steps = mode(0, "impacts so far")

    def complete(self, p, s):
        return s.replace(angle=p.slope - p.alpha, ahead=self.ground(p, s.steps + 1.0))

    def ground(self, p, step):
        """Slope (rad) from foothold `step` to the next one."""
        return p.slope + p.roughness * normal(p.seed, step)

    def flow(self, p, s):
        return {"angle": s.rate, "rate": jnp.sin(s.angle)}

    @event("spoke lands", section=True)
    def landing(self, p, s):
        return s.angle - s.ahead - p.alpha

    @landing.jump
    def impact(self, p, s):
        steps = s.steps + 1
        return s.replace(
            angle=s.ahead - p.alpha,
            rate=jnp.cos(2.0 * p.alpha) * s.rate,
            ahead=self.ground(p, steps + 1.0),
            steps=steps,
        )

    @observable("1", "energy above that of rest on a vertical spoke, in m g l")
    def margin(self, p, s):
        return 0.5 * s.rate**2 + jnp.cos(s.angle) - 1.0

    def failed(self, p, s):
        """Return whether the wheel rolls back."""
        return s.rate < 0.0

    def period(self, p):
        return jnp.full_like(p.alpha, 2.0)
