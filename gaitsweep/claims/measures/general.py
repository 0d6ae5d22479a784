"""Measures of any table or model: shares of rows, values of a column, default parameters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep import models
from gaitsweep.analysis.records import AnalysisError
from gaitsweep.claims.measure import measure
from gaitsweep.contract import Quantity
from gaitsweep.expression import resolve
from gaitsweep.near_miss import suggestion


class MeasureError(AnalysisError):
    """A table does not have what a measure needs; the message is a sentence."""


@measure
def share(table: pd.DataFrame, *, where: str, of: str | None = None) -> float:
    """Share of the rows that fulfil `where` among those that fulfil `of` (1).

    Args:
        table: a result table with one record a row.
        where, of: queries of pandas, such as `gait == 'direct'`; of all rows without `of`.

    Raises:
        MeasureError: no row fulfils `of`, or a query cannot be evaluated.
    """
    among = records(table, of)
    return len(records(among, where, may_be_empty=True)) / len(among)


@measure
def value(table: pd.DataFrame, *, column: str, where: str | None = None, take: str = "median") -> float:
    """One number from a column, in its unit.

    Args:
        table: a result table.
        column: the column.
        where: a query of pandas that selects records; all by default.
        take: min, max, median, mean, first, last or count.

    Raises:
        MeasureError: no record fulfils `where`, or the table has no such column or `take` is another word.
    """
    rows = records(table, where, may_be_empty=take == "count")
    if column not in rows.columns:
        raise MeasureError(f"The table has no column {column}.")
    if take in ("first", "last"):
        return float(rows[column].iloc[0 if take == "first" else -1])
    if take not in ("min", "max", "median", "mean", "count"):
        raise MeasureError(f"take is {take}: allowed are min, max, median, mean, first, last, count.")
    return float(getattr(rows[column], take)())


@measure
def texts(table: pd.DataFrame, *, column: str, where: str | None = None) -> list[str]:
    """The distinct texts of a column, in the order in which they appear.

    Args:
        table: a result table.
        column: the column.
        where: a query of pandas that selects records; all by default.

    Raises:
        MeasureError: no record fulfils `where`, or the table has no such column.
    """
    rows = records(table, where)
    if column not in rows.columns:
        raise MeasureError(f"The table has no column {column}.")
    return [str(text) for text in rows[column].dropna().unique()]


@measure
def ratio_of_medians(table: pd.DataFrame, *, column: str, where: str, to: str) -> float:
    """Median of a column in the records of one query, over that in the records of another (1)."""
    return value(table, column=column, where=where) / value(table, column=column, where=to)


@measure
def default_values(*, model: str, names: Sequence[str]) -> list[float]:
    """Default values of parameters of a model, in their units.

    Args:
        model: its name.
        names: the parameters.

    Raises:
        MeasureError: the model has no such parameter.
    """
    values = defaults(models.find(model)().parameters)
    for name in names:
        if name not in values:
            raise MeasureError(f"{name} is not a parameter of {model}{suggestion(name, values)}")
    return [values[name] for name in names]


def defaults(parameters: Iterable[Quantity]) -> dict[str, float]:
    """The default values of parameters, those that are formulas of others worked out."""
    written: dict[str, Any] = {quantity.name: quantity.default for quantity in parameters}
    return resolve(written, {})


def records(table: pd.DataFrame, where: str | None, may_be_empty: bool = False) -> pd.DataFrame:
    """The records of a table that fulfil a query of pandas; all of them without one.

    Raises:
        MeasureError: no record fulfils the query, unless that is allowed, or it cannot be evaluated.
    """
    if where is None:
        found = table
    else:
        try:
            found = table.query(where, engine="python")
        except (ValueError, SyntaxError, KeyError, TypeError, NameError, AttributeError) as error:
            raise MeasureError(f"The query {where} cannot be evaluated: {error}.") from error
        found.attrs = table.attrs
    if found.empty and not may_be_empty:
        raise MeasureError(f"No record of the table fulfils {where}." if where else "The table is empty.")
    return found


def masked(table: pd.DataFrame, mask: Any) -> pd.DataFrame:
    """The records (n,) where `mask` (n,) is true."""
    return pd.DataFrame(table.loc[np.asarray(mask, bool)])


def numbers(table: pd.DataFrame, column: str) -> np.ndarray:
    """A column as floats, (n,), in its unit."""
    return np.asarray(table[column], float)


def one_row(table: pd.DataFrame, row: int) -> pd.DataFrame:
    """The records of one row, those of a trace in order of time.

    Raises:
        MeasureError: the table has no such row.
    """
    part = masked(table, table["row"] == row)
    if part.empty:
        raise MeasureError(f"The table has no row {row}.")
    return part.sort_values(by="t") if "t" in part.columns else part
