"""External forces on the links of an articulated tree, such as ground contact or a push."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeAlias

import jax
from jaxtyping import Float

from gaitsweep.dynamics.tree.kinematics import Place
from gaitsweep.dynamics.tree.spatial import (
    EYE,
    ZERO,
    Array,
    ForceVector,
    Inertia,
    MotionVector,
    cross,
    skew,
    symmetric,
    turned,
)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PointForce:
    """A force on a point of a body.

    `link` is the link's number; `point` (3,) m is in the body's frame; `force` (3,) N in the world's axes.
    """

    link: int = dataclasses.field(metadata={"static": True})
    point: Float[Array, " 3"]
    force: Float[Array, " 3"]

    def on(self, place: Place) -> ForceVector:
        """The spatial force about the link's point, in the link's axes."""
        force = place.frame.T @ self.force
        return ForceVector(cross(place.turn @ (self.point - place.anchor), force), force)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class YieldingForce:
    """A force that decreases with the acceleration of its point: `force` - `yields` times the acceleration.

    An implicit damper is such a force: with the coefficient c and a step of dt, `yields` is dt c.

    `link` is the link's number; `at` (3,) m is the point in the world; `force` (3,) N and `yields` (3,) kg
    are along the world's axes.
    """

    link: int = dataclasses.field(metadata={"static": True})
    at: Float[Array, " 3"]
    force: Float[Array, " 3"]
    yields: Float[Array, " 3"]

    def on(self, place: Place) -> ForceVector:
        """The spatial force at zero acceleration, about the link's point, in the link's axes."""
        force = place.frame.T @ self.force
        return ForceVector(cross(self._lever(place), force), force)

    def inertia(self, place: Place) -> Inertia:
        """`yields` as a spatial inertia about the link's point: a point mass that differs by axis."""
        frame = place.frame.T
        M = turned(frame, EYE * self.yields[:, None])
        rx = skew(self._lever(place))
        H = rx @ M
        return Inertia(symmetric(H @ rx.T), H, M)

    def at_rest(self, place: Place, w: Float[Array, " 3"], gravity: Float[Array, " 3"]) -> MotionVector:
        """The acceleration of the force's point if its link's point and axes do not accelerate.

        Args:
            place: the link's place.
            w: its angular velocity (3,) rad/s, in its axes.
            gravity: acceleration (3,) m/s2, which the algorithm subtracts from accelerations.
        """
        # given as an acceleration of the link's point, as `inertia` expects
        return MotionVector(ZERO, cross(w, cross(w, self._lever(place))) + place.frame.T @ gravity)

    def _lever(self, place: Place) -> Array:
        return place.frame.T @ (self.at - place.base) - place.reach


External: TypeAlias = Sequence[PointForce | YieldingForce]
