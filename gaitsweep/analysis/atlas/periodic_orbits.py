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
from jaxtyping import Bool, Int

from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.engine.poincare.maps import Map, MapEvaluation, Points, Values

Rows = Int[np.ndarray, " points"]  # the row of each point
# starts for the rows (n,) of a round, from the number of starts before it
Draw = Callable[[Rows, int], Points]
# Two orbits are the same if a point of one is this close to a point of the other, relative to its size.
SAME = 1e-6
# Most Newton steps of a search, and most halvings of each.
STEPS, HALVINGS = 15, 2
# A simulated start has settled on an orbit if it is this close to a point of it, relative to its size.
REACHED = 1e-3
# Newton steps with which an orbit is polished.
POLISHING = 3


@dataclasses.dataclass(frozen=True)
class SearchOptions:
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

    def __init__(self, mapping: Map, values: Values, fix: Mapping[str, Any], options: SearchOptions) -> None:
        self.mapping, self.values, self.fix, self.options = mapping, values, fix, options
        self.orbits: list[Orbit] = []

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
        """Search in rounds, each row until its budget is spent or several rounds found nothing new."""
        active, starts = np.array(sorted(rows), int), 0
        idle = dict.fromkeys(active.tolist(), 0)
        while active.size and starts < self.options.budget:
            count = min(self.options.batch, self.options.budget - starts)
            self.options.on_progress(starts, len(self.orbits))
            of = np.repeat(active, count)
            new = self.add(draw(of, starts), of)
            starts += count
            for row in active.tolist():
                idle[row] = 0 if row in new else idle[row] + 1
            active = np.array([row for row in active.tolist() if idle[row] < self.options.patience], int)

    def add(self, starts: Points, rows: Rows, *, drawn: bool = True) -> set[int]:
        """Search from these starts with all periods; the rows with new orbits.

        Starts that are not `drawn` at random are not counted in the orbits' `hits`.
        """
        new: set[int] = set()
        for period in range(1, self.options.periods + 1):
            mapping = self.mapping.iterated(period)
            # a search that does not come near an orbit soon is worth less than another start
            found = newton(
                mapping,
                starts,
                rows_of(self.values, rows),
                fix=rows_of(self.fix, rows),
                most=STEPS,
                halvings=HALVINGS,
            )
            converged = np.flatnonzero(found.converged)
            # an orbit that many searches found is polished once
            for group in self._grouped(found.points[converged], rows[converged]):
                chosen = converged[group]
                hits = len(chosen) if drawn else 0
                if self._insert(found.points[chosen[:1]], int(rows[chosen[0]]), period, hits):
                    new.add(int(rows[chosen[0]]))
        return new

    def mark_reached(self, ends: Points, rows: Rows, sound: Bool[np.ndarray, " points"]) -> None:
        """Note for each orbit the share of its row's simulated starts that ended on it.

        Args:
            ends: the last points of the starts.
            rows: the row of each.
            sound: whether each start came so far.
        """
        for place, orbit in enumerate(self.orbits):
            of = np.flatnonzero(rows == orbit.row)
            values = rows_of(self.values, np.full(orbit.period, orbit.row))
            images = [orbit.points, *self.mapping.mirrored(orbit.points, values).values()]
            points = np.concatenate([image.at for image in images])
            away = self.mapping.distance(points[None], ends.at[of][:, None])
            share = float(np.mean((np.min(away, axis=1) < REACHED) & sound[of])) if of.size else np.nan
            self.orbits[place] = dataclasses.replace(orbit, reached=share)

    def _grouped(self, points: Points, rows: Rows) -> list[Rows]:
        """Groups of equal points of one row."""
        groups: list[list[int]] = []
        for k in range(len(points)):
            heads = np.array([group[0] for group in groups if rows[group[0]] == rows[k]], int)
            places = [n for n, group in enumerate(groups) if rows[group[0]] == rows[k]]
            if heads.size:
                far = self.mapping.distance(points.at[heads], points.at[[k]])
                if np.min(far) < SAME:
                    groups[places[int(np.argmin(far))]].append(k)
                    continue
            groups.append([k])
        return [np.array(group) for group in groups]

    def _insert(self, point: Points, row: int, period: int, hits: int) -> bool:
        """Add one orbit, or the hits of one that is known; whether it is new."""
        known = self._known(point, row)
        if known is not None:
            self._hit(known, period, hits)
            return False
        only = np.array([row])
        values, fix = rows_of(self.values, only), rows_of(self.fix, only)
        orbit = polished(self.mapping, point, row, values, period, fix)
        if orbit is None:
            return False
        mirrored = self.mapping.mirrored(orbit.points[[0]], values)
        for point_of_image in (orbit.points[[0]], *mirrored.values()):
            known = self._known(point_of_image, row)
            if known is not None:
                self._hit(known, period, hits)
                return False
        self.orbits.append(orbit)
        self._hit(len(self.orbits) - 1, period, hits)
        return True

    def _hit(self, place: int, period: int, hits: int) -> None:
        """Count searches with a period that found an orbit, if it is the orbit's own."""
        orbit = self.orbits[place]
        if orbit.period == period:
            self.orbits[place] = dataclasses.replace(orbit, hits=orbit.hits + hits)

    def _known(self, point: Points, row: int) -> int | None:
        """The place of the orbit of a row to which a point belongs, or None."""
        for place, orbit in enumerate(self.orbits):
            if orbit.row == row and np.min(self.mapping.distance(orbit.points.at, point.at)) < SAME:
                return place
        return None


