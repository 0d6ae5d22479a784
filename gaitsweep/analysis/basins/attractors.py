"""Attractors without labels: settled states grouped by single linkage, whatever their gaits are called.

The states where rows settled are points of a torus (angles) times a box (all other observables). States
joined by a chain of short links are one attractor. The largest link follows from the widest gap in the
lengths of the links, not from a unit. A line of neutrally stable states is one attractor, and lines that meet
at a corner are separate attractors. Rows without a period, as of chaotic sets, are grouped by the states that
they sample.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Bool, Float, Int

from gaitsweep.analysis.basins.state_space import (
    Coordinates,
    Space,
    StateArray,
    crossing_columns,
    extent,
    state_columns,
)
from gaitsweep.analysis.records import (
    AnalysisError,
    names_in,
    refuse_inferred,
    require,
    require_numbers,
)
from gaitsweep.status import RECURRENT, Status

# Largest ratio of the mean distance of crossings from a sampled set, to that between the crossings within it.
NEAR = 3.0
# States by which a sampled set is known.
MOST_STATES = 2000


@dataclasses.dataclass(frozen=True)
class SampledSet:
    """The states of some rows on one invariant set.

    Attributes:
        rows: the places of the rows in their table.
        states: states of these rows, (m, d).
        tree: the k-d tree of the states.
        spacing: the mean distance from each state to the nearest other one; 0 of one state.
    """

    rows: list[int]
    states: StateArray
    tree: scipy.spatial.KDTree
    spacing: float

    @classmethod
    def of(cls, space: Space, rows: list[int], states: StateArray) -> SampledSet:
        """The set of states (m, d) in a space."""
        tree = space.tree(states)
        nearest = np.asarray(tree.query(states, k=2)[0])[:, 1]
        return cls(rows, states, tree, float(nearest.mean()) if len(states) > 1 else 0.0)

    def is_near(self, other: SampledSet) -> bool:
        """Whether the set with fewer states is a sample of the other one."""
        fewer, more = sorted((self, other), key=lambda sampled: len(sampled.states))
        return float(np.asarray(more.tree.query(fewer.states)[0]).mean()) <= NEAR * more.spacing

    def joined(self, other: SampledSet, space: Space) -> SampledSet:
        """The set with the rows of both, and states of both up to `MOST_STATES`."""
        fewer, more = sorted((self, other), key=lambda sampled: len(sampled.states))
        rows = more.rows + fewer.rows
        if len(more.states) >= MOST_STATES:
            return dataclasses.replace(more, rows=rows)
        return SampledSet.of(space, rows, np.concatenate([more.states, fewer.states])[:MOST_STATES])


def sampled_sets(space: Space, table: pd.DataFrame, columns: Sequence[str], status: str) -> list[SampledSet]:
    """The sets on which the rows of a status are, from that with the most rows on.

    A row is on a set if its crossings (x_end, x_end_2, ...) are as near to those of the rows found there as
    these are to each other, within a factor of `NEAR` in the means of the distances to the nearest one. The
    crossings of a row that the table lacks are left out, as those of runs that kept fewer.

    Args:
        space: the space of the states.
        table: a settle table.
        columns: the columns of the state.
        status: chaotic or quasi_periodic.
    """
    rows = np.flatnonzero((table["status"].astype(str) == status).to_numpy())
    crossings = np.stack(
        [space.points(table.iloc[rows], at_crossing) for at_crossing in crossing_columns(table, columns)],
        axis=1,
    )
    sets: list[SampledSet] = []
    for row, at_crossings in zip(rows.tolist(), crossings, strict=True):
        states = _with_values(at_crossings[_has_value(at_crossings)])
        if not len(states):
            continue
        newest = SampledSet.of(space, [row], states)
        # a set that grows may become one with others
        while (near := next((earlier for earlier in sets if earlier.is_near(newest)), None)) is not None:
            sets.remove(near)
            newest = near.joined(newest, space)
        sets.append(newest)
    return sorted(sets, key=lambda sampled: -len(sampled.rows))


Links = Int[np.ndarray, "links 2"]  # pairs of states
Groups = Int[np.ndarray, " states"]  # a number for each state
MOST_CELLS = 8192  # the time of the spanning tree grows with their square
GAP = 3.0  # least ratio of successive link lengths at a gap between attractors
GRAINS_OF_A_POINT = 10.0  # largest extent of a point attractor, in grains
# radius of the neighbourhood that gives the direction of a line, as a share of its extent
WINDOW = 1.0 / 16.0
BENT = 0.05  # variance across a line over that along it, at a corner; 0.25 at a right angle, 0 if straight


@dataclasses.dataclass(frozen=True)
class Cells:
    """States binned into cells: `of` (n,) the cell of each state, `first` (m,) one state of each, `side`."""

    of: Groups
    first: Int[np.ndarray, " cells"]
    side: float


def cells(space: Space, points: StateArray, grain: float) -> Cells:
    """Bin states (n, d) into cells of side `grain`, doubled until there are at most `MOST_CELLS`.

    Args:
        space: the space of the states.
        points: the states.
        grain: the first side, in units of the scales.
    """
    side = grain
    while True:
        count = np.maximum(np.round(space.periods / side), 1.0)
        width = np.where(space.periods > 0.0, space.periods / count, side)
        places = pd.DataFrame(np.floor(points / width).astype(np.int64))
        of = places.groupby(list(places)).ngroup().to_numpy()
        first = np.unique(of, return_index=True)[1]
        if first.size <= MOST_CELLS:
            return Cells(of, first, side)
        side *= 2.0


def spanning_tree(space: Space, points: StateArray) -> tuple[Links, Float[np.ndarray, " links"]]:
    """The minimum spanning tree of states (m, d) by Prim's algorithm, in memory O(m) and time O(m^2).

    Returns:
        The links as pairs of indices, outwards from the first state, (m - 1, 2), and their lengths, (m - 1,).
    """
    count = len(points)
    near = np.full(count, np.inf)
    source = np.zeros(count, np.int64)
    outside = np.ones(count, bool)
    links, lengths = np.zeros((max(count - 1, 0), 2), np.int64), np.zeros(max(count - 1, 0))
    newest = 0
    for step in range(count - 1):
        outside[newest] = False
        distance = space.distance(points, points[newest])
        closer = outside & (distance < near)
        near[closer], source[closer] = distance[closer], newest
        near[newest] = np.inf
        newest = int(np.argmin(np.where(outside, near, np.inf)))
        links[step], lengths[step] = (source[newest], newest), near[newest]
    return links, lengths


def linking_distance(lengths: Float[np.ndarray, " links"], grain: float, rows: int) -> float:
    """The length above which a tree's links are cut: within the widest gap in their lengths, as a ratio.

    A gap counts where the longer link is at least `GAP` times the shorter one, and where cutting there leaves
    at most as many attractors as the square root of the rows (at least two). Without such a gap there is one
    attractor, and the length is inf. Scaling all lengths scales the result.

    Args:
        lengths: of the links between cells, (m - 1,).
        grain: the least length; shorter links, and those between rows of one cell, count as this long.
        rows: number of rows in all cells.
    """
    sorted_lengths = np.sort(np.maximum(lengths, grain))[::-1]
    if rows > lengths.size + 1:
        sorted_lengths = np.append(sorted_lengths, grain)
    most = max(2, int(np.ceil(np.sqrt(rows))))
    ratios = (sorted_lengths[:-1] / sorted_lengths[1:])[: most - 1]
    if not ratios.size or ratios.max() < GAP:
        return np.inf
    widest = int(np.argmax(ratios))
    return float(np.sqrt(sorted_lengths[widest] * sorted_lengths[widest + 1]))


def components(count: int, links: Links) -> Int[np.ndarray, " nodes"]:
    """The component (count,) of each of `count` nodes joined by links (k, 2), numbered in their order."""
    joined = np.ones(len(links), bool), (links[:, 0], links[:, 1])
    graph = scipy.sparse.coo_array(joined, shape=(count, count))
    return scipy.sparse.csgraph.connected_components(graph, directed=False)[1].astype(np.int64)


def cut_at_corners(
    space: Space,
    states: StateArray,
    flat: StateArray,
    group: Groups,
    links: Links,
    gaps: Float[np.ndarray, " links"],
    side: float,
) -> Groups:
    """The groups of states, lines split at their corners.

    Args:
        space: the space of the states.
        states: (m, d), and `flat` (m, d) the same without turns of angles between linked states.
        group: the group of each state, (m,).
        links: links between states, (k, 2), and `gaps` (k,) their lengths, 0 where cut.
        side: the distance below which states are equal.

    Returns:
        A number for each state, (m,).
    """
    pieces = np.zeros(len(flat), np.int64)
    for number in range(group.max(initial=-1) + 1):
        members = np.flatnonzero(group == number)
        if box_dimension(flat[members], side) == 1:
            gap = gaps[group[links[:, 0]] == number].max(initial=0.0)
            pieces[members] = _smooth_pieces(space, states[members], flat[members], side, gap)
    return np.unique(np.stack([group, pieces]), axis=1, return_inverse=True)[1].reshape(-1)


def box_dimension(flat: StateArray, side: float) -> int:
    """The box-counting dimension of unrolled states (m, d), rounded; 0 for a point."""
    size = extent(flat)
    if size <= GRAINS_OF_A_POINT * side:
        return 0
    sides = [size / 2.0**k for k in (2, 3, 4) if size / 2.0**k >= 1.2 * side]
    boxes = [len(np.unique(np.floor((flat - flat[0]) / box + 0.5), axis=0)) for box in sides]
    slope = np.polyfit(-np.log(sides), np.log(boxes), 1)[0]
    return max(1, round(float(slope)))


def _smooth_pieces(space: Space, states: StateArray, flat: StateArray, side: float, gap: float) -> Groups:
    """The smooth piece (m,) of each state of one line; at a corner its neighbours are bent."""
    window = WINDOW * extent(flat)
    one_piece = np.zeros(len(states), np.int64)
    if window < max(4.0 * side, gap):
        return one_piece
    straight = np.flatnonzero(_bend(space, states, window) <= BENT)
    if not straight.size:
        return one_piece
    # slightly more than the gap, so that the two ends of the longest link stay together
    links = space.tree(states[straight]).query_pairs(max(0.5 * window, 1.01 * gap), output_type="ndarray")
    piece = components(straight.size, links)
    members = [straight[piece == number] for number in range(piece.max() + 1)]
    large = [members_of_piece for members_of_piece in members if extent(flat[members_of_piece]) >= window]
    if len(large) < 2:
        return one_piece
    return np.argmin(
        [space.nearest_distance(states, states[members_of_piece]) for members_of_piece in large], axis=0
    )


def _bend(space: Space, states: StateArray, window: float) -> Float[np.ndarray, " states"]:
    """The variance of each state's neighbours across their main direction over that along it, (m,)."""
    around = space.tree(states).query_ball_point(states, window)
    bend = np.zeros(len(states))
    for place, members in enumerate(around):
        away = space.difference(states[members], states[place])
        spread = np.linalg.eigvalsh(np.atleast_2d(np.cov(away.T, bias=True)))
        if spread[-1] > 0.0:
            bend[place] = spread[:-1].sum() / spread[-1]
    return bend


