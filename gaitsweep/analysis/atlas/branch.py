"""Branches of periodic orbits: records of their points, and their points as text."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.branch_table import BranchTable
from gaitsweep.engine.poincare.maps import Points

# A point may lie beside the chord of a step by this share of its length, since a branch is bent.
BESIDE_CHORD = 0.3
# A point is on a branch if the branch passes it this closely, relative to its size.
ON_BRANCH = 1e-5
Record = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class StoredPoint:
    """One point (1,) of a branch, read from a table: the `points` of its `BranchPoints`."""

    points: Points


def text_of(at: BranchPoints) -> str:
    """A point (1,) of a branch as JSON, whose numbers have the same bits when they are read.

    The list has the coordinates, and each leaf of the modes.
    """
    modes = (np.ravel(np.asarray(leaf)) for leaf in jax.tree.leaves(at.points.modes))
    return json.dumps([array.tolist() for array in (at.points.at[0], *modes)])


def coordinates_of(text: str) -> list[float]:
    """The coordinates of a point in the text that `text_of` wrote."""
    return json.loads(text)[0]


def point_of(text: str, like: Points) -> StoredPoint:
    """Read the point from the text that `text_of` wrote.

    Args:
        text: the text.
        like: a point (1,) of the same map, for the structure of its modes.
    """
    leaves, structure = jax.tree.flatten(like.modes)
    at, *others = json.loads(text)
    modes = others[len(others) - len(leaves) :]  # older texts have three more lists in between
    shaped = [
        np.asarray(values, leaf.dtype).reshape(leaf.shape) for values, leaf in zip(modes, leaves, strict=True)
    ]
    return StoredPoint(Points(np.array([at], float), jax.tree.unflatten(structure, shaped)))


@dataclasses.dataclass(frozen=True)
class BranchStart:
    """The first point of a branch that is to be followed.

    Attributes:
        row, period, depth, begins: as of `Branch`.
        problem: the continuation problem, of this branch alone.
        first: the first point (1,).
        directions: the signs of the parameter's first change, or (0,) along the tangent of `first`.
        orbit: all points of the orbit through `first`.
    """

    row: int
    period: int
    depth: int
    begins: tuple[int, int] | None
    problem: ContinuationProblem
    first: BranchPoints
    directions: tuple[int, ...]
    orbit: Points


@dataclasses.dataclass
class Branch:
    """A branch of periodic orbits of one row.

    Attributes:
        row: the row.
        period: the period of its orbits.
        depth: the number of bifurcations between it and an orbit of the search.
        begins: the branch and the record at whose bifurcation it begins; None: it leads through an orbit.
        problem: the continuation problem, of this branch alone.
        records: its points in order, as records of `BranchTable` with their `BranchPoints` (1,) as `at`.
        asides: points on crossing branches by the place of the record where they cross.
    """

    row: int
    period: int
    depth: int
    begins: tuple[int, int] | None
    problem: ContinuationProblem
    records: list[Record]
    asides: dict[int, BranchPoints]

    def __post_init__(self) -> None:
        points = [record["at"] for record in self.records]
        self.at = np.concatenate([point.points.at for point in points])
        self.parameter = np.concatenate([point.parameter for point in points])

    def point(self, place: int) -> BranchPoints:
        """The point (1,) of the record at a place, with its image."""
        return self.records[place]["at"]

    def aside(self, place: int) -> Iterator[BranchPoints]:
        """The points (1,) on the branches that cross at a record."""
        if (aside := self.asides.get(place)) is not None:
            yield from (aside[[k]] for k in range(len(aside.parameter)))

    @staticmethod
    def of_halves(halves: list[Branch]) -> Branch:
        """The branch of one half, or of two from the same first point, of which the first is reversed."""
        # a closed branch is followed as a whole in either direction
        if len(halves) == 1 or halves[1].records[-1]["end"] == "closed":
            return halves[-1]
        back, forth = halves
        last = len(back.records) - 1
        asides = {last - place: aside for place, aside in back.asides.items()}
        asides |= {last + place: aside for place, aside in forth.asides.items()}
        records = [*_reversed(back.records, forth.records[0]), *forth.records]
        return dataclasses.replace(forth, records=records, asides=asides)

    def place_of(self, points: Points, parameter: float) -> int | None:
        """The record after which it passes one of these points (n,) at a parameter's value, or None."""
        if len(self.records) < 2:
            return None
        problem, weights, begin = self.problem, self.problem.weights[0], self.at[:-1]
        chords = problem.change(begin, self.parameter[:-1], self.at[1:], self.parameter[1:])
        lengths = np.sqrt(chords**2 @ weights)
        for point in range(len(points)):
            away = problem.change(begin, self.parameter[:-1], points.at[point], parameter)
            with np.errstate(divide="ignore", invalid="ignore"):
                share = np.nan_to_num((away * chords) @ weights / lengths**2)
            share = np.clip(share, 0.0, 1.0)
            beside_chord = np.sqrt(((away - share[:, None] * chords) ** 2) @ weights)
            for place in np.flatnonzero(beside_chord < BESIDE_CHORD * lengths + ON_BRANCH):
                if self._meets(int(place), points[[point]], parameter):
                    return int(place)
        return None

    def has_point(self, at: BranchPoints) -> bool:
        """Whether it has a record of a point (1,)."""
        away = self.problem.mapping.distance(at.points.at, self.at)
        return bool(np.any((away < ON_BRANCH) & (self.parameter == at.parameter[0])))

    def part(self, begin: int, end: int) -> Branch:
        """The records from `begin` to before `end`."""
        asides = {place - begin: aside for place, aside in self.asides.items() if begin <= place < end}
        return dataclasses.replace(self, records=self.records[begin:end], asides=asides)

    def begun_at(self, place: int) -> Branch:
        """The same closed branch, from another of its records on."""
        last = len(self.records) - 1
        records = [dict(record) for record in (*self.records[place:last], *self.records[: place + 1])]
        records[-1]["end"] = "closed"
        # its first record is its last one, too, to which the last step leads
        begin = records[last - place]
        begin["special"] = begin["special"] or self.records[last]["special"]
        asides = {(k - place) % last: aside for k, aside in self.asides.items()}
        return dataclasses.replace(self, records=records, asides=asides)

    def insert(self, place: int, record: Record) -> None:
        """Insert a record after the one at a place."""
        self.records.insert(place + 1, record)
        self.asides = {k + (k > place): aside for k, aside in self.asides.items()}
        self.__post_init__()

    def _meets(self, place: int, point: Points, parameter: float) -> bool:
        """Whether the step after the record `place` passes a point (1,)."""
        for end in (self.point(place), self.point(place + 1)):
            change = self.problem.change(end.points.at, end.parameter, point.at, parameter)
            length = np.sum(self.problem.weights * end.tangent * change, axis=1)
            near, converged = self.problem.step(end, length)
            miss = abs(near.parameter[0] - parameter) / (self.problem.high - self.problem.low)
            miss = max(miss, float(self.problem.mapping.distance(point.at, near.points.at)[0]))
            if converged[0] and miss < ON_BRANCH:
                return True
        return False


def branch_table(problem: ContinuationProblem, first: BranchPoints) -> BranchTable:
    """The table of branches (n,) from their first points, with the `BranchPoints` of each record."""
    n, observed = len(first.parameter), list(first.images.observed)
    return BranchTable(
        problem.mapping, problem.parameter, {}, observed, n, problem.constraints, with_points=True
    )


def record_of(problem: ContinuationProblem, at: BranchPoints) -> Record:
    """The record of one point (1,) of a branch."""
    table = branch_table(problem, at)
    table.write(np.zeros(1, int), problem, at, [""])
    return table.records(0)[0]


def _reversed(records: list[Record], first: Record) -> list[Record]:
    """The records of a half in reverse order, but for its first one, which the other half has as `first`."""
    backwards = [dict(record) for record in records[:0:-1]]
    # a kink marks the step that leads to its record
    for k in range(len(backwards) - 1, -1, -1):
        if backwards[k]["special"] == "kink":
            backwards[k]["special"] = ""
            after = backwards[k + 1] if k + 1 < len(backwards) else first
            after["special"] = after["special"] or "kink"
    return backwards
