"""Columns of a table in the format of the page: symbols and labels in HTML, and values as JSON."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Collection, Mapping
from typing import Any

import pandas as pd

from gaitsweep.plot import theme
from gaitsweep.plot.column_labels import symbol, unit_of
from gaitsweep.plot.columns import is_angle

DIGITS = 7  # significant digits of the numbers that the page shows
_ALL_DIGITS = 17  # significant digits that tell all numbers apart
_GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "Delta": "Δ", "eta": "η", "kappa": "κ", "mu": "μ",
    "omega": "ω", "phi": "φ", "psi": "ψ", "sigma": "σ", "tau": "τ", "theta": "θ", "zeta": "ζ", "lambda": "λ",
}  # fmt: skip


def label_of(table: pd.DataFrame, name: str) -> str:
    """A column's symbol and unit as HTML."""
    unit = html.escape(unit_of(table, name), quote=False)
    return f"{html_symbol(table, name)} ({unit})" if unit else html_symbol(table, name)


def written(table: pd.DataFrame, name: str, value: float) -> str:
    """Format a value in HTML, with its unit if it has one: `ψ₁ = 0.4π`."""
    if is_angle(table, name):
        return f"{html_symbol(table, name)} = {theme.in_pi(value)}"
    unit = html.escape(unit_of(table, name), quote=False)
    return f"{html_symbol(table, name)} = {value:.4g} {unit}".rstrip()


def html_symbol(table: pd.DataFrame, name: str) -> str:
    """A column's symbol as HTML; its name if its TeX has other commands than letters and accents."""
    for ending, word in (("_next", "next"), ("_change", "change of")):
        if name.endswith(ending) and name.removesuffix(ending) in table.columns:
            return f"{word} {html_symbol(table, name.removesuffix(ending))}"
    text = html.escape(symbol(table, name), quote=False)
    if not (text.startswith("$") and text.endswith("$")):
        return text
    text = re.sub(r"\\(?:mathrm|text|rm)\b\s*", "", text[1:-1])
    for mark, above in (("bar", "\u0304"), ("dot", "\u0307"), ("hat", "\u0302"), ("tilde", "\u0303")):
        text = re.sub(
            rf"\\{mark}(?![A-Za-z])\s*(?:\{{(\\?[A-Za-z]+)\}}|(\\?[A-Za-z]+))", rf"\1\2{above}", text
        )
    text = re.sub(r"\\([A-Za-z]+)", lambda command: _GREEK.get(command[1], command[0]), text)
    for mark, tag in (("_", "sub"), ("^", "sup")):
        text = re.sub(rf"\{mark}(?:\{{((?:[^{{}}]|\{{[^{{}}]*\}})*)\}}|(.))", rf"<{tag}>\1\2</{tag}>", text)
    text = text.replace("{", "").replace("}", "").replace("\\,", " ")
    return html.escape(name, quote=False) if "\\" in text else text


def columns_of(table: pd.DataFrame, exact: Collection[str] = ()) -> list[dict[str, Any]]:
    """The columns of a table in the format of the page: categories by number, numbers to `DIGITS` digits.

    Those that are `exact` keep all digits.
    """
    quantities: Mapping[str, Any] = table.attrs.get("quantities", {})
    columns = []
    for name in map(str, table.columns):
        values = table[name]
        quantity = quantities.get(name) or quantities.get(re.sub(r"_(end|n)\Z", "", name)) or {}
        entry: dict[str, Any] = {
            "name": name,
            "symbol": html_symbol(table, name),
            "unit": unit_of(table, name),
            "meaning": str(quantity.get("meaning", "")),
            "circular": is_angle(table, name) and pd.api.types.is_float_dtype(values),
        }
        if isinstance(values.dtype, pd.CategoricalDtype) or not pd.api.types.is_numeric_dtype(values):
            codes, categories = pd.factorize(values.astype(object), use_na_sentinel=True)
            entry |= {"categories": list(map(str, categories)), "values": codes.tolist()}
        elif pd.api.types.is_float_dtype(values):
            digits = _ALL_DIGITS if name in exact else DIGITS
            entry["values"] = [rounded(value, digits) for value in values.to_numpy(float)]
        else:
            entry["values"] = [int(value) for value in values]
        if len(set(map(str, entry["values"]))) == 1 and len(table) > 1:
            entry["values"] = entry["values"][0]  # one value of all records
        columns.append(entry)
    return columns


def rounded(value: float, digits: int = DIGITS) -> float | str | None:
    """Round a number to some digits; returns text for infinity, None for missing numbers."""
    if math.isnan(value):
        return None
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    short = float(f"{value:.{digits}g}")
    return int(short) if short == int(short) and abs(short) < 1e6 else short
