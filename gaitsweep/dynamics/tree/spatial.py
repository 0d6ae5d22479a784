"""Spatial vectors and inertias of rigid-body dynamics; the caller knows their reference points.

A motion or force vector has six coordinates, the angular ones first, as in Featherstone's "Rigid Body
Dynamics Algorithms" (2008, ch. 2). It is stored as two 3-vectors, and a 6 x 6 inertia as its 3 x 3 blocks. A
Pluecker transform is a rotation `E` of the axes and a shift `r` of the point, applied one after the other.

Accelerations are the classical ones, of the body's point at the origin (sec. 2.11): so linear velocities drop
out of the equations of motion, and the free joint's acceleration equals MuJoCo's.
Zeros that are NumPy constants cost nothing, since the scalar kernel folds them.
"""

from __future__ import annotations

import dataclasses
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

Array: TypeAlias = jax.Array | np.ndarray
Scalar: TypeAlias = jax.Array | np.ndarray | np.float64 | float

ZERO = np.zeros(3)
EYE = np.eye(3)
_UPPER = np.triu(np.ones((3, 3), bool))
_CROSS = np.array(  # r x m = (_CROSS @ r) @ m
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    ]
)


def skew(r: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """The matrix r x of the cross product with `r` (3,), shape (3, 3)."""
    return _CROSS @ r


def cross(a: Float[Array, " 3"], b: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """The cross product a x b, shape (3,)."""
    return skew(a) @ b


def symmetric(A: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """A symmetric matrix (3, 3) with its lower triangle copied from the upper one.

    So the scalar kernel computes the upper triangle only.
    """
    return np.where(_UPPER, A, A.T) if isinstance(A, np.ndarray) else jnp.where(_UPPER, A, A.T)


@dataclasses.dataclass(frozen=True)
class MotionVector:
    """A spatial velocity or (classical) acceleration.

    `angular` is in rad/s or rad/s2, `linear`, of the point, in m/s or m/s2.
    """

    angular: Float[Array, " 3"]
    linear: Float[Array, " 3"]

    def __add__(self, other: MotionVector) -> MotionVector:
        return MotionVector(self.angular + other.angular, self.linear + other.linear)

    def __mul__(self, rate: Scalar) -> MotionVector:
        return MotionVector(self.angular * rate, self.linear * rate)

    def dot(self, force: ForceVector) -> Scalar:
        """The scalar product with a force: its power (W), if this is a velocity."""
        return self.angular @ force.couple + self.linear @ force.linear

    def shifted(self, r: Float[Array, " 3"]) -> MotionVector:
        """The motion of the body's point at `r` (3,) from this one (table 2.2)."""
        return MotionVector(self.angular, self.linear + cross(self.angular, r))

    def rotated(self, E: Float[Array, "3 3"] | None) -> MotionVector:
        """The motion in other axes: `E` (3, 3) transforms coordinates into these; None: no rotation."""
        return self if E is None else MotionVector(E @ self.angular, E @ self.linear)


@dataclasses.dataclass(frozen=True)
class ForceVector:
    """A spatial force: its `couple` about the point (N m), and `linear` (N), each (3,)."""

    couple: Float[Array, " 3"]
    linear: Float[Array, " 3"]

    def __add__(self, other: ForceVector) -> ForceVector:
        return ForceVector(self.couple + other.couple, self.linear + other.linear)

    def __sub__(self, other: ForceVector) -> ForceVector:
        return ForceVector(self.couple - other.couple, self.linear - other.linear)

    def __mul__(self, factor: Scalar) -> ForceVector:
        return ForceVector(self.couple * factor, self.linear * factor)

    def moved_from(self, r: Float[Array, " 3"]) -> ForceVector:
        """The force about the point from which this one is at `r` (3,) (table 2.2)."""
        return ForceVector(self.couple + cross(r, self.linear), self.linear)

    def rotated(self, E: Float[Array, "3 3"] | None) -> ForceVector:
        """The force in other axes, as for a motion."""
        return self if E is None else ForceVector(E @ self.couple, E @ self.linear)


@dataclasses.dataclass(frozen=True)
class Inertia:
    """A spatial inertia [[I, H], [H^T, M]], rigid or articulated (sec. 2.13, 7.1), blocks (3, 3).

    `I` (kg m2) and `M` (kg) are symmetric, `H` is in kg m; for a rigid body H = m c x and M = m 1.
    """

    I: Float[Array, "3 3"]  # noqa: E741 - the book's name
    H: Float[Array, "3 3"]
    M: Float[Array, "3 3"]

    def __add__(self, other: Inertia) -> Inertia:
        return Inertia(self.I + other.I, self.H + other.H, self.M + other.M)

    def __matmul__(self, motion: MotionVector) -> ForceVector:
        w, v = motion.angular, motion.linear
        return ForceVector(self.I @ w + self.H @ v, self.H.T @ w + self.M @ v)

    def without(self, U: ForceVector, per_D: Scalar) -> Inertia:
        """The articulated inertia I - U D^-1 U^T across a joint; `per_D` is D^-1 (sec. 7.3)."""
        n, f = U.couple, U.linear
        n_D, f_D = n * per_D, f * per_D
        return Inertia(
            symmetric(self.I - n_D[:, None] * n[None, :]),
            self.H - n_D[:, None] * f[None, :],
            symmetric(self.M - f_D[:, None] * f[None, :]),
        )

    def freed_along(self, S: MotionVector) -> Inertia:
        """The inertia with exact zeros along `S`, a coordinate axis: I^a S = 0 up to rounding."""
        w, v = 1.0 - np.abs(S.angular), 1.0 - np.abs(S.linear)
        return Inertia(self.I * np.outer(w, w), self.H * np.outer(w, v), self.M * np.outer(v, v))

    def rotated(self, E: Float[Array, "3 3"] | None) -> Inertia:
        """The inertia in other axes, as for a motion: E I E^T block by block."""
        if E is None:
            return self
        return Inertia(turned(E, self.I), E @ self.H @ E.T, turned(E, self.M))

    def moved_from(self, r: Float[Array, " 3"]) -> Inertia:
        """The inertia about the point from which this one is at `r` (3,) (sec. 2.13)."""
        rx = skew(r)
        H = self.H + rx @ self.M
        return Inertia(symmetric(self.I + rx @ self.H.T - H @ rx), H, self.M)


def turned(E: Float[Array, "3 3"], A: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """The matrix E A E^T of a symmetric matrix `A` (3, 3)."""
    return A if E is EYE else symmetric(E @ A @ E.T)


def rotation_about(axis: Float[np.ndarray, " 3"], angle: Scalar) -> Float[Array, "3 3"]:
    """The rotation matrix (3, 3) by `angle` (rad) about a constant unit `axis` (3,).

    For a coordinate axis, zeros and ones of the matrix are constants.
    """
    along = np.outer(axis, axis)
    return along + jnp.cos(angle) * (EYE - along) + jnp.sin(angle) * skew(axis)


def rotation_of(quaternion: Float[Array, " 4"]) -> Float[Array, "3 3"]:
    """The rotation matrix (3, 3) of a quaternion (w, x, y, z) of any norm (eq. 4.12)."""
    w, x, y, z = (quaternion[k] for k in range(4))
    s = 2.0 / (w * w + x * x + y * y + z * z)
    xs, ys, zs = x * s, y * s, z * s
    return jnp.array(
        [
            [1.0 - (y * ys + z * zs), x * ys - w * zs, x * zs + w * ys],
            [x * ys + w * zs, 1.0 - (x * xs + z * zs), y * zs - w * xs],
            [x * zs - w * ys, y * zs + w * xs, 1.0 - (x * xs + y * ys)],
        ]
    )


def quaternion_product(p: Float[Array, " 4"], q: Float[Array, " 4"]) -> Float[Array, " 4"]:
    """The quaternion (w, x, y, z) of the rotation `q` followed, in its parent's frame, by `p`."""
    w, u, x, v = p[0], p[1:], q[0], q[1:]
    return jnp.concatenate([(w * x - u @ v)[None], w * v + x * u + cross(u, v)])


def quaternion_exponential(turn: Float[Array, " 3"]) -> Float[Array, " 4"]:
    """The quaternion (w, x, y, z) of the rotation vector `turn` (3,), rad; smooth at zero."""
    square = turn @ turn
    tiny = square < 1e-12
    angle = jnp.sqrt(jnp.where(tiny, 1.0, square))
    half_sinc = jnp.where(tiny, 0.5 - square / 48.0, jnp.sin(0.5 * angle) / angle)
    cosine = jnp.where(tiny, 1.0 - square / 8.0, jnp.cos(0.5 * angle))
    return jnp.concatenate([cosine[None], half_sinc * turn])


def solve_positive(A: Float[Array, "n n"], b: Float[Array, " n"]) -> Float[Array, " n"]:
    """The solution x of A x = b for a small symmetric positive definite `A` (n, n), by L D L^T.

    The loops are unrolled and read the upper triangle only, without linear algebra routines.
    """
    upper: list[Array] = []
    scaled: list[Scalar] = []
    for _ in range(b.shape[0] - 1):
        row, per_pivot = A[0, 1:], 1.0 / A[0, 0]
        factor = row * per_pivot
        upper.append(factor)
        scaled.append(b[0] * per_pivot)
        A = A[1:, 1:] - factor[:, None] * row[None, :]
        b = b[1:] - factor * b[0]
    x = b / A[0]
    for factor, value in zip(reversed(upper), reversed(scaled), strict=True):
        x = jnp.concatenate([jnp.asarray(value - factor @ x)[None], x])
    return x
