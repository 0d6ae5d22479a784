"""Columns of tables for figures: columns by name, how the job varies them, the outcomes of rows."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep import near_miss
from gaitsweep.analysis.records import axes_of, outcome_labels
from gaitsweep.angles import branch_cut
from gaitsweep.angles import is_circular as is_angle
from gaitsweep.design.vary import written_groups
from gaitsweep.errors import UserError
from gaitsweep.status import Outcome

if TYPE_CHECKING:
    from matplotlib.axes import Axes


OTHER = "another gait"  # settled, but in no gait of the model
HATCHED = (Outcome.NOT_SETTLED, Outcome.FAILED)  # outcomes whose cells are hatched grey, whatever the hue is


class PlotError(UserError, ValueError):
    """A figure cannot be drawn from this table; the message is a sentence for the user."""


def column(table: pd.DataFrame, name: str, suffixes: Sequence[str] = ("",)) -> str:
    """The column with a name and the first of some suffixes that the table has.

    Raises:
        PlotError: the table has no such column; the message names the near miss and the columns.
    """
    for suffix in suffixes:
        if name + suffix in table.columns:
            return name + suffix
    raise PlotError(
        f"{name} is not a column of this table{near_miss.column_suggestion(name, map(str, table.columns))}"
    )


def recorded_column(table: pd.DataFrame, y: str | None) -> str:
    """The column of an observable at the points of branches; by default that of the table's first one.

    Raises:
        PlotError: as for `column`, or the table names no observable.
    """
    observables = [*table.attrs.get("recorded", ()), *(name for name in table if str(name).endswith("_n"))]
    if y is None and not observables:
        raise PlotError(
            f"The table names no observable: give y. {near_miss.allowing(map(str, table.columns))}"
        )
    return column(table, y or observables[0], ("_n", ""))


def require_columns(table: pd.DataFrame, *names: str | None) -> None:
    """Refuse a table that lacks one of some columns; names that are None are skipped.

    Raises:
        PlotError: as for `column`.
    """
    for name in names:
        if name is not None:
            column(table, name)


def origin_of(table: pd.DataFrame, name: str, values: Float[np.ndarray, " values"]) -> float | None:
    """The angle (rad) at which an axis cuts the circle of a column's `values`; None if they are no angles."""
    return branch_cut(values) if is_angle(table, name) else None


def rows_where(table: pd.DataFrame, mask: Any) -> pd.DataFrame:
    """The rows of a table for which the mask is true."""
    return cast(pd.DataFrame, table.loc[np.asarray(mask, bool)])


def by_value(table: pd.DataFrame, name: str | None) -> list[tuple[Any, pd.DataFrame]]:
    """The values of a column, rising, each with its rows; None with the whole table if there are none."""
    values = [] if name is None else sorted(table[name].dropna().unique())
    return [(value, rows_where(table, table[name] == value)) for value in values] or [(None, table)]


def moved_parameter(table: pd.DataFrame) -> str | None:
    """The parameter that the table's job moves; None if it moves none."""
    return table.attrs.get("job", {}).get("run", {}).get("parameter")


def branch_parameter(table: pd.DataFrame) -> str:
    """The parameter along the branches of a table, which its job moves.

    Raises:
        PlotError: the table has no job that moves one, as a table that another program has written.
    """
    parameter = moved_parameter(table)
    if parameter is None:
        raise PlotError("The table's job moves no parameter: load the result of such a job by gs.load(DIR).")
    return parameter


def is_drawn(table: pd.DataFrame, name: str) -> bool:
    """Whether the table's job draws the values of a column: at random, or from a Sobol sequence."""
    for form, group in written_groups(table.attrs.get("job", {}).get("vary")):
        if form == "sample" and name in group.get("of", {}):
            return True
        axis = group.get(name)
        if form != "sample" and isinstance(axis, Mapping) and {"random", "sobol"} & set(axis):
            return True
    return False


def _written_axes(table: pd.DataFrame, name: str) -> list[Any]:
    """The axis of a column as the table's job has it, alone or in a zip; empty without one."""
    groups = written_groups(table.attrs.get("job", {}).get("vary"))
    return [group[name] for _, group in groups if name in group]


def is_logarithmic(table: pd.DataFrame, name: str) -> bool:
    """Whether the table's job varies a column in equal ratios (`logspace`), on a logarithmic axis."""
    return any(isinstance(axis, Mapping) and "logspace" in axis for axis in _written_axes(table, name))


def listed_values(table: pd.DataFrame, name: str) -> list[float]:
    """The values of a column that the table's job lists one by one; empty if it does not list numbers."""
    for axis in _written_axes(table, name):
        values = axis.get("values") if isinstance(axis, Mapping) else axis
        if isinstance(values, list) and all(isinstance(value, int | float) for value in values):
            return [float(value) for value in values]
    return []


def is_turn(table: pd.DataFrame, name: str) -> bool:
    """Whether a column is an angle along an axis that is not logarithmic, with ticks in multiples of pi."""
    return is_angle(table, name) and not is_logarithmic(table, name)


def log_axes(axes: Axes, table: pd.DataFrame, **along: str) -> None:
    """Make an axis logarithmic whose column (`x=`, `y=`) the table's job varies in equal ratios."""
    for which, name in along.items():
        if is_logarithmic(table, name):
            getattr(axes, f"set_{which}scale")("log")


def outcome(table: pd.DataFrame, hue: str) -> pd.Series:
    """The outcome of each row: its hue if it settled, else `not settled` or `failed`; NaN becomes `none`."""
    column(table, hue)
    return outcome_labels(table, hue)


MOST_PANELS = 12  # for values that are not named by `panels`


def parameters_of(table: pd.DataFrame) -> set[str]:
    """The names of the parameters of a table's model; none if the model is not known."""
    from gaitsweep.plot.limbs import model_of  # jobs are read without Matplotlib

    model = model_of(table)
    return set() if model is None else {quantity.name for quantity in model.parameters}


def varying_parameters(table: pd.DataFrame) -> list[str]:
    """The parameters of a table's model that differ between its rows, without the seeds of an ensemble.

    Rows that differ in starts and seeds are of one system; rows that differ in a parameter are not. A table
    without a known model has none.
    """
    parameters = parameters_of(table)
    return [
        name for name in axes_of(table) if is_compared(name, parameters) and len(table[name].unique()) > 1
    ]


def is_compared(name: str, parameters: Collection[str]) -> bool:
    """Whether an axis is one of the parameters, whose values are different systems, and no seed."""
    return name in parameters and not name.endswith("seed")


def too_many_panels(names: Sequence[str], count: int, value: object) -> str:
    """The sentence about a figure whose rows differ in parameters with too many combinations."""
    differ = " and ".join(names)
    return (
        f"The rows differ in {differ}, in {count} combinations, and each has a panel, of which a figure has "
        f'{MOST_PANELS} at most: keep some of the rows, such as table[table["{names[-1]}"] == {value}].'
    )


def require_one_system(table: pd.DataFrame, *shown: str | None) -> None:
    """Refuse a table whose rows differ in a parameter that a figure does not show.

    Args:
        table: the table.
        shown: columns that the figure shows, along an axis, by panels or by colours; None is skipped.

    Raises:
        PlotError: they differ; the message names the parameter and rows to keep.
    """
    hidden = [name for name in varying_parameters(table) if name not in shown]
    if hidden:
        value = table[hidden[0]].iloc[0]
        raise PlotError(
            f"The rows differ in {' and '.join(hidden)}, too, which this figure does not show: keep the rows "
            f'of one value, such as table[table["{hidden[0]}"] == {value}].'
        )
