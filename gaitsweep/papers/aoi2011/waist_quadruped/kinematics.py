"""Kinematics of the quadruped: indices of joints, limbs, tilt and falls, and the desired path of a foot."""

from __future__ import annotations

import dataclasses
import math
from typing import Literal, get_args

import jax
import jax.numpy as jnp

from gaitsweep.dynamics import TWO_PI

Scalar = jax.Array | float
Point = tuple[jax.Array, jax.Array]  # x and z of each foot or of one, m, or their rates, m/s

# Limits of a fall: height as a share of that in stance, and angles of tilt and twist (rad).
FALL_HEIGHT, FALL_TILT, FALL_TWIST = 0.4, 1.2, 1.5
# Indices in q; those in v, which has no quaternion, are one less.
WAIST, HIP, KNEE = 11, (7, 9, 12, 14), (8, 10, 13, 15)


def tilt(q: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Roll and pitch (rad) of the front body at positions q (16,)."""
    ahead, side, up, norm = _rises(q)
    return jnp.arctan2(side, up), jnp.arcsin(-ahead / norm)


def has_fallen(q: jax.Array, standing: jax.Array, ground: jax.Array | None = None) -> jax.Array:
    """Whether the front body is far below its standing height or tilted, or the waist is twisted.

    Args:
        q: positions (16,).
        standing: height of the front body in stance, m.
        ground: height of the ground below the front body, m; None where it is even.
    """
    ahead, side, up, norm = _rises(q)
    rolled = jnp.abs(side) > math.tan(FALL_TILT) * up
    pitched = jnp.abs(ahead) > math.sin(FALL_TILT) * norm
    twisted = jnp.abs(q[WAIST]) > FALL_TWIST
    height = q[2] if ground is None else q[2] - ground
    return (height < FALL_HEIGHT * standing) | rolled | pitched | twisted


def _rises(q: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """The vertical components of the front body's axes x, y and z at positions q (16,), each times a norm.

    The last result is this norm, the quaternion's squared length.
    """
    w, x, y, z = q[3:7]
    norm = w * w + x * x + y * y + z * z
    ahead, side, up = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z
    return ahead, side, up, norm


def joint_angles(x: jax.Array, z: jax.Array, length: Scalar, bend: Scalar) -> Point:
    """Hip and knee angles (rad) of a limb of two equal links whose foot is at (x, z) from the hip.

    Rotations are about +y, zero is straight down, and the knee angle is relative to the upper link. For a
    target out of reach the straight limb points at it.

    Args:
        x, z: position of the foot relative to the hip, m.
        length: length of each link, m.
        bend: sign of the knee angle, 1 or -1.
    """
    square = x * x + z * z
    reach = 4.0 * length * length - square
    # where the root is zero it has no derivative
    root = jnp.where(reach > 0.0, jnp.sqrt(jnp.where(reach > 0.0, reach, 1.0)), 0.0)
    # half the knee angle, from an isosceles triangle
    half = bend * jnp.arctan2(root, jnp.sqrt(square))
    return jnp.arctan2(-x, -z) - half, 2.0 * half


def joint_rates(
    x: jax.Array, z: jax.Array, x_rate: jax.Array, z_rate: jax.Array, length: Scalar, bend: Scalar
) -> Point:
    """Time derivatives (rad/s) of the hip and knee angles of `joint_angles`; x, z, length, bend as there.

    The knee of a target out of reach does not turn. A foot exactly at its hip has no rates; they are NaN.

    Args:
        x_rate, z_rate: velocity of the foot relative to the hip, m/s.
    """
    square = x * x + z * z
    reach = 4.0 * length * length - square
    # the half knee angle a has cos a = r / (2 length), at the foot's distance r from the hip
    slope = jnp.sqrt(square * jnp.where(reach > 0.0, reach, 1.0))
    half = jnp.where(reach > 0.0, -bend * (x * x_rate + z * z_rate) / slope, 0.0)
    return (z * x_rate - x * z_rate) / square - half, 2.0 * half


# Segments of the path: stance, first and second part of the swing, and after it without a landing.
STANCE, EARLY, LATE, BEYOND = 0, 1, 2, 3
# Curves of the swing; `FootPath.target` has their equations.
Swing = Literal["cycloid", "sine", "ellipse", "two_cycloids"]
SWINGS: tuple[Swing, ...] = get_args(Swing)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class FootPath:
    """The path; `phi_AEP` (rad) is the phase of the anterior extreme position, all others are in m.

    The extreme positions are at `x_c` + D/2 and `x_c` - D/2, `H` below the hip; `h` is the height of the
    swing, `dip` the depth that a foot without landing reaches below the extreme positions. `x_c` and `H` may
    differ from limb to limb, (4,). `swing` is one of `SWINGS`; `swing_ease` slows its ends.
    """

    phi_AEP: jax.Array
    x_c: jax.Array
    D: jax.Array
    H: jax.Array
    h: jax.Array
    dip: jax.Array
    swing_ease: jax.Array
    swing: Swing = dataclasses.field(default="cycloid", metadata={"static": True})

    @property
    def PEP(self) -> jax.Array:
        """X of the posterior extreme position, m."""
        return self.x_c - 0.5 * self.D

    def target(self, phi: jax.Array, segment: jax.Array, landing: Point) -> Point:
        """Desired x and z of the foot relative to its hip, m.

        With s = phi / phi_AEP from 0 to 1, x moves from the PEP by D (s - swing_ease sin(2 pi s) / (2 pi)),
        and z rises by h sin(pi s)^2 (`cycloid`), h sin(pi s) (`sine`), or along one cycloid up and one down
        (`two_cycloids`). `ellipse` is the half ellipse with axes D and 2 h, whose angle moves by
        pi (s - (swing_ease - 1) sin(2 pi s) / (2 pi)), at a constant rate for 1; without a landing it goes on
        along the lower half, with axes D and 2 dip.

        Args:
            phi: the limb's phase, rad.
            segment: STANCE, EARLY, LATE or BEYOND.
            landing: desired x and z at the last landing (LP), m.
        """
        standing = segment == STANCE
        swinging = (segment == EARLY) | (segment == LATE)
        turn = TWO_PI * (phi / self.phi_AEP)
        progress = self.progress(phi)
        # one angle serves both curves, since a limb follows one of them
        cycloids = self.swing in ("cycloid", "two_cycloids")
        swung = turn if cycloids else 0.5 * turn
        if self.swing == "ellipse":
            swung = swung - 0.5 * (self.swing_ease - 1.0) * jnp.sin(turn)
        angle = jnp.where(swinging, swung, jnp.pi * progress)
        sine, cosine = jnp.sin(angle), jnp.cos(angle)
        # both lines end at the PEP: one begins at the landing point, the other at the AEP and dips
        line_x = jnp.where(standing, landing[0], self.PEP + self.D)
        line_z = jnp.where(standing, landing[1], -self.H)
        x, z = self.line(line_x, line_z, progress)
        z = z - jnp.where(standing, 0.0, self.dip * sine)
        if self.swing == "ellipse":
            around = jnp.where(swinging, -cosine, cosine)
            x = jnp.where(standing, x, self.x_c + 0.5 * self.D * around)
            return x, jnp.where(swinging, self.h * sine - self.H, z)
        ease = self.swing_ease * (sine if cycloids else 2.0 * sine * cosine)
        x = jnp.where(swinging, self.PEP + self.D * (turn - ease) / TWO_PI, x)
        return x, jnp.where(swinging, self._rise(turn, sine, cosine) - self.H, z)

    def _rise(self, turn: jax.Array, sine: jax.Array, cosine: jax.Array) -> jax.Array:
        """Height (m) of the swing above the extreme positions; sine and cosine as in `target`."""
        if self.swing == "sine":
            return self.h * sine
        if self.swing == "cycloid":
            return 0.5 * self.h * (1.0 - cosine)
        climbed = self.h * (turn - sine * cosine) / jnp.pi  # as if the first cycloid went on
        return self.h - jnp.abs(climbed - self.h)

    def progress(self, phi: jax.Array) -> jax.Array:
        """Progress from the phase of the AEP to the end of the cycle, 0 to 1."""
        return (phi - self.phi_AEP) / (TWO_PI - self.phi_AEP)

    def line(self, x: jax.Array, z: jax.Array, progress: jax.Array) -> Point:
        """The point, x and z in m, on the line to the PEP.

        Args:
            x, z: beginning of the line, m.
            progress: place on the line, 0 to 1.
        """
        return x + (self.PEP - x) * progress, z + (-self.H - z) * progress
