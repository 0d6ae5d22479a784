"""Basin fractions: the share of starts with each outcome, with confidence intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Float, Shaped

from gaitsweep.analysis.basins.grid import BasinGrid, find_grid
from gaitsweep.analysis.records import (
    AnalysisError,
    axes_of,
    in_order,
    names_in,
    outcome_labels,
    panels_of,
    require,
    require_numbers,
    with_constants,
)

LEVEL = 0.95  # of confidence intervals
DrawsInterval = Literal["wilson", "clopper_pearson"]  # intervals of independent draws
Interval = Literal["wilson", "clopper_pearson", "cells"]
_METHODS = {"wilson": "wilson", "clopper_pearson": "exact"}  # as SciPy calls them
_COLUMNS = ["outcome", "rows", "of", "fraction", "low", "high", "interval"]


def fractions(
    table: pd.DataFrame | Sequence[pd.DataFrame],
    axes: str | Sequence[str] | None = None,
    *,
    label: str = "gait",
    by: str | Sequence[str] = (),
    level: float = LEVEL,
    interval: Interval | None = None,
) -> pd.DataFrame:
    """The basin fractions of a table with their confidence intervals.

    Args:
        table: a settle table, or several that differ in constants, which `by` then names; rows that were
            inferred count as others do.
        axes: the columns of the starts; by default the swept axes that are not in `by`.
        label: the column of the outcomes.
        by: columns, or constants of the table's job, of which each combination of values is a panel, counted
            separately.
        level: confidence level of the intervals.
        interval: wilson, clopper_pearson or cells; by default `cells` for grids and `wilson` for others.
            The first two treat starts as independent draws, so they are too wide on a grid. `cells` treats
            them as one draw from each cell, whose own share is that among the cell and its neighbours; where
            all starts agree, which leaves no width, the interval is Wilson's.

    Returns:
        One record for each panel and outcome: by, outcome, rows, of (rows of the panel), fraction, low, high
        and the kind of interval.

    Raises:
        AnalysisError: the table does not have a column, or an argument is not allowed.
    """
    table, by, axes = panels_and_axes(table, by, axes)
    check_level(level)
    if interval not in (None, "cells", *_METHODS):
        allowed = ", ".join(["cells", *_METHODS])
        raise AnalysisError(f"interval is {interval}, but must be one of {allowed}.")
    labels = outcome_labels(table, label)
    names = in_order(table, label, labels)
    records = []
    for panel, rows in panels_of(table, by):
        grid = find_grid(table.iloc[rows], axes)
        for record in _shares(labels.iloc[rows].to_numpy(), names, grid, level, interval):
            records.append({**panel, **record})
    return pd.DataFrame(records, columns=[*by, *_COLUMNS])


def panels_and_axes(
    table: pd.DataFrame | Sequence[pd.DataFrame], by: str | Sequence[str], axes: str | Sequence[str] | None
) -> tuple[pd.DataFrame, list[str], list[str]]:
    """One table of one or several, and its columns of the panels and of the starts.

    Args:
        table: a table, or several that differ in constants.
        by: columns, or constants of the table's job, of which each combination of values is a panel.
        axes: the columns of the starts; by default the swept axes that are not in `by`.

    Returns:
        The table, with columns for the constants in `by`; the columns of the panels; and those of the starts.

    Raises:
        AnalysisError: the table does not have a column.
    """
    by = names_in(by)
    table = with_constants(table, by, axes)
    axes = [name for name in axes_of(table) if name not in by] if axes is None else names_in(axes)
    require(table, "status", *by)
    require_numbers(table, *axes)
    return table, by, axes


def proportion_interval(
    hits: int, of: int, level: float = LEVEL, kind: DrawsInterval = "wilson"
) -> tuple[float, float]:
    """The confidence interval of a proportion.

    Args:
        hits: the number of draws that count.
        of: the number of independent draws.
        level: confidence level of the interval.
        kind: wilson or clopper_pearson.

    Raises:
        AnalysisError: there is no interval of that kind, `hits` is not between 0 and `of`, or `level` not
            between 0 and 1.

    Example:
        >>> import gaitsweep as gs
        >>> low, high = gs.analyses.proportion_interval(50, 100)
        >>> round(low, 4), round(high, 4)
        (0.4038, 0.5962)
    """
    if kind not in _METHODS:
        raise AnalysisError(f"kind is {kind}, but must be one of {', '.join(_METHODS)}.")
    check_level(level)
    if not (of > 0 and 0 <= hits <= of):
        raise AnalysisError(f"hits and of are {hits} and {of}, but hits must be between 0 and of, above 0.")
    interval = scipy.stats.binomtest(hits, of).proportion_ci(level, _METHODS[kind])
    return float(interval.low), float(interval.high)


def one_a_cell(shares: Float[np.ndarray, " cells"], level: float = LEVEL) -> float:
    """Half the width of the interval for one draw from each of n cells, given the share in each cell (n,).

    Only cells on a boundary add to the variance, the sum of share * (1 - share) over n^2.

    Source: stratified sampling, Cochran 1977, sec. 5.3.
    """
    shares = np.asarray(shares, float).ravel()
    deviation = np.sqrt(np.sum(shares * (1.0 - shares))) / shares.size
    return float(scipy.stats.norm.ppf(0.5 + 0.5 * level) * deviation)


def check_level(level: float) -> None:
    """Refuse a confidence level that is not between 0 and 1."""
    if not 0.0 < level < 1.0:
        raise AnalysisError(f"level is {level:g}, but must be between 0 and 1.")


def _shares(
    labels: Shaped[np.ndarray, " rows"],
    names: Sequence[str],
    grid: BasinGrid | None,
    level: float,
    interval: Interval | None,
) -> Iterator[dict[str, object]]:
    """The share of each outcome in a panel, with its interval."""
    if interval == "cells" and grid is None:
        raise AnalysisError(
            "interval is cells, but the starts do not form a grid: use wilson or clopper_pearson."
        )
    usual = interval or ("wilson" if grid is None else "cells")
    total = len(labels)
    for name in names:
        marked = labels == name
        hits = int(marked.sum())
        share = hits / total
        kind = "wilson" if usual == "cells" and hits in (0, total) else usual
        if kind != "cells":
            low, high = proportion_interval(hits, total, level, kind)
        else:
            assert grid is not None
            half = one_a_cell(grid.shares_nearby(marked), level)
            low, high = max(share - half, 0.0), min(share + half, 1.0)
        record = {"outcome": name, "rows": hits, "of": total, "fraction": share}
        yield {**record, "low": low, "high": high, "interval": kind}
