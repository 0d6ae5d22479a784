"""Search for all periodic orbits of a map up to some period, from starts drawn at random.

Newton's method runs from many starts at once on the map iterated 1, 2, ... times. What it finds is polished
to the precision of the map, reduced to its least period, and joined with the same orbit found before, also at
another of its points. How often each orbit was found tells how many are likely missing.

Source of the estimate: Chao 1984, Scand. J. Statist. 11:265 (a lower bound from the numbers of those found
once and twice).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.engine.poincare.maps import (
    ManyCoordinates,
    Map,
    MapEvaluation,
    Points,
    Values,
)

Rows = Int[np.ndarray, " points"]  # the row of each point
# starts for the rows (n,) of a round, from the number of starts before it
Draw = Callable[[Rows, int], Points]
# Two orbits are the same if a point of one is this close to a point of the other, relative to its size.
SAME = 1e-6
# Most Newton steps of a search.
STEPS = 15
# Most halvings of a Newton step.
HALVINGS = 2
# A simulated start has settled on an orbit if it is this close to a point of it, relative to its size.
REACHED = 1e-3
# Newton steps with which an orbit is polished.
POLISHING = 3


@dataclasses.dataclass(frozen=True)
class OrbitSearchOptions:
    """Extent of a search.

    Attributes:
        periods: the largest period.
        budget: the largest number of starts of a row.
        batch: starts of a row in a round.
        patience: rounds without a new orbit after which a row's search ends.
        on_progress: called before each round with the number of starts and of orbits so far.
    """

    periods: int = 1
    budget: int = 1024
    batch: int = 64
    patience: int = 3
    on_progress: Callable[[int, int], None] = lambda starts, orbits: None


@dataclasses.dataclass(frozen=True)
class Orbit:
    """A periodic orbit of a row.

    Attributes:
        row: the row.
        points: its points (period,), in their order.
        error: estimated error of a coordinate, relative to its scale.
        hits: the number of drawn starts whose search with its own period found it, or its image.
        symmetry: names of the symmetries that turn it into itself.
        reached: the share of the simulated starts that settled on it; NaN if none was simulated.
    """

    row: int
    points: Points
    error: float
    hits: int = 0
    symmetry: tuple[str, ...] = ()
    reached: float = float("nan")

    @property
    def period(self) -> int:
        """The number of its points."""
        return len(self.points)


def rows_of(values: Values, rows: Rows) -> dict[str, Any]:
    """The values (n,) of points from those of their rows; numbers stay."""
    return {name: np.asarray(v)[rows] if np.ndim(v) else v for name, v in values.items()}


class OrbitSearch:
    """The periodic orbits of each row's map that were found so far.

    Args:
        mapping: the map.
        values: its parameters, numbers or one for each row (n,).
        fix: conserved quantities that are held, each at one value for each row (n,).
        options: extent of the search.
    """

    def __init__(
        self,
        mapping: Map,
        values: Values,
        fix: Mapping[str, Any],
        options: OrbitSearchOptions,
    ) -> None:
        self.mapping, self.values, self.fix, self.options = mapping, values, fix, options
        self.orbits: list[Orbit] = []
        self._drawn: dict[int, int] = {}  # starts of each row that were drawn at random

    def drawn(self, row: int) -> int:
        """The number of starts of one row that were drawn at random."""
        return self._drawn.get(row, 0)

    def of_row(self, row: int) -> list[Orbit]:
        """The orbits of one row."""
        return [orbit for orbit in self.orbits if orbit.row == row]

    def missing(self, row: int) -> float:
        """A lower bound of the number of orbits of one row that were not found, by Chao's estimate.

        It is 0 where each orbit was found more than once. Orbits that no search of these starts can reach are
        not counted.
        """
        hits = np.array([orbit.hits for orbit in self.of_row(row)])
        once, twice = np.sum(hits == 1), np.sum(hits == 2)
        return float(once * (once - 1) / (2.0 * (twice + 1)))

    def run(self, draw: Draw, rows: Iterable[int]) -> None:
        """Search in rounds, each row until its budget is spent or several rounds found nothing new.

        Args:
            draw: function that draws the starts of a round.
            rows: the rows.
        """
        idle = dict.fromkeys(sorted(rows), 0)
        while active := [
            row for row in idle if self.drawn(row) < self.options.budget and idle[row] < self.options.patience
        ]:
            # the rows with the fewest starts first, since a draw is for rows with as many starts
            starts = min(self.drawn(row) for row in active)
            of_round = [row for row in active if self.drawn(row) == starts]
            count = min(self.options.batch, self.options.budget - starts)
            self.options.on_progress(starts, len(self.orbits))
            row_of_start = np.repeat(of_round, count)
            new = self.add(draw(row_of_start, starts), row_of_start)
            for row in of_round:
                self._drawn[row] = starts + count
                idle[row] = 0 if row in new else idle[row] + 1

    def add(self, starts: Points, rows: Rows, *, drawn: bool = True) -> set[int]:
        """Search from some starts with all periods.

        Args:
            starts: the starts (n,).
            rows: the row of each.
            drawn: whether they were drawn at random; others are not counted in the orbits' `hits`.

        Returns:
            The rows with new orbits.
        """
        new: set[int] = set()
        for period in range(1, self.options.periods + 1):
            mapping = self.mapping.iterated(period)
            # a search that does not come near an orbit soon is worth less than another start
            search = newton(
                mapping,
                starts,
                rows_of(self.values, rows),
                fix=rows_of(self.fix, rows),
                most=STEPS,
                halvings=HALVINGS,
            )
            converged = np.flatnonzero(search.converged)
            # an orbit that many searches found is polished once
            groups = [converged[k] for k in self._grouped(search.points[converged], rows[converged])]
            unknown = []
            for group in groups:
                known = self._known(search.points[group[:1]], int(rows[group[0]]))
                if known is None:
                    unknown.append(group)
                else:
                    self._hit(known, period, len(group) if drawn else 0)
            if unknown:
                hits = [len(group) if drawn else 0 for group in unknown]
                first = np.array([group[0] for group in unknown])
                new |= self._insert(search.points[first], rows[first], period, hits)
        return new

    def mark_reached(self, ends: Points, rows: Rows, sound: Bool[np.ndarray, " points"]) -> None:
        """Note for each orbit the share of its row's simulated starts that ended on it.

        A start ends on the nearest orbit alone.

        Args:
            ends: the last points of the starts.
            rows: the row of each.
            sound: whether each start came so far.
        """
        for row in {orbit.row for orbit in self.orbits} & set(rows.tolist()):
            starts = np.flatnonzero(rows == row)
            numbers = [number for number, orbit in enumerate(self.orbits) if orbit.row == row]
            away = np.array([self._distances(self.orbits[number], ends.at[starts]) for number in numbers])
            ended = (away < REACHED) & sound[starts]
            nearest = np.argmin(away, axis=0)
            for place, number in enumerate(numbers):
                share = float(np.mean(ended[place] & (nearest == place)))
                self.orbits[number] = dataclasses.replace(self.orbits[number], reached=share)

    def _distances(self, orbit: Orbit, at: ManyCoordinates) -> Float[np.ndarray, " points"]:
        """The distances of points (n, size) to an orbit or an image of it."""
        values = rows_of(self.values, np.full(orbit.period, orbit.row))
        points = np.concatenate([image.at for image in with_images(self.mapping, orbit.points, values)])
        return np.min(self.mapping.distance(points[None], at[:, None]), axis=1)

    def _grouped(self, points: Points, rows: Rows) -> list[Rows]:
        """Groups of equal points of one row."""
        groups: list[list[int]] = []
        for k in range(len(points)):
            of_row = [group for group in groups if rows[group[0]] == rows[k]]
            if of_row:
                heads = np.array([group[0] for group in of_row])
                away = self.mapping.distance(points.at[heads], points.at[[k]])
                if np.min(away) < SAME:
                    of_row[int(np.argmin(away))].append(k)
                    continue
            groups.append([k])
        return [np.array(group) for group in groups]

    def _insert(self, points: Points, rows: Rows, period: int, hits: Sequence[int]) -> set[int]:
        """Add the orbits through n points, or the hits of those that are known; the rows with new ones."""
        values, fix = rows_of(self.values, rows), rows_of(self.fix, rows)
        candidates = polished(self.mapping, points, rows, values, period, fix)
        sound = np.array([k for k, orbit in enumerate(candidates) if orbit is not None], int)
        orbits = [orbit for orbit in candidates if orbit is not None]
        if not orbits:
            return set()
        firsts = Points.joined([orbit.points[[0]] for orbit in orbits])
        images = with_images(self.mapping, firsts, rows_of(values, sound))
        new = set()
        for index, (orbit, k) in enumerate(zip(orbits, sound, strict=True)):
            of_images = (self._known(image[[index]], orbit.row) for image in images)
            known = next((number for number in of_images if number is not None), None)
            if known is None:
                known = len(self.orbits)
                self.orbits.append(orbit)
                new.add(orbit.row)
            self._hit(known, period, hits[k])
        return new

    def _hit(self, number: int, period: int, hits: int) -> None:
        """Count searches with a period that found an orbit, if it is the orbit's own."""
        orbit = self.orbits[number]
        if orbit.period == period:
            self.orbits[number] = dataclasses.replace(orbit, hits=orbit.hits + hits)

    def _known(self, point: Points, row: int) -> int | None:
        """The number of the orbit of a row to which a point belongs, or None."""
        for number, orbit in enumerate(self.orbits):
            if orbit.row != row:
                continue
            if np.min(self.mapping.distance(orbit.points.at, point.at)) < SAME:
                return number
        return None


