"""A map given as a function, for the same searches and continuations as a return map."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from gaitsweep import near_miss
from gaitsweep.contract import Quantity, State
from gaitsweep.engine.poincare.map_derivatives import FollowedMap
from gaitsweep.engine.poincare.maps import (
    MIN_SCALE,
    Coordinates,
    Events,
    Image,
    ManyCoordinates,
    Points,
    Values,
    column,
    group_of,
)
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.errors import ArgumentError


@dataclasses.dataclass(frozen=True)
class PlainMap(FollowedMap):
    """A map of R^n.

    Args:
        function: `(values, at) -> image` of one point (n,) in JAX, `values` the parameters by name.
        names: names of the coordinates.
        defaults: (name, number) of each parameter.
        angles: the coordinates that are angles, rad.
        invariants: (name, function `(values, at) -> number`) of each conserved quantity.
        symmetries: (name, function `(values, at) -> at`) of each symmetry, which commutes with the map.
    """

    function: Callable[[Mapping[str, Any], Coordinates], Coordinates]
    names: tuple[str, ...]
    defaults: tuple[tuple[str, float], ...] = ()
    angles: tuple[str, ...] = ()
    invariants: tuple[tuple[str, Callable[..., Float[Array, ""]]], ...] = ()
    symmetries: tuple[tuple[str, Callable[..., Coordinates]], ...] = ()

    @property
    def functions(self) -> tuple[Callable[..., Any], ...]:
        """Its functions, whose content decides the programs (`cached_by_content`)."""
        return self.function, *(function for _, function in (*self.invariants, *self.symmetries))

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return tuple(Quantity(name, "", name, circular=name in self.angles) for name in self.names)

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        return tuple(Quantity(name, "", name) for name, _ in self.invariants)

    def points(self, at: ArrayLike) -> Points:
        """Points at these coordinates (n, size)."""
        return Points(np.asarray(at, np.float64), None)

    def follow(self, values: Values, at: Coordinates, modes: State) -> Image:
        image = self.function(values, at)
        sound = jnp.all(jnp.isfinite(image))
        status = jnp.where(sound, ReturnStatus.crossed, ReturnStatus.lost).astype(jnp.int32)
        return image, modes, status, {name: image[k] for k, name in enumerate(self.names)}

    def conserved_values(self, values: Values, at: Coordinates) -> Float[Array, " conserved"]:
        return jnp.stack([jnp.zeros(()), *(function(values, at) for _, function in self.invariants)])[1:]

    def complete(self, values: Values, n: int) -> dict[str, Float[np.ndarray, " points"]]:
        defaults = dict(self.defaults)
        for name in values:
            if defaults and name not in defaults:
                near = near_miss.suggestion(name, defaults)
                raise ArgumentError(f"{name} is not a parameter of the map{near}")
        return {name: column(name, value, n) for name, value in {**defaults, **values}.items()}

    def sizes(self, at: ManyCoordinates) -> ManyCoordinates:
        return MIN_SCALE + np.abs(at)

    @property
    def durations(self) -> tuple[str, ...]:
        return ()

    def mirrored(self, points: Points, values: Values) -> dict[str, Points]:
        complete = self.complete(values, len(points))
        first = {name: column[0] for name, column in complete.items()}
        symmetries = group_of(dict(self.symmetries), first, jnp.zeros(len(self.names)), lambda image: image)
        return {
            name: Points(np.asarray(jax.vmap(function)(complete, points.at)), points.modes)
            for name, function in symmetries.items()
        }

    def events(self, points: Points, values: Values) -> list[Events]:
        return [[] for _ in range(len(points))]

    def refined(self) -> None:
        return None
