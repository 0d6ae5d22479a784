"""Forces from outside on the links of an articulated tree: of the ground on a foot, of a push."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import TypeAlias

import jax

from gaitsweep.dynamics.spatial import Array, Force, cross
from gaitsweep.dynamics.tree_kinematics import Place


@partial(jax.tree_util.register_dataclass, data_fields=["point", "force"], meta_fields=["link"])
@dataclasses.dataclass(frozen=True)
class PointForce:
    """A force on a point of a body.

    `link` its number; `point` (3,) m, in the body's frame; `force` (3,) N, in the world's axes.
    """

    link: int
    point: Array
    force: Array

    def on(self, place: Place) -> Force:
        """The spatial force about the link's point, in the link's axes."""
        force = place.frame.T @ self.force
        return Force(cross(place.turn @ (self.point - place.anchor), force), force)


@partial(jax.tree_util.register_dataclass, data_fields=["couple", "force"], meta_fields=["link"])
@dataclasses.dataclass(frozen=True)
class WorldForce:
    """A spatial force in the world's coordinates.

    `link` its number; `couple` (3,) N m, about the world's origin; `force` (3,) N.
    """

    link: int
    couple: Array
    force: Array

    def on(self, place: Place) -> Force:
        """The spatial force about the link's point, in the link's axes."""
        couple = self.couple - cross(place.point, self.force)
        return Force(place.frame.T @ couple, place.frame.T @ self.force)


External: TypeAlias = Sequence[PointForce | WorldForce]
