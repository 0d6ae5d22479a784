"""Footfalls in the limbs' colours, up to the time of a frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from gaitsweep.plot.gaits.footprints import contact_intervals
from gaitsweep.plot.limb_colours import limb_colours
from gaitsweep.skeleton import Limb

_BAR = 0.66
_MOST_NAMES = 16  # with more limbs only some are named


class Footfalls:
    """Footfall bars of each foot over time (s), the first limb on top."""

    def __init__(self, axes: Axes, limbs: Sequence[Limb], t: np.ndarray, contact: np.ndarray) -> None:
        """Draw all bars.

        Args:
            axes: the axes; their window of time is set later.
            limbs: names and colours of the limbs.
            t: times of the whole trace, (n,) s.
            contact: 1 while a foot is on the ground, (n, limbs).
        """
        self._axes = axes
        colours = limb_colours(limbs)
        for row, colour in enumerate(colours):
            starts, stops = contact_intervals(t, contact[:, row])
            bars = list(zip(starts, stops - starts, strict=True))
            axes.broken_barh(bars, (row - _BAR / 2, _BAR), facecolors=colour, linewidth=0)
        every = -(-len(limbs) // _MOST_NAMES)
        named = range(0, len(limbs), every)
        axes.set_yticks(list(named), [limbs[row].name for row in named])
        for tick, row in zip(axes.get_yticklabels(), named, strict=True):
            tick.set_color(colours[row])
            tick.set_fontweight("bold")
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        axes.set_ylim(len(limbs) - 0.4, -0.6)
        axes.set_xlabel("time (s)", labelpad=1.5)
        self._veil = axes.axvspan(0.0, 0.0, facecolor="white", linewidth=0, zorder=3)
        self._now = axes.axvline(0.0, color="black", lw=1.1, zorder=4)

    def window(self, low: float, high: float) -> None:
        """Show the time (s) from `low` to `high` alone."""
        self._axes.set_xlim(low, high)

    def now(self, t: float) -> None:
        """Set the current time `t` (s), and hide later footfalls."""
        self._now.set_xdata([t, t])
        self._veil.set_x(t)
        self._veil.set_width(max(self._axes.get_xlim()[1] - t, 0.0))

    def moments(self, times: Sequence[float]) -> None:
        """Mark several times (s), numbered from 1, instead of one."""
        self._now.set_visible(False)
        for number, t in enumerate(times):
            self._axes.axvline(t, color="black", lw=0.8, ls=(0, (4, 2)), zorder=4)
            self._axes.annotate(
                str(number + 1), (t, 1.0), (0, 1.5), xycoords=("data", "axes fraction"),
                textcoords="offset points", ha="center", va="bottom", fontsize=8, weight="bold",
            )  # fmt: skip
