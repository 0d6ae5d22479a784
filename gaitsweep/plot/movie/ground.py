"""The ground below a walking body: a moving strip with marks at round distances."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Rectangle

_STRIP, _MARK, _INK = "#F1EEE8", "#CFC9BE", "#8A8478"
_MARKS = 7  # approximate number of marks across the frame
# Space above the body and below the ground, as shares of its height, with names and without.
_NAMED, _PLAIN = (1.22, 0.24), (1.12, 0.1)


class Ground:
    """A strip of ground in axes, whose limits it sets."""

    def __init__(
        self, axes: Axes, half: float, height: float, depth: float, aside: np.ndarray, *, named: bool
    ) -> None:
        """Draw the strip.

        Args:
            axes: the axes; their limits are set to contain the body at equal scales.
            half: half of the body's width, m.
            height: the body's height, m.
            depth: half the width of the strip, m.
            aside: the drawn offset of a metre to the left, (2,) m.
            named: whether marks show their position.
        """
        self._aside = aside * depth
        self.near = -float(self._aside[1])
        above, below = _NAMED if named else _PLAIN
        low, high = self.near - below * height, above * height
        box = axes.get_window_extent()
        ratio = box.width / max(box.height, 1.0)
        width = max(2.3 * half, (high - low) * ratio)
        spare = max(0.0, width / ratio - (high - low))
        self._half = 0.5 * width
        axes.set_xlim(-self._half, self._half)
        axes.set_ylim(low - 0.5 * spare, high + 0.5 * spare)
        strip = Rectangle((-self._half, self.near), width, -2.0 * self.near, facecolor=_STRIP, zorder=0)
        axes.add_patch(strip)
        self._step = _round_step(width / _MARKS)
        self._marks = LineCollection([], colors=_MARK, linewidths=0.9, zorder=1)
        axes.add_collection(self._marks, autolim=False)
        self._labels = [
            axes.text(
                0.0, self.near, "", color=_INK, fontsize=6.5, ha="left", va="bottom", zorder=1.2, clip_on=True
            )
            for _ in range(2 * _MARKS + 4 if named else 0)
        ]

    def show(self, place: float) -> None:
        """Move the marks for a frame whose middle is at `place` (m) along the ground."""
        reach = self._half + abs(float(self._aside[0]))
        first, last = np.ceil((place - reach) / self._step), np.floor((place + reach) / self._step)
        marks = np.arange(first, last + 1.0) * self._step
        ahead = np.column_stack([marks - place, np.zeros_like(marks)])
        self._marks.set_segments(list(np.stack([ahead - self._aside, ahead + self._aside], axis=1)))
        digits = max(0, int(np.ceil(-np.log10(self._step) - 1e-9)))
        for label, x in zip(self._labels, marks, strict=False):
            label.set_position((x - place - self._aside[0] + 0.05 * self._step, self.near))
            label.set_text(f"{x + 0.0:.{digits}f} m")
        for label in self._labels[len(marks) :]:
            label.set_text("")


def _round_step(length: float) -> float:
    """The next number from 1, 2, 5, 10, ... times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(
        power * next(head for head in (1.0, 2.0, 5.0, 10.0) if head * power >= length * (1.0 - 1e-9))
    )
