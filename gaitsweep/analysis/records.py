"""Reading of tables for analyses: columns by name, swept axes, outcomes of rows, records before a fall."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import cast

import numpy as np
import pandas as pd
from jaxtyping import Bool, Int

from gaitsweep import near_miss
from gaitsweep.errors import ArgumentError, UserError
from gaitsweep.status import Outcome, Status
from gaitsweep.table.frames import outcomes

BEFORE_A_FALL = 10  # crossings before a failure that belong to the fall, not to a gait

_AFTER_AXES = ("stair", "crossing", "pass", "t", "status")


class AnalysisError(UserError, ValueError):
    """A table does not allow this analysis; the message is a sentence for the user."""


class ColumnError(AnalysisError):
    """A table does not have a column; the message is a sentence for the user."""


def section_column(table: pd.DataFrame, observable: str) -> str:
    """The column of a section observable.

    Args:
        table: a table of section crossings.
        observable: the name of the observable, or of its column.

    Raises:
        ColumnError: the table has no such column; the message names the near miss.
    """
    for name in (f"{observable}_n", observable):
        if name in table.columns:
            return name
    raise ColumnError(_not_there(table, observable))


def require(table: pd.DataFrame, *names: str) -> None:
    """Raise ColumnError for the first column that the table does not have."""
    for name in names:
        if name not in table.columns:
            raise ColumnError(_not_there(table, name))


def require_numbers(table: pd.DataFrame, *names: str) -> None:
    """Raise ColumnError for the first column that a table lacks, AnalysisError for one without numbers."""
    require(table, *names)
    for name in names:
        if not pd.api.types.is_numeric_dtype(table[name]):
            raise AnalysisError(f"The values of {name} are not numbers: name another column.")


def is_true(table: pd.DataFrame, name: str) -> Bool[np.ndarray, " records"]:
    """Mask of the records (n,) in which a column of flags is true; one without a value is not."""
    return table[name].eq(True).fillna(False).to_numpy(bool)


def require_rows(table: pd.DataFrame) -> None:
    """Raise AnalysisError for a table without rows."""
    if table.empty:
        raise AnalysisError("The table has no rows.")


def require_single_records(table: pd.DataFrame, order: str) -> None:
    """Raise AnalysisError where a row has several records with one number in the column `order`."""
    repeated = table.duplicated(["row", order]).to_numpy()
    if repeated.any():
        row, number = table.iloc[int(repeated.argmax())][["row", order]]
        raise AnalysisError(
            f"Row {row} has several records of {order} {number}, as after pandas.concat of tables whose rows "
            "have the same numbers: join results by gs.concat."
        )


def names_in(names: str | Iterable[str]) -> list[str]:
    """The names in an argument that takes one name or several: a text is one name, not its letters.

    Raises:
        ArgumentError: the argument is something else.
    """
    listed = [names] if isinstance(names, str) or not isinstance(names, Iterable) else list(names)
    for name in listed:
        if not isinstance(name, str):
            raise ArgumentError(f"{name!r} is not a name: give one name, or several in a list.")
    return listed


def axes_of(table: pd.DataFrame) -> list[str]:
    """The columns of the swept axes: those between `row` and the first column of the table's kind."""
    names = [str(name) for name in table.columns]
    after_axes = [names.index(name) for name in _AFTER_AXES if name in names]
    return [name for name in names[: min(after_axes, default=0)] if name != "row"]


def with_constants(
    tables: pd.DataFrame | Sequence[pd.DataFrame],
    names: str | Sequence[str],
    axes: str | Sequence[str] | None = None,
) -> pd.DataFrame:
    """One table of one or several, with columns for constants of their jobs.

    Args:
        tables: a table, or several that differ in constants, with the same axes.
        names: columns, or parameters, start values or sizes that a table's job holds constant.
        axes: the axes that are compared; by default the swept ones that are not among `names`.

    Raises:
        AnalysisError: a name is neither, its constant is no number, the tables have other axes, or there is
            no table.
    """
    tables = [tables] if isinstance(tables, pd.DataFrame) else list(tables)
    names = names_in(names)
    axes = None if axes is None else names_in(axes)
    if not tables:
        raise AnalysisError("There is no table: give at least one.")
    completed = [table.assign(**_constants(table, names)) for table in tables]
    swept = {", ".join(name for name in axes or axes_of(table) if name not in names) for table in tables}
    if len(swept) != 1:
        listed = " and ".join(sorted(swept)) or "none"
        raise AnalysisError(
            f"The tables have different axes, {listed}: name the constants in `by`, or `axes`."
        )
    together = completed[0] if len(tables) == 1 else pd.concat(completed, ignore_index=True)
    together.attrs = tables[0].attrs
    return together