CYCLES_OF_A_GRAIN = 10.0  # cycles in which a row settled to the tolerance of `run` may still move by a grain
_GRAIN = 0.01  # rad; for tables without a tolerance

_KINDS = ("point", "line", "surface", "space")


@dataclasses.dataclass(frozen=True)
class Attractors:
    """The attractors of a table's rows.

    Rows at rest (at a fixed point of the flow) are in no attractor with rows that settled on their section.
    Rows on orbits of p crossings are in one attractor if their crossings are linked in turn, from whichever
    crossing on.
    Chaotic and quasi-periodic rows are in one attractor if their crossings are samples of one set
    (`sampled_sets`).

    Attributes:
        column: the attractor of each row, a category; NaN where the row did not settle, was inferred, or has
            no value.
        summary: one record an attractor: attractor (its name), rows, share (of the settled rows), the columns
            of a state in its middle (of an orbit: at a crossing), extent (the distance between its ends, in
            the columns' unit, over whole turns; NaN for orbits), dimension and kind (point, line, surface, or
            space from 3 dimensions on; `rest` at rest; `period p`; `chaotic`; `quasi_periodic`).
        link: the largest link within an attractor of settled states, inf where there is one attractor.
        grain: the distance below which states are equal.
        states: states of each attractor by its name, (m, d), one for each cell, in units of the scales.
    """

    column: pd.Series
    summary: pd.DataFrame
    link: float
    grain: float
    states: dict[str, Float[np.ndarray, "_states coordinates"]]


