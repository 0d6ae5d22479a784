"""The source of plotly.js, made quicker to read for a browser without a change of what it does."""

from __future__ import annotations

import importlib.util
import re
from importlib import resources

from gaitsweep.runs.dataset import MissingPackageError

# How plotly.js begins and ends: a function, handed to one that calls it at once.
_BEGIN = '} (typeof self !== "undefined" ? self : this, () => {'
_END = "}));"


def plotly_source() -> str:
    """The source of plotly.js, of the Python package plotly.

    Raises:
        MissingPackageError: plotly is not installed.
    """
    if importlib.util.find_spec("plotly") is None:
        raise MissingPackageError(
            "The explorer needs the package plotly: install it with pip install 'gaitsweep[explore]'."
        )
    file = resources.files("plotly").joinpath("package_data", "plotly.min.js")
    return quicker(file.read_text(encoding="utf-8"))


def quicker(source: str) -> str:
    """The same program, for which V8 needs less time.

    Letters beyond ASCII become escapes: a text of Latin letters alone takes one byte a letter. A function in
    parentheses is compiled when it is first read; another is read, left, and read again when it is called.
    """
    source = re.sub(r"[^\x00-\x7f]+", _escapes, source)
    begin, end = source.count(_BEGIN), source.rstrip().endswith(_END)
    if begin == 1 and end:  # else another version, which stays as it is
        place = source.rindex(_END)
        source = source[:place] + "})" + source[place + 1 :]
        source = source.replace(_BEGIN, _BEGIN.replace("() => {", "(() => {"))
    return source


def _escapes(letters: re.Match[str]) -> str:
    """Letters as escapes of JavaScript, the same in texts, expressions and names."""
    units = letters[0].encode("utf-16-be")
    return "".join(f"\\u{units[i]:02x}{units[i + 1]:02x}" for i in range(0, len(units), 2))