def with_images(mapping: Map, points: Points, values: Values) -> list[Points]:
    """Points (n,) and their images (n,) under each symmetry of a map.

    Args:
        mapping: the map.
        points: the points.
        values: parameters, numbers or one for each point (n,).
    """
    return [points, *mapping.mirrored(points, values).values()]


def polished(
    mapping: Map,
    points: Points,
    rows: Rows,
    values: Values,
    period: int,
    fix: Sequence[str] | Mapping[str, object] = (),
) -> list[Orbit | None]:
    """The orbits through n points that are nearly fixed by the map iterated `period` times.

    Args:
        mapping: the map, not iterated.
        points: the points.
        rows: the row (n,) of each.
        values: parameters, numbers or one for each point (n,).
        period: the period.
        fix: conserved quantities to constrain, as for `newton`.

    Returns:
        The orbits with their least periods; None where a point is on no orbit after all. The error of an
        orbit is the larger of the last Newton step and the distance to the orbit of the refined map.
    """
    iterated = mapping.iterated(period)
    fixed = newton(iterated, points, values, fix=fix)
    at, residual, images = fixed.points, fixed.residual, fixed.images
    for _ in range(POLISHING):
        again = newton(iterated, at, values, fix=fix, tolerance=0.0, most=1)
        better = np.flatnonzero(again.residual < residual)
        if not better.size:
            break
        at, images = at.merged(better, again.points[better]), images.merged(better, again.images[better])
        residual = np.minimum(residual, again.residual)
    orbits = orbits_of(mapping, at, values, period)
    mirrored, errors = mapping.mirrored(at, values), _errors(iterated, at, images, values, fix)
    polished_orbits: list[Orbit | None] = []
    for k, (orbit, error) in enumerate(zip(orbits, errors, strict=True)):
        if orbit is None or not fixed.converged[k]:
            polished_orbits.append(None)
            continue
        apart = {name: np.min(mapping.distance(orbit.at, image.at[k])) for name, image in mirrored.items()}
        symmetry = tuple(name for name, distance in apart.items() if distance < SAME)
        polished_orbits.append(Orbit(int(rows[k]), orbit, float(error), symmetry=symmetry))
    return polished_orbits


