"""Angles of period 2 pi: their differences and means, where to cut the circle, and their columns."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import pandas as pd
from jaxtyping import Complex, Float

if TYPE_CHECKING:
    import jax

TURN = 2.0 * math.pi  # rad
_ROUNDING = 1e-9  # rad
_AT_ZERO = 0.2  # rad: a cluster within so much below 2 pi is one at 0
_LEAST_LENGTH = 1e-12  # mean resultant length of angles below which their direction is rounding

Angles = TypeVar("Angles", "float", "np.ndarray", "jax.Array", "pd.Series")


def wrapped_difference(difference: Angles) -> Angles:
    """Differences of angles, wrapped to [-pi, pi).

    Args:
        difference: a number or an array of any shape, rad.

    Example:
        >>> import numpy as np, gaitsweep as gs
        >>> degrees = np.array([350.0 - 10.0, 90.0 - 0.0])
        >>> np.rad2deg(gs.analyses.wrapped_difference(np.deg2rad(degrees))).round(6).tolist()
        [-20.0, 90.0]
    """
    return (difference + math.pi) % TURN - math.pi


def shorter_way(difference: Float[np.ndarray, "*angles"]) -> Float[np.ndarray, "*angles"]:
    """Differences of angles (rad) by the shorter way; half a turn is -pi, whatever its rounding.

    Args:
        difference: of any shape, rad.
    """
    return difference - TURN * np.floor((difference + TURN / 2.0 + _ROUNDING) / TURN)


def unwrapped(angles: Float[np.ndarray, " angles"]) -> Float[np.ndarray, " angles"]:
    """Angles (rad) in order, each the shorter way from the one before it, as `shorter_way` has it."""
    change = np.diff(angles)
    return np.concatenate([angles[:1], angles[1:] + np.cumsum(shorter_way(change) - change)])


def is_circular(table: pd.DataFrame, name: str) -> bool:
    """Return whether a column is an angle.

    `table.attrs["quantities"]` decides where it names the column, as it is or without the suffix _n, _end or
    _end_2 of section observables; else a name that begins with psi, phi or delta.
    """
    quantities = table.attrs.get("quantities", {})
    without_suffix = re.sub(r"_(n|end(_\d+)?)\Z", "", name)
    for known_name in (name, without_suffix):
        circular = quantities.get(known_name, {}).get("circular")
        if circular is not None:
            return bool(circular)
    return re.match(r"(psi|phi|delta)(_|\Z)", name) is not None


def mean_direction(angles: Float[np.ndarray, " angles"]) -> float:
    """The circular mean of angles, rad, in [0, 2 pi); NaN if there are none, or if they cancel (0 and pi).

    Example:
        The mean of 350 and 30 degrees is 10 degrees, not 190:

        >>> import numpy as np, gaitsweep as gs
        >>> mean = gs.analyses.mean_direction(np.deg2rad([350.0, 30.0]))
        >>> np.rad2deg(mean).round(6).item()
        10.0
    """
    if not len(angles):
        return float("nan")
    mean = float(np.mod(direction(np.exp(1j * np.asarray(angles, float)).mean()), TURN))
    return 0.0 if mean == TURN else mean  # a small negative angle becomes 2 pi by rounding


def direction(resultant: Complex[np.ndarray, "*means"] | complex) -> Float[np.ndarray, "*means"]:
    """The angles of mean resultants (complex, of any shape), rad; NaN where unit vectors cancel."""
    return np.where(np.abs(resultant) > _LEAST_LENGTH, np.angle(resultant), np.nan)


def branch_cut(angles: Float[np.ndarray, " angles"]) -> float:
    """The angle at which to cut the circle so that clusters of angles (rad) stay whole, in (-2 pi, 0].

    It is in a gap between the angles at least half as wide as the widest: 0 if such a gap contains 0, so that
    they keep their usual range; else the middle of the last such gap, less a turn. A cluster right below 2 pi
    is at 0, too.
    """
    on_circle = np.unique(np.mod(np.asarray(angles, float)[np.isfinite(angles)], TURN))
    if not len(on_circle):
        return 0.0
    gaps = np.diff(np.append(on_circle, on_circle[0] + TURN))
    wide = np.flatnonzero(gaps >= 0.5 * gaps.max())
    last = int(wide[-1])
    if last == len(on_circle) - 1:
        below = int(wide[-2]) if len(wide) > 1 else -1  # the gap below the last cluster
        if on_circle[below + 1] < TURN - _AT_ZERO:
            return 0.0
        if below < 0:
            return -0.5 * TURN
        last = below
    return float(on_circle[last] + 0.5 * gaps[last] - TURN)


def unwrap_from(angles: Float[np.ndarray, " angles"], origin: float | None) -> Float[np.ndarray, " angles"]:
    """Angles (rad) in the turn that begins at `origin`; unchanged without an origin, as other values have.

    Example:
        >>> import numpy as np, gaitsweep as gs
        >>> np.rad2deg(gs.analyses.unwrap_from(np.deg2rad([350.0, 10.0]), -np.pi)).round(6).tolist()
        [-10.0, 10.0]
    """
    values = np.asarray(angles, float)
    return values if origin is None else origin + np.mod(values - origin, TURN)


def in_nearest_turn(angles: pd.Series) -> pd.Series:
    """Angles (rad) of a cluster: unchanged, or in another turn if their range is smaller there."""
    values = angles.to_numpy(float)
    turned = pd.Series(unwrap_from(values, branch_cut(values)), angles.index)
    return turned if turned.max() - turned.min() < angles.max() - angles.min() - _ROUNDING else angles
