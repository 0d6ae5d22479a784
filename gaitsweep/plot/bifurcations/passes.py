"""The passes of one row: a parameter's rise and its fall, in their colours, with arrows."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch
from matplotlib.transforms import ScaledTranslation

from gaitsweep.analysis.circular import unwrap_from
from gaitsweep.analysis.transitions.jumps import STEEPER, where_it_moves
from gaitsweep.plot import theme

UP, DOWN = "#E69F00", "#0072B2"  # distinct for colour-blind readers, and in lightness
LINES: dict[str, Any] = {UP: "-", DOWN: (0, (4, 2))}
MARKER: dict[str, Any] = {"ms": 5.0, "mew": 0.9}  # points: large enough to be seen as hollow in 85 mm
_GRID = 201  # values of the parameter at which two passes are compared


class Pass(NamedTuple):
    """A drawn pass: the parameter and the observable, (n,) each, and its colour."""

    at: Float[np.ndarray, " records"]
    value: Float[np.ndarray, " records"]
    colour: str


def draw_row(
    axes: Axes,
    records: pd.DataFrame,
    name: str,
    parameter: str,
    origin: float | None,
    alpha: float,
    least: float,
) -> list[Pass]:
    """Draw one row: each pass as a line (of a ramp) or markers (of a staircase).

    Lines are interrupted at missing records, where an angle wraps, and, between stairs, at jumps.

    Args:
        axes: the panel.
        records: the row's records in their order.
        name, parameter: columns along axis y and axis x.
        origin: the angle (rad) at which axis y cuts the circle; None if y is no angle.
        alpha: opacity of lines and markers, from 0 to 1.
        least: change of y that counts as a jump, in its unit.

    Returns:
        The passes.
    """
    stairs = "stair" in records.columns
    if not stairs:
        records = records.iloc[where_it_moves(records[parameter].to_numpy(float)) :]
    at = records[parameter].to_numpy(float)
    value = unwrap_from(records[name].to_numpy(float), origin)
    pass_numbers = records["pass"].to_numpy(int)
    order = records["stair" if stairs else "crossing"].to_numpy(int)
    settled = np.ones(len(records), bool)
    if "settled" in records.columns:
        settled = records["settled"].to_numpy(bool)
    passes = []
    for number in np.unique(pass_numbers):
        of_pass = np.flatnonzero(pass_numbers == number)
        line = np.arange(max(of_pass[0] - 1, 0), of_pass[-1] + 1)  # from the turning point on
        colour, marker = (UP, "^") if at[line[-1]] >= at[line[0]] else (DOWN, "v")
        passes.append(Pass(at[line], value[line], colour))
        change = np.abs(np.diff(value[line]))
        parted = np.diff(order[line]) > 1
        if origin is not None:
            parted |= change > np.pi
        if stairs and len(change):
            parted |= change >= max(least, STEEPER * float(np.quantile(change, 0.25)))
        pieces = theme.interrupted(parted, at[line], value[line])
        axes.plot(*pieces, color=colour, ls=LINES[colour], lw=0.8, alpha=alpha)
        if stairs:
            look: dict[str, Any] = {"ls": "", "marker": marker, "alpha": alpha, "color": colour, **MARKER}
            closed, hollow = of_pass[settled[of_pass]], of_pass[~settled[of_pass]]
            axes.plot(at[closed], value[closed], mfc=colour, **look)
            axes.plot(at[hollow], value[hollow], mfc="white", **look)
    return passes


def draw_arrows(axes: Axes, passes: list[Pass], least: float) -> None:
    """Draw an arrow along the first pass up and the first pass down, where the two differ most.

    No arrow is drawn if they never differ by half of `least` (in the observable's unit).
    """
    first_passes = {drawn.colour: drawn for drawn in reversed(passes)}
    if set(first_passes) != {UP, DOWN}:
        return
    low = max(float(drawn.at.min()) for drawn in first_passes.values())
    high = min(float(drawn.at.max()) for drawn in first_passes.values())
    if not high > low:
        return
    grid = np.linspace(low, high, _GRID)
    curves = {colour: _along(drawn, grid) for colour, drawn in first_passes.items()}
    differ = np.abs(curves[UP] - curves[DOWN])
    if differ.max() < 0.5 * least:
        return
    begin, end = _longest(differ >= 0.5 * differ.max())
    half_length = min(0.06 * (high - low), 0.4 * (grid[end] - grid[begin]))
    middle = (begin + end) // 2
    for colour, curve in curves.items():
        above = curve[middle] >= curves[DOWN if colour == UP else UP][middle]
        offset = ScaledTranslation(0.0, (9 if above else -9) / 72, axes.figure.dpi_scale_trans)
        ahead = half_length if colour == UP else -half_length
        look: dict[str, Any] = {"arrowstyle": "-|>", "mutation_scale": 9, "shrinkA": 0, "shrinkB": 0}
        ends = (grid[middle] - ahead, curve[middle]), (grid[middle] + ahead, curve[middle])
        arrow = FancyArrowPatch(*ends, color=colour, lw=1.0, zorder=5, **look)
        arrow.set_transform(axes.transData + offset)
        axes.add_patch(arrow)


def _along(drawn: Pass, grid: Float[np.ndarray, " grid"]) -> Float[np.ndarray, " grid"]:
    """A pass's values at the grid's parameters."""
    order = np.argsort(drawn.at, kind="stable")
    return np.interp(grid, drawn.at[order], drawn.value[order])


def _longest(marked: Bool[np.ndarray, " grid"]) -> tuple[int, int]:
    """The first and last index of the longest run that is marked."""
    turns = np.flatnonzero(np.diff(np.r_[False, marked, False]))
    begins, ends = turns[::2], turns[1::2] - 1
    longest = int(np.argmax(ends - begins))
    return int(begins[longest]), int(ends[longest])
