"""Measures of any table: shares of rows, and values of a column."""

from __future__ import annotations

import pandas as pd

from gaitsweep.claims.measure import measure
from gaitsweep.errors import UserError


class MeasureError(UserError):
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
    among = _rows(table, of)
    return len(_rows(among, where, may_be_empty=True)) / len(among)


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
    rows = _rows(table, where, may_be_empty=take == "count")
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
    rows = _rows(table, where)
    if column not in rows.columns:
        raise MeasureError(f"The table has no column {column}.")
    return [str(text) for text in rows[column].dropna().unique()]


def _rows(table: pd.DataFrame, where: str | None, may_be_empty: bool = False) -> pd.DataFrame:
    if where is None:
        found = table
    else:
        try:
            found = table.query(where, engine="python")
        except (ValueError, SyntaxError, KeyError, TypeError, NameError, AttributeError) as error:
            raise MeasureError(f"The query {where} cannot be evaluated: {error}.") from error
    if found.empty and not may_be_empty:
        raise MeasureError(f"No record of the table fulfils {where}." if where else "The table is empty.")
    return found
