"""Parameters in which rows differ: their values have a panel each, or a figure of one system refuses them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any

import pandas as pd

from gaitsweep.analysis.records import axes_of
from gaitsweep.plot.columns import PlotError
from gaitsweep.plot.kind import PlannedTable, Refusal, check_parameter

MOST_PANELS = 12  # for values that are not named by `panels`


def varying_parameters(table: pd.DataFrame) -> list[str]:
    """The parameters of a table's model that differ between its rows, without the seeds of an ensemble.

    Rows that differ in starts and seeds are of one system; rows that differ in a parameter are not. A table
    without a known model has none.
    """
    from gaitsweep.plot.limbs import model_of  # jobs are read without Matplotlib

    model = model_of(table)
    parameters = {quantity.name for quantity in model.parameters} if model is not None else set()
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
        shown: columns that the figure shows, along an axis, by panels or by colours.

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


def check_one_system(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refuse a job whose rows differ in a parameter that its figure does not show."""
    parameters = [quantity.name for quantity in table.model.parameters]
    shown = {dict(figure).get(field) for field in ("x", "panels", "hue")}
    hidden = [name for name in table.varied if is_compared(name, parameters) and name not in shown]
    if hidden:
        field = "panels" if "panels" in type(figure).model_fields else "x"
        differ = " and ".join(hidden)
        yield (
            (field,),
            (
                f"leaves out {differ}, in which the rows differ, too: fix its value under params, or draw "
                "the figure in Python from the rows of one value."
            ),
        )


def check_one_parameter(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refuse an x that is no varying parameter, and rows that differ in another one."""
    wrong = list(check_parameter(figure, table))
    yield from wrong or check_one_system(figure, table)
