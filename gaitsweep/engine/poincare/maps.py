"""Discrete maps on a space of coordinates: the abstract map, its batches, its iterates and its symmetries.

`map_derivatives.py` computes the images and derivatives of a batch.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Real

from gaitsweep.contract import Params, Quantity, State
from gaitsweep.engine.carry import Integer
from gaitsweep.engine.leaves import float_leaves, with_float_leaves
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.errors import ArgumentError

POINTS_SHOWN = 3  # in a `repr`
MIN_SCALE = 0.1  # least scale of a coordinate (in its unit); larger coordinates are scaled by their magnitude

Values = Mapping[str, Any]  # a parameter's name: a number, or one for each point (n,)
Events = list[tuple[float, str]]  # the time (s) and the name of each event, in their order
Coordinates = Float[Array, " coordinates"]
# the image of one point: its coordinates, its state, its `ReturnStatus`, its observables
Image = tuple[Coordinates, State, Integer, dict[str, Real[Array, ""]]]
# coordinates of many points
ManyCoordinates = Float[np.ndarray, "... coordinates"]


class Batch:
    """A JAX pytree whose arrays have n points or images as their first axis."""

    def __getitem__(self, which: Any) -> Self:
        return jax.tree.map(lambda leaf: leaf[which], self)

    @classmethod
    def joined(cls, several: Sequence[Self]) -> Self:
        """The elements of several batches, one after the other."""
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *several)

    def merged(self, which: Int[np.ndarray, " some"], others: Self) -> Self:
        """The batch with some elements replaced.

        Args:
            which: the indices (m,) of these elements.
            others: the m new elements.
        """

        def replaced(values: np.ndarray, new: np.ndarray) -> np.ndarray:
            merged = np.array(values)
            merged[which] = new
            return merged

        return jax.tree.map(replaced, self, others)


def format_points(at: Any) -> str:
    """Format the first of some points (n, size), for a short `repr`."""
    texts = []
    for point in at[:POINTS_SHOWN]:
        coordinates = ", ".join(f"{coordinate:.6g}" for coordinate in point)
        texts.append(f"[{coordinates}]")
    if len(at) > POINTS_SHOWN:
        texts.append("...")
    return ", ".join(texts)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Points(Batch):
    """A batch of points.

    Args:
        at: their coordinates (n, size).
        modes: states with their discrete modes, the leaves (n, ...).
    """

    at: Float[np.ndarray, "points coordinates"]
    modes: State

    def __len__(self) -> int:
        return len(self.at)

    def __repr__(self) -> str:
        return f"Points({len(self)}: {format_points(self.at)})"


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class MapEvaluation(Batch):
    """The images of n points under a map, and their derivatives.

    Attributes:
        points: the images.
        status: their `ReturnStatus` (n,).
        observed: the observables (n,) by name.
        conserved_values: the conserved quantities (n, k) at the points themselves.
        jacobian: the derivative (n, size, size) of the images by the points' coordinates; NaN if it is not
            requested.
        d_parameter: the derivative (n, size) of the images by a parameter; 0 if it is not requested.
        conserved_jacobian: the derivative (n, k, size) of the conserved quantities by the coordinates.
        conserved_d_parameter: their derivative (n, k) by the parameter; 0 if it is not requested.
    """

    points: Points
    status: Int[np.ndarray, " points"]
    observed: dict[str, Real[np.ndarray, " points"]]
    conserved_values: Float[np.ndarray, "points conserved"]
    jacobian: Float[np.ndarray, "points coordinates coordinates"]
    d_parameter: Float[np.ndarray, "points coordinates"]
    conserved_jacobian: Float[np.ndarray, "points conserved coordinates"]
    conserved_d_parameter: Float[np.ndarray, "points conserved"]

    @property
    def sound(self) -> Bool[np.ndarray, " points"]:
        """Mask of the points at which the map is defined, (n,)."""
        return self.status == ReturnStatus.crossed

    def __repr__(self) -> str:
        return f"MapEvaluation({np.count_nonzero(self.sound)} of {len(self.points)} defined)"


class Map(abc.ABC):
    """A map of a space of coordinates into itself, with parameters; hashable, since programs are cached."""

    @property
    @abc.abstractmethod
    def coordinates(self) -> tuple[Quantity, ...]:
        """The coordinates, in order; angles are marked circular."""

    @property
    @abc.abstractmethod
    def conserved(self) -> tuple[Quantity, ...]:
        """The quantities that the map conserves."""

    @abc.abstractmethod
    def sizes(self, at: ManyCoordinates) -> ManyCoordinates:
        """The scale of each of some coordinates (..., size): a least one plus its magnitude."""

    @abc.abstractmethod
    def follow(self, values: Values, at: Coordinates, modes: State) -> Image:
        """The image of one point, in JAX.

        Args:
            values: parameters by name, one scalar each.
            at: the coordinates (size,) of the point.
            modes: a state with its discrete modes.
        """

    @abc.abstractmethod
    def conserved_values(self, values: Values, at: Coordinates) -> Float[Array, " conserved"]:
        """The values (k,) of the `conserved` quantities at one point, in JAX.

        Args:
            values: parameters by name, one scalar each.
            at: the coordinates (size,) of the point.
        """

    @abc.abstractmethod
    def complete(self, values: Values, n: int) -> dict[str, Float[np.ndarray, " points"]]:
        """All parameters that `follow` reads, (n,) each; those without a value have their defaults.

        Args:
            values: parameters by name, numbers or (n,).
            n: the number of points.

        Raises:
            ArgumentError: a name is unknown, or it has another number of values.
        """

    @abc.abstractmethod
    def refined(self) -> Map | None:
        """The same map with a finer integration; None where it has no numerical error."""

    @property
    @abc.abstractmethod
    def durations(self) -> tuple[str, ...]:
        """The observables that are durations of an iteration: those of several iterations add up."""

    @abc.abstractmethod
    def mirrored(self, points: Points, values: Values) -> dict[str, Points]:
        """Points of the images of these points' orbits under the symmetries, by name.

        Args:
            points: the points.
            values: parameters by name, numbers or (n,).
        """

    @abc.abstractmethod
    def events(self, points: Points, values: Values) -> list[Events]:
        """The events between each of n points and its image, in their order.

        Args:
            points: the points.
            values: parameters by name, numbers or (n,).
        """

    def iterated(self, count: int) -> Map:
        """The map that applies this one a number of times, 1 or more.

        Raises:
            ArgumentError: the number is below 1.
        """
        if count < 1:
            raise ArgumentError(f"A map is applied {count} times, but must be applied once or more.")
        return self if count == 1 else IteratedMap(self, count)

    @functools.cached_property
    def circular(self) -> Bool[np.ndarray, " coordinates"]:
        """Mask of the coordinates that are angles, (size,)."""
        return np.array([quantity.circular for quantity in self.coordinates])

    def difference(self, a: ManyCoordinates, b: ManyCoordinates) -> ManyCoordinates:
        """The difference a - b of coordinates (..., size); differences of angles are wrapped."""
        return wrap_difference(a - b, self.circular)

    def distance(self, a: ManyCoordinates, b: ManyCoordinates) -> Float[np.ndarray, " ..."]:
        """The largest difference of a coordinate, relative to its scale; inf where a difference is NaN."""
        share = np.abs(self.difference(a, b)) / self.sizes(a)
        return np.nan_to_num(np.max(share, axis=-1), nan=np.inf)

    def images(self, points: Points, values: Values) -> MapEvaluation:
        """The images of n points; `values` are parameters by name, numbers or (n,)."""
        return self._evaluated(points, values, None, derivatives=False)

    def linearised(self, points: Points, values: Values, over: str | None = None) -> MapEvaluation:
        """The images of n points with their derivatives.

        Args:
            points: the points.
            values: parameters by name, numbers or (n,).
            over: a parameter by which the images are differentiated as well; None: by coordinates alone.
        """
        return self._evaluated(points, values, over, derivatives=True)

    @abc.abstractmethod
    def _evaluated(
        self, points: Points, values: Values, over: str | None, *, derivatives: bool
    ) -> MapEvaluation:
        """The images of many points; arguments as of `linearised`, and whether derivatives are computed."""


@dataclasses.dataclass(frozen=True)
class DerivedMap(Map):
    """A map that is made of another one, on the same space.

    Args:
        base: the other map.
    """

    base: Map

    @property
    def model(self) -> Any:
        """The model of the other map, which decides the programs too (`cached_by_content`); None without."""
        return getattr(self.base, "model", None)

    @property
    def functions(self) -> tuple[Callable[..., Any], ...]:
        """The functions of a map without a model, which decide the programs likewise."""
        return getattr(self.base, "functions", ())

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return self.base.coordinates

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        return self.base.conserved

    def sizes(self, at: ManyCoordinates) -> ManyCoordinates:
        return self.base.sizes(at)

    @property
    def durations(self) -> tuple[str, ...]:
        return self.base.durations


@dataclasses.dataclass(frozen=True)
class IteratedMap(DerivedMap):
    """A map applied several times; it has the programs of the map, and derivatives by the chain rule.

    Args:
        base: the map.
        count: the number of its applications.
    """

    count: int

    def follow(self, values: Values, at: Coordinates, modes: State) -> Image:
        image, modes, status, observed = self.base.follow(values, at, modes)
        for _ in range(self.count - 1):
            passed = {name: observed[name] for name in self.durations}
            image, modes, later, observed = self.base.follow(values, image, modes)
            observed |= {name: observed[name] + duration for name, duration in passed.items()}
            status = jnp.where(status == ReturnStatus.crossed, later, status)
        return image, modes, status, observed

    def conserved_values(self, values: Values, at: Coordinates) -> Float[Array, " conserved"]:
        return self.base.conserved_values(values, at)

    def complete(self, values: Values, n: int) -> dict[str, Float[np.ndarray, " points"]]:
        return self.base.complete(values, n)

    def refined(self) -> Map | None:
        refined = self.base.refined()
        return None if refined is None else refined.iterated(self.count)

    def mirrored(self, points: Points, values: Values) -> dict[str, Points]:
        return self.base.mirrored(points, values)

    def events(self, points: Points, values: Values) -> list[Events]:
        values = self.base.complete(values, len(points))
        events: list[Events] = [[] for _ in range(len(points))]
        starts = np.zeros(len(points))
        for _ in range(self.count):
            events_of_iteration = self.base.events(points, values)
            for events_of_point, later, start in zip(events, events_of_iteration, starts, strict=True):
                events_of_point += [(start + t, name) for t, name in later]
            images = self.base.images(points, values)
            points = images.points
            starts = starts + images.observed.get("time", 0.0)
        return events

    def _evaluated(
        self, points: Points, values: Values, over: str | None, *, derivatives: bool
    ) -> MapEvaluation:
        values = self.base.complete(values, len(points))
        total = self.base._evaluated(points, values, over, derivatives=derivatives)
        for _ in range(self.count - 1):
            rows = np.flatnonzero(total.sound)
            if not rows.size:
                break
            before = total[rows]
            at = {name: column[rows] for name, column in values.items()}
            after = self.base._evaluated(before.points, at, over, derivatives=derivatives)
            summed = {name: before.observed[name] + after.observed[name] for name in self.durations}
            chained = dataclasses.replace(
                before,
                points=after.points,
                status=after.status,
                observed={**after.observed, **summed},
                jacobian=after.jacobian @ before.jacobian,
                d_parameter=(after.jacobian @ before.d_parameter[:, :, None])[:, :, 0] + after.d_parameter,
            )
            total = total.merged(rows, chained)
        return total


def column(name: str, value: Any, n: int) -> Float[np.ndarray, " points"]:
    """A number, or one for each of n points, as a column (n,); raises ArgumentError for other lengths."""
    column = np.asarray(value, np.float64)
    if column.shape not in ((), (1,), (n,)):
        raise ArgumentError(f"{name} has {column.size} values, but there are {n} points.")
    return np.broadcast_to(column, (n,)).copy()


def wrap_difference(
    difference: ManyCoordinates, circular: Bool[np.ndarray, " coordinates"]
) -> ManyCoordinates:
    """Differences of coordinates, of which those of angles (rad) are wrapped to [-pi, pi].

    Args:
        difference: the differences (..., size).
        circular: mask of the coordinates that are angles.
    """
    if not circular.any():
        return difference
    with np.errstate(invalid="ignore"):  # an infinite difference stays one
        turns = np.round(difference / (2.0 * np.pi))
        return np.where(circular, difference - 2.0 * np.pi * turns, difference)


Action: TypeAlias = "Callable[[Params, State], State]"
# Largest number of elements besides the identity.
MAX_ELEMENTS = 47
# Seed of the state whose images tell the elements apart.
SEED = 20
# Images of one state are the same if they differ by less.
SAME_IMAGE = 1e-9


def group_of(
    generators: Mapping[str, Action],
    params: Params,
    state: State,
    read: Callable[[State], Float[Array, " coordinates"]],
) -> dict[str, Action]:
    """The elements of the group besides the identity, by name: "a", "b", "a after b", ...

    Args:
        generators: the symmetries that a model names.
        params: parameters of the model.
        state: a state; combinations with the same image of a random state of its shape are one element.
        read: returns the numbers of a state that are compared; others may be a memory of the past.

    Raises:
        ArgumentError: the symmetries generate more than `MAX_ELEMENTS`, so that one of them is no symmetry of
            finite order; or one of them gives NaN.
    """
    random = np.random.default_rng(SEED)
    numbers = [random.uniform(0.1, 0.9, np.shape(leaf)) for leaf in float_leaves(state)]
    generic = with_float_leaves(state, numbers)
    # named symmetries are elements even if they are the identity at these parameters alone
    elements = dict(generators)
    images = [np.asarray(read(generic))]
    images += [np.asarray(read(action(params, generic))) for action in generators.values()]
    latest = dict(generators)
    while latest:
        combinations: dict[str, Action] = {}
        for inner_name, inner in latest.items():
            for outer_name, outer in generators.items():
                combined = _after(outer, inner)
                name = f"{outer_name} after {inner_name}"
                image = np.asarray(read(combined(params, generic)))
                if np.isnan(image).any():
                    raise ArgumentError(
                        f"The symmetry {name} gives NaN for a state whose variables are all between 0.1 and "
                        "0.9, so it cannot be compared with others: it has to map all states."
                    )
                if not any(np.allclose(image, other, rtol=0.0, atol=SAME_IMAGE) for other in images):
                    images.append(image)
                    combinations[name] = combined
        elements |= combinations
        if len(elements) > MAX_ELEMENTS:
            raise ArgumentError(
                f"The symmetries {', '.join(generators)} generate more than {MAX_ELEMENTS} others: each has "
                "to be of finite order (angles are compared as numbers, so wrap them with jnp.mod)."
            )
        latest = combinations
    return elements


def _after(outer: Action, inner: Action) -> Action:
    """The symmetry `outer` applied after `inner`."""
    return lambda params, state: outer(params, inner(params, state))
