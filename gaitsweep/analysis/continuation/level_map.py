"""A map whose conserved quantity is a parameter, so that families of fixed points are branches over it."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Array, Float

from gaitsweep.contract import State
from gaitsweep.engine.poincare.map_derivatives import FollowedMap
from gaitsweep.engine.poincare.maps import Coordinates, DerivedMap, Events, Image, Points, Values


@dataclasses.dataclass(frozen=True)
class LevelMap(DerivedMap, FollowedMap):
    """A map with one more parameter, the value of a quantity that it conserves.

    The family of fixed points on the level sets of that quantity is then a branch over this parameter. The
    parameter is subtracted from the quantity, so a search that holds it at zero is on the level set.

    Args:
        base: the map.
        name: the conserved quantity.
    """

    name: str

    def follow(self, values: Values, at: Coordinates, modes: State) -> Image:
        image, state, status, observed = self.base.follow(self._of_base(values), at, modes)
        # an observable of that name would stand beside the parameter
        return image, state, status, {name: v for name, v in observed.items() if name != self.name}

    def conserved_values(self, values: Values, at: Coordinates) -> Float[Array, " conserved"]:
        index = [quantity.name for quantity in self.conserved].index(self.name)
        return self.base.conserved_values(self._of_base(values), at).at[index].add(-values[self.name])

    def complete(self, values: Values, n: int) -> dict[str, Float[np.ndarray, " points"]]:
        level = np.broadcast_to(np.asarray(values[self.name], np.float64), (n,)).copy()
        return {**self.base.complete(self._of_base(values), n), self.name: level}

    def refined(self) -> LevelMap | None:
        refined = self.base.refined()
        return None if refined is None else LevelMap(refined, self.name)

    def mirrored(self, points: Points, values: Values) -> dict[str, Points]:
        return self.base.mirrored(points, self._of_base(values))

    def events(self, points: Points, values: Values) -> list[Events]:
        return self.base.events(points, self._of_base(values))

    def _of_base(self, values: Values) -> Values:
        return {name: value for name, value in values.items() if name != self.name}
