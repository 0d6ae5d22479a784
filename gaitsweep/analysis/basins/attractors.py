"""Attractors without labels: settled states grouped by single linkage, whatever their gaits are called.

The states where rows settled are points of a torus (angles) times a box (all other observables). States
joined by a chain of short links are one attractor. The largest link follows from the widest gap in the
lengths of the links, not from a unit. A line of neutrally stable states is one attractor, and lines that meet
at a corner are separate attractors.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Bool, Float, Int

from gaitsweep.analysis.basins.state_space import Space, StateArray, extent, state_columns
from gaitsweep.analysis.records import AnalysisError, require
from gaitsweep.contract import RECURRENT, Status

Links = Int[np.ndarray, "links 2"]  # pairs of states
Groups = Int[np.ndarray, " states"]  # a number for each state
GRAINS_OF_A_POINT = 10.0  # largest extent of a point attractor, in grains
CYCLES_OF_A_GRAIN = 10.0  # cycles in which a row settled to the tolerance of `run` may still move by a grain
_GRAIN = 0.01  # rad; for tables without a tolerance
# radius of the neighbourhood that gives the direction of a line, as a share of its extent
WINDOW = 1.0 / 16.0
BENT = 0.05  # variance across a line over that along it, at a corner; 0.25 at a right angle, 0 if straight
MOST_CELLS = 8192  # the time of the spanning tree grows with their square
GAP = 3.0  # least ratio of successive link lengths at a gap between attractors

CLOUDED = 3.0  # largest ratio of the mean distance to an attractor without a period, to that within it
MOST_STATES = 2000  # states by which such an attractor is known

_KINDS = ("point", "line", "surface", "space")


@dataclasses.dataclass(frozen=True)
class Attractors:
    """The attractors of a table's rows.

    `column`: the attractor of each row, a category; NaN where the row did not settle or was inferred. Rows at
    rest (at a fixed point of the flow) are in no attractor with rows that settled on their section. Rows on
    orbits of p crossings are in one attractor if their crossings are linked in turn, from whichever crossing
    on; in tables of older versions, which have one crossing of each, they all are `period p`. Chaotic and
    quasi-periodic rows are in one attractor if their crossings are a sample of one set (`_grouped_clouds`).
    `summary`: one record an attractor: attractor (its name), rows, share (of the settled rows), the columns
    of a state in its middle (of an orbit: at a crossing), extent (the distance between its ends, in the
    columns' unit, over whole turns; NaN for orbits), dimension and kind (point, line, surface, or space from
    3 dimensions on; `rest` at rest; `period p`; `chaotic`; `quasi_periodic`). `link`: the largest link within
    an attractor of settled states, inf where there is one attractor. `grain`: the distance below which states
    are equal. `states`: states of each attractor by its name, (m, d), one for each cell, in units of the
    scales.
    """

    column: pd.Series
    summary: pd.DataFrame
    link: float
    grain: float
    states: dict[str, Float[np.ndarray, "_states coordinates"]]


def attractors(
    table: pd.DataFrame,
    columns: Sequence[str] | None = None,
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
            tolerance of the table's run. It is doubled while there are more than some thousand cells.
        link: the longest link within an attractor; by default from the widest gap in the links' lengths.
        corners: whether lines that meet at a corner are separate attractors.
        scales: the unit of each column in the distance; by default 1 in the column's own unit.

    Returns:
        The attractor of each row, and the attractors.

    Raises:
        AnalysisError: the table does not have a column or any observable, or a number is not above 0.

    Example:
        Six rows settle at three phase differences; 0.005 and 6.28 rad are neighbours on the circle:

        >>> import pandas as pd, gaitsweep as gs
        >>> psi = [0.005, 6.28, 2.0, 2.001, 2.002, 4.0]
        >>> found = gs.analyses.attractors(pd.DataFrame({"status": "settled", "psi_1_end": psi}))
        >>> found.summary["rows"].tolist()
        [3, 2, 1]
    """
    columns = list(columns) if columns is not None else state_columns(table)
    if not columns:
        raise AnalysisError(
            "This table has no observables at the ends of rows (psi_1_end): name the columns."
        )
    require(table, "status", *columns)
    grain = _grain_of(table) if grain is None else grain
    if not grain > 0.0 or not (link is None or link > 0.0):
        raise AnalysisError(f"grain is {grain:g} and link {link}, but both must be above 0.")
    space = Space.of(table, columns, scales)
    settled = _settled(table, columns)
    points = space.points(table, columns)[settled]
    binned = cells(space, points, grain)
    states = points[binned.first]
    links, lengths = spanning_tree(space, states)
    orbits = _orbits(table)
    periods = [int(p) for p in np.unique(orbits[orbits > 1])]
    cycles = [
        (f"period {p}", *cycle)
        for p in periods
        for cycle in _grouped_orbits(space, table, columns, p, grain, link)
    ]
    for status in sorted(RECURRENT):
        cycles += [(status, *cloud) for cloud in _grouped_clouds(space, table, columns, status)]
    link = linking_distance(lengths, binned.side, len(points)) if link is None else link
    flat = space.unrolled(states, links)
    group = components(len(states), links[lengths <= link])
    if corners:
        gaps = np.where(lengths <= link, lengths, 0.0)
        group = _cut_at_corners(space, states, flat, group, links, gaps, binned.side)
    resting = (table["status"].astype(str) == Status.at_rest.name).to_numpy()[settled][binned.first]
    group = np.unique(np.stack([group, resting]), axis=1, return_inverse=True)[1].reshape(-1)
    # the largest first
    order = np.argsort(-np.bincount(group[binned.of]), kind="stable")
    members = {f"A{number + 1}": group == own for number, own in enumerate(order)}
    codes = np.full(len(table), -1)
    codes[settled] = np.argsort(order, kind="stable")[group[binned.of]]
    names = [*members]
    states_of = {name: states[own] for name, own in members.items()}
    for kind, rows, crossings in cycles:
        codes[rows] = len(names)
        names.append(f"A{len(names) + 1}" if len(crossings) else kind)
        states_of |= {names[-1]: crossings} if len(crossings) else {}
    column = pd.Series(pd.Categorical.from_codes(codes.tolist(), names), index=table.index, name="attractor")
    records = []
    for own in members.values():
        record = _described(space, states[own], flat[own], binned.side, columns)
        records.append(record | ({"kind": "rest"} if resting[own].any() else {}))
    for kind, rows, _ in cycles:
        dimension = {"dimension": 0} if kind.startswith("period") else {}
        records.append(dict(table.iloc[rows[0]][columns]) | dimension | {"kind": kind})
    summary = pd.DataFrame(records, columns=[*columns, "extent", "dimension", "kind"])
    rows = np.bincount(codes[codes >= 0], minlength=len(names))
    counted = pd.DataFrame({"attractor": names, "rows": rows, "share": rows / max(rows.sum(), 1)})
    return Attractors(column, pd.concat([counted, summary], axis=1), link, grain, states_of)


