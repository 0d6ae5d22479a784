"""Forces from outside on the links of an articulated tree: of the ground on a foot, of a push."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import TypeAlias

import jax

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


@partial(jax.tree_util.register_dataclass, data_fields=["point", "force"], meta_fields=["link"])
@dataclasses.dataclass(frozen=True)
class PointForce:
    """A force on a point of a body.

    `link` its number; `point` (3,) m, in the body's frame; `force` (3,) N, in the world's axes.
    """

    link: int
    point: Array
    force: Array

    def on(self, place: Place) -> ForceVector:
        """The spatial force about the link's point, in the link's axes."""
        force = place.frame.T @ self.force
        return ForceVector(cross(place.turn @ (self.point - place.anchor), force), force)


@partial(jax.tree_util.register_dataclass, data_fields=["couple", "force"], meta_fields=["link"])
@dataclasses.dataclass(frozen=True)
class WorldForce:
    """A spatial force in the world's coordinates.

    `link` its number; `couple` (3,) N m, about the world's origin; `force` (3,) N.
    """

    link: int
    couple: Array
    force: Array

    def on(self, place: Place) -> ForceVector:
        """The spatial force about the link's point, in the link's axes."""
        couple = self.couple - cross(place.point, self.force)
        return ForceVector(place.frame.T @ couple, place.frame.T @ self.force)


@partial(jax.tree_util.register_dataclass, data_fields=["at", "force", "yields"], meta_fields=["link"])
@dataclasses.dataclass(frozen=True)
class YieldingForce:
    """A force that is the less the more its point accelerates: `force` - `yields` times the acceleration.

    So does a damper at the end of a step of dt: with its coefficient c, `yields` is dt c.

    `link` its number; `at` (3,) m, the point in the world; `force` (3,) N and `yields` (3,) kg along the
    world's axes.
    """

    link: int
    at: Array
    force: Array
    yields: Array

    def on(self, place: Place) -> ForceVector:
        """The spatial force of a point at rest, about the link's point, in the link's axes."""
        force = place.frame.T @ self.force
        return ForceVector(cross(self._lever(place), force), force)

    def inertia(self, place: Place) -> Inertia:
        """What yields, as the inertia about the link's point of a mass at the force's, by axis."""
        frame = place.frame.T
        M = turned(frame, EYE * self.yields[:, None])
        rx = skew(self._lever(place))
        H = rx @ M
        return Inertia(symmetric(H @ rx.T), H, M)

    def at_rest(self, place: Place, w: Array, gravity: Array) -> MotionVector:
        """The acceleration of the force's point where its link's joints and its point do not accelerate.

        Args:
            place: where the link is.
            w: its angular velocity (3,) rad/s, in its axes.
            gravity: what the algorithm leaves out of accelerations, (3,) m/s2.
        """
        # as that of the link's point, from which `inertia` takes it
        return MotionVector(ZERO, cross(w, cross(w, self._lever(place))) + place.frame.T @ gravity)

    def _lever(self, place: Place) -> Array:
        return place.frame.T @ (self.at - place.base) - place.reach


External: TypeAlias = Sequence[PointForce | WorldForce | YieldingForce]