def attractors(
    table: pd.DataFrame,
    columns: str | Sequence[str] | None = None,
    *,
    grain: float | None = None,
    link: float | None = None,
    corners: bool = True,
    scales: Mapping[str, float] | None = None,
) -> Attractors:
    """Group the settled rows of a table by attractor; memory grows with the number of rows.

    Args:
        table: a settle table.
        columns: the columns of the state; by default all observables (psi_1_end, ...).
        grain: distance below which states are equal, in the columns' unit; by default ten cycles at the
            tolerance of the table's run, of columns with a scale of 1 (angles): of others give `scales`. It
            is doubled while there are more than some thousand cells.
        link: the longest link within an attractor; by default from the widest gap in the links' lengths.
        corners: whether lines that meet at a corner are separate attractors.
        scales: the unit of each column in the distance; by default 1 in the column's own unit.

    Returns:
        The attractor of each row, and the attractors.

    Raises:
        AnalysisError: the table does not have a column or any observable, a number is not above 0, or rows
            were not tested for settling.

    Example:
        Six rows settle at three phase differences; 0.005 and 6.28 rad are neighbours on the circle:

        >>> import pandas as pd, gaitsweep as gs
        >>> psi = [0.005, 6.28, 2.0, 2.001, 2.002, 4.0]
        >>> grouped = gs.analyses.attractors(pd.DataFrame({"status": "settled", "psi_1_end": psi}))
        >>> grouped.summary["rows"].tolist()
        [3, 2, 1]
    """
    columns = names_in(columns) if columns is not None else state_columns(table)
    if not columns:
        raise AnalysisError(
            "This table has no observables at the ends of rows (psi_1_end): name the columns."
        )
    require(table, "status")
    if np.any(table["status"].astype(str) == Status.complete.name):
        raise AnalysisError(
            "This table has rows that were simulated for a given time and not tested for settling (status "
            "complete), so their attractors are unknown: simulate them in a run of kind settle."
        )
    require_numbers(table, *columns)
    grain = _grain_of(table, columns) if grain is None else grain
    if not grain > 0.0 or not (link is None or link > 0.0):
        raise AnalysisError(f"grain is {grain:g} and link {link}, but both must be above 0.")
    space = Space.of(table, columns, scales)
    # settled states and those at rest apart, since one kind may lie between two of the other
    most = _link_of_points(space, table, columns, grain) if link is None else link
    groups, link_of_points = _point_groups(space, table, columns, Status.settled, grain, link, most, corners)
    groups += _point_groups(space, table, columns, Status.at_rest, grain, link, most, corners)[0]
    groups.sort(key=lambda group: -len(group.rows))
    periods = orbit_periods(table)
    for period in np.unique(periods[periods > 1]).tolist():
        groups += _orbit_groups(space, table, columns, period, grain, link)
    for status in sorted(RECURRENT):
        groups += _set_groups(space, table, columns, status)
    names = [group.name(number) for number, group in enumerate(groups, start=1)]
    codes = np.full(len(table), -1)
    for number, group in enumerate(groups):
        codes[group.rows] = number
    column = pd.Series(pd.Categorical.from_codes(codes.tolist(), names), index=table.index, name="attractor")
    states = {name: group.states for name, group in zip(names, groups, strict=True) if len(group.states)}
    return Attractors(column, _summary(names, groups, columns), link_of_points, grain, states)


