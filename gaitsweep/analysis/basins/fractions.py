"""The share of starts that come to each outcome, with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from gaitsweep.analysis.basins.grid import BasinGrid, find_grid
from gaitsweep.analysis.basins.outcomes import in_order, outcomes
from gaitsweep.analysis.basins.proportions import LEVEL, clopper_pearson, one_a_cell, wilson
from gaitsweep.analysis.gaits.records import AnalysisError, axes_of, require

_INTERVALS = {"wilson": wilson, "clopper_pearson": clopper_pearson}
_COLUMNS = ["outcome", "rows", "of", "fraction", "low", "high", "interval"]


def fractions(
    table: pd.DataFrame,
    axes: Sequence[str] | None = None,
    *,
    label: str = "gait",
    by: str | Sequence[str] = (),
    level: float = LEVEL,
    interval: str | None = None,
) -> pd.DataFrame:
    """The share of starts that come to each outcome.

    Args:
        table: a settle table; rows that were inferred count as others do.
        axes: the columns of the starts; what varies and is not in `by` if not given.
        label: the column of what starts come to.
        by: columns of which each combination of values is a panel, counted by itself.
        level: of the intervals.
        interval: wilson, clopper_pearson or cells; `cells` for grids and `wilson` for others if not given.
            The first two take starts for independent draws: on a grid they are too wide. `cells` takes them
            for one draw from each cell, whose own share is that among it and its neighbours.

    Returns:
        One record a panel and outcome: by, outcome, rows, of (rows of the panel), fraction, low, high and the
        kind of interval.

    Raises:
        AnalysisError: a column is not there, or an argument is not one of those allowed.
    """
    by, axes = panels_and_axes(table, by, axes)
    _check(level, interval)
    came_to = outcomes(table, label)
    names = in_order(table, label, came_to)
    found = []
    for place, rows in panels_of(table, by):
        grid = find_grid(table.iloc[rows], axes)
        for record in _shares(came_to.iloc[rows].to_numpy(), names, grid, level, interval):
            found.append({**place, **record})
    return pd.DataFrame(found, columns=[*by, *_COLUMNS])


def panels_and_axes(
    table: pd.DataFrame, by: str | Sequence[str], axes: Sequence[str] | None
) -> tuple[list[str], list[str]]:
    """The columns of the panels, and those of the starts: what varies besides, if they are not given.

    Raises:
        AnalysisError: a column is not there.
    """
    by = [by] if isinstance(by, str) else list(by)
    axes = [name for name in axes_of(table) if name not in by] if axes is None else list(axes)
    require(table, "status", *axes, *by)
    return by, axes


def panels_of(table: pd.DataFrame, by: Sequence[str]) -> Iterator[tuple[dict[str, object], np.ndarray]]:
    """Each combination of the values of `by` in order, and where its rows stand; all rows without `by`."""
    if not by:
        yield {}, np.arange(len(table))
        return
    for key, rows in table.groupby(list(by), sort=True, observed=True).indices.items():
        values = key if isinstance(key, tuple) else (key,)
        yield dict(zip(by, values, strict=True)), np.sort(rows)


def _check(level: float, interval: str | None) -> None:
    if not 0.0 < level < 1.0:
        raise AnalysisError(f"level is {level:g}, but must be between 0 and 1.")
    if interval not in (None, "cells", *_INTERVALS):
        allowed = ", ".join(["cells", *_INTERVALS])
        raise AnalysisError(f"interval is {interval}, but takes one of {allowed}.")


def _shares(
    came_to: np.ndarray, names: Sequence[str], grid: BasinGrid | None, level: float, interval: str | None
) -> Iterator[dict[str, object]]:
    """The share of each outcome in a panel, with its interval."""
    kind = interval or ("wilson" if grid is None else "cells")
    if kind == "cells" and grid is None:
        raise AnalysisError("interval is cells, but the starts are no grid: take wilson or clopper_pearson.")
    of = len(came_to)
    for name in names:
        marked = came_to == name
        hits = int(marked.sum())
        share = hits / of
        if grid is not None and kind == "cells":
            half = one_a_cell(grid.shares_nearby(marked), level)
            low, high = max(share - half, 0.0), min(share + half, 1.0)
        else:
            low, high = (float(end) for end in _INTERVALS[kind](np.array(hits), np.array(of), level))
        record = {"outcome": name, "rows": hits, "of": of, "fraction": share}
        yield {**record, "low": low, "high": high, "interval": kind}
