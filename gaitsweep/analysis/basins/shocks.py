"""How far a start is from one that comes out otherwise: the smallest shock that changes the outcome."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from gaitsweep.analysis.attractors.state_space import Space
from gaitsweep.analysis.gaits.records import AnalysisError


def shocks(
    table: pd.DataFrame,
    axes: Sequence[str],
    outcomes: pd.Series,
    scales: Mapping[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The distance from each start to the nearest one with another outcome, angles by the shorter way.

    Exact among the starts that there are: on a grid the boundary itself lies up to one step nearer.

    Args:
        table: a settle table; its rows differ along `axes` alone.
        axes: the columns of the starts.
        outcomes: what each row came to.
        scales: by column, what counts as one in the distance; 1 in the column's unit if not given.

    Returns:
        Distances (n,), inf where no start comes out otherwise, and the outcome there (n,), None likewise.

    Raises:
        AnalysisError: a column is not there, or the axes have different units and a scale is missing.
    """
    _check_units(table, axes, scales)
    space = Space.of(table, axes, scales)
    points = space.points(table, axes)
    apart = np.full(len(table), np.inf)
    towards = np.full(len(table), None, object)
    came_to = outcomes.to_numpy()
    for each in pd.unique(came_to):
        mine, others = np.flatnonzero(came_to == each), np.flatnonzero(came_to != each)
        if others.size:
            distance, nearest = space.tree(points[others]).query(points[mine])
            apart[mine], towards[mine] = distance, came_to[others[nearest]]
    return apart, towards


def _check_units(table: pd.DataFrame, axes: Sequence[str], scales: Mapping[str, float] | None) -> None:
    known = table.attrs.get("quantities", {})
    units = {name: str(known.get(name, {}).get("unit", "")) for name in axes if name not in (scales or {})}
    if len(set(units.values())) > 1:
        shown = ", ".join(f"{name} in {unit or '1'}" for name, unit in units.items())
        raise AnalysisError(
            f"A distance needs one unit, but the axes are {shown}: give scales, such as "
            f"{{{next(iter(units))!r}: 1.0}}, for what counts as one along each."
        )
