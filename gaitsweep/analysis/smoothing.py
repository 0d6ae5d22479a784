"""Local regression: a smooth curve through scattered points, its slope, and the errors of both."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

LEAST_POINTS = 4  # for each coefficient, within a bandwidth on either side, else there is no curve there
_BENT = 3.0  # standard errors of its bending that a parabola has to show
_WORST = 1e9  # condition of a fit that still tells something
LEAST_GROUPS = 5  # groups of points that belong together, for errors that know of them


class Smooth(NamedTuple):
    """The curve at some places, (k,) each: value and slope with their standard errors, points in the window.

    All but the points are NaN where there are too few points.
    """

    at: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    value_error: np.ndarray
    slope_error: np.ndarray
    points: np.ndarray


def local_polynomial(
    x: np.ndarray, y: np.ndarray, group: np.ndarray, at: np.ndarray, bandwidth: float, degree: int = 1
) -> Smooth:
    """Fit a line or a parabola around each place, by weights that fall to zero at `bandwidth` from it.

    The weights are Epanechnikov's, 1 - (distance/bandwidth)^2. The errors come from the scatter around the
    fit, whatever its size along x (jackknifed residuals in a sandwich); points of a group may err together.
    What a line loses to the curve's bending is not in them: value by bandwidth^2/10 times the second
    derivative amid the data, and slope by about half a bandwidth times it at their end; a parabola does not.

    Args:
        x, y: the points, (n,).
        group: which points belong together, such as those of one row, (n,).
        at: the places, (k,).
        bandwidth: half the width of the window, in the unit of x.
        degree: 1 or 2; a parabola is fitted only where its bending is three standard errors from none.
    """
    order = np.argsort(x, kind="stable")
    x, y, group = x[order], y[order], group[order]
    lows, highs = np.searchsorted(x, at - bandwidth, "left"), np.searchsorted(x, at + bandwidth, "right")
    fits = [
        _fit((x[low:high] - place) / bandwidth, y[low:high], group[low:high], degree)
        for place, low, high in zip(at, lows, highs, strict=True)
    ]
    value, slope, value_error, slope_error = np.array(fits, float).reshape(-1, 4).T
    return Smooth(
        np.asarray(at, float), value, slope / bandwidth, value_error, slope_error / bandwidth, highs - lows
    )


def _fit(distance: np.ndarray, y: np.ndarray, group: np.ndarray, degree: int) -> tuple[float, ...]:
    """Value, slope and their standard errors at distance 0, the bandwidth being 1."""
    nothing = (float("nan"),) * 4
    weight = 1.0 - distance**2
    if len(distance) < LEAST_POINTS * (degree + 1) or weight.sum() <= 0.0:
        return nothing
    design = distance[:, None] ** np.arange(degree + 1)
    normal = design.T @ (weight[:, None] * design)
    # columns to one length: then the condition tells points in one place from points far from it
    scale = np.sqrt(np.diag(normal))
    if np.linalg.cond(normal / np.outer(scale, scale)) > _WORST:
        return nothing  # all in one place: they have settled, and tell no slope
    inverse = np.linalg.inv(normal)
    fit = inverse @ (design.T @ (weight * y))
    leverage = weight * np.einsum("ij,jk,ik->i", design, inverse, design)
    residual = (y - design @ fit) / np.maximum(1.0 - leverage, 0.1)
    scores = (weight * residual)[:, None] * design
    names, member = np.unique(group, return_inverse=True)
    if len(names) >= LEAST_GROUPS:
        scores = np.stack([np.bincount(member, column) for column in scores.T], axis=1)
        scores *= np.sqrt(len(names) / (len(names) - 1))
    spread = inverse @ (scores.T @ scores) @ inverse
    errors = np.sqrt(np.maximum(np.diag(spread), 0.0))
    if degree == 2 and abs(fit[2]) < _BENT * errors[2]:
        return nothing
    value_error, slope_error = errors[:2]
    return float(fit[0]), float(fit[1]), float(value_error), float(slope_error)
