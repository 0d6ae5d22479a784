"""Measures: functions that compute a claim's value from tables, registered by name; here the general ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, Any, Literal, TypeVar, cast

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int, Shaped
from numpy.typing import ArrayLike
from pydantic import AfterValidator

from gaitsweep import models
from gaitsweep.analysis.records import AnalysisError, require
from gaitsweep.angles import in_nearest_turn, is_circular
from gaitsweep.contract import Quantity
from gaitsweep.errors import ArgumentError
from gaitsweep.expression import fulfilled, in_order, read_condition, resolve
from gaitsweep.near_miss import suggestion

# Selects the records of a table; a claim's is checked when its list is read.
Condition = Annotated[str, AfterValidator(read_condition)]
Value = float | str | Sequence[float] | Sequence[str]
Measure = TypeVar("Measure", bound=Callable[..., Value])

MEASURES: dict[str, Callable[..., Value]] = {}

LONGEST_BREAK = 0.05  # s; a shorter loss of contact is a break of the stance, not a swing


def measure(function: Measure) -> Measure:
    """Register a function as a measure, under its name; a decorator.

    A measure takes the tables of a claim's jobs by position and the fields of `with` by keyword. It returns
    a number, a text, or a list of either. It raises UserError if the tables lack the needed data.

    Raises:
        ValueError: another function has this name.
    """
    name = function.__name__
    if MEASURES.setdefault(name, function) is not function:
        raise ValueError(f"A measure named {name} exists already: choose another name.")
    return function


class Angle(float):
    """An angle (rad), which is the same after a whole turn."""


class MeasureError(AnalysisError):
    """A table lacks data that a measure needs; the message is a sentence."""


def plain_value(result: object) -> Value:
    """The result of a measure as a number or a text of Python, or a list of either.

    Args:
        result: what a measure returned; numbers and arrays (n,) of NumPy and pandas are converted.

    Raises:
        MeasureError: it is none of these.
    """
    converted = result.tolist() if isinstance(result, np.ndarray | np.generic | pd.Series) else result
    is_list = isinstance(converted, list | tuple)
    items: list[Any] = list(converted) if is_list else [converted]
    items = [item.item() if isinstance(item, np.generic) else item for item in items]
    if not all(isinstance(item, int | float | str) for item in items):
        allowed = "a number, a text, or a list of either"
        raise MeasureError(f"The measure returned {type(result).__name__}, but must return {allowed}.")
    return items if is_list else items[0]


@measure
def share(table: pd.DataFrame, *, where: Condition, of: Condition | None = None) -> float:
    """Fraction of the rows fulfilling `of` that also fulfil `where` (1).

    Args:
        table: a result table with one record a row.
        where, of: conditions, such as `gait == 'direct'`; without `of` all rows count.

    Raises:
        MeasureError: no row fulfils `of`.
        ExpressionError: a condition cannot be evaluated over the table's columns.
    """
    all_rows = records(table, of)
    return len(records(all_rows, where, may_be_empty=True)) / len(all_rows)


@measure
def difference_of_shares(table: pd.DataFrame, *, where: Condition, of: Condition, less: Condition) -> float:
    """Fraction fulfilling `where` among the rows of `of`, minus that among the rows of `less` (1).

    Args:
        table: a result table with one record a row.
        where, of, less: conditions.

    Raises:
        MeasureError, ExpressionError: as for `share`.
    """
    return share(table, where=where, of=of) - share(table, where=where, of=less)


Reduction = Literal["min", "max", "median", "mean", "first", "last", "count"]
_REDUCTIONS: dict[Reduction, Callable[[pd.Series], float]] = {
    "min": pd.Series.min,
    "max": pd.Series.max,
    "median": pd.Series.median,
    "mean": pd.Series.mean,
    "first": lambda column: column.iloc[0],
    "last": lambda column: column.iloc[-1],
    "count": pd.Series.count,
}
_OF_ALL: tuple[Reduction, ...] = ("min", "max", "median", "mean")


@measure
def value(
    table: pd.DataFrame, *, column: str, where: Condition | None = None, take: Reduction = "median"
) -> float:
    """One number from a column, in its unit; of angles in the turn in which they are nearest to each other.

    Args:
        table: a result table.
        column: the column.
        where: a condition that selects records; all by default.
        take: the statistic; `count` is the number of records with a value.

    Raises:
        MeasureError: no record fulfils `where`, the values of the column are not numbers, or `take` is not
            allowed.
        ColumnError: the table has no such column.
        ExpressionError: the condition cannot be evaluated over the table's columns.
    """
    values = _column(records(table, where, may_be_empty=take == "count"), column)
    if take not in _REDUCTIONS:
        raise MeasureError(f"take is {take}{suggestion(take, _REDUCTIONS)}")
    try:
        if take == "count" or not is_circular(table, column):
            return float(_REDUCTIONS[take](values))
        return Angle(_REDUCTIONS[take](in_nearest_turn(values) if take in _OF_ALL else values))
    except (TypeError, ValueError):
        text = f"The values of {column} are not numbers: use the measure texts, or take: count."
        raise MeasureError(text) from None


@measure
def texts(table: pd.DataFrame, *, column: str, where: Condition | None = None) -> list[str]:
    """The distinct texts of a column, in the order in which they appear.

    Args:
        table: a result table.
        column: the column.
        where: a condition that selects records; all by default.

    Raises:
        MeasureError, ColumnError, ExpressionError: as for `value`.
    """
    return [str(text) for text in _column(records(table, where), column).dropna().unique()]


@measure
def ratio_of_medians(table: pd.DataFrame, *, column: str, where: Condition, to: Condition) -> float:
    """Median of a column over the records of one condition, divided by that of another condition (1).

    Args:
        table: a result table.
        column: the column.
        where, to: the conditions.

    Raises:
        MeasureError, ColumnError, ExpressionError: as for `value`.
    """
    return value(table, column=column, where=where) / value(table, column=column, where=to)


@measure
def default_values(*, model: str, names: Sequence[str]) -> list[float]:
    """Default values of parameters of a model, in their units.

    Args:
        model: its name.
        names: the parameters.

    Raises:
        ArgumentError: the model has no such parameter.
        ModelError: there is no such model.
    """
    values = defaults(models.find(model)().parameters)
    for name in names:
        if name not in values:
            raise ArgumentError(f"{name} is not a parameter of {model}{suggestion(name, values)}")
    return [values[name] for name in names]


def defaults(parameters: Iterable[Quantity]) -> dict[str, float]:
    """The default values of parameters, with formulas evaluated."""
    written: dict[str, Any] = {quantity.name: quantity.default for quantity in parameters}
    return resolve(in_order(written), {})


def records(table: pd.DataFrame, where: str | None, *, may_be_empty: bool = False) -> pd.DataFrame:
    """The records of a table that fulfil a condition; without a condition, all records.

    Args:
        table: a result table.
        where: the condition.
        may_be_empty: whether a result without records is allowed.

    Raises:
        MeasureError: no record fulfils the condition, and `may_be_empty` is false.
        ExpressionError: the condition cannot be evaluated over the table's columns.
    """
    rows = table
    if where is not None:
        rows = masked(table, fulfilled(where, {str(name): column for name, column in table.items()}, _plain))
    if rows.empty and not may_be_empty:
        raise MeasureError(f"No record of the table fulfils {where}." if where else "The table is empty.")
    return rows


def _plain(column: pd.Series) -> Shaped[np.ndarray, " rows"]:
    """The values of a column for conditions: numbers, truth values, or objects; missing ones are NaN.

    Truth values of which some are missing are numbers, 0 and 1.
    """
    is_flags = pd.api.types.infer_dtype(column, skipna=True) == "boolean"
    if is_flags and not column.hasnans:
        return column.to_numpy(bool)
    if is_flags or pd.api.types.is_numeric_dtype(column.dtype):
        return column.to_numpy(np.float64, na_value=np.nan)
    return column.astype(object).where(column.notna(), np.nan).to_numpy(object)


def _column(table: pd.DataFrame, name: str) -> pd.Series:
    """A column of a table; raises ColumnError for a name that it does not have."""
    require(table, name)
    return pd.Series(table[name])


def masked(table: pd.DataFrame, mask: ArrayLike) -> pd.DataFrame:
    """The records (n,) where `mask` (n,) is true, with the table's `attrs`, so with its job."""
    return cast(pd.DataFrame, table.loc[np.asarray(mask, bool)])  # a new DataFrame would lose the attributes


