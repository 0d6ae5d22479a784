"""Local regression of scattered points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Real

PerPoint = Float[np.ndarray, " points"]  # a number for each point
LEAST = (3.0, 6.0)  # least weight of the points in the window of a line and of a parabola
SPREAD = 0.02  # least variance of these points, in squared bandwidths; 0.2 if evenly spread
WIDER = (1.0, 1.5, 2.25)  # bandwidths tried for a line where points are few
_WORST = 1e9  # largest condition number of a fit
_BENT = 3.0  # least curvature of a parabola, in standard errors
LEAST_GROUPS = 12  # least number of groups for clustered errors, which are too small with fewer


class _Fit(NamedTuple):
    """A local fit at one position: value and slope with their standard errors; NaN without a fit."""

    value: float = float("nan")
    slope: float = float("nan")
    value_error: float = float("nan")
    slope_error: float = float("nan")


class Smooth(NamedTuple):
    """The curve at k positions, (k,) each: value and slope with standard errors, points in the window.

    All but the number of points are NaN where there are too few points.
    """

    at: Float[np.ndarray, " positions"]
    value: Float[np.ndarray, " positions"]
    slope: Float[np.ndarray, " positions"]
    value_error: Float[np.ndarray, " positions"]
    slope_error: Float[np.ndarray, " positions"]
    points: Int[np.ndarray, " positions"]


def local_polynomial(
    x: PerPoint,
    y: PerPoint,
    group: Real[np.ndarray, " points"],
    share: PerPoint,
    at: Float[np.ndarray, " positions"],
    bandwidth: float,
    degree: int = 1,
    widen: bool = True,
) -> Smooth:
    """Fit a line or a parabola around each position, with weights that fall to zero at `bandwidth`.

    The weights are Epanechnikov's, 1 - (distance/bandwidth)^2. If the points within a bandwidth are too few
    or coincide, a line is fitted to those within 1.5 or 2.25 bandwidths, if that helps. The errors are
    heteroscedastic (jackknifed residuals in a sandwich estimator), with correlated errors within groups. They
    do not contain the bias of a line by curvature: bandwidth^2/10 times the second derivative for the value
    amid the data, and about half a bandwidth times it for the slope at their end. A parabola has no such
    bias.

    Args:
        x, y: the points, (n,).
        group: the group of each point, such as its row, (n,).
        share: the weight of each point in the test for enough points, (n,).
        at: the positions, (k,).
        bandwidth: half the width of the window, in the unit of x.
        degree: 1 or 2; a parabola is fitted only if its curvature is three standard errors from zero.
        widen: whether the window of a line may be widened where points are few.
    """
    order = np.argsort(x, kind="stable")
    x, y, group, share = x[order], y[order], group[order], share[order]
    widths = bandwidth * np.array(WIDER if degree == 1 and widen else WIDER[:1])
    lines = []
    for place in at:
        line = (*_Fit(), 0)
        for width in widths:
            low, high = np.searchsorted(x, place - width, "left"), np.searchsorted(x, place + width, "right")
            near = slice(low, high)
            fit = _fit((x[near] - place) / width, y[near], group[near], share[near], degree)
            line = (fit.value, fit.slope / width, fit.value_error, fit.slope_error / width, high - low)
            if np.isfinite(fit.value):
                break
        lines.append(line)
    value, slope, value_error, slope_error, points = np.array(lines, float).reshape(-1, 5).T
    return Smooth(np.asarray(at, float), value, slope, value_error, slope_error, points.astype(int))


def _enough(distance: PerPoint, weight: PerPoint, least: float) -> bool:
    """Whether the points have the weight `least`, and do not coincide."""
    if len(distance) < 4 or weight.sum() < least:
        return False
    middle = np.average(distance, weights=weight)
    return float(np.average((distance - middle) ** 2, weights=weight)) >= SPREAD


def _fit(
    distance: PerPoint, y: PerPoint, group: Real[np.ndarray, " points"], share: PerPoint, degree: int
) -> _Fit:
    """The value, slope and their standard errors at distance 0, for bandwidth 1."""
    weight = 1.0 - distance**2
    if not _enough(distance, weight * share, LEAST[degree - 1]):
        return _Fit()
    design = distance[:, None] ** np.arange(degree + 1)
    normal = design.T @ (weight[:, None] * design)
    # columns of equal length: then the condition number detects points that coincide
    scale = np.sqrt(np.diag(normal))
    if np.linalg.cond(normal / np.outer(scale, scale)) > _WORST:
        return _Fit()  # all points coincide, as of settled rows: no slope
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
        return _Fit()
    return _Fit(*map(float, (*fit[:2], *errors[:2])))
