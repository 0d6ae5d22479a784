"""A curve in two parameters along which the order of events of a gait changes: two at once, or a grazing.

At a corner two gaits, one of each order, meet and vanish.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from gaitsweep.analysis.atlas.order_changes import changes_of_order
from gaitsweep.analysis.continuation.floquet_multipliers import multipliers
from gaitsweep.analysis.continuation.newton import FixedPoints, newton
from gaitsweep.engine.poincare.maps import Events, Map, Points, Values

# Steps of the second parameter over its range.
STEPS = 32
# First and largest width of the interval that is searched at each step, as a share of the first parameter's
# range, and the factor by which it grows where the order does not change in it.
WIDTH = 0.01
WIDEST = 0.7
WIDER = 4.0
# Values of the first parameter in an interval.
VALUES = 33
# Rounds of ever smaller intervals.
ROUNDS = 8


@dataclasses.dataclass(frozen=True)
class _CurvePoint:
    """A point of a curve of order changes.

    Attributes:
        parameter, second: the values of the two parameters.
        columns: these, the observables of the gait there, and how many multipliers are outside the unit
            circle, by name.
        point: the gait's point (1,).
    """

    parameter: float
    second: float
    columns: dict[str, float]
    point: Points


@dataclasses.dataclass(frozen=True)
class OrderChange:
    """A change of the order of events on a branch.

    Attributes:
        mapping: the map, iterated to the period of the gait.
        parameter, second: names of the two parameters.
        within: the ranges of both.
        values: the other parameters, (1,) each.
        fix: conserved quantities that are held, and their values (1,).
        point: a point of the gait.
        home: the values of both parameters there.
        events: the events on one side of the change.
        changes: the changes of the order there, as of `changes_of_order`.
        vanishes: whether it is a corner, on one side of which there is no gait.
    """

    mapping: Map
    parameter: str
    second: str
    within: tuple[Sequence[float], Sequence[float]]
    values: Values
    fix: dict[str, Any]
    point: Points
    home: tuple[float, float]
    events: Events
    changes: frozenset[str]
    vanishes: bool = False

    def curve(self) -> list[dict[str, Any]]:
        """Follow the curve as a function of the second parameter, until the change is no longer found.

        Returns:
            One record a point, in order; 0 is the change on the branch, and points below 0 are behind it.
        """
        first = self._located(self.home[1], self.home[0], self.point)
        if first is None:
            return []
        behind, begin = self._side(first, -1)
        ahead, end = self._side(first, 1)
        points = [*behind[::-1], first, *ahead]
        if len(points) == 1:
            return []
        ends = [begin, *[""] * (len(points) - 2), end]
        return [
            {**point.columns, "point": number, "special": "", "end": end, "corrections": 0}
            for number, (point, end) in enumerate(zip(points, ends, strict=True), start=-len(behind))
        ]

    def _side(self, first: _CurvePoint, direction: int) -> tuple[list[_CurvePoint], str]:
        """The points after `first` in one direction of the second parameter, and why they end."""
        low, high = self.within[1]
        border = high if direction > 0 else low
        if self.home[1] == border:
            return [], "range"
        steps = np.arange(1, STEPS) * (high - low) / STEPS * direction + self.home[1]
        levels = [*steps[(steps > low) & (steps < high)], border]
        points = [first]
        for level in levels:
            last = points[-1]
            before = points[-2] if len(points) > 1 else last
            run = last.second - before.second
            slope = (last.parameter - before.parameter) / run if run else 0.0
            guess = last.parameter + slope * (level - last.second)
            point = self._located(float(level), guess, last.point)
            if point is None:
                is_inside = self.within[0][0] <= guess <= self.within[0][1]
                return points[1:], "lost" if is_inside else "range"
            points.append(point)
        return points[1:], "range"

    def _located(self, level: float, guess: float, near: Points) -> _CurvePoint | None:
        """The point of the curve at a value of the second parameter; None if it is not found."""
        low, high = self.within[0]
        width = WIDTH
        while width <= WIDEST:
            half = width * (high - low)
            interval = max(low, guess - half), min(high, guess + half)
            point = self._within(level, interval, near) if interval[0] < interval[1] else None
            if point is not None:
                return point
            width *= WIDER
        return None

    def _within(self, level: float, interval: tuple[float, float], near: Points) -> _CurvePoint | None:
        """The change in an interval of the first parameter, by intervals of it that get smaller."""
        point = None
        for _ in range(ROUNDS):
            at = np.linspace(*interval, VALUES)
            gaits, values = self._gaits(at, level, near)
            is_on_side, is_beyond = self._sides(gaits.points, values, gaits.converged)
            leaves = is_on_side[:-1] & is_beyond[1:]
            enters = is_beyond[:-1] & is_on_side[1:]
            changes = np.flatnonzero(leaves | enters)
            if not changes.size:
                break
            before = int(changes[np.argmin(np.abs(changes - 0.5 * (VALUES - 2)))])
            interval = float(at[before]), float(at[before + 1])
            side = before if is_on_side[before] else before + 1
            near, parameter = gaits.points[[side]], 0.5 * (interval[0] + interval[1])
            columns = {self.parameter: parameter, self.second: level}
            columns |= {name: float(column[side]) for name, column in gaits.images.observed.items()}
            columns |= {"unstable": self._unstable(gaits, side)}
            point = _CurvePoint(parameter, level, columns, near)
        return point

    def _gaits(
        self, at: Float[np.ndarray, " values"], level: float, near: Points
    ) -> tuple[FixedPoints, Values]:
        """The gaits near a point (1,) at values of the first parameter, with all parameters there.

        Args:
            at: the values of the first parameter.
            level: the value of the second one.
            near: the point.
        """
        starts = Points.joined([near] * VALUES)
        values = {name: np.repeat(np.ravel(v), VALUES) for name, v in self.values.items()}
        values |= {self.parameter: at, self.second: np.full(VALUES, level)}
        fix = {name: np.repeat(np.ravel(v), VALUES) for name, v in self.fix.items()}
        return newton(self.mapping, starts, values, fix=fix), values

    def _unstable(self, gaits: FixedPoints, index: int) -> int:
        """The number of multipliers of one gait outside the unit circle."""
        constrained = [quantity.name in self.fix for quantity in self.mapping.conserved]
        gradients = gaits.images.conserved_jacobian[[index]][:, constrained]
        factors = multipliers(gaits.images.jacobian[[index]], gradients)[0]
        return int(np.sum(np.abs(factors) > 1.0))

    def _sides(
        self, points: Points, values: Values, converged: Bool[np.ndarray, " values"]
    ) -> tuple[Bool[np.ndarray, " values"], Bool[np.ndarray, " values"]]:
        """Masks of the gaits on the one side of this change, and of those on the other.

        Other changes of the order, which this curve may cross, do not count. At a corner, there is a gait on
        the one side, and none on the other.
        """
        if self.vanishes:
            return converged, ~converged
        orders = self.mapping.events(points, values)
        is_same = np.array(
            [self.changes.isdisjoint(changes_of_order(self.events, order)) for order in orders]
        )
        return converged & is_same, converged & ~is_same
