"""The format of the page: labels in HTML, columns as JSON, motions as integers; the source of plotly.js."""

from __future__ import annotations

import base64
import gzip
import html
import importlib.util
import json
import math
import re
from collections.abc import Collection, Mapping
from html.entities import html5
from importlib import resources
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int, Real

from gaitsweep.plot import theme
from gaitsweep.plot.column_labels import symbol, unit_of
from gaitsweep.plot.columns import is_angle
from gaitsweep.runs.dataset import MissingPackageError
from gaitsweep.view.explorer.replays import Crossings, Motion

# The only kind of trace that the page has besides scatter, which is always there.
TRACE = "heatmap"
# The beginning and the end of plotly.js: a function, passed to another one that calls it at once.
_BEGIN = '} (typeof self !== "undefined" ? self : this, () => {'
_END = "}));"
_NAME = r"[\w$]+"
# The list of all kinds of traces; each is a function that returns a module.
_ALL_TRACES = re.compile(rf"(?<=\.register\(\[)(?:{_NAME}\(\),?)+(?=\]\))")
# A module whose only content is another module.
_REEXPORT = re.compile(
    rf'(?P<make>{_NAME})\(\({_NAME},{_NAME}\)=>{{"use strict";{_NAME}\.exports=(?P<inner>{_NAME})\(\)}}\)'
)
_OPENING = 1500  # letters at the beginning of a module that contain its name


def require_plotly() -> None:
    """Refuse to make a page without the Python package plotly.

    Raises:
        MissingPackageError: plotly is not installed.
    """
    if importlib.util.find_spec("plotly") is None:
        raise MissingPackageError(
            "The explorer needs the package plotly: run pip install 'gaitsweep[explore]'."
        )


def plotly_source() -> str:
    """The source of plotly.js, from the Python package plotly.

    Raises:
        MissingPackageError: as for `require_plotly`.
    """
    require_plotly()
    file = resources.files("plotly").joinpath("package_data", "plotly.min.js")
    return fast_to_load(file.read_text(encoding="utf-8"))


def fast_to_load(source: str) -> str:
    """An equivalent program for scatter plots and heatmaps that browsers load faster.

    Other kinds of traces (maps of the world, surfaces, ...) are not initialised, which takes most of the
    time. Browsers compile a function in parentheses when they first parse it; they parse others twice.
    Non-ASCII letters become escapes, since browsers store pure Latin text with one byte per letter. Code that
    is not recognised, as in other versions of plotly.js, is left unchanged.
    """
    source = re.sub(r"[^\x00-\x7f]+", _escapes, source)
    lists = _ALL_TRACES.findall(source)
    if len(lists) == 1:
        functions = [name for name in re.findall(_NAME, lists[0]) if _trace_of(source, name) == TRACE]
        if len(functions) == 1:
            source = _ALL_TRACES.sub(lambda _: f"{functions[0]}()", source)
    if source.count(_BEGIN) == 1 and source.rstrip().endswith(_END):
        place = source.rindex(_END)
        source = source[:place] + "})" + source[place + 1 :]
        source = source.replace(_BEGIN, _BEGIN.replace("() => {", "(() => {"))
    return source


def _trace_of(source: str, function: str) -> str | None:
    """The kind of trace whose module a function returns, from the name of the module that it reexports."""
    reexport = _REEXPORT.match(source, source.find(f"var {function}=") + len(f"var {function}="))
    if reexport is None:
        return None
    place = source.find(f"var {reexport['inner']}={reexport['make']}((")
    module = source[place : place + _OPENING].split(f"={reexport['make']}((")
    name = re.search(r'name:"([\w-]+)"', module[1]) if place >= 0 else None
    return name[1] if name else None


def _escapes(letters: re.Match[str]) -> str:
    """Letters as JavaScript escapes, which are valid in texts, expressions and names."""
    units = letters[0].encode("utf-16-be")
    return "".join(f"\\u{units[i]:02x}{units[i + 1]:02x}" for i in range(0, len(units), 2))


DIGITS = 7  # significant digits of the numbers that the page shows
_ALL_DIGITS = 17  # significant digits that tell all numbers apart
RESOLUTION = 1e-3  # of stored pictures, as a share of the body's height
# Integers of two bytes: the largest in magnitude that is a number, and the one for a missing number.
_LARGEST = 32767
_NO_NUMBER = -32768


def label_of(table: pd.DataFrame, name: str) -> str:
    """A column's symbol and unit as HTML."""
    unit = html.escape(unit_of(table, name), quote=False)
    return f"{html_symbol(table, name)} ({unit})" if unit else html_symbol(table, name)