def with_attractors(table: pd.DataFrame, **grouping: Any) -> pd.DataFrame:
    """The table with the column `attractor`; `grouping` are arguments of `attractors`.

    Raises:
        AnalysisError: as for `attractors`, or the table has inferred rows, which have no state.
    """
    if np.any(table["status"].astype(str) == Status.inferred.name):
        raise AnalysisError(
            "This table has inferred rows, which have no state that identifies an attractor: use the "
            "gait, or run the job without run.refine."
        )
    grouped = table.assign(attractor=attractors(table, **grouping).column)
    grouped.attrs = table.attrs
    return grouped


def agreement(table: pd.DataFrame, column: pd.Series, label: str = "gait") -> float:
    """The share of rows whose label is the most frequent one of their attractor; NaN if there are no rows."""
    require(table, label)
    counts = pd.crosstab(column.astype(object), table[label].astype(object))
    total = counts.to_numpy().sum()
    return float(counts.max(axis=1).sum() / total) if total else float("nan")


def _grain_of(table: pd.DataFrame) -> float:
    """The distance below which states are equal, by the tolerance of the table's run."""
    tolerance = table.attrs.get("job", {}).get("run", {}).get("tolerance")
    if isinstance(tolerance, Mapping):  # one for each observable: the largest determines the grain
        tolerance = max(tolerance.values(), default=None)
    return CYCLES_OF_A_GRAIN * float(tolerance) if tolerance else _GRAIN


