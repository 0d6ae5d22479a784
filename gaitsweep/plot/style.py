"""How figures look: sizes of paper columns, fixed colours and markers of gaits, axes of angles."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from types import MappingProxyType
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gaitsweep.plot.columns import FAILED, NOT_SETTLED

COLUMN, PAGE = 3.4, 7.1  # inches: one column of a paper, and its full width
HATCH = "/////"

# Okabe and Ito's colours, apart for the colour-blind; gaits also differ in lightness, for print in grey.
COLOURS = MappingProxyType(
    {
        "direct": "#E69F00",
        "source": "#009E73",
        "retrograde": "#0072B2",
        "locked": "#CC79A7",
        "none": "#BBBBBB",
        NOT_SETTLED: "#E4E4E4",
        FAILED: "#7A7A7A",
    }
)
MARKERS = MappingProxyType({"direct": "o", "source": "s", "retrograde": "^", "locked": "D", "none": "x"})
SPARE_COLOURS = ("#E69F00", "#0072B2", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#F0E442", "#000000")
SPARE_MARKERS = ("o", "^", "s", "D", "v", "P", "X", "*")

_RC: dict[Any, Any] = {
    "font.size": 8.0,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.0,
    "figure.dpi": 150.0,
    "savefig.dpi": 200.0,
    "hatch.linewidth": 0.5,
    "axes.grid": False,
    "figure.facecolor": "white",
}


@contextlib.contextmanager
def canvas(width: float, height: float, title: str | None = None) -> Iterator[Figure]:
    """An empty figure of this size (inches), in the house style while the block draws on it."""
    with mpl.rc_context(_RC):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        if title:
            figure.suptitle(title, fontsize=9.5)
        yield figure


def colours(names: Iterable[str]) -> dict[str, str]:
    """A colour for each name: a gait's own, the others in the order in which they come."""
    names = list(names)
    free = [colour for colour in SPARE_COLOURS if colour not in {COLOURS.get(name) for name in names}]
    others = [name for name in names if name not in COLOURS]
    spare = {name: free[number % len(free)] for number, name in enumerate(others)}
    return {name: COLOURS.get(name) or spare[name] for name in names}


def markers(names: Iterable[str]) -> dict[str, str]:
    """A marker for each name, as `colours`."""
    names = list(names)
    others = [name for name in names if name not in MARKERS]
    spare = {name: SPARE_MARKERS[number % len(SPARE_MARKERS)] for number, name in enumerate(others)}
    return {name: MARKERS.get(name) or spare[name] for name in names}


def angle_axis(axes: Axes, which: str, steps: int = 4) -> None:
    """Show an angle from 0 to 2 pi on axis x, y or z, ticks at multiples of pi, `steps` intervals a turn."""
    names = {2: ["0", "π", "2π"], 4: ["0", "π/2", "π", "3π/2", "2π"]}[steps]
    getattr(axes, f"set_{which}lim")(0.0, 2 * np.pi)
    getattr(axes, f"set_{which}ticks")(np.linspace(0.0, 2 * np.pi, steps + 1), names)


def message(axes: Axes, text: str) -> None:
    """Say in an empty panel why it is empty."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color="#555555")
