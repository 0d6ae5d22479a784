"""The explorer's map of a table: place and outcome of each record, and the starts that are animated."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from gaitsweep.analysis.records import in_order, is_true, outcome_labels, sound
from gaitsweep.angles import branch_cut
from gaitsweep.design import Design
from gaitsweep.job import Job
from gaitsweep.plot import PlotError, theme
from gaitsweep.plot.basin_maps.cells import cell_edges
from gaitsweep.plot.column_labels import digits_of
from gaitsweep.plot.columns import column, is_angle, is_logarithmic, rows_where
from gaitsweep.status import Outcome, Status
from gaitsweep.view.explorer.page_format import label_of, written

CELLS, POINTS = "cells", "points"
MAX_POINTS = 6000  # beyond which a figure in a browser responds slowly
_MAX_SLICES = 12  # values of a parameter of which one is shown at a time


@dataclasses.dataclass(frozen=True)
class Slice:
    """An axis of which one value is shown at a time; `texts` (n,) name its values."""

    name: str
    texts: list[str]
    of_record: Int[np.ndarray, " records"]


@dataclasses.dataclass(frozen=True)
class StartMap:
    """The records of a table on the map.

    `kind` is cells or points; `x` and `y` name columns of `table`; `edges` are those of cells along x and y,
    `at` the cell (n, 2) of each record. `outcome` (n,) is the number of each record's outcome in
    `outcomes`, which have name, colour and marker. `no_change` is the slope of the line in a return map on
    which the value stays. `thinned` describes records that were left out.
    """

    table: pd.DataFrame
    kind: str
    x: str
    y: str
    slices: list[Slice]
    outcomes: list[dict[str, Any]]
    outcome: Int[np.ndarray, " records"]
    edges: tuple[Float[np.ndarray, " edges_x"], Float[np.ndarray, " edges_y"]] | None = None
    at: Int[np.ndarray, "records 2"] | None = None
    closed: tuple[bool, bool] = (False, False)
    no_change: float | None = None
    thinned: str = ""

    def axis(self, which: str) -> dict[str, Any]:
        """The label of an axis, whether it is logarithmic or an angle, and the cut of the circle."""
        name = self.x if which == "x" else self.y
        log = is_logarithmic(self.table, name)
        circular = is_angle(self.table, name) and not log
        origin = 0.0
        if circular and self.kind == POINTS:
            origin = branch_cut(self.table[name].to_numpy(float))
        label = label_of(self.table, name)
        return {"name": name, "label": label, "circular": circular, "log": log, "origin": origin}


def map_of(table: pd.DataFrame, job: Job, x: str | None, y: str | None, most: int) -> StartMap:
    """Create the map of a table.

    Args:
        table: the table, with a column `gait`.
        job: its job.
        x, y: columns along the axes; by default those of the job's figures, or the longest axes.
        most: largest number of records on the page.

    Raises:
        PlotError: a column is missing, has no numbers, or is along both axes.
    """
    x, y = _axes(table, job, x, y)
    outcomes, outcome = _outcomes(table)
    no_change = {next_of(x): 1.0, change_of(x): 0.0}.get(y)
    shown = StartMap(table, POINTS, x, y, [], outcomes, outcome, no_change=no_change)
    groups = [group for group in job.design.groups if group.length > 1]
    number_of_group = {axis: number for number, group in enumerate(groups) for axis in group.axes}
    drawn = [number_of_group[name] for name in (x, y) if name in number_of_group]
    if job.run.one_a_row and len(set(drawn)) == 2:
        values = [np.unique(table[name].to_numpy(float)) for name in (x, y)]
        of_axes = [groups[number] for number in drawn]
        # an axis whose values follow another's makes no grid, nor does a sample
        follows = any(len(v) > group.length for v, group in zip(values, of_axes, strict=True))
        if not follows and not any(group.drawn for group in of_axes):
            return _cells(shown, values, job, drawn, most)
    return _points(shown, job, drawn, most)


def _cells(
    shown: StartMap, values: list[Float[np.ndarray, " _values"]], job: Job, drawn: list[int], most: int
) -> StartMap:
    """A map of cells centred at `values` along x and y, thinned to `most` of them.

    It has points if there are more slices than that. `drawn` are the numbers of the groups of axes along x
    and y.
    """
    table = shown.table
    cell_of_record = [
        np.searchsorted(centres, table[name].to_numpy(float))
        for name, centres in zip((shown.x, shown.y), values, strict=True)
    ]
    at = np.column_stack(cell_of_record)
    for step in range(1, max(map(len, values)) + 1):
        shown_cells = (at % step == 0).all(axis=1)
        if np.count_nonzero(shown_cells) <= most:
            break
    else:  # one cell of each slice would be too many
        return _points(shown, job, drawn, most)
    table = rows_where(table, shown_cells)
    grids = job.design.grids
    return dataclasses.replace(
        shown,
        kind=CELLS,
        table=table,
        outcome=shown.outcome[shown_cells],
        slices=_slices(table, job, drawn),
        edges=(
            cell_edges(values[0][::step], log=is_logarithmic(table, shown.x)),
            cell_edges(values[1][::step], log=is_logarithmic(table, shown.y)),
        ),
        at=at[shown_cells] // step,
        closed=tuple(name in grids and grids[name].closed for name in (shown.x, shown.y)),
        thinned=f"one cell in {step} along both axes" if step > 1 else "",
    )


def _points(shown: StartMap, job: Job, drawn: list[int], most: int) -> StartMap:
    """A map of points, thinned to `most` of them; `drawn` as for `_cells`."""
    step = math.ceil(len(shown.table) / min(most, MAX_POINTS))
    table = rows_where(shown.table, np.arange(len(shown.table)) % step == 0)
    return dataclasses.replace(
        shown,
        table=table,
        outcome=shown.outcome[::step],
        slices=[] if job.run.one_a_row else _slices(table, job, drawn, few=_MAX_SLICES),
        thinned=f"one record in {step}" if step > 1 else "",
    )


def with_next(table: pd.DataFrame, y: str) -> pd.DataFrame:
    """A return map's table with an observable at the next crossing, and its change until then."""
    table = table.sort_values(["row", "crossing"], kind="stable")
    attrs = table.attrs
    circular = is_angle(table, y)
    after = table.groupby("row")[y].shift(-1)
    change = after - table[y]
    change = np.pi - np.mod(np.pi - change, 2.0 * np.pi) if circular else change  # the shorter way round
    table = table.assign(**{next_of(y): after, change_of(y): change})
    quantities = dict(attrs.get("quantities", {}))
    quantity = {**(quantities.get(y) or quantities.get(y.removesuffix("_n")) or {}), "symbol": ""}
    added = {next_of(y): quantity, change_of(y): {**quantity, "circular": False}}
    table.attrs = {**attrs, "quantities": {**quantities, **added}}
    return rows_where(table, table[next_of(y)].notna())