def polished(
    mapping: Map,
    point: Points,
    row: int,
    values: Values,
    period: int,
    fix: Sequence[str] | Mapping[str, object] = (),
) -> Orbit | None:
    """The orbit through a point (1,) that is nearly fixed by the map iterated `period` times.

    Returns:
        The orbit with its least period; None where it is no orbit after all. Its error is the larger of the
        last Newton step and the distance to the orbit of the refined map.
    """
    iterated = mapping.iterated(period)
    best = newton(iterated, point, values, fix=fix)
    if not best.converged[0]:
        return None
    for _ in range(POLISHING):
        again = newton(iterated, best.points, values, fix=fix, tolerance=0.0, most=1)
        if not again.residual[0] < best.residual[0]:
            break
        best = again
    orbit = orbit_of(mapping, best.points, values, period)
    if orbit is None:
        return None
    mirrored = mapping.mirrored(best.points, values)
    apart = {name: np.min(mapping.distance(orbit.at, image.at)) for name, image in mirrored.items()}
    symmetry = tuple(name for name, distance in apart.items() if distance < SAME)
    error = _error(iterated, best.points, best.images, values, fix)
    return Orbit(row, orbit, error, symmetry=symmetry)


def orbit_of(mapping: Map, point: Points, values: Values, period: int) -> Points | None:
    """The points of the orbit with its least period, in their order; None where a point has no image."""
    points = [point]
    for count in range(1, period):
        images = mapping.images(points[-1], values)
        if not images.sound[0]:
            return None
        if period % count == 0 and mapping.distance(point.at, images.points.at)[0] < SAME:
            break
        points.append(images.points)
    return Points.joined(points)


def _error(
    mapping: Map,
    points: Points,
    images: MapEvaluation,
    values: Values,
    fix: Sequence[str] | Mapping[str, object],
) -> float:
    """The estimated error of a fixed point (1,): by its residual, and by that of the refined map."""
    step = 0.0
    if not fix:
        miss = mapping.difference(images.points.at, points.at)[0]
        step = float(
            mapping.distance(
                points.at[0], points.at[0] + np.linalg.lstsq(images.jacobian[0] - np.eye(len(miss)), miss)[0]
            )
        )
    refined = mapping.refined()
    if refined is None:
        return step
    # nearly fixed by the refined map, too: a tolerance would end the search before its first step
    finer = newton(refined, points, values, fix=fix, tolerance=0.0, most=POLISHING)
    apart = float(mapping.distance(points.at, finer.points.at)[0])
    return max(step, apart) if finer.residual[0] < SAME else float("nan")