@dataclasses.dataclass(frozen=True)
class _Group:
    """The rows of one attractor, its states (m, d), none if unknown, and its record in the summary."""

    rows: Int[np.ndarray, " rows"]
    states: StateArray
    record: dict[str, object]

    def name(self, number: int) -> str:
        """The name of the attractor with this number; without states that of its kind."""
        return f"A{number}" if len(self.states) else str(self.record["kind"])


def _summary(names: Sequence[str], groups: Sequence[_Group], columns: Sequence[str]) -> pd.DataFrame:
    """The summary of attractors by name, as `Attractors` has it."""
    rows = np.array([len(group.rows) for group in groups], np.int64)
    counts = pd.DataFrame({"attractor": names, "rows": rows, "share": rows / max(rows.sum(), 1)})
    records = [group.record for group in groups]
    states = pd.DataFrame(records, columns=[*columns, "extent", "dimension", "kind"])
    return pd.concat([counts, states], axis=1)


def _link_of_points(space: Space, table: pd.DataFrame, columns: Sequence[str], grain: float) -> float:
    """The longest link by which settled states and those at rest together are told apart.

    It is inf if there are not both: each kind alone has its own.
    """
    settled, resting = (_settled(table, columns, status) for status in (Status.settled, Status.at_rest))
    if not (settled.any() and resting.any()):
        return np.inf
    points = _with_values(space.points(table, columns)[settled | resting])
    binned = cells(space, points, grain)
    _, lengths = spanning_tree(space, points[binned.first])
    return linking_distance(lengths, binned.side, len(points))


