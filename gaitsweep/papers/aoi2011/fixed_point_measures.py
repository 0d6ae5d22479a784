"""Measures of fixed points: their stability in fitted return maps and along continued branches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.analyses import AnalysisError, fixed_points, stable_ranges
from gaitsweep.claims import measure


@measure
def kinds_of_fixed_points(
    table: pd.DataFrame, *, observable: str, parameter: str, at: float, bandwidth: float | None = None
) -> list[str]:
    """Kinds of the fixed points of the return map at a value of the parameter, in order of the observable."""
    points = fixed_points(table, observable, parameter, bandwidth)
    at_value = np.flatnonzero(np.isclose(points[parameter].to_numpy(float), at))
    order = at_value[np.argsort(points["value"].to_numpy(float)[at_value])]
    return ["stable" if points["stable"].iloc[k] else "unstable" for k in order]


@measure
def stable_until(
    table: pd.DataFrame,
    *,
    observable: str,
    parameter: str,
    between: Sequence[float],
    take: str,
    bandwidth: float | None = None,
) -> float:
    """Largest (`max`) or smallest (`min`) parameter at which the return map has a stable point in a range."""
    points = fixed_points(table, observable, parameter, bandwidth)
    low, high = between
    value, stable = points["value"].to_numpy(float), points["stable"].to_numpy(bool)
    stable_values = points[parameter].to_numpy(float)[stable & (value >= low) & (value <= high)]
    if not stable_values.size:
        raise AnalysisError(f"No stable fixed point has {observable} between {low:g} and {high:g}.")
    return float(stable_values.max() if take == "max" else stable_values.min())


@measure
def share_with_unstable_between(
    table: pd.DataFrame, *, observable: str, parameter: str, bandwidth: float | None = None
) -> float:
    """Share of the parameter values with two stable fixed points that have an unstable one between (1)."""
    points = fixed_points(table, observable, parameter, bandwidth)
    several = [
        [bool(stable) for stable in points_at_value.sort_values("value")["stable"]]
        for _, points_at_value in points.groupby(parameter)
        if np.count_nonzero(points_at_value["stable"].to_numpy(bool)) >= 2
    ]
    if not several:
        raise AnalysisError("No value of the parameter has two stable fixed points.")
    return sum(not all(kinds) and kinds[0] and kinds[-1] for kinds in several) / len(several)


@measure
def gaits_of_branch(table: pd.DataFrame, *, parameter: str) -> list[str]:
    """Gaits of the stable pieces of the first branch of a continuation, in the order in which they follow."""
    pieces = stable_ranges(table, parameter)
    return list(dict.fromkeys(pieces.loc[pieces["row"] == pieces["row"].min(), "gait"].astype(str)))
