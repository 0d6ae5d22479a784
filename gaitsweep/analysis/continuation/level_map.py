"""A map whose conserved quantity is a parameter, so that a family of fixed points is followed along it."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Array, Float

from gaitsweep.contract import State
from gaitsweep.engine.poincare.maps import Coordinates, DerivedMap, Events, FollowedMap, Image, Points, Values


@dataclasses.dataclass(frozen=True)
class LevelMap(DerivedMap, FollowedMap):
    """A map with one more parameter, the value of a quantity that it conserves.

    Of the conserved quantity `name` the parameter is subtracted: a search that holds it at zero is on the
    parameter's level set.

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
        place = [quantity.name for quantity in self.conserved].index(self.name)
        return self.base.conserved_values(self._of_base(values), at).at[place].add(-values[self.name])

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
