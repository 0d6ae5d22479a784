"""A spring-mass runner (SLIP): a point mass that bounces along on a massless spring.

In flight the leg is held at a fixed angle of attack; in stance it pushes along the line to its foot. Energy
is conserved, so at a given energy the height of an apex decides the next one. On uneven ground (the key
`ground` of a job) heights are those above x = 0, where the first apex is.

Source: Seyfarth, Geyer and Herr 2003, J. Exp. Biol. 206:2547; Geyer, Seyfarth and Blickhan 2005, J. Theor.
Biol. 232:315, eq. (1).
"""

import dataclasses

import jax.numpy as jnp

from gaitsweep import DeclaredModel, energy, event, ground_field, mode, parameter, variable

DESCENDING, STANCE, ASCENDING, FALLEN = range(4)


@dataclasses.dataclass(frozen=True)
class SlipRunner(DeclaredModel):
    """The runner; the section is the apex, whose height is the only coordinate."""

    source = "Seyfarth, Geyer and Herr 2003, J. Exp. Biol. 206:2547"
    gaits = ("running",)
    section_coordinates = ("z",)

    ground: str = ground_field()

    alpha = parameter("deg", "angle of attack of the leg", 68.0, low=0.0, high=90.0, symbol=r"\alpha_0")
    k = parameter("N/m", "stiffness of the leg", 20000.0, low=0.0, open_ends=True)
    m = parameter("kg", "mass", 80.0, low=0.0, open_ends=True)
    l0 = parameter("m", "rest length of the leg", 1.0, low=0.0, open_ends=True, symbol="l_0")
    speed = parameter("m/s", "forward speed at an apex of height l0: it sets the energy", 5.0, low=0.0)
    g = parameter("m/s2", "gravitational acceleration", 9.81, low=0.0, open_ends=True)

    x = variable("m", "distance from the last apex, in stance from the foot")
    z = variable("m", "height", 1.0, low=0.0)
    v_x = variable("m/s", "forward speed", observed=True)
    v_z = variable("m/s", "speed upwards")
    origin = variable("m", "place from which x is measured", signal=False, held=True)
    base = variable("m", "height of the foot on the ground", signal=False, held=True)
    phase = mode(DESCENDING, "descending, stance, ascending or fallen")

    def complete(self, p, s):
        speed = jnp.sqrt(p.speed**2 + 2.0 * p.g * (p.l0 - s.z))  # a start with too little energy has none
        # an apex below the height of touchdown leaves no room for the leg
        falls = (s.z <= p.ground(_reach(p)) + _touchdown(p)) | (speed <= 0.0)
        return s.replace(x=0.0, v_x=speed, v_z=0.0, phase=jnp.where(falls, FALLEN, s.phase))

    def without_start(self, p, s):
        return {"the height takes more than the energy, which speed sets": jnp.isnan(s.v_x)}

    def flow(self, p, s):
        length = _leg(s)
        push = jnp.where(s.phase == STANCE, p.k / p.m * (p.l0 - length) / length, 0.0)
        return {"x": s.v_x, "z": s.v_z, "v_x": push * s.x, "v_z": push * (s.z - s.base) - p.g}

    @event("foot lands", during=lambda s: s.phase == DESCENDING)
    def touchdown(self, p, s):
        return p.ground(_foothold(p, s)) + _touchdown(p) - s.z

    @touchdown.jump
    def land(self, p, s):
        foot = _foothold(p, s)
        return s.replace(x=-_reach(p), origin=foot, base=p.ground(foot), phase=STANCE)

    @event("foot lifts off", during=lambda s: s.phase == STANCE)
    def liftoff(self, p, s):
        return _leg(s) - p.l0

    @liftoff.jump
    def take_off(self, p, s):
        forwards = (s.v_z > 0.0) & (s.v_x > 0.0)
        return s.replace(phase=jnp.where(forwards, ASCENDING, FALLEN))

    @event("mass hits the ground", during=lambda s: s.phase == STANCE)
    def crash(self, p, s):
        return s.base - s.z

    @crash.jump
    def fall(self, p, s):
        return s.replace(phase=FALLEN)

    @event("apex", section=True, during=lambda s: s.phase == ASCENDING)
    def apex(self, p, s):
        return -s.v_z

    @apex.jump
    def begin_step(self, p, s):
        clears = s.z > p.ground(_foothold(p, s)) + _touchdown(p)
        return s.replace(x=0.0, origin=s.origin + s.x, phase=jnp.where(clears, DESCENDING, FALLEN))

    @energy("J", "energy", observed=True)
    def energy(self, p, s):
        spring = jnp.where(s.phase == STANCE, 0.5 * p.k * (p.l0 - _leg(s)) ** 2, 0.0)
        return 0.5 * p.m * (s.v_x**2 + s.v_z**2) + p.m * p.g * s.z + spring

    def failed(self, p, s):
        """Return whether a step failed: too low an apex, a lift-off backwards, or the mass on the ground."""
        return s.phase == FALLEN

    def period(self, p):
        return jnp.pi * jnp.sqrt(p.m / p.k) + jnp.sqrt(2.0 * p.l0 / p.g)  # a stance and a flight, roughly


def _leg(s):
    """Length (m) of the leg in stance."""
    return jnp.sqrt(s.x**2 + (s.z - s.base) ** 2)


def _reach(p):
    """Distance (m) of the foot ahead of the mass where it lands."""
    return p.l0 * jnp.cos(jnp.deg2rad(p.alpha))


def _foothold(p, s):
    """Horizontal position (m) of the foot in flight."""
    return s.origin + s.x + _reach(p)


def _touchdown(p):
    """Height (m) of the mass above the foot where it lands."""
    return p.l0 * jnp.sin(jnp.deg2rad(p.alpha))
