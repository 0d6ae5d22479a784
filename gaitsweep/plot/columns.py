"""Columns of tables for figures: columns by name, their labels on axes, the outcomes of rows."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
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
from gaitsweep.mathtext import can_be_set, settable
from gaitsweep.plot.figure_style import current
from gaitsweep.run_columns import COLUMNS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_GREEK = frozenset(
    {"alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda", "mu", "nu"}
    | {"xi", "pi", "rho", "sigma", "tau", "phi", "chi", "psi", "omega"}
)
OTHER = "another gait"  # settled, but in no gait of the model
_ONE_FORMULA = re.compile(r"[^$]*(\$[^$]+\$)[^$]*")
_REMARK = re.compile(r"(?!\d)(.*?\w{3})[:;](?![^(]*\))")  # not of "1: yes; 0: no", nor in brackets
_UNIT_AT_END = re.compile(r"\s*\([^()]*\)\Z")
_WORDS = {"t": "time", "t_end": "time at the end", "crossing": "cycle", "cycles": "cycles"}


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
        f"{name} is not a column of this table{near_miss.suggestion(name, map(str, table.columns))}"
    )


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


def base_name(name: str) -> str:
    """The quantity in a column: psi_1 for psi_1_end and psi_1_n."""
    return re.sub(r"_(end|n)\Z", "", name) if re.fullmatch(r"\w+_\w+_(end|n)", name) else name


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
    quantities = table.attrs.get("quantities", {})
    recorded = bare(name) in quantities or (name in quantities and name not in axes_of(table))
    base = bare(name) if recorded and name not in _WORDS else base_name(name)
    return _WORDS.get(base) or _formula(base) or bare(base).replace("_", " ")


def _formula(name: str) -> str | None:
    """The symbol in TeX of a name that begins with a letter, Latin or Greek, and may have an index."""
    head, _, tail = name.partition("_")
    if head not in _GREEK and len(head) != 1:
        return None
    letter = f"\\{head}" if head in _GREEK else head
    index = rf"\mathrm{{{tail}}}" if len(tail) > 1 and tail.isalpha() else tail
    return f"${letter}_{{{index}}}$" if tail else f"${letter}$"


def axis_label(table: pd.DataFrame, name: str) -> str:
    """The style's label of a column, else its symbol and unit, for an axis."""
    unit = unit_of(table, name)
    return _own_label(table, name) or (f"{symbol(table, name)} ({unit})" if unit else symbol(table, name))


def _own_label(table: pd.DataFrame, name: str) -> str | None:
    """The style's label of a column, by its name or, if the column is recorded, by the observable's."""
    labels = current().labels or {}
    plain = name if name in axes_of(table) else bare(name)
    return labels.get(name) or labels.get(plain)


def unit_of(table: pd.DataFrame, name: str) -> str:
    """A column's unit, or an empty text."""
    own = "rad" if is_angle(table, name) else COLUMNS.get(name, ("",))[0]
    unit = _quantity(table, name).get("unit", own)
    return "" if unit == "1" else settable(str(unit))


def described(table: pd.DataFrame, name: str, width: int = 44, *, named: bool = False) -> str:
    """A column's meaning, symbol (if it has one) and unit in lines of `width`, as the label of an axis.

    Remarks on the meaning, behind a colon or semicolon, are left out. With `named` a column without a symbol
    is named, too, as where a legend names it.
    """
    meaning = "" if _own_label(table, name) else settable(str(_quantity(table, name).get("meaning", "")))
    if remark := _REMARK.match(meaning):
        meaning = remark[1]
    label, unit = axis_label(table, name), unit_of(table, name)
    if not meaning or len(meaning) > 2 * width or label.startswith(meaning):
        return label
    lines = textwrap.wrap(meaning, width)
    # a name in words would say less than the meaning
    if named and "$" not in label and symbol(table, name).lower() not in meaning.lower():
        label = label.replace(" (", "\u00a0(")  # no break before the unit
    else:
        named = "$" in label
    end = f", {label}" if named else f" ({unit})" if unit else ""
    return "\n".join([*lines[:-1], lines[-1] + end])


def written(table: pd.DataFrame, name: str, value: object) -> str:
    """Format the value of a column: `f = 2.6 Hz`, angles in multiples of pi."""
    if not isinstance(value, int | float | np.number):
        return f"{symbol(table, name)} = {value}"
    number = float(value)
    if not is_angle(table, name):
        return f"{symbol(table, name)} = {number:.4g} {unit_of(table, name)}".rstrip().replace("= -", "= −")
    turns = f"{number / np.pi:.3g}"
    text = {"0": "0", "1": r"\pi", "-1": r"-\pi"}.get(turns, rf"{turns}\,\pi")
    return f"{symbol(table, name)} = ${text}$"


def row_names(table: pd.DataFrame, without: Sequence[str] = ()) -> dict[Any, str]:
    """The name of each row: the values of the axes that differ between the rows, or its number.

    Args:
        without: axes that are named elsewhere, such as that of the panels.
    """
    firsts = table.drop_duplicates("row")
    axes = [name for name in axes_of(table) if name not in without]
    differ = [name for name in axes if len(firsts[name].unique()) > 1]
    values = [firsts[name].tolist() for name in differ]
    names = {}
    for number, row in enumerate(firsts["row"].tolist()):
        texts = [written(table, name, of_axis[number]) for name, of_axis in zip(differ, values, strict=True)]
        names[row] = ", ".join(texts) or f"row {row}"
    return names


def outcome(table: pd.DataFrame, hue: str) -> pd.Series:
    """The outcome of each row: its hue if it settled, else `not settled` or `failed`; NaN becomes `none`."""
    column(table, hue)
    return outcome_labels(table, hue)


def _quantity(table: pd.DataFrame, name: str) -> dict[str, Any]:
    """The entry of a column in `table.attrs["quantities"]`: its unit, symbol and whether it is circular."""
    quantities = table.attrs.get("quantities", {})
    name = re.sub(r"_end_\d+\Z", "_end", name)  # at a further crossing of an orbit
    return dict(quantities.get(name) or quantities.get(base_name(name)) or quantities.get(bare(name)) or {})


def bare(name: str) -> str:
    """A name without its suffix (speed for speed_n), even if that may be part of the name (m_end)."""
    return re.sub(r"_(end|n)\Z", "", name)
