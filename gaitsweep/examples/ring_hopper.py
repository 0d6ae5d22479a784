"""A hopper whose leg is timed by a ring of phase oscillators.

Each of N equal oscillators is coupled to its two neighbours,

    phi_i' = omega + K (sin(phi_{i+1} - phi_i) + sin(phi_{i-1} - phi_i)).

The first one times the leg of a hopper: a landing turns the speed u into e u + push (1 + cos phi_1) / 2. The
ring comes to rest in twisted states, in which the phase rises by 2 pi q / N from each oscillator to the next;
those with |q| < N / 4 are stable.

Source: Wiley, Strogatz and Girvan 2006, Chaos 16:015103, of the ring; the hopper is that of the notebook
`your_own_model`, whose return map is known.
"""

import dataclasses

import jax.numpy as jnp

from gaitsweep import DeclaredModel, event, parameter, variable

MOST_TURNS = 2  # twisted states with more turns have the gait `none`
TOLERANCE = 1e-2  # rad, of the phase differences of a twisted state


@dataclasses.dataclass(frozen=True)
class RingHopper(DeclaredModel):
    """The hopper and its ring of N oscillators; the section is the landing."""

    N: int = dataclasses.field(default=8, metadata={"meaning": "number of oscillators", "low": 3, "high": 64})

    source = "Wiley, Strogatz and Girvan 2006, Chaos 16:015103"
    gaits = ("q = -2", "q = -1", "q = 0", "q = 1", "q = 2", "none")
    section_coordinates = ("phi", "launch")

    K = parameter("1/s", "coupling of neighbours", 1.0, low=0.0)
    omega = parameter("rad/s", "frequency of the oscillators", 12.0, low=0.0, open_ends=True)
    push = parameter("m/s", "speed that the leg adds at most", 2.6, low=0.0, open_ends=True)
    restitution = parameter("1", "share of its speed that a landing keeps", 0.7, low=0.0, high=0.99)
    g = parameter("m/s2", "gravitational acceleration", 9.81, low=0.0, open_ends=True)

    phi = variable("rad", "phase of oscillator", 0.0, count="N", circular=True, symbol=r"\phi")
    launch = variable("m/s", "speed upwards; at a landing that of the launch", 5.0, low=0.0, open_ends=True)
    height = variable("m", "height of the foot")

    def complete(self, p, s):
        return s.replace(height=0.0)

    def flow(self, p, s):
        ahead = jnp.roll(s.phi, -1) - s.phi
        pull = p.K * (jnp.sin(ahead) - jnp.sin(jnp.roll(ahead, 1)))
        return {"phi": p.omega + pull, "height": s.launch, "launch": -p.g}

    @event("foot lands", section=True)
    def landing(self, p, s):
        return -s.height

    @landing.jump
    def push_off(self, p, s):
        launch = p.restitution * jnp.abs(s.launch) + p.push * (1.0 + jnp.cos(s.phi[0])) / 2.0
        # phases that grow without end would be known less and less precisely
        turns = jnp.floor(s.phi[0] / (2.0 * jnp.pi))
        return s.replace(height=0.0, launch=launch, phi=s.phi - 2.0 * jnp.pi * turns)

    def label(self, p, at):
        phi = jnp.stack([at[f"phi_{i}"] for i in range(1, self.N + 1)])
        ahead = jnp.roll(phi, -1) - phi
        wrapped = ahead - 2.0 * jnp.pi * jnp.round(ahead / (2.0 * jnp.pi))
        q = jnp.round(jnp.sum(wrapped) / (2.0 * jnp.pi)).astype(jnp.int32)
        is_twisted = jnp.max(jnp.abs(wrapped - 2.0 * jnp.pi * q / self.N)) < TOLERANCE
        is_named = is_twisted & (jnp.abs(q) <= MOST_TURNS)
        return {"gait": jnp.where(is_named, q + MOST_TURNS, len(self.gaits) - 1)}

    def period(self, p):
        return 2.0 * p.push / (1.0 - p.restitution) / p.g  # of the longest hop that repeats
