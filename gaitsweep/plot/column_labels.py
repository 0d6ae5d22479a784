"""Labels of columns in figures: their symbols, units and meanings in TeX, and their values."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.analysis.records import axes_of
from gaitsweep.column_meanings import COLUMNS
from gaitsweep.mathtext import can_be_set, escape_unparsable
from gaitsweep.plot.columns import is_angle
from gaitsweep.plot.figure_style import current

_GREEK = frozenset(
    {"alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda", "mu", "nu"}
    | {"xi", "pi", "rho", "sigma", "tau", "phi", "chi", "psi", "omega"}
)
_ONE_FORMULA = re.compile(r"[^$]*(\$[^$]+\$)[^$]*")
_REMARK = re.compile(r"(?!\d)(.*?\w{2})[:;](?![^(]*\))")  # not of "1: yes; 0: no", nor in brackets
_LAST_CLAUSE = re.compile(r",(?![^(]*\)).*\Z", re.DOTALL)  # from the first comma that is not in brackets
_AT_START = "at the start"  # the end of the meaning of a start value
_UNIT_AT_END = re.compile(r"\s*\([^()]*\)\Z")
_MOST_DIGITS = 10  # by which values are told apart: others differ by rounding
_MOST_TOLD_APART = 100  # values of a column; of more, as of a random axis, labels are not told apart
_SUFFIX = re.compile(r"_(end(_\d+)?|n)\Z")  # of recorded columns; _end_2 is at a further crossing of an orbit
_WORDS = {"t": "time", "t_end": "time at the end", "crossing": "cycle", "cycles": "cycles"}


def observable_in(table: pd.DataFrame, name: str) -> str:
    """The observable that a column records: speed for speed_n, psi_1 for psi_1_end; else the name itself.

    A swept axis, such as the parameter m_end, records no observable. Nor does a quantity of the table that is
    no column of it, or whose name without the suffix is no quantity.
    """
    observable = _SUFFIX.sub("", name)
    quantities = table.attrs.get("quantities", {})
    is_parameter = name in quantities and (name not in table.columns or observable not in quantities)
    return name if is_parameter or name in _WORDS or name in axes_of(table) else observable


def symbol(table: pd.DataFrame, name: str) -> str:
    """A column's symbol in TeX: from `table.attrs["quantities"]`, else from its name.

    Of a label of the style it is the formula, or the text without a unit in brackets at its end. If
    Matplotlib cannot typeset the symbol, the name is used.
    """
    if label := _own_label(table, name):
        formula = _ONE_FORMULA.fullmatch(label)
        return formula[1] if formula else _UNIT_AT_END.sub("", label) or label
    own = _quantity(table, name).get("symbol")
    if own and can_be_set(f"${own}$"):
        return f"${own}$"
    observable = observable_in(table, name)
    starts = observable.endswith("_0") and str(_quantity(table, name).get("meaning", "")).endswith(_AT_START)
    if starts and (formula := _formula(observable.removesuffix("_0"))):
        return f"{formula[:-1]}(0)$"
    return _WORDS.get(observable) or _formula(observable) or observable.replace("_", " ")


def _formula(name: str) -> str | None:
    """The symbol in TeX of a name that begins with a letter, Latin or Greek, and may have an index.

    None for another name, and for one whose index TeX cannot have, such as m_1_.
    """
    head, _, tail = name.partition("_")
    if head not in _GREEK and len(head) != 1:
        return None
    letter = f"\\{head}" if head in _GREEK else head
    indices = tail.split("_") if all(tail.split("_")) else [tail]  # m_1_ has an index that TeX cannot have
    index = ",".join(rf"\mathrm{{{part}}}" if len(part) > 1 and part.isalpha() else part for part in indices)
    formula = f"${letter}_{{{index}}}$" if tail else f"${letter}$"
    return formula if can_be_set(formula) else None


def axis_label(table: pd.DataFrame, name: str) -> str:
    """The style's label of a column, else its symbol and unit, for an axis."""
    unit = unit_of(table, name)
    return _own_label(table, name) or (f"{symbol(table, name)} ({unit})" if unit else symbol(table, name))


def _own_label(table: pd.DataFrame, name: str) -> str | None:
    """The style's label of a column, by its name or, if the column is recorded, by the observable's."""
    labels = current().labels or {}
    return labels.get(name) or labels.get(observable_in(table, name))


def unit_of(table: pd.DataFrame, name: str) -> str:
    """A column's unit, or an empty text."""
    own = "rad" if is_angle(table, name) else COLUMNS.get(name, ("",))[0]
    unit = _quantity(table, name).get("unit", own)
    return "" if unit == "1" else escape_unparsable(str(unit))


