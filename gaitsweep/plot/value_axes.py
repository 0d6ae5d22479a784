"""Axes of angles, with ticks at multiples of pi, and of values over a parameter; gaps of lines."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, Locator, MultipleLocator

from gaitsweep.plot.columns import PlotError

# Distances of ticks, in pi.
_FINE_STEPS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5)
_STEPS = (*_FINE_STEPS, *(digit * 10.0**power for power in range(16) for digit in (1.0, 2.0, 5.0)))
# The least span of values along an axis, below which rounding would look like a change.
_LEAST_ANGLE = 0.01  # rad
_LEAST_SHARE = 1e-3  # of the largest magnitude
_LEAST_VALUE = 1e-9  # in the unit of the axis
_SHORT = 4  # ticks for which an axis of a turn has room, below which it has one at every half turn
_FRACTIONS_FROM = 0.25  # pi: least distance of ticks that are labelled with fractions


class _TurnLocator(FixedLocator):
    """Ticks over a turn in an even number of steps, at every half turn where an axis is short."""

    def __init__(self, steps: int) -> None:
        super().__init__(np.linspace(0.0, 2 * np.pi, steps + 1).tolist())

    def __call__(self) -> Any:
        ticks = super().__call__()
        short = self.axis is not None and self.axis.get_tick_space() < _SHORT
        return ticks[:: (len(ticks) - 1) // 2] if short else ticks


class _PiLocator(Locator):
    """Ticks at round multiples of pi, as many as an axis has room for, at most seven."""

    def __call__(self) -> Any:
        assert self.axis is not None
        return self.tick_values(*self.axis.get_view_interval())

    def step(self) -> float:
        """The distance of two ticks, in pi."""
        assert self.axis is not None
        span = abs(float(np.ptp(self.axis.get_view_interval()))) / np.pi
        most = max(2, min(6, self.axis.get_tick_space()))
        return next((step for step in _STEPS if span / step <= most), _STEPS[-1])

    def tick_values(self, vmin: float, vmax: float) -> Any:
        return MultipleLocator(self.step() * np.pi).tick_values(vmin, vmax)


def angle_axis(axes: Axes, which: Literal["x", "y", "z"], steps: int = 4) -> None:
    """Show an angle (rad) along an axis with ticks at multiples of pi.

    The axis extends from 0 to 2 pi; axis x or y only over the data if they take less than half of that.

    Args:
        axes: the panel.
        which: x, y or z.
        steps: intervals between ticks in a turn, an even number.

    Raises:
        PlotError: the number of steps is not even, or below 2.
    """
    if steps < 2 or steps % 2:
        raise PlotError(f"steps is {steps}, but must be even, so that a tick is at half a turn.")
    if which != "z" and not _half_a_turn(axes, which):
        angle_ticks(axes, which)
        return
    getattr(axes, f"set_{which}lim")(0.0, 2 * np.pi)
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(_TurnLocator(steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: in_pi(value)))


def value_axis(axes: Axes, *, angle: bool) -> None:
    """Scale axis y to values over a parameter: angles in pi, and no span so small that rounding shows."""
    if angle:
        angle_ticks(axes, "y")
    spans = [panel.dataLim.intervaly for panel in axes.get_shared_y_axes().get_siblings(axes)]
    values = np.array([span for span in spans if np.isfinite(span).all()])
    if not len(values) or axes.get_yscale() != "linear":
        return
    low, high = float(values.min()), float(values.max())
    least = _LEAST_ANGLE if angle else max(_LEAST_SHARE * max(-low, high), _LEAST_VALUE)
    if high - low < least:
        axes.set_ylim(0.5 * (low + high - least), 0.5 * (low + high + least))


def _half_a_turn(axes: Axes, which: Literal["x", "y"]) -> bool:
    """Whether the data of an axis and those that share it extend over half a turn, or there are no data."""
    shared = getattr(axes, f"get_shared_{which}_axes")().get_siblings(axes)
    spans = np.array([getattr(other.dataLim, f"interval{which}") for other in shared])
    spans = spans[np.isfinite(spans).all(axis=1)]
    return not len(spans) or float(np.ptp(spans)) >= np.pi


def angle_ticks(axes: Axes, which: Literal["x", "y"]) -> None:
    """Put ticks at round multiples of pi on axis x or y, which shows a part of the circle."""
    axis = getattr(axes, f"{which}axis")
    locator = _PiLocator()
    axis.set_major_locator(locator)

    def label(value: float, _: int | None) -> str:
        return in_pi(value, fractions=locator.step() >= _FRACTIONS_FROM)

    axis.set_major_formatter(FuncFormatter(label))


def in_pi(angle: float, *, fractions: bool = True) -> str:
    """Format an angle (rad) as a multiple of pi to four decimals: 3π/4, or 0.77π if no simple fraction."""
    half_turns = round(angle / np.pi, 4)
    if half_turns == round(half_turns):
        return {0: "0", 1: "π", -1: "−π"}.get(round(half_turns), f"{round(half_turns)}π").replace("-", "−")
    if fractions and 4 * half_turns == round(4 * half_turns):
        bottom = 2 if 2 * half_turns == round(2 * half_turns) else 4
        top = round(half_turns * bottom)
        return f"{'−' if top < 0 else ''}{'' if abs(top) == 1 else abs(top)}π/{bottom}"
    return f"{half_turns}π".replace("-", "−")


def interrupted(
    parted: Bool[np.ndarray, " gaps"], *lines: Float[np.ndarray, " points"]
) -> list[Float[np.ndarray, " interrupted"]]:
    """Insert NaN into lines (n,) between neighbours that are `parted` (n - 1,), where a line has a gap."""
    gaps = np.flatnonzero(parted) + 1
    return [np.insert(line, gaps, np.nan) for line in lines]
