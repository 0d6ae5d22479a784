"""The source of plotly.js, rewritten so that browsers load it faster with the same behaviour."""

from __future__ import annotations

import importlib.util
import re
from importlib import resources

from gaitsweep.runs.dataset import MissingPackageError

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
