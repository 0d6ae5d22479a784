"""Falls on rough ground or with noise: mean steps to a fall, and the share of rows that walk so far."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Bool

from gaitsweep.analysis.basins.fractions import LEVEL, check_level, proportion_interval
from gaitsweep.analysis.records import (
    AnalysisError,
    names_in,
    panels_of,
    require,
    require_numbers,
    require_rows,
    with_constants,
)
from gaitsweep.status import Status

# Largest share of rows whose run may end before they have made the steps or fallen.
MOST_OPEN = 0.05


def steps_to_fall(
    table: pd.DataFrame | Sequence[pd.DataFrame],
    by: str | Sequence[str] = (),
    *,
    after: int = 10,
    level: float = LEVEL,
) -> pd.DataFrame:
    """The mean number of steps to a fall, with its confidence interval.

    Rows on other grounds forget their starts within some steps. From then on a row that still walks falls in
    each step with the same chance p, and the mean is 1 / p. Rows that end without a fall count with the steps
    that they made, so a run need not last until all rows have fallen.

    Args:
        table: a table of kind `fixed_time`, one row for each seed, or several such tables.
        by: columns, or constants of the table's job, of which each combination of values is counted
            separately.
        after: section crossings from the start that do not count, so that the starts are forgotten.
        level: confidence level of the interval.

    Returns:
        One record for each combination: by, rows that walked long enough, falls, tried (steps of these rows,
        the last one of a fall included), steps (the mean), low and high. Without a fall in these steps the
        mean and `high` are infinite; without such steps the mean is NaN.

    Raises:
        AnalysisError: the table does not have a column, an argument is not allowed, or rows failed in another
            way than by a fall.

    Source: Byl and Tedrake 2009, Int. J. Robotics Research 28:1040, of metastable walking; Clopper and
    Pearson 1934, Biometrika 26:404, of the interval.

    Example:
        >>> import numpy as np, gaitsweep as gs
        >>> from gaitsweep.examples.rimless_wheel import RimlessWheel
        >>> run, seeds = gs.FixedTime(duration=200.0), np.arange(200)
        >>> table = gs.sweep(RimlessWheel(), roughness=[0.06, 0.08], seed=seeds, run=run, verify=0).table
        >>> gs.analyses.steps_to_fall(table, "roughness")["steps"].round(0).tolist()
        [40.0, 18.0]
    """
    if after < 0:
        raise AnalysisError(f"after is {after}, but must be 0 or more.")
    table, by, fell = _walks(table, by, level)
    walked = table["cycles"].to_numpy(int) - after
    records = []
    for panel, rows in panels_of(table, by):
        counted = rows[walked[rows] >= 0]
        falls = int(fell[counted].sum())
        tried = int(walked[counted].sum()) + falls
        low, high = proportion_interval(falls, tried, level, "clopper_pearson") if tried else (0.0, 1.0)
        record = {**panel, "rows": counted.size, "falls": falls, "tried": tried}
        record["steps"] = tried / falls if falls else (np.inf if tried else np.nan)
        record["low"] = 1.0 / high
        record["high"] = 1.0 / low if low > 0.0 else np.inf
        records.append(record)
    return pd.DataFrame(records, columns=[*by, "rows", "falls", "tried", "steps", "low", "high"])


def survival(
    table: pd.DataFrame | Sequence[pd.DataFrame],
    by: str | Sequence[str] = (),
    *,
    steps: int = 100,
    level: float = LEVEL,
) -> pd.DataFrame:
    """The share of rows that walk for some steps, with its confidence interval.

    A row may neither fall nor make so many steps within its run, as one that steps on the spot before a rise.
    Up to a twentieth of the rows of a combination may end so: they do not count as walking, and `high` is
    that of the share if all of them did.

    Args:
        table: a table of kind `fixed_time`, one row for each seed, or several such tables.
        by: columns, or constants of the table's job, of which each combination of values is counted
            separately.
        steps: section crossings that a row has to make.
        level: confidence level of the interval.

    Returns:
        One record for each combination: by, steps, rows, walked (rows that made so many steps), open (rows
        that ended before without a fall), share, low and high.

    Raises:
        AnalysisError: the table does not have a column, an argument is not allowed, rows failed in another
            way than by a fall, or too many ended before so many steps without a fall.

    Source: Clopper and Pearson 1934, Biometrika 26:404, of the interval.
    """
    if steps < 1:
        raise AnalysisError(f"steps is {steps}, but must be 1 or more.")
    table, by, fell = _walks(table, by, level)
    cycles = table["cycles"].to_numpy(int)
    is_open = ~fell & (cycles < steps)
    records = []
    for panel, rows in panels_of(table, by):
        walked = int((cycles[rows] >= steps).sum())
        ended_early = rows[is_open[rows]]
        if len(ended_early) > MOST_OPEN * len(rows):
            raise AnalysisError(
                f"{len(ended_early)} of {len(rows)} rows ended before {steps} steps without a fall, the "
                f"first after {cycles[ended_early[0]]}: run them for a longer time, or ask for fewer steps."
            )
        low, _ = proportion_interval(walked, len(rows), level, "clopper_pearson")
        _, high = proportion_interval(walked + len(ended_early), len(rows), level, "clopper_pearson")
        counts = {"steps": steps, "rows": len(rows), "walked": walked, "open": len(ended_early)}
        records.append({**panel, **counts, "share": walked / len(rows), "low": low, "high": high})
    return pd.DataFrame(records, columns=[*by, "steps", "rows", "walked", "open", "share", "low", "high"])


def _walks(
    table: pd.DataFrame | Sequence[pd.DataFrame], by: str | Sequence[str], level: float
) -> tuple[pd.DataFrame, list[str], Bool[np.ndarray, " rows"]]:
    """The table of all tables, the names of `by`, and which rows fell.

    Raises:
        AnalysisError: the table does not have a column or a row, or rows ended in another way or lack
            `cycles`.
    """
    by = names_in(by)
    check_level(level)
    table = with_constants(table, by)
    require(table, "status", *by)
    require_numbers(table, "cycles")
    require_rows(table)
    if without := np.count_nonzero(table["cycles"].isna()):
        raise AnalysisError(f"{without} rows have no number of cycles: leave them out.")
    status = table["status"].astype(str).to_numpy()
    fell, lasted = status == Status.fell.name, status == Status.complete.name
    if len(wrong := np.flatnonzero(~fell & ~lasted)):
        raise AnalysisError(
            f"{len(wrong)} rows ended as {status[wrong[0]]}, neither by a fall nor after the whole time: use "
            "a run of kind fixed_time, and see why these rows ended."
        )
    return table, by, fell
