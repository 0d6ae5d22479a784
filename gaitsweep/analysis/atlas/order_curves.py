"""A curve in two parameters along which the order of events of a gait changes: two at once, or a grazing.

At a corner two gaits, one of each order, meet and vanish.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from gaitsweep.analysis.atlas.order_changes import change_of_order
from gaitsweep.analysis.continuation.floquet_multipliers import multipliers
from gaitsweep.analysis.continuation.newton import newton
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
        change: what changes there, as `change_of_order` says it.
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
    change: str
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
        records = [*behind[::-1], first, *ahead]
        for number, record in enumerate(records, start=-len(behind)):
            record |= {"point": number, "special": "", "end": "", "corrections": 0}
            del record["at"]
        records[0]["end"], records[-1]["end"] = begin, end
        return records if len(records) > 1 else []

    def _side(self, first: dict[str, Any], direction: int) -> tuple[list[dict[str, Any]], str]:
        """The records in one direction of the second parameter, and why they end."""
        low, high = self.within[1]
        border = high if direction > 0 else low
        levels = np.arange(1, STEPS) * (high - low) / STEPS * direction + self.home[1]
        levels = [*levels[(levels > low) & (levels < high)], border] if self.home[1] != border else []
        records: list[dict[str, Any]] = []
        for level in levels:
            last, before = ([first, first, *records][k] for k in (-1, -2))
            run = last[self.second] - before[self.second]
            slope = (last[self.parameter] - before[self.parameter]) / run if run else 0.0
            guess = last[self.parameter] + slope * (level - last[self.second])
            record = self._located(float(level), guess, last["at"])
            if record is None:
                left = not self.within[0][0] <= guess <= self.within[0][1]
                return records, "range" if left else "lost"
            records.append(record)
        return records, "range"

    def _located(self, level: float, guess: float, near: Points) -> dict[str, Any] | None:
        """The record of the change at a value of the second parameter; None if it is not found."""
        low, high = self.within[0]
        width = WIDTH
        while width <= WIDEST:
            half = width * (high - low)
            interval = max(low, guess - half), min(high, guess + half)
            record = self._within(level, interval, near) if interval[0] < interval[1] else None
            if record is not None:
                return record
            width *= WIDER
        return None

    def _within(self, level: float, interval: tuple[float, float], near: Points) -> dict[str, Any] | None:
        """The change in an interval of the first parameter, by intervals of it that get smaller."""
        record = None
        for _ in range(ROUNDS):
            at = np.linspace(*interval, VALUES)
            starts = Points.joined([near] * VALUES)
            values = {name: np.repeat(np.ravel(v), VALUES) for name, v in self.values.items()}
            values |= {self.parameter: at, self.second: np.full(VALUES, level)}
            fix = {name: np.repeat(np.ravel(v), VALUES) for name, v in self.fix.items()}
            fixed = newton(self.mapping, starts, values, fix=fix)
            same = self._same(fixed.points, values, fixed.converged)
            changes = np.flatnonzero(np.abs(np.diff(same)) == 1.0)
            if not changes.size:
                break
            before = int(changes[np.argmin(np.abs(changes - 0.5 * (VALUES - 2)))])
            interval = float(at[before]), float(at[before + 1])
            side = before if same[before] == 1.0 else before + 1
            constrained = [quantity.name in self.fix for quantity in self.mapping.conserved]
            gradients = fixed.images.conserved_jacobian[[side]][:, constrained]
            factors = multipliers(fixed.images.jacobian[[side]], gradients)[0]
            near = fixed.points[[side]]
            record = {
                self.parameter: 0.5 * (interval[0] + interval[1]),
                self.second: level,
                **{name: float(column[side]) for name, column in fixed.images.observed.items()},
                "unstable": int(np.sum(np.abs(factors) > 1.0)),
                "at": near,
            }
        return record

    def _same(
        self, points: Points, values: Values, converged: Bool[np.ndarray, " values"]
    ) -> Float[np.ndarray, " values"]:
        """1 where a gait is on the one side of this change, 0 where on the other, NaN where there is none.

        Other changes of the order, which this curve may cross, do not count. At a corner, 1 where there is a
        gait and 0 where there is none.
        """
        if self.vanishes:
            return converged.astype(float)
        parts = set(self.change.split(", "))
        changes = [
            change_of_order(self.events, events).split(", ") for events in self.mapping.events(points, values)
        ]
        same = np.array([float(parts.isdisjoint(change)) for change in changes])
        return np.where(converged, same, np.nan)