def written(table: pd.DataFrame, name: str, value: float, digits: int) -> str:
    """Format a value with so many digits in HTML, with its unit if it has one: `ψ₁ = 0.4π`."""
    if is_angle(table, name):
        return f"{html_symbol(table, name)} = {theme.in_pi(value)}"
    unit = html.escape(unit_of(table, name), quote=False)
    return f"{html_symbol(table, name)} = {value:.{digits}g} {unit}".rstrip()


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
    text = re.sub(r"\\([A-Za-z]+)", lambda command: html5.get(f"{command[1]};", command[0]), text)
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
            entry["values"] = [rounded(value, digits) for value in values.to_numpy(float, na_value=math.nan)]
        else:
            entry["values"] = [None if pd.isna(value) else int(value) for value in values]
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


def packed(numbers: Real[np.ndarray, ...]) -> str:
    """Integers (n,) of two bytes as text: the low bytes, then the high ones, which compress better.

    Args:
        numbers: whole numbers that fit into two bytes; callers encode missing ones as `_NO_NUMBER`.
    """
    assert np.all((numbers >= _NO_NUMBER) & (numbers <= _LARGEST)), (
        "a number is NaN or has more than two bytes"
    )
    planes = numbers.astype("<i2").reshape(-1).view(np.uint8).reshape(-1, 2).T
    return base64.b64encode(planes.tobytes()).decode()


def compressed(text: bytes) -> str:
    """Bytes compressed by gzip, as base64 text."""
    return base64.b64encode(gzip.compress(text, 9, mtime=0)).decode()


def json_bytes(fields: Any) -> bytes:
    """Fields as JSON without spaces; NaN, which browsers do not read, raises ValueError."""
    text = json.dumps(fields, separators=(",", ":"), ensure_ascii=False, default=_plain, allow_nan=False)
    return text.encode()


def _plain(value: Any) -> Any:
    """Convert a NumPy scalar, which JSON does not know, to a number of Python."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value)} is not JSON")


def motion_fields(motion: Motion) -> dict[str, Any]:
    """A stretch of motion in the format of the page.

    Each column of `points` is stored as differences from frame to frame, the first from 0, in units of
    `unit` m; the last column is the camera's path. `contact` has, for each limb, the samples at which ground
    contact alternately begins and ends.
    """
    stretch, t = motion.stretch, motion.t
    # a single sample has no interval; the page divides by it, so it is any above 0
    interval = float(t[-1] - t[0]) / (len(t) - 1) if len(t) > 1 else 1.0
    fields: dict[str, Any] = {
        "name": stretch.name,
        "begin": round(float(t[0]), 6),
        "sample": _digits(interval),
        "samples": len(t),
        "stride": motion.stride,
        "loops": stretch.loops,
        "contact": [_turns(column > 0.5) for column in motion.contact.T],
    }
    if motion.pictures is not None:
        pictures = motion.pictures
        unit = RESOLUTION * pictures.height
        columns = np.column_stack([pictures.points, pictures.camera - pictures.camera[0]])
        in_units = np.rint(columns / unit)
        steps = np.diff(in_units, axis=0, prepend=np.zeros((1, in_units.shape[1])))
        steps = np.clip(steps, -_LARGEST, _LARGEST)  # less than 32 heights from one picture to the next
        fields |= {
            "unit": _digits(unit),
            "ground": _digits(float(pictures.camera[0])),
            "pictures": len(in_units),
            "points": packed(steps.T.ravel()),
        }
    return fields


def crossing_fields(
    crossings: Crossings,
    shown: Int[np.ndarray, " shown"],
    low: Float[np.ndarray, " shown"],
    high: Float[np.ndarray, " shown"],
) -> dict[str, Any]:
    """Observables over the crossings of a row in the format of the page, as fractions from low to high.

    Args:
        crossings: the crossings of the row.
        shown: numbers of the observables, (k,).
        low, high: their ranges, (k,), each in the unit of its observable.
    """
    values = crossings.observed[:, shown]
    share = (values - low) / np.where(high > low, high - low, 1.0)
    integers = np.rint(share * 2.0 * _LARGEST) - _LARGEST
    integers = np.where(np.isfinite(integers), np.clip(integers, -_LARGEST, _LARGEST), _NO_NUMBER)
    return {"first": int(crossings.number[0]) if len(crossings.number) else 0, "values": packed(integers.T)}


def _turns(down: Bool[np.ndarray, " samples"]) -> list[int]:
    """The samples at which a limb alternately lands and lifts, from its contact (n,)."""
    return np.flatnonzero(np.diff(np.r_[False, down, False])).tolist()


def _digits(number: float) -> float:
    """A number to nine significant digits."""
    return float(f"{number:.9g}")
