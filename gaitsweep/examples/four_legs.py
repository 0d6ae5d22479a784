"""Four legs in place, each with a phase oscillator: coupled in pairs, and held back by the loads on the feet.

The phases of a fore leg and the hind leg of its side differ by d, and their coupling moves d by

    d' = 2 K_fore sin(d) - 2 K_two sin(2 d).

So a trot (d = pi) is stable for K_fore > -2 K_two, and a pace (d = 0) for K_fore < 2 K_two: between these two
values the gait depends on the past.

Source: Haken, Kelso and Bunz 1985, Biol. Cybern. 51:347, of two coupled rhythms.
"""

import math

import jax.numpy as jnp

from gaitsweep import DeclaredModel, event, footfalls, mode, parameter, variable

TURN = 2.0 * math.pi  # rad


class FourLegs(DeclaredModel):
    """Oscillators of the legs LF, RF, LH and RH; a cycle ends when the left fore foot lands."""

    source = "Haken, Kelso and Bunz 1985, Biol. Cybern. 51:347"

    omega = parameter("rad/s", "frequency of the oscillators", 6.0, low=0.0, open_ends=True)
    duty = parameter("1", "duty factor", 0.6, low=0.0, high=1.0, open_ends=True)
    K_side = parameter("1/s", "coupling of left and right leg", 1.0)
    K_fore = parameter("1/s", "coupling of fore and hind leg", 0.5)
    K_two = parameter("1/s", "coupling of fore and hind leg, second harmonic", 0.2)
    sigma = parameter("rad/s", "feedback of the load", 1.0)
    # sums over left and right, fore and hind, and diagonal legs differ: see docs/four_legs.md
    bias = parameter("1", "share by which leg {} is faster", (0.0, 1e-4, 3e-4, 7e-4), count=4)

    phi = variable("rad", "phase of leg {}", (0.0, 3.0, 3.1, 0.1), count=4, circular=True, low=0.0, high=TURN)
    time = variable("s", "time since the left fore foot landed")  # the clock of `feet`
    down = mode(False, "foot {} is down", count=4)

    def complete(self, p, s):  # a leg is down during the first part of its turn, at the start too
        return s.replace(down=s.phi < TURN * p.duty)

    def flow(self, p, s):
        LF, RF, LH, RH = s.phi
        side = jnp.stack([LF - RF, RF - LF, LH - RH, RH - LH])
        fore = jnp.stack([LF - LH, RF - RH, LH - LF, RH - RF])
        load = s.down / jnp.maximum(s.down.sum(), 1)  # equal parts of the weight
        rate = p.omega * (1.0 + p.bias) - p.sigma * load * jnp.cos(s.phi)
        rate += p.K_side * jnp.sin(side)  # positive: the two legs alternate
        rate += p.K_fore * jnp.sin(fore) - p.K_two * jnp.sin(2.0 * fore)
        return {"phi": rate, "time": 1.0}

    @event("foot {} lands", count=4, section="first")
    def landing(self, p, s):
        return s.phi - TURN

    @landing.jump
    def land(self, p, s, i):  # of leg i, from 0
        time = jnp.where(i == 0, 0.0, s.time)
        return s.replace(phi=s.phi.at[i].add(-TURN), down=s.down.at[i].set(True), time=time)

    @event("foot {} lifts", count=4, during=lambda s: s.down)
    def lifting(self, p, s):
        return s.phi - TURN * p.duty

    @lifting.jump
    def lift(self, p, s, i):
        return s.replace(down=s.down.at[i].set(False))

    @footfalls("time", legs=("LF", "RF", "LH", "RH"))  # lags, duty factors, names of gaits
    def feet(self, p, s):
        return s.down

    def period(self, p):
        return TURN / p.omega
