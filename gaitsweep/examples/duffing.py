"""Duffing's oscillator: a mass in a potential with two wells, driven by a periodic force.

The section is one instant of each period of the drive, where the force is largest.

Source: Duffing 1918, Erzwungene Schwingungen bei veraenderlicher Eigenfrequenz; Guckenheimer and Holmes 1983,
Nonlinear Oscillations, section 2.2.
"""

import jax.numpy as jnp

from gaitsweep import DeclaredModel, instants, parameter, time, variable


def drive_period(p):
    """Period of the drive (s)."""
    return 2.0 * jnp.pi / p.omega


class Duffing(DeclaredModel):
    """The oscillator x'' + d x' + beta x + x^3 = f cos(omega t), of mass 1 kg."""

    source = "Guckenheimer and Holmes 1983, section 2.2"

    d = parameter("1/s", "damping", 0.15, low=0.0)
    beta = parameter("N/m", "stiffness at the middle; below 0 there are two wells", -1.0, symbol=r"\beta")
    f = parameter("N", "amplitude of the drive", 0.3)
    omega = parameter("rad/s", "angular frequency of the drive", 1.0, low=0.0, open_ends=True)

    t = time()
    x = variable("m", "displacement", 0.1)
    v = variable("m/s", "velocity", 0.0)
    strobe = instants("strobe", every=drive_period, section=True)

    def flow(self, p, s):
        return {"t": 1.0, "x": s.v, "v": p.f * jnp.cos(p.omega * s.t) - p.d * s.v - p.beta * s.x - s.x**3}

    def period(self, p):
        return drive_period(p)
