"""Columns of the rows of several sets, and formulas of such columns: their values and units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from gaitsweep.contract import Model
from gaitsweep.expression import evaluate, functions_of, names_in
from gaitsweep.fitting.measure import SetRows


def column(formula: str, rows: SetRows) -> np.ndarray:
    """Evaluate a column or a formula of columns for the rows of n sets: (n, conditions), NaN without a value.

    The column at the rows' end is preferred, since the name of an observable may be that of a start.
    """
    if (name := _end(formula, rows)) in rows:
        return rows[name].astype(float)
    names = {name: rows[_end(name, rows)].astype(float) for name in names_in(formula)}
    with np.errstate(all="ignore"):
        values = evaluate(formula, names, functions_of(np))
    return np.broadcast_to(values, rows["status"].shape)


def within(among: Mapping[str, tuple[float, float]], rows: SetRows) -> np.ndarray:
    """Return whether each row (n, conditions) is within all ranges, ends included."""
    inside = np.ones(rows["status"].shape, bool)
    for name, (low, high) in among.items():
        values = column(name, rows)
        inside &= (values >= low) & (values <= high)
    return inside


def _end(name: str, columns: Iterable[str]) -> str:
    """Return the column with the last value of a name."""
    last = f"{name}_end"
    return last if last in columns else name


def unit_of_parameter(name: str, model: Model) -> str:
    """Return the unit of a parameter, "1" if the model has none of this name."""
    return {q.name: q.unit for q in model.parameters}.get(name, "1")


def unit_of(formula: str, model: Model) -> str:
    """Return the unit of a column, "" for a formula."""
    units = {q.name: q.unit for q in model.label_fields} | {"t_end": "s"}
    for quantity in model.observables:
        units[quantity.name] = units[f"{quantity.name}_end"] = quantity.unit
    return units.get(formula, "1" if formula.isidentifier() else "")
