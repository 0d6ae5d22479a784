"""What analyses read from tables: columns by name, what varies, and the records that a fall spoils."""

from __future__ import annotations

import numpy as np
import pandas as pd

from gaitsweep import near_miss
from gaitsweep.contract import Status, Verdict
from gaitsweep.errors import UserError

FAILURES, UNDECIDED = Status.of(Verdict.failed), Status.of(Verdict.undecided)
BEFORE_A_FALL = 10  # crossings before a failure that belong to the fall, not to a gait

_AFTER_AXES = ("stair", "crossing", "pass", "t", "status")


class AnalysisError(UserError, ValueError):
    """A table cannot be analysed so; the message is a sentence for the user."""


def section_column(table: pd.DataFrame, observable: str) -> str:
    """The column of a section observable, by the observable's own name or its column's.

    Raises:
        AnalysisError: there is none; it names the near miss and the columns that there are.
    """
    for name in (f"{observable}_n", observable):
        if name in table.columns:
            return name
    raise AnalysisError(_not_there(table, observable))


def require(table: pd.DataFrame, *names: str) -> None:
    """Raise AnalysisError for the first of the columns that is not there."""
    for name in names:
        if name not in table.columns:
            raise AnalysisError(_not_there(table, name))


def axes_of(table: pd.DataFrame) -> list[str]:
    """The columns of what varies: those between `row` and the first that every table of its kind has."""
    names = [str(name) for name in table.columns]
    ends = [names.index(name) for name in _AFTER_AXES if name in names]
    return [name for name in names[: min(ends, default=0)] if name != "row"]


def sound(table: pd.DataFrame, *columns: str) -> np.ndarray:
    """Which records of crossings to read: finite in the columns, and not among the last ones before a fall.

    Rows that failed lose their last `BEFORE_A_FALL` crossings; a staircase's records, which stand at the ends
    of holds that were walked through, are all kept.
    """
    kept = np.asarray(np.isfinite(table[list(columns)].to_numpy(float)).all(axis=1))
    if "status" not in table.columns or "stair" in table.columns:
        return kept
    fell = table["status"].astype(str).isin(list(FAILURES)).to_numpy()
    if fell.any():
        to_the_end = table.groupby("row").cumcount(ascending=False).to_numpy()
        kept = kept & ~(fell & (to_the_end < BEFORE_A_FALL))
    return np.asarray(kept, bool)


def _not_there(table: pd.DataFrame, name: str) -> str:
    return f"{name} is not a column of this table{near_miss.suggestion(name, map(str, table.columns))}"
