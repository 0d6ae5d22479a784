"""Design of a job: the parameters and starts of each row, computed from the row's number."""

from __future__ import annotations

import dataclasses
import functools
import graphlib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from gaitsweep.contract import Model, Params, Quantity
from gaitsweep.design.axes import LinearSpacing, ListAxis, RangeAxis
from gaitsweep.design.vary import Group
from gaitsweep.errors import JobError
from gaitsweep.expression import functions_of, names_used, resolve
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.numbers import bound

# Limits of a name that is checked before a job runs: combinations of its axes, and these times the letters of
# its formulas.
MAX_CHECKED = 1_000_000
MAX_LETTERS = 20_000_000
MAX_CELLS = 200_000  # points of an axis whose distinct values are counted
MAX_FEW_VALUES = 4  # distinct values of an axis without equal steps that figures draw as cells

RowNumbers = Int[np.ndarray, " rows"]
Columns = dict[str, Float[np.ndarray, " rows"]]  # the values of rows by name


class RowValues(NamedTuple):
    """All parameters and all starts of some rows: float64 arrays (n,) by name."""

    parameters: Columns
    starts: Columns


@dataclasses.dataclass(frozen=True)
class GridAxis:
    """Position of an axis among a design's groups, and whether its last cell borders on its first."""

    place: int
    closed: bool


