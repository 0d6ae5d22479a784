"""Random starts of the search of gaits."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from gaitsweep.analysis.atlas.periodic_orbits import rows_of
from gaitsweep.engine.poincare.maps import Points
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.kinds.fixed_points import MappedRows

Rows = Int[np.ndarray, " starts"]


@dataclasses.dataclass(frozen=True)
class DrawnStarts:
    """Random starts of some rows, each of which depends on its row, the seed and the starts before it alone.

    Attributes:
        mapped: the rows.
        ranges: [lowest, highest] of start values, or of coordinates of the section, by name.
        seed: the seed.
    """

    mapped: MappedRows
    ranges: Mapping[str, Sequence[float]]
    seed: int

    def points(self, row_of_start: Rows, drawn_before: int, count: int, cycles: int = 0) -> Points:
        """Starts (n,), `count` of each row.

        Args:
            row_of_start: the row of each start (n,).
            drawn_before: the number of starts of each row that were drawn before.
            count: starts of each row.
            cycles: cycles that are simulated; a start that does not come so far is NaN.
        """
        mapping, values = self.mapped.mapping, rows_of(self.mapped.values, row_of_start)
        columns = self._columns(row_of_start, drawn_before, count)
        names = [quantity.name for quantity in mapping.model.initial_conditions]
        drawn_starts = {name: column for name, column in columns.items() if name in names}
        starts = {name: np.asarray(column)[row_of_start] for name, column in self.mapped.starts.items()}
        starts |= drawn_starts
        if cycles and len(drawn_starts) == len(columns):
            points, status = mapping.settled(starts, values, cycles)
            return Points(
                np.where((status == ReturnStatus.crossed)[:, None], points.at, np.nan), points.modes
            )
        points, _ = mapping.settled(starts, values, 0)
        outside = np.flatnonzero(~mapping.covers(points, values))
        if outside.size:
            points = points.merged(outside, mapping.settled(starts, values, 1)[0][outside])
        moved = points.at.copy()
        for k, quantity in enumerate(mapping.coordinates):
            if quantity.name in columns and quantity.name not in drawn_starts:
                moved[:, k] = columns[quantity.name]
        if cycles:
            images = mapping.iterated(cycles).images(Points(moved, points.modes), values)
            moved, points = np.where(images.sound[:, None], images.points.at, np.nan), images.points
        return Points(moved, points.modes)

    def _columns(
        self, row_of_start: Rows, drawn_before: int, count: int
    ) -> dict[str, Float[np.ndarray, " starts"]]:
        """Random numbers (n,) in each of `ranges`, `count` for each row."""
        low, high = np.array(list(self.ranges.values())).T
        drawn = []
        for row in dict.fromkeys(row_of_start.tolist()):
            generator = np.random.default_rng([self.seed, int(self.mapped.numbers[row]), drawn_before])
            drawn.append(generator.uniform(low, high, (count, len(low))))
        return dict(zip(self.ranges, np.concatenate(drawn).T, strict=True))

    def levels(self, fix: Sequence[str]) -> dict[str, Float[np.ndarray, " rows"]]:
        """The value (n,) of each conserved quantity that is held: that of the row's own start."""
        if not fix:
            return {}
        conserved = self.mapped.mapping.images(self.mapped.settled(0), self.mapped.values).conserved_values
        names = [quantity.name for quantity in self.mapped.mapping.conserved]
        return {name: conserved[:, names.index(name)] for name in fix}
