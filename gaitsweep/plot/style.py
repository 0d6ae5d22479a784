"""The style of figures: sizes of paper columns, colours and markers of gaits, axes of angles."""

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
from matplotlib.ticker import FuncFormatter, MultipleLocator

from gaitsweep.contract import Outcome
from gaitsweep.extension import gait_styles

COLUMN, PAGE = 3.4, 7.1  # inches: one column of a paper, and its full width
HATCH = "/////"

# Of outcomes that no model names; gaits have those of their extensions.
COLOURS = MappingProxyType({"none": "#BBBBBB", Outcome.NOT_SETTLED: "#E4E4E4", Outcome.FAILED: "#3B3B3B"})
MARKERS = MappingProxyType({"none": "x"})
# Okabe and Ito's colours, distinct for colour-blind readers.
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
    """A context with an empty figure of this size (inches), in which Matplotlib has this style."""
    with mpl.rc_context(_RC):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        if title:
            figure.suptitle(title, fontsize=9.5)
        yield figure


def colours(names: Iterable[str]) -> dict[str, str]:
    """A colour for each name: that of a gait, else spare colours in order."""
    names, own = list(names), {name: colour for name, (colour, _) in gait_styles().items()} | dict(COLOURS)
    free = [colour for colour in SPARE_COLOURS if colour not in {own.get(name) for name in names}]
    others = [name for name in names if name not in own]
    spare = {name: free[number % len(free)] for number, name in enumerate(others)}
    return {name: own.get(name) or spare[name] for name in names}


def markers(names: Iterable[str]) -> dict[str, str]:
    """A marker for each name, as for `colours`."""
    names, own = list(names), {name: marker for name, (_, marker) in gait_styles().items()} | dict(MARKERS)
    others = [name for name in names if name not in own]
    spare = {name: SPARE_MARKERS[number % len(SPARE_MARKERS)] for number, name in enumerate(others)}
    return {name: own.get(name) or spare[name] for name in names}


def angle_axis(axes: Axes, which: str, steps: int = 4) -> None:
    """Show an angle on axis x, y or z with ticks at multiples of pi, `steps` intervals per turn.

    The axis extends from 0 to 2 pi, or only over the data if they take less than half of that.
    """
    if which in "xy" and not _half_a_turn(axes, which):
        angle_ticks(axes, which)
        return
    names = {2: ["0", "π", "2π"], 4: ["0", "π/2", "π", "3π/2", "2π"]}[steps]
    getattr(axes, f"set_{which}lim")(0.0, 2 * np.pi)
    getattr(axes, f"set_{which}ticks")(np.linspace(0.0, 2 * np.pi, steps + 1), names)


def _half_a_turn(axes: Axes, which: str) -> bool:
    """Whether the data of an axis and those that share it extend over half a turn, or there are no data."""
    shared = getattr(axes, f"get_shared_{which}_axes")().get_siblings(axes)
    spans = np.array([getattr(each.dataLim, f"interval{which}") for each in shared])
    spans = spans[np.isfinite(spans).all(axis=1)]
    return not len(spans) or float(np.ptp(spans)) >= np.pi


def percent(share: float) -> str:
    """Format a fraction in whole per cent, for a legend."""
    return "<1" if 0.0 < share < 0.005 else f"{100 * share:.0f}"


def angle_ticks(axes: Axes, which: str) -> None:
    """Ticks at round multiples of pi on a part of the circle that axis x or y already shows."""
    low, high = sorted(getattr(axes, f"get_{which}lim")())
    steps = (0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0)
    step = next((step for step in steps if (high - low) / (step * np.pi) <= 6.0), steps[-1])
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(MultipleLocator(step * np.pi))
    axis.set_major_formatter(FuncFormatter(lambda value, _: in_pi(value, fractions=step >= 0.25)))


def in_pi(angle: float, *, fractions: bool = True) -> str:
    """Format an angle (rad) as a multiple of pi: 3π/4, or 0.77π if it is not a simple fraction."""
    turns = round(angle / np.pi, 4)
    if turns == round(turns):
        return {0: "0", 1: "π", -1: "−π"}.get(round(turns), f"{round(turns)}π").replace("-", "−")
    if fractions and 4 * turns == round(4 * turns):
        bottom = 2 if 2 * turns == round(2 * turns) else 4
        top = round(turns * bottom)
        return f"{'−' if top < 0 else ''}{'' if abs(top) == 1 else abs(top)}π/{bottom}"
    return f"{turns:.4g}π".replace("-", "−")


def message(axes: Axes, text: str) -> None:
    """Write the reason into an empty panel."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color="#555555")
