"""Smooth flows: Van der Pol's, with a section; and a spring without any event."""

from __future__ import annotations

import jax.numpy as jnp

from gaitsweep import DeclaredModel, event, parameter, variable


class VanDerPol(DeclaredModel):
    """Crossed upwards where v = 0, at the least x of a cycle."""

    mu = parameter("1", "damping", 1.0, low=0.0)
    x = variable("1", "position", 2.0)
    v = variable("1/s", "velocity", 0.0, scale=1.0)

    def flow(self, p, s):
        return {"x": s.v, "v": p.mu * (1.0 - s.x**2) * s.v - s.x}

    @event("v rises through 0", section=True)
    def turns(self, p, s):
        return s.v

    def period(self, p):
        return 2.0 * jnp.pi + p.mu


class Spring(DeclaredModel):
    """A harmonic oscillator without any event."""

    k = parameter("1/s2", "stiffness over mass", 4.0, low=0.0)
    x = variable("m", "position", 1.0)
    v = variable("m/s", "velocity", 0.0)

    def flow(self, p, s):
        return {"x": s.v, "v": -p.k * s.x}

    def period(self, p):
        return 2.0 * jnp.pi / jnp.sqrt(p.k)
