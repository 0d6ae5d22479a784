"""Branches of fixed points over a parameter, stable and unstable ones, with their folds: pseudo-arclength.

Many branches are followed at once, each with its own other parameters and its own steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.analysis.arclength import Places, Track
from gaitsweep.analysis.newton import Conditions, Outcome, newton
from gaitsweep.analysis.turning_points import (
    changes,
    kinds,
    leaving,
    located,
    multipliers_of,
    turning,
    turns,
)
from gaitsweep.engine.maps import Map, Points, Values

# Cosine of the angle by which a branch may turn in a step, and corrections that make the next step longer.
STRAIGHT, FEW = 0.95, 3
LONGER, SHORTER = 1.4, 0.5
# A branch has closed where it passes its start by less than this share of a step.
NEAR_HOME = 0.75
# Shares of the longest step that are tried where no step is short enough.
LEAPS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)


def continuation(
    mapping: Map,
    starts: Points,
    values: Values,
    *,
    parameter: str,
    within: Sequence[float],
    begin: Any = None,
    towards: int = 1,
    fix: Sequence[str] | Mapping[str, object] = (),
    step: float = 0.02,
    longest: float = 0.08,
    shortest: float = 1e-4,
    most: int = 300,
    shown: Sequence[str] | None = None,
) -> pd.DataFrame:
    """The branches of fixed points through n starts.

    Args:
        mapping: a return map, or any other.
        starts: points near fixed points.
        values: other parameters, numbers or one for each start (n,).
        parameter: the name of the parameter along which branches are followed.
        within: the range of it in which they are, two numbers.
        begin: its values at the starts, a number or (n,); the range's end that `towards` leads away from.
        towards: 1 or -1, the direction of the parameter in which a branch starts.
        fix: conserved quantities that are held, as for `newton`.
        step, longest, shortest: lengths of the first step, of the longest and of the shortest; in a length, the
            parameter counts as a share of its range, and coordinates in proportion to their size.
        most: points of one branch.
        shown: the values that the table has beside the parameter; all that are given if not said.

    Returns:
        One record a point: row (the start's), point, parameter and other values, what the map observes there,
        drift_NAME for what is held, multiplier (the largest in size, with its parts multiplier_re and
        multiplier_im), unstable (how many are outside the unit circle), stable, special (fold, flip,
        neimark_sacker, branch_point; corner: a fold at a bend of the map, where no multiplier is 1; kink: a step over a place where the map bends; or nothing), corrections, end (why the branch ends there, or
        nothing): range, closed, most, lost (no step is short enough, or the map is not defined beyond), or,
        where no fixed point was found at the start, an `Outcome`.

    Raises:
        ValueError: a name that the map does not have; a range without width.
    """
    if not max(within) > min(within):
        raise ValueError(f"within is {list(within)}, but must be a range: two numbers that differ.")
    n = len(starts)
    low, high = min(within), max(within)
    begin = (low if towards > 0 else high) if begin is None else begin
    at = np.broadcast_to(np.asarray(begin, np.float64), (n,)).copy()
    held_values = mapping.complete({**values, parameter: at}, n)
    others = {name: each for name, each in held_values.items() if name != parameter}
    found = newton(mapping, starts, held_values, fix=fix)
    held = Conditions.of(mapping, fix, found.images.kept)
    ready = np.flatnonzero(found.converged)
    track = Track.of(mapping, parameter, within, others, held, found.points.at)[ready]
    beside = {name: np.asarray(values[name]) for name in (values if shown is None else shown)}
    book = _Book(mapping, parameter, beside, n, held)
    for row in np.flatnonzero(~found.converged):
        book.failed(int(row), float(at[row]), Outcome(int(found.outcome[row])).name)
    if ready.size:
        places = track.first(found.points[ready], found.drift[ready], at[ready], float(np.sign(towards)))
        _follow(track, places, ready, book, (step, longest, shortest), most)
    return book.table()


def _follow(
    track: Track,
    places: Places,
    names: np.ndarray,
    book: _Book,
    lengths: tuple[float, float, float],
    most: int,
) -> None:
    """Follow the branches until each has ended; `names` (n,) are their rows."""
    first, longest, shortest = lengths
    length = np.full(len(names), first)
    home = places
    book.write(names, track, places, [""] * len(names))
    going = np.ones(len(names), bool)
    while going.any():
        rows = np.flatnonzero(going)
        here, mine = places[rows], track[rows]
        there, found = mine.step(here, length[rows])
        straight = np.sum(mine.weights * here.tangent * there.tangent, axis=1) > STRAIGHT
        taken = found & (straight | (length[rows] <= shortest))
        length[rows[~taken]] *= SHORTER
        stuck = np.flatnonzero(~taken & (length[rows] < shortest))
        if stuck.size:
            over, leapt = _leap(mine[stuck], here[stuck], longest)
            places = places.merged(rows[stuck[leapt]], over[leapt])
            length[rows[stuck]] = first
            book.write(
                names[rows[stuck[leapt]]], mine[stuck[leapt]], over[leapt], ["kink"] * int(leapt.sum())
            )
            book.end(names[rows[stuck[~leapt]]], "lost")
            going[rows[stuck[~leapt]]] = False
        if not taken.any():
            continue
        rows, here, there, mine = rows[taken], here[taken], there[taken], mine[np.flatnonzero(taken)]
        _specials(mine, here, there, length[rows], names[rows], book)
        inside = (there.parameter >= mine.low) & (there.parameter <= mine.high)
        _edge(mine, there, ~inside, names[rows], book)
        book.end(names[rows[~inside]], "range")
        going[rows[~inside]] = False
        rows, there, mine = rows[inside], there[inside], mine[np.flatnonzero(inside)]
        if not rows.size:
            continue
        book.write(names[rows], mine, there, [""] * len(rows))
        places = places.merged(rows, there)
        closed = _distance(mine, there, home[rows]) < NEAR_HOME * length[rows]
        closed &= (book.counts(names[rows]) > 4) & (
            np.sum(mine.weights * there.tangent * home[rows].tangent, axis=1) > 0
        )
        full = book.counts(names[rows]) >= most
        book.end(names[rows[closed]], "closed")
        book.end(names[rows[full & ~closed]], "most")
        going[rows[closed | full]] = False
        easy = there.corrections <= FEW
        length[rows[easy]] = np.minimum(LONGER * length[rows[easy]], longest)


def _leap(track: Track, here: Places, longest: float) -> tuple[Places, np.ndarray]:
    """Places beyond a point at which the map bends or jumps, and whether any were found (n,).

    Where a trajectory grazes an event the map has no derivative, and may jump: no step is short enough to get
    there, but a longer one may get over it, across the branch or at a given value of the parameter.
    """
    best, found = here, np.zeros(len(here.parameter), bool)
    for share in LEAPS:
        for across in (True, False):
            rows = np.flatnonzero(~found)
            if not rows.size:
                return best, found
            mine, start = track[rows], here[rows]
            there, good = (
                mine.step(start, np.full(rows.size, share * longest))
                if across
                else _beyond(mine, start, share * longest)
            )
            onwards = np.sum(mine.weights * start.tangent * there.tangent, axis=1) > 0.0
            good &= onwards & (there.parameter >= track.low) & (there.parameter <= track.high)
            good &= _distance(mine, start, there) < 2.0 * longest
            best = best.merged(rows[good], there[good])
            found[rows[good]] = True
    return best, found


def _beyond(track: Track, here: Places, length: float) -> tuple[Places, np.ndarray]:
    """Places found by damped steps at the parameter's value a `length` ahead, and whether they were found."""
    change = length * here.tangent
    parameter = here.parameter + change[:, -1]
    size = here.points.at.shape[1]
    starts = Points(here.points.at + change[:, :size], here.points.like)
    fix = {track.mapping.conserved[k].name: track.held.values[:, i] for i, k in enumerate(track.held.which)}
    found = newton(track.mapping, starts, {**track.values, track.parameter: parameter}, fix=fix)
    good = np.flatnonzero(found.converged)
    if not good.size:
        return here, found.converged
    sign = np.sign(here.tangent[good, -1])
    places = track[good].first(found.points[good], found.drift[good], parameter[good], sign)
    return here.merged(good, places), found.converged


def _specials(
    track: Track, here: Places, there: Places, length: np.ndarray, names: np.ndarray, book: _Book
) -> None:
    """Write down what changes on the way from `here` to `there`."""
    ends = turning(track, here), turning(track, there)
    what = changes(multipliers_of(track, here), multipliers_of(track, there), ends[0] * ends[1] < 0.0)
    for kind, test in (("fold", turning), ("crossing", leaving)):
        rows = np.flatnonzero(what == kind)
        if not rows.size:
            continue
        mine = track[rows]
        values = test(mine, here[rows]), test(mine, there[rows])
        places, where = located(mine, here[rows], length[rows], test, values)
        good = np.flatnonzero(np.isfinite(where))
        if good.size:
            some, at = mine[good], places[good]
            book.write(names[rows[good]], some, at, (turns if kind == "fold" else kinds)(some, at))


def _edge(track: Track, there: Places, outside: np.ndarray, names: np.ndarray, book: _Book) -> None:
    """Write down where branches cross the range's end."""
    rows = np.flatnonzero(outside)
    if not rows.size:
        return
    mine, over = track[rows], there[rows]
    places, found = mine.at(over, np.clip(over.parameter, mine.low, mine.high))
    good = np.flatnonzero(found)
    if good.size:
        book.write(names[rows[good]], mine[good], places[good], [""] * good.size)


def _distance(track: Track, a: Places, b: Places) -> np.ndarray:
    """The length of the straight way between places (n,)."""
    apart = np.zeros_like(track.weights)
    size = a.points.at.shape[1]
    apart[:, :size] = track.mapping.apart(a.points.at, b.points.at)
    apart[:, -1] = a.parameter - b.parameter
    return np.sqrt(np.sum(track.weights * apart**2, axis=1))


class _Book:
    """The records of all branches."""

    def __init__(
        self, mapping: Map, parameter: str, values: dict[str, np.ndarray], n: int, held: Conditions
    ) -> None:
        self.parameter = parameter
        self._values = {k: np.broadcast_to(v, (n,)) for k, v in values.items() if k != parameter}
        self._held = [mapping.conserved[k].name for k in held.which]
        self._records: list[list[dict[str, Any]]] = [[] for _ in range(n)]

    def counts(self, rows: np.ndarray) -> np.ndarray:
        return np.array([len(self._records[row]) for row in rows])

    def end(self, rows: np.ndarray, why: str) -> None:
        for row in rows:
            self._records[row][-1]["end"] = why

    def failed(self, row: int, parameter: float, why: str) -> None:
        self._records[row].append({**self._head(row, parameter), "end": why})

    def _head(self, row: int, parameter: float) -> dict[str, Any]:
        others = {name: each[row] for name, each in self._values.items()}
        return {"row": row, "point": len(self._records[row]), self.parameter: parameter, **others}

    def write(self, rows: np.ndarray, track: Track, places: Places, special: Sequence[str]) -> None:
        if not len(rows):
            return
        found = multipliers_of(track, places)
        for k, row in enumerate(rows):
            unstable = int(np.sum(np.abs(found[k]) > 1.0))
            self._records[row].append(
                {
                    **self._head(int(row), float(places.parameter[k])),
                    **{name: float(each[k]) for name, each in places.images.observed.items()},
                    **{f"drift_{name}": places.drift[k, i] for i, name in enumerate(self._held)},
                    "multiplier": float(np.abs(found[k, 0])),
                    "multiplier_re": float(found[k, 0].real),
                    "multiplier_im": float(found[k, 0].imag),
                    "unstable": unstable,
                    "stable": unstable == 0,
                    "special": special[k],
                    "corrections": int(places.corrections[k]),
                    "end": "",
                }
            )

    def table(self) -> pd.DataFrame:
        return pd.DataFrame([record for branch in self._records for record in branch])
