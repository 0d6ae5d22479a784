"""Distances between settled states: angles by the shorter way, other observables in their own units."""

from __future__ import annotations

import dataclasses
import itertools
import numbers
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Float, Int

from gaitsweep import near_miss
from gaitsweep.analysis.records import AnalysisError, axes_of, require
from gaitsweep.angles import TURN, is_circular

StateArray = Float[np.ndarray, "states coordinates"]
Coordinates = Float[np.ndarray, "... coordinates"]
_CHUNK = 1 << 20  # numbers in a block of distances


@dataclasses.dataclass(frozen=True)
class Space:
    """A space of states whose coordinates are divided by `scales` (d,).

    `periods` (d,) are those of the divided coordinates, 0 if not periodic.
    """

    periods: Float[np.ndarray, " coordinates"]
    scales: Float[np.ndarray, " coordinates"]

    @classmethod
    def of(
        cls, table: pd.DataFrame, columns: Sequence[str], scales: Mapping[str, float] | None = None
    ) -> Space:
        """The space of these columns, each divided by its scale; angles have the period of a full turn.

        Raises:
            AnalysisError: the table does not have a column, or a scale is no number above 0 or has another
                name than the columns.
        """
        require(table, *columns)
        scales = scales or {}
        check_scales(scales, columns, "one of the columns")
        divisors = np.array([float(scales.get(name, 1.0)) for name in columns])
        turns = np.array([TURN if is_circular(table, name) else 0.0 for name in columns])
        return cls(turns / divisors, divisors)

    def points(self, table: pd.DataFrame, columns: Sequence[str]) -> Float[np.ndarray, "rows coordinates"]:
        """The states of a table's rows, (n, d), angles in [0, period)."""
        points = table[list(columns)].to_numpy(float) / self.scales
        closed = self.periods > 0.0
        points[:, closed] = np.mod(points[:, closed], self.periods[closed])
        # np.mod of a tiny negative number is the period itself, which is outside the range
        points[:, closed] = np.where(points[:, closed] >= self.periods[closed], 0.0, points[:, closed])
        return points

    def difference(self, one: Coordinates, other: Coordinates) -> Coordinates:
        """`one - other` (..., d), angles by the shorter way."""
        away = one - other
        turn = np.where(self.periods > 0.0, self.periods, 1.0)
        return np.where(self.periods > 0.0, away - turn * np.round(away / turn), away)

    def distance(self, one: Coordinates, other: Coordinates) -> Float[np.ndarray, " ..."]:
        """Distances (...) between states (..., d)."""
        return np.sqrt(np.sum(self.difference(one, other) ** 2, axis=-1))

    def tree(self, points: StateArray) -> scipy.spatial.KDTree:
        """A k-d tree of states (n, d), periodic in angles."""
        return scipy.spatial.KDTree(points, boxsize=self.periods)

    def nearest_distance(
        self, points: StateArray, others: Float[np.ndarray, "others coordinates"]
    ) -> Float[np.ndarray, " states"]:
        """The distance (n,) of each state (n, d) to the nearest of `others` (m, d); inf if there is none."""
        if not len(others) or not len(points):
            return np.full(len(points), np.inf)
        return np.asarray(self.tree(others).query(points)[0])

    def medoid(self, points: StateArray) -> int:
        """The index of the medoid of states (n, d), which has the smallest sum of distances to the others.

        From 1000 states on it is the best of 500 to 750 evenly spaced ones, which locate the middle well
        enough.
        """
        stride = max(1, len(points) // 500)
        candidates = np.arange(0, len(points), stride)
        rows = max(1, _CHUNK // points.size)
        sums = [
            self.distance(points[candidates[first : first + rows], None], points[None]).sum(axis=1)
            for first in range(0, candidates.size, rows)
        ]
        return int(candidates[np.argmin(np.concatenate(sums))])

    def unrolled(self, points: StateArray, links: Int[np.ndarray, "links 2"]) -> StateArray:
        """States (m, d) shifted by whole turns so that the links of a tree do not wrap.

        Args:
            points: the states.
            links: pairs of indices (k, 2), in order outwards from the root, the inner state first.
        """
        flat = points.copy()
        for inner, outer in links:
            flat[outer] = flat[inner] + self.difference(points[outer], points[inner])
        return flat


def check_scales(scales: Mapping[str, float], allowed: Sequence[str], noun: str = "a start") -> None:
    """Refuse scales of names that are not allowed, and those that are no numbers above 0.

    Args:
        scales: the scales by name.
        allowed: the allowed names.
        noun: what an allowed name is, for the message.

    Raises:
        AnalysisError: a name of `scales` is not one of `allowed`, or a scale is no number above 0.
    """
    for name, scale in scales.items():
        if name not in allowed:
            raise AnalysisError(f"scales.{name} is not {noun}{near_miss.suggestion(name, allowed)}")
        if not isinstance(scale, numbers.Real) or not 0.0 < float(scale) < np.inf:
            raise AnalysisError(f"The scale of {name} is {scale}, but must be a number above 0.")


def extent(points: StateArray) -> float:
    """The extent of points (m, d) in open space.

    It is the distance from the point farthest from the first to the point farthest from there.
    """
    farthest = points[np.argmax(np.linalg.norm(points - points[0], axis=1))]
    return float(np.linalg.norm(points - farthest, axis=1).max())


def crossing_columns(table: pd.DataFrame, columns: Sequence[str]) -> list[list[str]]:
    """The columns of a state at each crossing that a table has: x_end, then x_end_2, and so on."""
    later = ([f"{name}_{k}" for name in columns] for k in itertools.count(2))
    return [list(columns), *itertools.takewhile(lambda names: set(names) <= set(table), later)]


def state_columns(table: pd.DataFrame) -> list[str]:
    """The columns of the section observables at the end of a row: psi_1_end and so on."""
    quantities = table.attrs.get("quantities", {})
    skipped = {"t_end", *axes_of(table)}
    names = [str(name) for name in table.columns if str(name).endswith("_end") and name not in skipped]
    return [name for name in names if not quantities or name.removesuffix("_end") in quantities]