def _settled(table: pd.DataFrame, columns: Sequence[str]) -> Bool[np.ndarray, " rows"]:
    """Whether each row settled at a state, on its section or at rest, (n,)."""
    finite = np.isfinite(table[list(columns)].to_numpy(float)).all(axis=1)
    status = table["status"].astype(str)
    return finite & status.isin([Status.settled.name, Status.at_rest.name]).to_numpy() & (_orbits(table) <= 1)


def _orbits(table: pd.DataFrame) -> Int[np.ndarray, " rows"]:
    """The period (n,) of each row's attractor in crossings; 1 in older tables without that column."""
    if "attractor_period" not in table.columns:
        return np.ones(len(table), int)
    return table["attractor_period"].fillna(0).to_numpy(int)


def _grouped_orbits(
    space: Space, table: pd.DataFrame, columns: Sequence[str], p: int, grain: float, link: float | None
) -> list[tuple[Int[np.ndarray, " rows"], StateArray]]:
    """The rows on each orbit of `p` crossings, the most frequent first, and its states; none if unknown."""
    rows = np.flatnonzero(_orbits(table) == p)
    names = [[*columns], *([f"{name}_{k}" for name in columns] for k in range(2, p + 1))]
    ends = table.iloc[rows].reindex(columns=[name for own in names for name in own])
    crossings = np.stack([space.points(ends, own) for own in names], axis=1)
    if not np.isfinite(crossings).all():  # of an older version
        return [(rows, crossings[:0, 0])]
    points = crossings.reshape(-1, len(columns))
    binned = cells(space, points, grain)
    states = points[binned.first]
    links, lengths = spanning_tree(space, states)
    # an orbit has p groups of crossings, so that the most groups are p times as many
    link = linking_distance(lengths, binned.side, p * len(points)) if link is None else link
    place = components(len(states), links[lengths <= link])[binned.of].reshape(-1, p)
    sequences, sequence_of = np.unique(place, axis=0, return_inverse=True)
    from_least = [min(turn[k:] + turn[:k] for k in range(p)) for turn in sequences.tolist()]
    group = np.unique(from_least, axis=0, return_inverse=True)[1].reshape(-1)[sequence_of.reshape(-1)]
    order = np.argsort(-np.bincount(group), kind="stable")
    cell = binned.of.reshape(-1, p)
    return [(rows[group == own], states[np.unique(cell[group == own])]) for own in order]


def _grouped_clouds(
    space: Space, table: pd.DataFrame, columns: Sequence[str], status: str
) -> list[tuple[Int[np.ndarray, " rows"], StateArray]]:
    """The rows of a status on each attractor without a period, the most frequent first, and its states.

    A row is on an attractor if its crossings lie as near to those of the rows found there as these lie to
    each other, within a factor of `CLOUDED` in the means of the distances to the nearest one.
    """
    last = itertools.takewhile(lambda k: f"{columns[0]}_{k}" in table, itertools.count(2))
    names = [list(columns), *([f"{name}_{k}" for name in columns] for k in last)]
    rows = np.flatnonzero((table["status"].astype(str) == status).to_numpy())
    crossings = np.stack([space.points(table.iloc[rows], own) for own in names], axis=1)
    known = np.isfinite(crossings).all(axis=(1, 2))
    clouds: list[tuple[list[int], StateArray]] = []
    for row, cloud in zip(rows[known].tolist(), crossings[known], strict=True):
        clouds.append(([row], cloud))
        # what the row joins may then be near to others
        while (near := _near_cloud(space, clouds)) is not None:
            members, states = clouds.pop()
            clouds[near] = (clouds[near][0] + members, _thinned(np.concatenate([clouds[near][1], states])))
            clouds.append(clouds.pop(near))
    clouds.sort(key=lambda cloud: -len(cloud[0]))
    return [(np.array(members), states) for members, states in clouds]