def orbits_of(mapping: Map, points: Points, values: Values, period: int) -> list[Points | None]:
    """The points of the orbits of n points, each with its least period; None where a point has no image.

    Args:
        mapping: the map, not iterated.
        points: the points.
        values: parameters, numbers or one for each point (n,).
        period: crossings after which each point repeats, not always its least period.
    """
    crossings, sound = [points], np.ones(len(points), bool)
    periods = np.full(len(points), period)
    for count in range(1, period):
        images = mapping.images(crossings[-1], values)
        sound &= images.sound | (periods < period)
        if period % count == 0:
            back = mapping.distance(points.at, images.points.at) < SAME
            periods = np.where(images.sound & back & (periods == period), count, periods)
        crossings.append(images.points)
    return [
        Points.joined([crossing[[k]] for crossing in crossings[: periods[k]]]) if sound[k] else None
        for k in range(len(points))
    ]


def _errors(
    mapping: Map,
    points: Points,
    images: MapEvaluation,
    values: Values,
    fix: Sequence[str] | Mapping[str, object],
) -> Float[np.ndarray, " points"]:
    """The estimated errors (n,) of fixed points, relative to the scales of their coordinates.

    The larger of two distances: of a Newton step from the residual, where no conserved quantity is held, and
    to the fixed point of the refined map, from which Newton's method begins at the point. NaN if the latter
    is not found.
    """
    steps = np.zeros(len(points))
    if not fix:
        miss = mapping.difference(images.points.at, points.at)
        matrices = images.jacobian - np.eye(miss.shape[1])
        for k in np.flatnonzero(np.isfinite(matrices).all(axis=(1, 2))):
            solved = points.at[k] - np.linalg.lstsq(matrices[k], miss[k])[0]
            steps[k] = mapping.distance(points.at[k], solved)
    refined = mapping.refined()
    if refined is None:
        return steps
    # nearly fixed by the refined map, too: a tolerance would end the search before its first step
    finer = newton(refined, points, values, fix=fix, tolerance=0.0, most=POLISHING)
    apart = np.maximum(steps, mapping.distance(points.at, finer.points.at))
    return np.where(finer.residual < SAME, apart, np.nan)
