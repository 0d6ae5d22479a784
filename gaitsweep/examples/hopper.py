"""A body that hops upright on a leg whose push-off follows an oscillator.

The oscillator turns at omega, and the leg pushes hardest at phase 0: a landing turns the speed u into
restitution u + push (1 + cos(phase)) / 2. Flight is ballistic.
"""

import jax.numpy as jnp

from gaitsweep import DeclaredModel, event, parameter, variable


class Hopper(DeclaredModel):
    """A hopping body with an oscillator; the section is the landing."""

    gaits = ("1:1", "2:1", "3:1", "none")  # turns of the oscillator a hop
    section_coordinates = ("phase", "launch")

    push = parameter("m/s", "speed that the leg adds at most", 2.6, low=0.0, open_ends=True)
    restitution = parameter("1", "share of its speed that a landing keeps", 0.7, low=0.0, high=0.99)
    omega = parameter("rad/s", "frequency of the oscillator", 12.0, low=0.0, open_ends=True)
    g = parameter("m/s2", "gravitational acceleration", 9.81, low=0.0, open_ends=True)

    phase = variable("rad", "phase of the oscillator", 0.0, circular=True)
    launch = variable("m/s", "speed upwards; at a landing that of the launch", 2.0, low=0.0, open_ends=True)
    height = variable("m", "height of the foot")

    def flow(self, p, s):
        return {"phase": p.omega, "launch": -p.g, "height": s.launch}

    @event("foot lands", section=True)
    def landing(self, p, s):
        return -s.height

    @landing.jump
    def push_off(self, p, s):
        launch = p.restitution * jnp.abs(s.launch) + p.push * (1.0 + jnp.cos(s.phase)) / 2.0
        # a phase that grows without end would be known less and less precisely
        return s.replace(height=0.0, launch=launch, phase=jnp.mod(s.phase, 2.0 * jnp.pi))

    def complete(self, p, s):
        return s.replace(height=0.0)  # on the section, and at the start

    def label(self, p, at):
        turns = at["launch"] * p.omega / (jnp.pi * p.g)  # of the oscillator during a hop
        per_hop = jnp.round(turns)
        even = (jnp.abs(turns - per_hop) < 1e-3) & (per_hop >= 1) & (per_hop <= 3)
        return {"gait": jnp.where(even, per_hop - 1, 3).astype(int)}

    def period(self, p):
        return 2.0 * p.push / (1.0 - p.restitution) / p.g  # of the longest hop that repeats