def next_of(y: str) -> str:
    """The name of the column with the value at the next crossing."""
    return f"{y}_next"


def change_of(y: str) -> str:
    """The name of the column with the change until the next crossing."""
    return f"{y}_change"


def _axes(table: pd.DataFrame, job: Job, x: str | None, y: str | None) -> tuple[str, str]:
    """The columns along x and y; by default those of the job's figures, or its longest axes."""
    suffixes = ("", "_end") if job.run.one_a_row else ("_n", "")
    default_of = _axes_of_rows if job.run.one_a_row else _axes_of_records
    default_x, default_y = default_of(table, job)
    chosen = (column(table, x, suffixes) if x else default_x, column(table, y, suffixes) if y else default_y)
    for name in chosen:
        if name not in table.columns:
            raise PlotError(f"{name} is not a column of this table.")
        if not pd.api.types.is_numeric_dtype(table[name]):
            raise PlotError(f"{name} has no numbers for an axis.")
    if chosen[0] == chosen[1]:
        raise PlotError(f"Both axes would be {chosen[0]}: name another column by x or y.")
    return chosen


def _axes_of_rows(table: pd.DataFrame, job: Job) -> tuple[str, str]:
    """The columns along x and y of a table with one record a row."""
    axes_of_figures = ((dict(figure).get("x"), dict(figure).get("y")) for figure in job.figures)
    x, y = next((axes for axes in axes_of_figures if None not in axes), (None, None))
    if isinstance(x, str) and isinstance(y, str) and {x, y} <= set(table.columns):
        return x, y
    observable = f"{job.design.model.observables[0].name}_end"
    names = _longest_axes(job.design)
    if len(names) == 2:
        return names[0], names[1]
    return names[0] if names else "row", observable


