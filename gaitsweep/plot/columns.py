"""Columns of tables for figures: columns by name, how the job varies them, the outcomes of rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep import near_miss
from gaitsweep.analysis.records import outcome_labels
from gaitsweep.angles import branch_cut
from gaitsweep.angles import is_circular as is_angle
from gaitsweep.design.vary import written_groups
from gaitsweep.errors import UserError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OTHER = "another gait"  # settled, but in no gait of the model


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


def is_logarithmic(table: pd.DataFrame, name: str) -> bool:
    """Whether the table's job varies a column in equal ratios (`logspace`), on a logarithmic axis."""
    groups = written_groups(table.attrs.get("job", {}).get("vary"))
    axes = [group[name] for _, group in groups if name in group]
    return any(isinstance(axis, Mapping) and "logspace" in axis for axis in axes)


def log_axes(axes: Axes, table: pd.DataFrame, **along: str) -> None:
    """Make an axis logarithmic whose column (`x=`, `y=`) the table's job varies in equal ratios."""
    for which, name in along.items():
        if is_logarithmic(table, name):
            getattr(axes, f"set_{which}scale")("log")


def outcome(table: pd.DataFrame, hue: str) -> pd.Series:
    """The outcome of each row: its hue if it settled, else `not settled` or `failed`; NaN becomes `none`."""
    column(table, hue)
    return outcome_labels(table, hue)
