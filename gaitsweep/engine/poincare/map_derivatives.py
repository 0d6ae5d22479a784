"""Derivatives of a map by its points and a parameter, in programs compiled for batches of points.

`LevelMap` makes a conserved quantity a parameter, so that families of fixed points are branches over it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaitsweep.compiling_threads import compiling
from gaitsweep.contract import State
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.devices import refuse_fork
from gaitsweep.engine.poincare.maps import (
    Coordinates,
    DerivedMap,
    Events,
    Image,
    Map,
    MapEvaluation,
    Points,
    Values,
    column,
)
from gaitsweep.errors import ArgumentError

# Batch sizes for which programs are compiled. A larger batch is split; a smaller one is filled up to the next
# size by repeating its last point, which costs kernels nothing.
BATCH_SIZES = (1, 8, 64, 1024)


class FollowedMap(Map):
    """A map whose images are those of `follow`, by programs that are compiled for batches of points."""

    def _evaluated(
        self, points: Points, values: Values, over: str | None, *, derivatives: bool
    ) -> MapEvaluation:
        refuse_fork()
        program = _program(self, over, derivatives=derivatives)
        outputs = in_batches(program, points, self.complete(values, len(points)))
        image, state, status, observed, conserved, slopes = outputs
        size = points.at.shape[1]
        return MapEvaluation(
            points=Points(image, state),
            status=status,
            observed=observed,
            conserved_values=conserved,
            jacobian=slopes[:, :size, :size],
            d_parameter=slopes[:, :size, size:].sum(axis=2),
            conserved_jacobian=slopes[:, size:, :size],
            conserved_d_parameter=slopes[:, size:, size:].sum(axis=2),
        )


def in_batches(
    program: Callable[..., Any],
    points: Points,
    parameters: Mapping[str, Float[np.ndarray, " points"]],
    sizes: Sequence[int] = BATCH_SIZES,
) -> Any:
    """The outputs of a program for points, one after the other.

    Args:
        program: the function `(parameters, at, modes)` of a batch of points.
        points: the points, one at least.
        parameters: parameters by name, (n,) each.
        sizes: the sizes of batches for which the program is compiled, the largest last.

    Raises:
        ArgumentError: there are no points.
    """
    if not len(points):
        raise ArgumentError("A map is evaluated at no points, but needs one point or more.")
    batches = []
    for first in range(0, len(points), sizes[-1]):
        count = min(sizes[-1], len(points) - first)
        width = next(size for size in sizes if size >= count)
        order = np.minimum(first + np.arange(width), first + count - 1)
        batch = points[order]
        columns = {name: column[order] for name, column in parameters.items()}
        outputs = program(columns, batch.at, batch.modes)
        batches.append(jax.tree.map(lambda leaf, n=count: np.asarray(leaf)[:n], outputs))
    return jax.tree.map(lambda *parts: np.concatenate(parts), *batches)


def over_points(function: Callable[..., Any]) -> Callable[..., Any]:
    """The program that evaluates a function of one point for many, whose arrays have them as first axis."""
    return jax.jit(jax.vmap(function))


@cached_by_content(maxsize=64)
def _program(mapping: Map, over: str | None, *, derivatives: bool) -> Callable[..., Any]:
    """The map of a batch of points and its derivatives, compiled for each batch size."""

    def of_point(values: Any, at: Coordinates, modes: State) -> Any:
        size = at.size

        def image_of(variables: Float[Array, " variables"]) -> Any:
            parameters = values if over is None else {**values, over: variables[size]}
            image, state, status, observed = mapping.follow(parameters, variables[:size], modes)
            conserved = mapping.conserved_values(parameters, variables[:size])
            return jnp.concatenate([image, conserved]), (image, state, status, observed, conserved)

        variables = at if over is None else jnp.concatenate([at, values[over][None]])
        if derivatives:
            slopes, outputs = jax.jacfwd(image_of, has_aux=True)(variables)
        else:
            _, outputs = image_of(variables)
            gradients = jax.jacfwd(lambda at: mapping.conserved_values(values, at))(at)
            slopes = jnp.concatenate([jnp.full((size, size), jnp.nan), gradients])
        return (*outputs, slopes)

    program = over_points(of_point)
    compiled: set[int] = set()

    def of_batch(values: Any, at: Float[np.ndarray, "points coordinates"], modes: State) -> Any:
        if len(at) in compiled:
            return program(values, at, modes)
        with compiling():
            outputs = jax.block_until_ready(program(values, at, modes))
        compiled.add(len(at))
        return outputs

    return of_batch


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
        level = column(self.name, values[self.name], n)
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
