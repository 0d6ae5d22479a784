"""The passes of one row: a parameter's way up and its way down, in their colours, with arrows."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch
from matplotlib.transforms import ScaledTranslation

from gaitsweep.analysis.transitions.jumps import STEEPER, where_it_moves
from gaitsweep.angles import unwrap_from
from gaitsweep.plot import theme

UP, DOWN = "#E69F00", "#0072B2"  # distinct for colour-blind readers, and in lightness
LINES: dict[str, Any] = {UP: "-", DOWN: (0, (4, 2))}
MARKER: dict[str, Any] = {"ms": 5.0, "mew": 0.9}  # points: whether it is hollow is seen at 85 mm
_GRID = 201  # values of the parameter at which two passes are compared


class Pass(NamedTuple):
    """A drawn pass: the parameter and the observable, (n,) each, and its colour."""

    at: Float[np.ndarray, " records"]
    value: Float[np.ndarray, " records"]
    colour: str


def draw_row(
    axes: Axes,
    part: pd.DataFrame,
    name: str,
    parameter: str,
    origin: float | None,
    alpha: float,
    least: float,
) -> list[Pass]:
    """Draw one row: each pass as a line (of a ramp) or markers (of a staircase); returns its passes.

    Lines are interrupted at missing records, where an angle wraps, and, between stairs, at jumps by `least`.
    """
    stairs = "stair" in part.columns
    if not stairs:
        part = part.iloc[where_it_moves(part[parameter].to_numpy(float)) :]
    at, value = part[parameter].to_numpy(float), part[name].to_numpy(float)
    numbers = part["pass"].to_numpy(int)
    count = part["stair" if stairs else "crossing"].to_numpy(int)
    value = unwrap_from(value, origin)
    settled = part["settled"].to_numpy(bool) if "settled" in part.columns else np.ones(len(part), bool)
    passes = []
    for number in np.unique(numbers):
        records = np.flatnonzero(numbers == number)
        line = np.arange(max(records[0] - 1, 0), records[-1] + 1)  # from the turning point on
        colour, marker = (UP, "^") if at[line[-1]] >= at[line[0]] else (DOWN, "v")
        passes.append(Pass(at[line], value[line], colour))
        change = np.abs(np.diff(value[line]))
        parted = np.diff(count[line]) > 1
        if origin is not None:
            parted |= change > np.pi
        if stairs and len(change):
            parted |= change >= max(least, STEEPER * float(np.quantile(change, 0.25)))
        pieces = theme.interrupted(parted, at[line], value[line])
        axes.plot(*pieces, color=colour, ls=LINES[colour], lw=0.8, alpha=alpha)
        if stairs:
            look: dict[str, Any] = {"ls": "", "marker": marker, "alpha": alpha, **MARKER}
            for which, face in ((settled[records], colour), (~settled[records], "white")):
                axes.plot(at[records][which], value[records][which], color=colour, mfc=face, **look)
    return passes


def draw_arrows(axes: Axes, passes: list[Pass], least: float) -> None:
    """Draw an arrow along the first pass up and the first pass down, where the two differ most.

    No arrow is drawn if they never differ by half of `least` (in the observable's unit).
    """
    first = {one.colour: one for one in reversed(passes)}
    if set(first) != {UP, DOWN}:
        return
    low = max(float(one.at.min()) for one in first.values())
    high = min(float(one.at.max()) for one in first.values())
    if not high > low:
        return
    grid = np.linspace(low, high, _GRID)
    curves = {colour: _along(one, grid) for colour, one in first.items()}
    differ = np.abs(curves[UP] - curves[DOWN])
    if differ.max() < 0.5 * least:
        return
    begin, end = _longest(differ >= 0.5 * differ.max())
    half = min(0.06 * (high - low), 0.4 * (grid[end] - grid[begin]))
    at = (begin + end) // 2
    for colour, curve in curves.items():
        above = curve[at] >= curves[DOWN if colour == UP else UP][at]
        offset = ScaledTranslation(0.0, (9 if above else -9) / 72, axes.figure.dpi_scale_trans)
        way = half if colour == UP else -half
        look: dict[str, Any] = {"arrowstyle": "-|>", "mutation_scale": 9, "shrinkA": 0, "shrinkB": 0}
        ends = (grid[at] - way, curve[at]), (grid[at] + way, curve[at])
        arrow = FancyArrowPatch(*ends, color=colour, lw=1.0, zorder=5, **look)
        arrow.set_transform(axes.transData + offset)
        axes.add_patch(arrow)


def _along(one: Pass, grid: Float[np.ndarray, " grid"]) -> Float[np.ndarray, " grid"]:
    """A pass's values at the grid's parameters."""
    order = np.argsort(one.at, kind="stable")
    return np.interp(grid, one.at[order], one.value[order])


def _longest(marked: Bool[np.ndarray, " grid"]) -> tuple[int, int]:
    """The first and last index of the longest run that is marked."""
    turns = np.flatnonzero(np.diff(np.r_[False, marked, False]))
    begins, ends = turns[::2], turns[1::2] - 1
    longest = int(np.argmax(ends - begins))
    return int(begins[longest]), int(ends[longest])