def numbers(table: pd.DataFrame, column: str) -> Float[np.ndarray, " rows"]:
    """A column as floats, (n,), in its unit.

    Raises:
        ColumnError: the table has no such column.
    """
    return np.asarray(_column(table, column), float)


def stances(
    t: Float[np.ndarray, " samples"], down: Bool[np.ndarray, " samples"]
) -> Int[np.ndarray, "stances 2"]:
    """First sample of each stance and first sample after it, (n, 2), without breaks of `LONGEST_BREAK`.

    Args:
        t: times of the samples (k,), s.
        down: whether the foot is on the ground (k,).
    """
    turns = np.flatnonzero(np.diff(np.concatenate([[False], down, [False]]).astype(int)))
    lands = turns[::2]
    lifts = turns[1::2]
    swings = t[lands[1:]] - t[lifts[:-1]] > LONGEST_BREAK
    first = np.ones(len(lands), bool)
    last = np.ones(len(lands), bool)
    first[1:], last[:-1] = swings, swings
    return np.stack([lands[first], lifts[last]], axis=1)


def one_row(table: pd.DataFrame, row: int) -> pd.DataFrame:
    """The records of one row, those of a trace in order of time.

    Raises:
        MeasureError: the table has no such row.
    """
    part = masked(table, table["row"] == row)
    if part.empty:
        raise MeasureError(f"The table has no row {row}.")
    return part.sort_values(by="t", kind="stable") if "t" in part.columns else part
