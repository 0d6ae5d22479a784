"""Labels, colours, markers and hatches of gaits and of other outcomes, distinct in grey print too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.colors import to_hex, to_rgb

from gaitsweep.extension import gait_styles
from gaitsweep.plot.figure_style import current
from gaitsweep.status import Outcome

HATCH = "/////"

# Of outcomes that no model names; gaits have those of their extensions.
COLOURS = MappingProxyType(
    {"none": "#BBBBBB", Outcome.NOT_SETTLED: "#E4E4E4", Outcome.FAILED: "#3B3B3B", "fell": "#3B3B3B"}
)
MARKERS = MappingProxyType({"none": "x"})
HATCHES = MappingProxyType({"none": "xxx", Outcome.NOT_SETTLED: HATCH, Outcome.FAILED: HATCH, "fell": "...."})
# Okabe and Ito's colours, distinct for colour-blind readers.
SPARE_COLOURS = ("#E69F00", "#0072B2", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#F0E442", "#000000")
SPARE_MARKERS = ("o", "^", "s", "D", "v", "P", "X", "*")
LINE_COLOURS = SPARE_COLOURS[:6]  # the others are too pale or too dark for lines
DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (5, 1, 1, 1)))
MOST_NAMED_LINES = 8  # in a legend
_SPARE_HATCHES = ("", "....", "\\\\\\\\", "----", "++++", "oo", "||||", "xxxx", "**")
CONTRAST = 1.8  # the least ratio of luminances at which grey print tells two colours apart
_DARK = 0.28  # luminance of a colour below which white text on it is more legible than black


def named(name: str) -> str:
    """The label of a gait in legends: its style's, else its name."""
    return (current().labels or {}).get(name, name)


def ordered(names: Iterable[str]) -> list[str]:
    """Gaits in the order of the style; others follow in their own order."""
    names = list(names)
    first = [name for name in current().order or () if name in names]
    return [*first, *(name for name in names if name not in first)]


def colours(names: Iterable[str]) -> dict[str, str]:
    """A colour for each name: that of the style or of the gait, else spare colours in order."""
    own = {name: colour for name, (colour, *_) in gait_styles().items()}
    own |= {**COLOURS, **(current().colours or {})}
    return _own_or_spare(list(names), own, SPARE_COLOURS, to_hex)


def markers(names: Iterable[str]) -> dict[str, str]:
    """A marker for each name: that of the gait, else spare markers in order."""
    own = {name: marker for name, (_, marker, *_) in gait_styles().items()} | dict(MARKERS)
    return _own_or_spare(list(names), own, SPARE_MARKERS, str)


def _own_or_spare(
    names: list[str], own: Mapping[str, str], spare: Sequence[str], normal: Callable[[str], str]
) -> dict[str, str]:
    """Each name's own entry, or in turn the spare ones that no name has as its own.

    `normal` writes equal entries alike.
    """
    used = {normal(own[name]) for name in names if name in own}
    free = [entry for entry in spare if normal(entry) not in used] or spare
    others = [name for name in names if name not in own]
    return {name: own[name] if name in own else free[others.index(name) % len(free)] for name in names}


def hatches(names: Iterable[str]) -> dict[str, str]:
    """A hatch for each name, by which grey print tells areas apart: that of the gait, else a spare one.

    A gait with a colour of the style has the first hatch that no gait of nearly its lightness has. Without
    `hatches` in the style, only what is no gait has one.
    """
    names = list(names)
    colour = colours(names)
    # an extension need not give a hatch
    own = {name: hatch for name, (_, _, *hatch_of) in gait_styles().items() for hatch in hatch_of}
    own |= HATCHES
    recoloured = current().colours or {}
    hatch_of = {name: own[name] for name in names if name in own and name not in recoloured}
    # of many gaits few colours differ
    used: dict[str, set[str]] = {}
    for name, hatch in hatch_of.items():
        used.setdefault(colour[name], set()).add(hatch)
    for name in (name for name in names if name not in hatch_of):
        alike = [hatches for other, hatches in used.items() if contrast(colour[name], other) < CONTRAST]
        confusable = set[str]().union(*alike)
        first = ("", own[name]) if name in own else ()
        free = (hatch for hatch in (*first, *_SPARE_HATCHES) if hatch not in confusable)
        hatch_of[name] = next(free, _SPARE_HATCHES[-1])
        used.setdefault(colour[name], set()).add(hatch_of[name])
    if current().hatches is False:
        hatch_of |= {name: "" for name in names if name not in HATCHES}
    return hatch_of


def contrast(colour: str, other: str) -> float:
    """The contrast of two colours in grey print: the ratio of their luminances (WCAG 2), at least 1."""
    low, high = sorted(map(_luminance, (colour, other)))
    return (high + 0.05) / (low + 0.05)


def _luminance(colour: str) -> float:
    """The relative luminance of a colour (WCAG 2), from 0 to 1."""
    channels = np.array(to_rgb(colour))
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def mixed(colour: str, other: str) -> str:
    """The mean of two colours."""
    red, green, blue = 0.5 * (np.array(to_rgb(colour)) + np.array(to_rgb(other)))
    return to_hex((float(red), float(green), float(blue)))


def hatched(colour: str, hatch: str) -> dict[str, Any]:
    """The look of an area in a colour with a hatch."""
    return {"facecolor": colour, "hatch": hatch or None, "edgecolor": line_on(colour), "linewidth": 0.0}


def ink_on(colour: str) -> str:
    """Black or white, for a text over a colour."""
    return "white" if _luminance(colour) < _DARK else "black"


def line_on(colour: str) -> str:
    """The colour of a hatch: lighter on dark colours, darker on light ones."""
    return mixed(colour, ink_on(colour))