def _longest_axes(design: Design) -> list[str]:
    """The names of the two longest axes of a design, or fewer; the one that varies fastest is first."""
    groups = [group for group in design.groups if group.length > 1]
    if len(groups) == 1 and len(groups[0].names) > 1 and design.groups[0].drawn:
        return list(groups[0].names[:2])
    # axes that vary alone come before a zip, which is named by the first of its axes
    longest = sorted(groups, key=lambda group: (len(group.names) > 1, -group.length))
    names = [group.names[0] for group in longest[:2]]
    return sorted(names, key=design.names.index, reverse=True)


def _axes_of_records(table: pd.DataFrame, job: Job) -> tuple[str, str]:
    """The columns along x and y of a table with several records a row."""
    fields = [dict(figure) for figure in job.figures if dict(figure).get("y") is not None]
    y = fields[0]["y"] if fields else None
    observable = f"{job.design.model.observables[0].name}_n"
    first = column(table, y, ("_n", "")) if isinstance(y, str) else observable
    if job.run.kind_name == "return_map":
        forms = [of_figure["form"] for of_figure in fields if "form" in of_figure]
        return first, next_of(first) if forms[:1] == ["next"] else change_of(first)
    return job.run.moved or "crossing", first


def _outcomes(table: pd.DataFrame) -> tuple[list[dict[str, Any]], Int[np.ndarray, " records"]]:
    """The outcomes that occur, with their looks, and the number of each record's outcome.

    In rows with several records each record has its own outcome: its gait, hollow if a stair had not settled
    or a steady gait is unstable, and `failed` for the last crossings before a fall.
    """
    hollow = np.zeros(len(table), bool)
    suffix = ""
    if "stable" in table.columns:
        hollow = np.asarray(table["stable"].astype(object) == False)  # noqa: E712 - also missing values
        suffix = "unstable"
    elif "settled" in table.columns:
        hollow = ~is_true(table, "settled")
        suffix = Outcome.NOT_SETTLED
    if "cycles" in table.columns:  # one record a row
        shown = outcome_labels(table, "gait")
    else:
        numbered = [name for name in ("t",) if name in table.columns]  # NaN in a record without numbers
        labels = np.where(table["gait"].notna(), table["gait"].astype(str), "none").astype(object)
        gone = table["status"].astype(str) == Status.no_fixed_point.name
        labels[~sound(table, *numbered) | gone.to_numpy()] = Outcome.FAILED
        shown = pd.Series(labels, table.index)
    names = in_order(table, "gait", shown)
    colours, markers = theme.colours(names), theme.markers(names)
    outcomes: list[dict[str, Any]] = []
    numbers = np.zeros(len(table), np.int64)
    for name, is_hollow in itertools.product(names, (False, True)):
        records = np.asarray(shown == name) & (hollow == is_hollow)
        if records.any():
            numbers[records] = len(outcomes)
            outcomes.append(
                {
                    "name": f"{name}, {suffix}" if is_hollow else name,
                    "colour": colours[name],
                    "marker": markers[name],
                    "hollow": is_hollow,
                    "leads": name,
                    "hatched": name in (Outcome.NOT_SETTLED, Outcome.FAILED),
                }
            )
    return outcomes, numbers


def _slices(table: pd.DataFrame, job: Job, drawn: Sequence[int], few: int | None = None) -> list[Slice]:
    """The axes that are not drawn; with `few`, only parameters with at most that many values."""
    design = job.design
    row = table["row"].to_numpy(np.int64)
    parameters = {q.name for q in design.model.parameters}
    groups = [(place, group) for place, group in enumerate(design.groups) if group.length > 1]
    slices = []
    for number, (place, group) in enumerate(groups):
        is_few = few is None or (group.length <= few and bool(parameters & set(group.axes)))
        if number in drawn or not is_few:
            continue
        texts = []
        digits = {name: digits_of(table, name) for name in group.axes}
        for value in range(group.length):
            values = design.at(np.array([value * design.stride(place)]), tuple(group.axes))
            texts.append(
                ", ".join(written(table, name, float(v[0]), digits[name]) for name, v in values.items())
            )
        slices.append(Slice(next(iter(group.axes)), texts, design.index(row, place)))
    return slices