def _constants(table: pd.DataFrame, names: Sequence[str]) -> dict[str, object]:
    """The constants of a table's job among `names`, without those that are columns."""
    job = table.attrs.get("job", {})
    constants = {k: v for part in ("structure", "params", "start") for k, v in job.get(part, {}).items()}
    missing = [name for name in names if name not in table]
    for name in missing:
        if name not in constants:
            raise ColumnError(_not_there(table, name, constants))
        if isinstance(constants[name], str):
            formula = f'{name} is the formula "{constants[name]}" in the job of a table'
            raise AnalysisError(f"{formula}, and no number: name one of its parameters.")
    return {name: constants[name] for name in missing}


def panels_of(
    table: pd.DataFrame, by: Sequence[str]
) -> Iterator[tuple[dict[str, object], Int[np.ndarray, " rows"]]]:
    """Each combination of the values of `by`, in order, and the places of its rows; one without `by`.

    A missing value is one of the values, so that no row is left out.
    """
    if not by:
        yield {}, np.arange(len(table))
        return
    # not `indices`, which leaves out missing categories
    values = table[list(by)].reset_index(drop=True)
    for key, part in values.groupby(list(by), sort=True, observed=True, dropna=False):
        yield dict(zip(by, cast(tuple[object, ...], key), strict=True)), part.index.to_numpy()


def sound(table: pd.DataFrame, *columns: str) -> Bool[np.ndarray, " records"]:
    """Mask of valid records of crossings: finite in the columns, and not among the last before a fall.

    Rows that failed lose their last `BEFORE_A_FALL` crossings. All records of a staircase are kept: each is
    the end of a hold that the model completed.
    """
    finite = np.asarray(np.isfinite(table[list(columns)].to_numpy(float)).all(axis=1))
    if "status" not in table.columns or "stair" in table.columns:
        return finite
    fell = Status.FAILED.among(table["status"])
    if fell.any():
        to_the_end = table.groupby("row").cumcount(ascending=False).to_numpy()
        finite = finite & ~(fell & (to_the_end < BEFORE_A_FALL))
    return np.asarray(finite, bool)


def outcome_labels(table: pd.DataFrame, label: str) -> pd.Series:
    """The outcome of each row: its label if it settled, else `not settled` or `failed`; NaN becomes `none`.

    Raises:
        AnalysisError: the table does not have the column; or it has inferred rows, whose gait alone is known,
            and the label is another quantity of the model.
    """
    require(table, label)
    if label in table.attrs.get("quantities", {}) and label not in ("gait", "outcome", *axes_of(table)):
        refuse_inferred(table, f"no {label}")
    # the stored outcome is of the gait that the run gave: an edited one has another
    stored_of = table.attrs.get("outcome_of", None if "status" in table.columns else "gait")
    if "outcome" in table.columns and label == stored_of:
        return pd.Series(table["outcome"]).astype(object).fillna(Outcome.NO_GAIT.value)
    names = table[label].astype(object).map(str, na_action="ignore")
    status = table["status"] if "status" in table.columns else np.full(len(table), Status.complete.name)
    return pd.Series(outcomes(pd.Categorical(names), status), index=table.index).astype(object)


def refuse_inferred(table: pd.DataFrame, lacking: str) -> None:
    """Refuse a table with inferred rows; `lacking` is what they do not have, such as "no state"."""
    if "status" in table.columns and np.any(table["status"].astype(str) == Status.inferred.name):
        raise AnalysisError(
            f"This table has inferred rows, which have {lacking}: use the gait, or run the job without "
            "run.refine."
        )


def in_order(table: pd.DataFrame, label: str, labels: pd.Series) -> list[str]:
    """The outcomes that occur: in the order of the label's categories, rows without a label last.

    Args:
        table: the table.
        label: the column of the labels.
        labels: the outcome of each row, as `outcome_labels` returns them.

    Raises:
        AnalysisError: the table does not have the column.
    """
    require(table, label)
    dtype = table[label].dtype
    categories: list[str] = []
    if isinstance(dtype, pd.CategoricalDtype):
        categories = [str(category) for category in dtype.categories]
    present = set(labels.unique())
    labels_in_order = [*categories, *sorted(present - set(categories))]
    order = [*(name for name in labels_in_order if name not in set(Outcome)), *map(str, Outcome)]
    return [name for name in order if name in present]


def _not_there(table: pd.DataFrame, name: str, constants: Iterable[str] = ()) -> str:
    """The sentence about a name that is no column of a table, nor a constant of its job."""
    allowed = [*map(str, table.columns), *constants]
    noun = "a column of this table or a constant of its job" if constants else "a column of this table"
    return f"{name} is not {noun}{near_miss.suggestion(name, allowed)}"
