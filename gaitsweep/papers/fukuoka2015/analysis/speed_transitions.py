"""The speeds at which gaits change as the speed rises and as it falls."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pandas as pd

from gaitsweep.analyses import AnalysisError, require
from gaitsweep.papers.fukuoka2015.analysis.gait_bouts import gait_bouts, gaits_along
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import FAMILIES

LEAST = 3  # windows of a bout


def speed_transitions(table: pd.DataFrame, by: Sequence[str] = (), cycles: int = 3) -> pd.DataFrame:
    """The speed at which a faster family begins as the speed rises, and a slower one as it falls.

    The transition up from `slower` to `faster` is where a row first comes to `faster` or a family above it;
    the one down is where it then first comes to `slower` or a family below it as the speed falls. The speed
    is the middle of those at the end of one gait bout and the begin of the next. A ramp lags: a width is
    that of this ramp.

    Args:
        table: a ramp, or a trace with a moving parameter, of a model with the nine gaits; the parameter rises
            in pass 0 and falls in pass 1.
        by: swept axes; rows with equal values are pooled.
        cycles: number of cycles in a window of `gaits_along`.

    Returns:
        One record for each set of `by` and pair of families: by, slower, faster; up, up_low, up_high, down,
        down_low, down_high (median, least and largest over the rows, m/s); width (median of up less down of
        the rows that have both, m/s), rows (with both), of (all rows).

    Raises:
        AnalysisError: the table does not have a column, or has no passes up and down.
    """
    require(table, "row", *by)
    if "pass" not in table.columns:
        raise AnalysisError(
            "These rows have no passes up and down: use a ramp, or a trace with run.parameter."
        )
    along = gaits_along(after_dwell(table), cycles=cycles)
    if "speed" not in along.columns:
        raise AnalysisError("The table has no speeds (speed_n, or x of a trace).")
    records = []
    for row, cycles_of_row in along.loc[along["family"].isin(FAMILIES)].groupby("row"):
        bouts = gait_bouts(cycles_of_row, least=LEAST)
        turn = cycles_of_row.loc[cycles_of_row["pass"] == 1, "t"].min()
        for slower, faster in itertools.pairwise(FAMILIES):
            up, down = _up_and_down(bouts, FAMILIES.index(faster), turn)
            records.append({"row": row, "slower": slower, "faster": faster, "up": up, "down": down})
    speeds = pd.DataFrame(records, columns=["row", "slower", "faster", "up", "down"])
    for name in reversed(list(by)):
        speeds.insert(0, name, table.groupby("row")[name].first().reindex(speeds["row"]).to_numpy())
    return _pooled(speeds.assign(width=speeds["up"] - speeds["down"]), [*by, "slower", "faster"])


def after_dwell(table: pd.DataFrame) -> pd.DataFrame:
    """The records after the parameter has begun to move."""
    dwell = table.attrs.get("job", {}).get("run", {}).get("initial_dwell", 0.0)
    moving = table.loc[table["t"] >= dwell]
    moving.attrs = table.attrs
    return moving


def _up_and_down(bouts: pd.DataFrame, rank: int, turn: float) -> tuple[float, float]:
    """The speeds (m/s) at which a row comes to families of a rank and above, and leaves them; NaN if never.

    Args:
        bouts: the row's gait bouts.
        rank: of the slower of the families above the transition.
        turn: when the parameter begins to fall, s.
    """
    faster = np.array([FAMILIES.index(name) >= rank for name in bouts["family"]])
    middle = 0.5 * (bouts["speed_end"].to_numpy()[:-1] + bouts["speed_begin"].to_numpy()[1:])
    begin = bouts["begin"].to_numpy()[1:]
    up = np.flatnonzero(faster[1:] & ~faster[:-1])
    if not len(up):
        return np.nan, np.nan
    down = np.flatnonzero(~faster[1:] & faster[:-1] & (begin > max(turn, begin[up[0]])))
    return float(middle[up[0]]), float(middle[down[0]]) if len(down) else np.nan


def _pooled(speeds: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """The speeds of transitions of all rows with the same keys."""
    groups = speeds.groupby(keys, sort=False)
    pooled = groups.agg(
        up=("up", "median"), up_low=("up", "min"), up_high=("up", "max"),
        down=("down", "median"), down_low=("down", "min"), down_high=("down", "max"),
        width=("width", "median"), rows=("width", "count"), of=("row", "nunique"),
    )  # fmt: skip
    return pooled.reset_index()
