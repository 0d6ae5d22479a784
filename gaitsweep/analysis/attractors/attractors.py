"""Attractors without labels: settled states that hang together, whatever their gaits are called.

The states where rows settled are points of a torus (angles) times a box (all else). Those that a chain of
short links joins are one attractor; how short follows from the widest gap in the lengths of the links, not
from a unit. A line of neutrally stable states is one attractor, and lines that meet at a corner are one
each.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.analysis.attractors.linkage import cells, components, linking_distance, shortest_tree
from gaitsweep.analysis.attractors.state_space import Space, extent, state_columns
from gaitsweep.analysis.records import AnalysisError, require
from gaitsweep.analysis.transitions.smooth_pieces import smooth_pieces
from gaitsweep.contract import Status

GRAINS_OF_A_POINT = 10.0  # an attractor of no more than so many grains across is a point
CYCLES_OF_A_GRAIN = 10.0  # cycles at the tolerance of `run` in which a settled row may still move a grain
_GRAIN = 0.01  # of tables that do not say their tolerance; rad
_KINDS = ("point", "line", "surface", "space")


@dataclasses.dataclass(frozen=True)
class Attractors:
    """The attractors of a table's rows.

    `column`: the attractor of each row, a category; NaN where none settled or it was inferred. Rows on an
    orbit of p crossings, of which a table holds one point each, are `period p` all together: they are not
    grouped by their states, and have no state in `summary` (its kind is `orbit`) and none in `states`.
    `summary`: one record an attractor: attractor (its name), rows, share (of the settled rows), the columns
    of a state in its middle, extent (the distance between its ends, in the columns' unit, along whole turns),
    dimension and kind (point, line, surface, or space of 3 and more). `link`: the distance at which chains of
    states were cut, inf where nothing parts them. `grain`: the distance below which states count as one.
    `states`: some states of each attractor by its name, (m, d), one a cell, in units of the scales.
    """

    column: pd.Series
    summary: pd.DataFrame
    link: float
    grain: float
    states: dict[str, np.ndarray]


def attractors(
    table: pd.DataFrame,
    columns: Sequence[str] | None = None,
    *,
    grain: float | None = None,
    link: float | None = None,
    corners: bool = True,
    scales: Mapping[str, float] | None = None,
) -> Attractors:
    """Group the settled rows of a table by attractor; memory grows as the rows.

    Args:
        table: a settle table.
        columns: the columns of the state; all observables (psi_1_end, ...) if not given.
        grain: distance below which states count as one, in the columns' unit; ten cycles at the tolerance of
            the table's run if not given. Doubled where there are more than some thousand cells of it.
        link: the longest link inside an attractor; from the widest gap in the links' lengths if not given.
        corners: whether lines that meet at a corner are attractors of their own.
        scales: by column, what counts as one in the distance; 1 in the column's unit if not given.

    Raises:
        AnalysisError: a column is not there, the table has no observables, or a number is not above 0.
    """
    columns = list(columns) if columns is not None else state_columns(table)
    if not columns:
        raise AnalysisError("This table has no observables where rows ended (psi_1_end): name the columns.")
    require(table, "status", *columns)
    grain = _grain_of(table) if grain is None else grain
    if not grain > 0.0 or not (link is None or link > 0.0):
        raise AnalysisError(f"grain is {grain:g} and link {link}, but both must be above 0.")
    space = Space.of(table, columns, scales)
    settled = _settled(table, columns)
    points = space.points(table, columns)[settled]
    gathered = cells(space, points, grain)
    states = points[gathered.first]
    links, lengths = shortest_tree(space, states)
    link = linking_distance(lengths, gathered.side, len(points)) if link is None else link
    flat = space.unrolled(states, links)
    group = components(len(states), links[lengths <= link])
    if corners:
        gaps = np.where(lengths <= link, lengths, 0.0)
        group = _cut_at_corners(space, states, flat, group, links, gaps, gathered.side)
    # the largest first
    rows = np.bincount(group[gathered.of])
    group = np.argsort(np.argsort(-rows, kind="stable"), kind="stable")[group]
    rows = -np.sort(-rows)
    names = [f"A{number + 1}" for number in range(rows.size)]
    codes = np.full(len(table), -1)
    codes[settled] = group[gathered.of]
    orbits = _orbits(table)
    periods = [int(p) for p in np.unique(orbits[orbits > 1])]
    for number, p in enumerate(periods, start=len(names)):
        codes[orbits == p] = number
    every = [*names, *(f"period {p}" for p in periods)]
    column = pd.Series(pd.Categorical.from_codes(codes.tolist(), every), index=table.index, name="attractor")
    own = [group == number for number in range(rows.size)]
    records = [_described(space, states[mine], flat[mine], gathered.side, columns) for mine in own]
    records += [{"dimension": 0, "kind": "orbit"} for _ in periods]
    summary = pd.DataFrame(records, columns=[*columns, "extent", "dimension", "kind"])
    rows = np.concatenate([rows, [np.count_nonzero(orbits == p) for p in periods]]).astype(int)
    counted = pd.DataFrame({"attractor": every, "rows": rows, "share": rows / max(rows.sum(), 1)})
    of_each = {name: states[mine] for name, mine in zip(names, own, strict=True)}
    return Attractors(column, pd.concat([counted, summary], axis=1), link, grain, of_each)


def with_attractors(table: pd.DataFrame, **grouping: Any) -> pd.DataFrame:
    """The table with the column `attractor`; `grouping` as for `attractors`.

    Raises:
        AnalysisError: as `attractors`; rows were inferred, which have no state to go by.
    """
    if np.any(table["status"].astype(str) == Status.inferred.name):
        raise AnalysisError(
            "This table has rows that were inferred, which have no state to tell an attractor by: "
            "go by the gait, or run the job without run.refine."
        )
    grouped = table.assign(attractor=attractors(table, **grouping).column)
    grouped.attrs = table.attrs
    return grouped


def agreement(table: pd.DataFrame, column: pd.Series, label: str = "gait") -> float:
    """The share of rows whose label is the most frequent one of their attractor; NaN without any such row."""
    require(table, label)
    counts = pd.crosstab(column.astype(object), table[label].astype(object))
    total = counts.to_numpy().sum()
    return float(counts.max(axis=1).sum() / total) if total else float("nan")


def _grain_of(table: pd.DataFrame) -> float:
    tolerance = table.attrs.get("job", {}).get("run", {}).get("tolerance")
    if isinstance(tolerance, Mapping):  # one for each observable: a grain is as long as the longest
        tolerance = max(tolerance.values(), default=None)
    return CYCLES_OF_A_GRAIN * float(tolerance) if tolerance else _GRAIN


def _settled(table: pd.DataFrame, columns: Sequence[str]) -> np.ndarray:
    known = np.isfinite(table[list(columns)].to_numpy(float)).all(axis=1)
    return known & (table["status"].astype(str) == Status.settled.name).to_numpy() & (_orbits(table) <= 1)


def _orbits(table: pd.DataFrame) -> np.ndarray:
    """The period (n,) of each row's attractor in crossings; 1 in tables of before there was such a column."""
    if "attractor_period" not in table.columns:
        return np.ones(len(table), int)
    return table["attractor_period"].fillna(0).to_numpy(int)


def _cut_at_corners(
    space: Space,
    states: np.ndarray,
    flat: np.ndarray,
    group: np.ndarray,
    links: np.ndarray,
    gaps: np.ndarray,
    side: float,
) -> np.ndarray:
    """The groups (m,) of states (m, d), as they are and unrolled, lines cut into their smooth pieces.

    `links` (k, 2) are those of the tree and `gaps` (k,) their lengths, 0 where they were cut.
    """
    pieces = np.zeros(len(flat), np.int64)
    for number in range(group.max(initial=-1) + 1):
        mine = np.flatnonzero(group == number)
        if _dimension(flat[mine], side) == 1:
            gap = gaps[group[links[:, 0]] == number].max(initial=0.0)
            pieces[mine] = smooth_pieces(space, states[mine], flat[mine], side, gap)
    return np.unique(np.stack([group, pieces]), axis=1, return_inverse=True)[1].reshape(-1)


def _described(
    space: Space, states: np.ndarray, flat: np.ndarray, side: float, columns: Sequence[str]
) -> dict[str, object]:
    """A state in the middle of an attractor (m, d), its extent and its dimension."""
    middle = states[space.medoid(states)] * space.scales
    dimension = _dimension(flat, side)
    shape = {"extent": extent(flat), "dimension": dimension, "kind": _KINDS[min(dimension, len(_KINDS) - 1)]}
    return {**dict(zip(columns, middle, strict=True)), **shape}


def _dimension(flat: np.ndarray, side: float) -> int:
    """The power at which boxes that cover an attractor grow in number as their side shrinks."""
    whole = extent(flat)
    if whole <= GRAINS_OF_A_POINT * side:
        return 0
    sides = [whole / 2.0**k for k in (2, 3, 4) if whole / 2.0**k >= 1.2 * side]
    boxes = [len(np.unique(np.floor((flat - flat[0]) / each + 0.5), axis=0)) for each in sides]
    slope = np.polyfit(-np.log(sides), np.log(boxes), 1)[0]
    return max(1, round(float(slope)))