def boundary(shown: StartMap) -> Bool[np.ndarray, " records"]:
    """Whether a cell has a neighbour with another outcome in its slice; circular axes are closed."""
    assert shown.at is not None
    assert shown.edges is not None
    lengths = [len(edges) - 1 for edges in shown.edges]
    layer = np.zeros(len(shown.outcome), np.int64)
    for axis_of_slices in shown.slices:
        layer = layer * len(axis_of_slices.texts) + axis_of_slices.of_record
    _, layer = np.unique(layer, return_inverse=True)
    field = np.full((int(layer.max(initial=0)) + 1, *lengths), -1)
    at = (layer, shown.at[:, 0], shown.at[:, 1])
    field[at] = shown.outcome
    at_boundary = np.zeros(field.shape, bool)
    for axis, closed in ((1, shown.closed[0]), (2, shown.closed[1])):
        other = np.roll(field, -1, axis)
        differs = (field != other) & (field >= 0) & (other >= 0)
        if not closed:
            last = [slice(None)] * 3
            last[axis] = slice(-1, None)
            differs[tuple(last)] = False
        at_boundary |= differs | np.roll(differs, 1, axis)
    return at_boundary[at]


def spread(n: int) -> Int[np.ndarray, " n"]:
    """The numbers 0 to n-1, ordered so that the first k numbers are spread evenly for every k.

    Source: the sequence of van der Corput (1935) in base 2.
    """
    bits = max(1, int(n - 1).bit_length())
    numbers = np.arange(1 << bits)
    reversed_bits = np.zeros_like(numbers)
    for bit in range(bits):
        reversed_bits |= ((numbers >> bit) & 1) << (bits - 1 - bit)
    return reversed_bits[reversed_bits < n]


def subgrid(shown: StartMap) -> Int[np.ndarray, " records"]:
    """The records from a coarse grid of cells to ever finer ones, all slices in turn."""
    assert shown.at is not None
    assert shown.edges is not None
    level = np.zeros(len(shown.at), int)  # of the coarsest grid that has the cell
    longest = max(len(edges) - 1 for edges in shown.edges)
    spacing, number = 1, 0
    while spacing < longest:
        # shifted by half a spacing, so that coarse grids keep away from the edges of the map
        on_grid = ((shown.at - spacing // 2) % spacing == 0).all(axis=1)
        level[on_grid] = number
        spacing, number = 2 * spacing, number + 1
    rank = np.empty(len(level), np.int64)
    rank[spread(len(level))] = np.arange(len(level))
    return np.lexsort((rank, -level))


def cells_to_trace(
    shown: StartMap, simulated: Bool[np.ndarray, " records"], most: int
) -> tuple[Int[np.ndarray, " traced"], int]:
    """The records to animate, the most useful first, and the number of them at boundaries.

    Half of them are cells of a subgrid, the others are beside a boundary.

    Args:
        shown: the map.
        simulated: whether a record was simulated; others cannot be animated.
        most: largest number of records to animate.
    """
    even = subgrid(shown)
    even = even[simulated[even]]
    edge = np.flatnonzero(boundary(shown) & simulated)
    in_turn = even
    if len(edge):
        edge = edge[spread(len(edge))]
        in_turn = np.resize(edge, len(even))
    order: dict[int, None] = {}  # without repetitions, in the order of insertion
    for on_subgrid, beside_boundary in zip(even, in_turn, strict=True):
        order.setdefault(int(on_subgrid))
        order.setdefault(int(beside_boundary))
        if len(order) >= most:
            break
    chosen = np.array(list(order)[:most], np.int64)
    return chosen, int(np.isin(chosen, edge).sum())