def _point_groups(
    space: Space,
    table: pd.DataFrame,
    columns: Sequence[str],
    status: Status,
    grain: float,
    link: float | None,
    most: float,
    corners: bool,
) -> tuple[list[_Group], float]:
    """The rows of a status on each attractor that is no orbit, the most frequent first; the longest link.

    Without a `link` it is that between the states of this status, `most` at most.
    """
    rows = np.flatnonzero(_settled(table, columns, status))
    points = _with_values(space.points(table, columns)[rows])
    binned = cells(space, points, grain)
    states = points[binned.first]
    links, lengths = spanning_tree(space, states)
    if link is None:
        link = min(linking_distance(lengths, binned.side, len(points)), most)
    flat = space.unrolled(states, links)
    group = components(len(states), links[lengths <= link])
    if corners:
        gaps = np.where(lengths <= link, lengths, 0.0)
        group = cut_at_corners(space, states, flat, group, links, gaps, binned.side)
    groups = []
    for number in _largest_first(group[binned.of]):
        members = group == number
        record = _described(space, states[members], flat[members], binned.side, columns)
        if status is Status.at_rest:
            record["kind"] = "rest"
        groups.append(_Group(rows[members[binned.of]], states[members], record))
    return groups, link


def with_attractors(table: pd.DataFrame, **grouping: Any) -> pd.DataFrame:
    """The table with the column `attractor`; `grouping` are arguments of `attractors`.

    Raises:
        AnalysisError: as for `attractors`, or the table has inferred rows, which have no state.
    """
    require(table, "status")
    refuse_inferred(table, "no state that identifies an attractor")
    return table.assign(attractor=attractors(table, **grouping).column)


def agreement(table: pd.DataFrame, column: pd.Series, label: str = "gait") -> float:
    """The share of rows whose label is the most frequent one of their attractor; NaN if there are no rows.

    Args:
        table: a settle table.
        column: the attractor of each row, as `Attractors.column` of this table.
        label: the column of the labels.

    Raises:
        AnalysisError: the table does not have the column, or its rows are not those of the attractors.
    """
    require(table, label)
    if not column.index.equals(table.index):
        raise AnalysisError(
            f"The attractors are of {len(column)} rows, but the table has {len(table)}, or others: give the "
            "column of this table."
        )
    counts = pd.crosstab(column.astype(object), table[label].astype(object))
    total = counts.to_numpy().sum()
    return float(counts.max(axis=1).sum() / total) if total else float("nan")


def _grain_of(table: pd.DataFrame, columns: Sequence[str]) -> float:
    """The distance below which states are equal, by the tolerance of the table's run."""
    tolerance = table.attrs.get("job", {}).get("run", {}).get("tolerance")
    if isinstance(tolerance, Mapping):  # of some observables: the largest of all determines the grain
        from gaitsweep.engine.recorders.bounds import TOLERANCE  # which imports JAX

        others = {TOLERANCE for name in columns if name.removesuffix("_end") not in tolerance}
        tolerance = max({*tolerance.values(), *others}, default=None)
    return CYCLES_OF_A_GRAIN * float(tolerance) if tolerance else _GRAIN


def _settled(table: pd.DataFrame, columns: Sequence[str], status: Status) -> Bool[np.ndarray, " rows"]:
    """Mask of the rows of a status that settled at a state, (n,)."""
    return (
        _has_value(table[list(columns)].to_numpy(float))
        & (table["status"].astype(str) == status.name).to_numpy()
        & (orbit_periods(table) <= 1)
    )