def _near_cloud(space: Space, clouds: Sequence[tuple[list[int], StateArray]]) -> int | None:
    """The place of a cloud that is a sample of the same set as the last one; None: there is none."""
    newest = clouds[-1][1]
    for place, (_, states) in enumerate(clouds[:-1]):
        fewer, more = sorted((newest, states), key=len)
        own = np.asarray(space.tree(more).query(more, k=2)[0])[:, 1].mean()
        if space.nearest_distance(fewer, more).mean() <= CLOUDED * own:
            return place
    return None


def _thinned(states: StateArray) -> StateArray:
    """At most `MOST_STATES` of some states, evenly spaced among them."""
    return states[:: -(-len(states) // MOST_STATES)]


def _cut_at_corners(
    space: Space,
    states: StateArray,
    flat: StateArray,
    group: Groups,
    links: Links,
    gaps: Float[np.ndarray, " links"],
    side: float,
) -> Groups:
    """The groups (m,) of states, lines split at their corners; `gaps`: of the `links`, 0 where cut."""
    pieces = np.zeros(len(flat), np.int64)
    for number in range(group.max(initial=-1) + 1):
        members = np.flatnonzero(group == number)
        if _dimension(flat[members], side) == 1:
            gap = gaps[group[links[:, 0]] == number].max(initial=0.0)
            pieces[members] = _smooth_pieces(space, states[members], flat[members], side, gap)
    return np.unique(np.stack([group, pieces]), axis=1, return_inverse=True)[1].reshape(-1)


def _described(
    space: Space, states: StateArray, flat: StateArray, side: float, columns: Sequence[str]
) -> dict[str, object]:
    """The medoid of an attractor's states (m, d), its extent, dimension and kind."""
    middle = states[space.medoid(states)] * space.scales
    dimension = _dimension(flat, side)
    shape = {"extent": extent(flat), "dimension": dimension, "kind": _KINDS[min(dimension, len(_KINDS) - 1)]}
    return {**dict(zip(columns, middle, strict=True)), **shape}


def _dimension(flat: StateArray, side: float) -> int:
    """The box-counting dimension of unrolled states (m, d), rounded; 0 for a point."""
    size = extent(flat)
    if size <= GRAINS_OF_A_POINT * side:
        return 0
    sides = [size / 2.0**k for k in (2, 3, 4) if size / 2.0**k >= 1.2 * side]
    boxes = [len(np.unique(np.floor((flat - flat[0]) / box + 0.5), axis=0)) for box in sides]
    slope = np.polyfit(-np.log(sides), np.log(boxes), 1)[0]
    return max(1, round(float(slope)))


def _smooth_pieces(space: Space, states: StateArray, flat: StateArray, grain: float, gap: float) -> Groups:
    """The smooth piece (m,) of each state of one line; at a corner its neighbours are bent."""
    window = WINDOW * extent(flat)
    one_piece = np.zeros(len(states), np.int64)
    if window < max(4.0 * grain, gap):
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


@dataclasses.dataclass(frozen=True)
class Cells:
    """States binned into cells: `of` (n,) the cell of each state, `first` (m,) one state of each, `side`."""

    of: Groups
    first: Int[np.ndarray, " cells"]
    side: float


def cells(space: Space, points: StateArray, grain: float) -> Cells:
    """Bin states (n, d) into cells of side `grain`, doubled until there are at most `MOST_CELLS`."""
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