def described(table: pd.DataFrame, name: str, width: int = 44, *, named: bool = False) -> str:
    """A column's meaning, symbol (if it has one) and unit in lines of `width`, as the label of an axis.

    Remarks on the meaning, behind a colon or semicolon, are left out: of "coupling, positive: antiphase" also
    the clause before the colon, which says nothing alone. With `named` a column without a symbol
    is named, too, as where a legend names it.
    """
    stated = "" if _own_label(table, name) else str(_quantity(table, name).get("meaning", ""))
    meaning = escape_unparsable(stated)
    if remark := _REMARK.match(meaning):
        meaning = _LAST_CLAUSE.sub("", remark[1]) if meaning[remark.end() - 1] == ":" else remark[1]
    label, unit = axis_label(table, name), unit_of(table, name)
    if not meaning or len(meaning) > 2 * width or label.startswith(meaning):
        return label
    end = f" ({unit})" if unit else ""
    if "$" in label:
        end = f", {label}"
    elif named and symbol(table, name).lower() not in meaning.lower():
        end = f", {label}".replace(" (", "\u00a0(")  # no break before the unit
    lines = textwrap.wrap(meaning, width)
    return "\n".join([*lines[:-1], lines[-1] + end])


def written(table: pd.DataFrame, name: str, value: object, digits: int | None = None) -> str:
    """Format the value of a column: `f = 2.6 Hz`, angles in multiples of pi.

    Args:
        digits: the number of digits, by default `digits_of` the column.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or math.isnan(float(value)):
        return f"{symbol(table, name)} = {value}"
    number = float(value) + 0.0  # -0.0 becomes 0.0
    digits = digits_of(table, name) if digits is None else digits
    if not is_angle(table, name):
        text = f"{number:.{digits}g} {unit_of(table, name)}"
        return f"{symbol(table, name)} = {text}".rstrip().replace("= -", "= −")
    turns = f"{number / np.pi + 0.0:.{digits}g}"
    text = {"0": "0", "1": r"\pi", "-1": r"-\pi"}.get(turns, rf"{turns}\,\pi")
    return f"{symbol(table, name)} = ${text}$"


def least_digits(table: pd.DataFrame, name: str) -> int:
    """The number of digits of a measured value: 4, of an angle in multiples of pi 3."""
    return 3 if is_angle(table, name) else 4


def digits_of(table: pd.DataFrame, name: str) -> int:
    """The fewest digits, from `least_digits` on, that tell a column's values apart; 10 at most.

    If all values are whole, such as seeds, none is rounded.
    """
    least = least_digits(table, name)
    numbers: Any = pd.to_numeric(pd.Series(table.get(name, [])), errors="coerce")
    numbers = np.asarray(numbers, np.float64)
    values = np.unique(numbers[np.isfinite(numbers)]) / (np.pi if is_angle(table, name) else 1.0)
    if values.size > _MOST_TOLD_APART:
        return least
    if (values == np.round(values)).all():
        least = next((n for n in range(least, _MOST_DIGITS) if _keep(values, n)), _MOST_DIGITS)
    texts = [{f"{value:.{digits}g}" for value in values} for digits in range(least, _MOST_DIGITS + 1)]
    return least + next(place for place, told in enumerate(texts) if len(told) == len(texts[-1]))


def _keep(values: Float[np.ndarray, " values"], digits: int) -> bool:
    """Whether values with so many digits are the values themselves."""
    return all(float(f"{value:.{digits}g}") == value for value in values)


def row_names(table: pd.DataFrame, without: Sequence[str] = ()) -> dict[Any, str]:
    """The name of each row: the values of the axes that differ between the rows, or its number.

    Args:
        without: axes that are named elsewhere, such as that of the panels.
    """
    firsts = table.drop_duplicates("row")
    axes = [name for name in axes_of(table) if name not in without]
    differ = [name for name in axes if len(firsts[name].unique()) > 1]
    columns = [(name, firsts[name].tolist(), digits_of(firsts, name)) for name in differ]
    names = {}
    for number, row in enumerate(firsts["row"].tolist()):
        texts = [written(table, name, values[number], digits) for name, values, digits in columns]
        names[row] = ", ".join(texts) or f"row {row}"
    return names


def _quantity(table: pd.DataFrame, name: str) -> dict[str, Any]:
    """The entry of a column in `table.attrs["quantities"]`: its unit, symbol and whether it is circular."""
    quantities = table.attrs.get("quantities", {})
    name = re.sub(r"_end_\d+\Z", "_end", name)  # at a further crossing of an orbit
    return dict(quantities.get(name) or quantities.get(observable_in(table, name)) or {})