def _has_value(states: Coordinates) -> Bool[np.ndarray, " ..."]:
    """Mask of the states (..., d) that are known: some observables have no value on some gaits, but not all.

    An example is the lag of a foot that stands.
    """
    return np.asarray(~np.isinf(states).any(axis=-1) & ~np.isnan(states).all(axis=-1))


def _with_values(states: Coordinates) -> Coordinates:
    """States with 0 for the observables that have no value on their gait."""
    return np.where(np.isnan(states), 0.0, states)


def orbit_periods(table: pd.DataFrame) -> Int[np.ndarray, " rows"]:
    """The period (n,) of each row's attractor in crossings; 1 in tables without that column."""
    if "attractor_period" not in table.columns:
        return np.ones(len(table), int)
    return table["attractor_period"].fillna(0).to_numpy(int)


def _set_groups(space: Space, table: pd.DataFrame, columns: Sequence[str], status: str) -> list[_Group]:
    """The rows of a status without a period on each set, the most frequent first, and its states."""
    groups = []
    for sampled in sampled_sets(space, table, columns, status):
        record: dict[str, object] = {**table.iloc[sampled.rows[0]][list(columns)], "kind": status}
        groups.append(_Group(np.array(sampled.rows), sampled.states, record))
    return groups


def _orbit_groups(
    space: Space, table: pd.DataFrame, columns: Sequence[str], period: int, grain: float, link: float | None
) -> list[_Group]:
    """The rows on each orbit of `period` crossings, the most frequent first, and its states.

    Rows of which the table does not have all crossings, as numbers, are one group without states.
    """
    rows = np.flatnonzero(orbit_periods(table) == period)
    kind = f"period {period}"
    at_crossings = crossing_columns(table, columns)[:period]
    crossings = np.stack([space.points(table.iloc[rows], names) for names in at_crossings], axis=1)
    is_known = (_has_value(crossings) & (crossings.shape[1] == period)).all(axis=1)
    unknown = rows[~is_known]
    without_states = [_orbit_group(table, columns, unknown, crossings[:0, 0], kind)] if unknown.size else []
    rows = rows[is_known]
    if not rows.size:
        return without_states
    points = _with_values(crossings[is_known]).reshape(-1, len(columns))
    binned = cells(space, points, grain)
    states = points[binned.first]
    links, lengths = spanning_tree(space, states)
    # an orbit has as many groups of crossings as its period, so that the most groups are as many times more
    link = linking_distance(lengths, binned.side, period * len(points)) if link is None else link
    crossing_groups = components(len(states), links[lengths <= link])[binned.of].reshape(-1, period)
    sequences, sequence_of = np.unique(crossing_groups, axis=0, return_inverse=True)
    # one orbit has the same groups in turn, from whichever crossing on: its least sequence stands for all
    from_least = [min(turn[k:] + turn[:k] for k in range(period)) for turn in sequences.tolist()]
    group = np.unique(from_least, axis=0, return_inverse=True)[1].reshape(-1)[sequence_of.reshape(-1)]
    cell = binned.of.reshape(-1, period)
    groups = [
        _orbit_group(table, columns, rows[group == number], states[np.unique(cell[group == number])], kind)
        for number in _largest_first(group)
    ]
    return groups + without_states


def _orbit_group(
    table: pd.DataFrame, columns: Sequence[str], rows: Int[np.ndarray, " rows"], states: StateArray, kind: str
) -> _Group:
    """The group of rows on one orbit, described by the end of the first."""
    return _Group(rows, states, dict(table.iloc[rows[0]][columns]) | {"dimension": 0, "kind": kind})


def _largest_first(group: Int[np.ndarray, " rows"]) -> Int[np.ndarray, " groups"]:
    """The numbers of groups, from that with the most rows on."""
    return np.argsort(-np.bincount(group), kind="stable")


def _described(
    space: Space, states: StateArray, flat: StateArray, side: float, columns: Sequence[str]
) -> dict[str, object]:
    """The medoid of an attractor's states (m, d), its extent, dimension and kind."""
    middle = states[space.medoid(states)] * space.scales
    dimension = box_dimension(flat, side)
    kind = _KINDS[min(dimension, len(_KINDS) - 1)]
    return {
        **dict(zip(columns, middle, strict=True)),
        "extent": extent(flat),
        "dimension": dimension,
        "kind": kind,
    }