@dataclasses.dataclass(frozen=True)
class Design:
    """Rows of a job; their values follow from their numbers, so memory does not grow with their number.

    `settings` has a number or a formula for each parameter and start that does not vary, including the
    model's defaults; NaN stands for a start that the model itself decides. The parameter of a ramp or
    staircase has the first value of its path. `sizes` are the numbers of the structure.
    """

    model: Model
    groups: tuple[Group, ...]
    settings: dict[str, float | str]
    sizes: dict[str, float]

    @property
    def n_rows(self) -> int:
        """Number of rows: the product of the axes' lengths, 1 without axes."""
        return math.prod(group.length for group in self.groups)

    @property
    def names(self) -> tuple[str, ...]:
        """Names that vary, in the order of the table's columns."""
        return tuple(name for group in self.groups for name in group.axes)

    @property
    def derived(self) -> dict[str, str]:
        """Formulas of the parameters that follow others, with the structure's numbers filled in.

        A parameter that moves while a row runs (ramp, staircase) also moves the parameters `following` it.
        """
        parameters = [quantity.name for quantity in self.model.parameters]
        settings = {name: self.settings[name] for name in parameters if name in self.settings}
        # a negative number in parentheses, since powers bind more than the minus
        operands = {size: f"({n!r})" if n < 0.0 else repr(n) for size, n in self.sizes.items()}

        return {
            name: re.sub(r"\b[A-Za-z_]\w*", lambda word: operands.get(word[0], word[0]), setting)
            for name, setting in settings.items()
            if isinstance(setting, str)
        }

    def values(self, start: int, stop: int) -> RowValues:
        """Return the values in rows start..stop-1.

        Raises:
            IndexError: the job does not have these rows.
            ExpressionError: an expression has no value in one of these rows.
            JobError: the model does not allow a value; only for names that are not `checkable`.
        """
        if not 0 <= start <= stop <= self.n_rows:
            raise IndexError(f"Rows {start} to {stop} are out of range: the job has {self.n_rows} rows.")
        return self.values_in(np.arange(start, stop, dtype=np.int64))

    def values_in(self, rows: RowNumbers) -> RowValues:
        """Return the values in some rows, as `values` does.

        Args:
            rows: the rows (n,), int64.

        Raises:
            ExpressionError, JobError: as `values`.
        """
        parameters = [quantity.name for quantity in self.model.parameters]
        starts = [quantity.name for quantity in self.model.initial_conditions]
        values = self.at(rows, [*parameters, *starts])
        self._check_block(rows, values)
        if self.model.host_parameters:  # a user's `on_host` may change values in place
            values = {name: np.array(column) for name, column in values.items()}
        return RowValues({name: values[name] for name in parameters}, {name: values[name] for name in starts})

    def at(self, rows: RowNumbers, wanted: Iterable[str]) -> Columns:
        """Return the values of names in some rows.

        Args:
            rows: the rows (n,), int64.
            wanted: the names.

        Returns:
            Float64 arrays (n,) by name, in the order of `wanted`; read-only, since a value that all rows
            have takes no memory.

        Raises:
            ExpressionError: an expression has no value in one of these rows.
        """
        wanted = tuple(wanted)
        needed = self.closure(wanted)
        known: dict[str, Any] = dict(self.sizes)
        for name in self.order:
            if name not in needed:
                continue
            if name in self._places:
                place = self._places[name]
                axis = self.groups[place].axes[name]
                if not axis.formulas and axis.length < rows.size:
                    known[name] = self._spread(axis.at(np.arange(axis.length), known), rows, place)
                else:
                    known[name] = axis.at(self.index(rows, place), known)
            else:
                known = resolve({name: self.settings[name]}, known)
        return {name: np.broadcast_to(np.asarray(known[name], np.float64), rows.shape) for name in wanted}

    def row(self, number: int) -> dict[str, float]:
        """Return all parameters and starts of a row; NaN for a start that the model itself decides.

        Raises:
            IndexError, ExpressionError, JobError: as `values`.
        """
        parameters, starts = self.values(number, number + 1)
        return {name: float(value[0]) for name, value in {**parameters, **starts}.items()}

    def closure(self, names: Iterable[str]) -> set[str]:
        """Return the names and all names in their formulas, directly or indirectly."""
        reached: set[str] = set()
        waiting = list(names)
        while waiting:
            name = waiting.pop()
            if name not in reached:
                reached.add(name)
                waiting.extend(self.uses(name))
        return reached

    def following(self, *parameters: str) -> dict[str, str]:
        """Return the formulas of parameters that move with `parameters`, each after those that it uses."""
        derived = self.derived
        others = (name for name in self.order if name in derived and name not in parameters)
        return {name: derived[name] for name in others if not self.closure([name]).isdisjoint(parameters)}

    def uses(self, name: str) -> set[str]:
        """Return the quantities that the formulas of `name` use directly."""
        if name in self._places:
            settings: tuple[float | str, ...] = self.groups[self._places[name]].axes[name].formulas
        else:
            settings = (self.settings[name],)
        return {used for setting in settings for used in names_used(setting)} - set(self.sizes)

    @functools.cached_property
    def order(self) -> tuple[str, ...]:
        """All names, each after those that it uses.

        Raises:
            graphlib.CycleError: names use each other in a cycle.
        """
        graph = {name: sorted(self.uses(name)) for name in [*self.settings, *self._places]}
        return tuple(graphlib.TopologicalSorter(graph).static_order())

    @property
    def grids(self) -> dict[str, GridAxis]:
        """Separate axes (not in a zip or sample) with equal steps or ratios, by name."""
        return {
            name: GridAxis(place, self._closed(name, axis))
            for place, group in enumerate(self.groups)
            for name, axis in group.axes.items()
            if len(group.axes) == 1 and isinstance(axis, RangeAxis) and not axis.drawn
        }

    def is_drawn_as_cells(self, name: str) -> bool:
        """Return whether figures draw a name as cells: equal steps or ratios, or at most four values."""
        if name not in self._places:
            return False
        axis = self.groups[self._places[name]].axes[name]
        if axis.formulas or axis.length > MAX_CELLS:
            return False
        is_regular = isinstance(axis, RangeAxis) and not axis.drawn
        return is_regular or np.unique(axis.at(np.arange(axis.length), {})).size <= MAX_FEW_VALUES

    def _closed(self, name: str, axis: RangeAxis) -> bool:
        """Return whether an axis is an angle whose cells cover one turn, in either direction."""
        quantities = (*self.model.parameters, *self.model.initial_conditions)
        is_angle = any(quantity.circular for quantity in quantities if quantity.name == name)
        if not is_angle or axis.logarithmic or axis.formulas:
            return False
        steps = axis.length if axis.fraction == LinearSpacing(axis.length, "centre") else axis.length - 1
        width = abs(float(axis.high) - float(axis.low))
        return steps > 0 and math.isclose(width * axis.length, 2.0 * math.pi * steps)

    def with_columns(self, columns: Mapping[str, Float[np.ndarray, " rows"]]) -> Design:
        """Return the design whose rows are the entries of these columns (n,), without other axes."""
        settings = {name: value for name, value in self.settings.items() if name not in columns}
        group = Group({name: ListAxis(column) for name, column in columns.items()})
        return dataclasses.replace(self, groups=(group,), settings=settings)

    def stride(self, position: int) -> int:
        """Return the number of rows for which the group at `position` keeps its point."""
        return math.prod(group.length for group in self.groups[position + 1 :])

    def index(self, rows: RowNumbers, position: int) -> Int[np.ndarray, " rows"]:
        """Return the index of the point of the group at `position` in rows (n,)."""
        stride, length = self.stride(position), self.groups[position].length
        turns = rows // stride if stride > 1 else rows
        # NumPy's remainder takes several times as long
        return turns - turns // length * length

    def _spread(
        self, points: Float[np.ndarray, " points"], rows: RowNumbers, position: int
    ) -> Float[np.ndarray, " rows"]:
        """Return the values in rows (n,) of an axis of the group at `position`, from those at its points."""
        stride, length = self.stride(position), points.size
        first, last = int(rows[0]), int(rows[-1])
        if last - first != rows.size - 1 or np.any(rows[1:] <= rows[:-1]):
            return points[self.index(rows, position)]
        # consecutive rows repeat the points in order, which takes less time than to look them up
        if stride == 1:
            return np.tile(points, 2 + rows.size // length)[first % length :][: rows.size]
        turns = np.arange(first // stride, last // stride + 1)
        ends = np.minimum((turns + 1) * stride, last + 1)
        return np.repeat(points[turns % length], ends - np.maximum(turns * stride, first))

    def spans(self, name: str) -> tuple[int, ...]:
        """Return the positions of the groups on which the value of a name depends."""
        needed = self.closure([name])
        return tuple(place for place, group in enumerate(self.groups) if needed & set(group.axes))

    def rows_over(
        self, points: Int[np.ndarray, " combinations"], positions: Sequence[int]
    ) -> Int[np.ndarray, " combinations"]:
        """Return rows at combinations of the points of some groups; other groups have their first point.

        Args:
            points: the numbers of the combinations (n,); the last group varies fastest.
            positions: the positions of the groups.
        """
        rows = np.zeros_like(points)
        for position in reversed(positions):
            length = self.groups[position].length
            rows += points % length * self.stride(position)
            points = points // length
        return rows

    def combinations(self, names: Iterable[str], most: int) -> tuple[RowNumbers, int]:
        """Return the first row with each combination of values of names, and the number of combinations.

        Args:
            names: the names.
            most: the largest number of rows; of more combinations, evenly spaced ones have a row.
        """
        positions = sorted({position for name in names for position in self.spans(name)})
        count = math.prod(self.groups[position].length for position in positions)
        points = np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(np.int64)
        return self.rows_over(points, positions), count

    def with_moved(self, values: Columns, place: Mapping[str, float]) -> Columns:
        """Return the parameters of rows where some of them move.

        Args:
            values: the parameters, (n,) by name.
            place: the value of each parameter that moves; those that follow it by a formula change with it.
        """
        size = next((column.size for column in values.values()), 0)
        moved = {name: np.full(size, value) for name, value in place.items()}
        return resolve(self.following(*place), {**values, **moved}, functions_of(np))

    def checkable(self, name: str) -> bool:
        """Return whether a name has so few values that all can be checked before the job runs.

        Plain numbers have, and so have formulas whose axes have few combinations.
        """
        if name in self._places and not self.uses(name):
            return True
        count = math.prod(self.groups[place].length for place in self.spans(name))
        texts = (self.settings.get(closed_name) for closed_name in self.closure([name]))
        letters = sum(len(text) for text in texts if isinstance(text, str))
        return count <= MAX_CHECKED and count * letters <= MAX_LETTERS

    def _check_block(self, rows: RowNumbers, values: Columns) -> None:
        """Raise JobError for a value in `rows` (n,) that is not allowed; `checkable` names are left out."""
        for quantity in self._unchecked:
            column = values[quantity.name]
            wrong = np.flatnonzero(~inside(column, quantity))
            if wrong.size:
                text = f"is {column[wrong[0]]:g} in row {rows[wrong[0]]}, but {requirement(quantity)}."
                raise JobError([Diagnostic((quantity.name,), text)])

    @functools.cached_property
    def _unchecked(self) -> list[Quantity]:
        """Quantities whose values are checked block by block."""
        quantities = (*self.model.parameters, *self.model.initial_conditions)
        return [quantity for quantity in quantities if not self.checkable(quantity.name)]

    @functools.cached_property
    def _places(self) -> dict[str, int]:
        """Position of the group of each name that varies."""
        return {name: place for place, group in enumerate(self.groups) for name in group.axes}


def row_params(design: Design, row: int) -> Params:
    """Return the model's parameters of a row, a frozen pytree.

    Args:
        design: the rows.
        row: the number of the row.

    Raises:
        IndexError: the design does not have this row.
    """
    values = design.model.on_host(design.values(row, row + 1).parameters)
    return design.model.params({name: jnp.asarray(value[0]) for name, value in values.items()})


def inside(values: Float[np.ndarray, " *rows"], quantity: Quantity) -> np.ndarray:
    """Return a mask of allowed values of a quantity; NaN is allowed for a start that the model decides."""
    if quantity.open_ends:
        is_inside = (values > quantity.low) & (values < quantity.high)
    else:
        is_inside = (values >= quantity.low) & (values <= quantity.high)
    if quantity.whole:
        is_inside = is_inside & (values == np.round(values))
    model_decides = isinstance(quantity.default, float) and math.isnan(quantity.default)
    return is_inside | np.isnan(values) if model_decides else is_inside


def requirement(quantity: Quantity) -> str:
    """Return the end of a message about a value out of range: allowed range, meaning and unit."""
    unit = "" if quantity.unit in ("", "1") else f", in {quantity.unit}"
    limits = bound(quantity.low, quantity.high, open_ends=quantity.open_ends)
    if quantity.whole:
        is_unlimited = math.isinf(quantity.low) and math.isinf(quantity.high)
        limits = "a whole number" if is_unlimited else f"a whole number {limits}"
    return f"must be {limits} ({quantity.meaning}{unit})"
