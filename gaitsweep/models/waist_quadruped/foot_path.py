"""The desired path of a foot: a curve in swing, a line in stance, a dip if it misses the ground."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from gaitsweep.dynamics.phase_oscillator import TWO_PI

# Segments of the path: stance, first and second half of the swing, and after it without a landing.
STANCE, EARLY, LATE, BEYOND = 0, 1, 2, 3


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class FootPath:
    """The path; `phi_AEP` (rad) is the phase of the anterior extreme position, all others are in m.

    The extreme positions are at `x_c` + D/2 and `x_c` - D/2, `H` below the hip; `h` is the height of the
    swing, `dip` the depth that a foot without landing reaches below the extreme positions.
    """

    phi_AEP: jax.Array
    x_c: jax.Array
    D: jax.Array
    H: jax.Array
    h: jax.Array
    dip: jax.Array

    @property
    def PEP(self) -> jax.Array:
        """x of the posterior extreme position, m."""
        return self.x_c - 0.5 * self.D

    def target(
        self, phi: jax.Array, segment: jax.Array, landing: tuple[jax.Array, jax.Array]
    ) -> tuple[jax.Array, jax.Array]:
        """Desired x and z of the foot relative to its hip, m.

        Args:
            phi: the limb's phase, rad.
            segment: STANCE, EARLY, LATE or BEYOND.
            landing: desired x and z at the last landing (LP), m.
        """
        standing, swinging = segment == STANCE, (segment == EARLY) | (segment == LATE)
        turn, done = TWO_PI * (phi / self.phi_AEP), self.done(phi)
        # one angle serves both curves, since a limb follows one of them
        angle = jnp.where(swinging, turn, jnp.pi * done)
        sine, cosine = jnp.sin(angle), jnp.cos(angle)
        # both lines end at the PEP: one begins at the landing point, the other at the AEP and dips
        from_x = jnp.where(standing, landing[0], self.PEP + self.D)
        from_z = jnp.where(standing, landing[1], -self.H)
        x, z = self.line(from_x, from_z, done)
        z = z - jnp.where(standing, 0.0, self.dip * sine)
        x = jnp.where(swinging, self.PEP + self.D * (turn - sine) / TWO_PI, x)
        return x, jnp.where(swinging, 0.5 * self.h * (1.0 - cosine) - self.H, z)

    def done(self, phi: jax.Array) -> jax.Array:
        """Progress from the phase of the AEP to the end of the cycle, 0 to 1."""
        return (phi - self.phi_AEP) / (TWO_PI - self.phi_AEP)

    def line(self, x: jax.Array, z: jax.Array, done: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The point on the line from (x, z) to the PEP at the progress `done`, 0 to 1."""
        return x + (self.PEP - x) * done, z + (-self.H - z) * done
