"""The parameter ranges in which branches of fixed points are stable, and what bounds them."""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Int, Shaped

from gaitsweep.analysis.continuation.branch_points import CROSSINGS
from gaitsweep.analysis.records import AnalysisError, require, require_numbers

# Special points of a continuation at which the stability of a branch may change.
MARKS = ("fold", "corner", "flip", "neimark_sacker", *CROSSINGS, "hopf")
NARROWEST_RANGE = 0.02  # as a share of the width of all branches


def stable_ranges(table: pd.DataFrame, parameter: str, least: float = NARROWEST_RANGE) -> pd.DataFrame:
    """The stable pieces of each branch, in the order in which they were followed.

    A range reaches to the outermost points of its piece, with the special points at its ends. It may extend
    over a corner or a jump of the map, as the gait does in a simulation. A branch that was followed in both
    directions from its start is one, from its end in direction -1 to that in direction 1.

    Args:
        table: a continuation's table.
        parameter: the column of the continuation parameter.
        least: the least width of a piece, as a share of the width of all branches.

    Returns:
        One record a piece: row, gait (the most frequent one, where the table has it; None if none of its
        points has one), low and high (of the parameter), low_by and high_by (the special point there; kink at
        a corner or jump of the map; start where the branch begins; range, most, closed or lost where it ends;
        or empty).

    Raises:
        AnalysisError: the table does not have a column.
    """
    require(table, "row", "point", "stable", "special", "end")
    require_numbers(table, parameter)
    table = table.dropna(subset=["stable"]).sort_values(["row", "point"], kind="stable")
    width = np.ptp(table[parameter].to_numpy(float)) if len(table) else 0.0
    records = []
    keys = ["row", "branch"] if "branch" in table else ["row"]
    for _, branch in table.groupby(keys, sort=True, dropna=False):
        pieces_of_branch = _pieces(_in_one_direction(branch, parameter), parameter)
        records += [{"row": branch["row"].iloc[0], **piece} for piece in pieces_of_branch]
    gaits = ["gait"] if "gait" in table else []
    names = ["row", *gaits, "low", "high", "low_by", "high_by"]
    pieces = pd.DataFrame(records, columns=pd.Index(names))
    wide = pieces["high"].to_numpy(float) - pieces["low"].to_numpy(float) > least * width
    return pieces.iloc[np.flatnonzero(wide)].reset_index(drop=True)


def range_of_gait(table: pd.DataFrame, parameter: str, gait: str) -> pd.DataFrame:
    """The widest stable range of one gait in each row.

    Args:
        table: a continuation's table with gaits.
        parameter: the column of the continuation parameter.
        gait: the gait.

    Returns:
        One record a row: row, low, high, low_by and high_by, as of `stable_ranges`.

    Raises:
        AnalysisError: the table does not have a column, or no branch is stable in that gait.
    """
    require(table, "gait")
    ranges = stable_ranges(table, parameter)
    ranges_of_gait = ranges.iloc[np.flatnonzero(ranges["gait"] == gait)]
    if not len(ranges_of_gait):
        stable = ", ".join(sorted(set(ranges["gait"].dropna()))) or "none"
        raise AnalysisError(f"no branch is stable in the gait {gait}. Stable here: {stable}.")
    widths = ranges_of_gait.assign(width=ranges_of_gait["high"] - ranges_of_gait["low"])
    widest = widths.sort_values(["row", "width"], kind="stable").drop_duplicates("row", keep="last")
    return widest.drop(columns=["gait", "width"]).reset_index(drop=True)


def _in_one_direction(branch: pd.DataFrame, parameter: str) -> pd.DataFrame:
    """The points of a branch from one end to the other, its start once, if it has two directions."""
    if "direction" not in branch or len(np.unique(branch["direction"])) < 2:
        return branch
    for direction in (1, -1):
        if np.ptp(branch.loc[branch["direction"] == direction, parameter]) == 0.0:  # it starts at an end
            return branch.loc[branch["direction"] == -direction]
    back = branch.loc[branch["direction"] < 0].iloc[::-1]
    # a kink marks the step that leads to its record, which is the next record now
    kink = (back["special"] == "kink").to_numpy(bool)
    leads = np.append(False, kink[:-1]) & ~back["special"].isin(MARKS).to_numpy(bool)
    back = back.assign(special=back["special"].mask(kink, "").mask(leads, "kink"))
    return pd.concat([back, branch.loc[(branch["direction"] > 0) & (branch["point"] > 0)]])


def _pieces(branch: pd.DataFrame, parameter: str) -> list[dict[str, object]]:
    """The stable pieces of one branch, as `stable_ranges` returns them."""
    at = branch[parameter].to_numpy(float)
    special = branch["special"].fillna("").to_numpy(str)
    end = branch["end"].fillna("").to_numpy(str)
    marked = np.isin(special, MARKS)
    inner = np.flatnonzero(branch["stable"].to_numpy(bool) & ~marked)
    pieces = []
    for points in np.split(inner, np.flatnonzero(np.diff(inner) > 1) + 1):
        if not points.size:
            continue
        before, after = max(points[0] - 1, 0), min(points[-1] + 1, len(at) - 1)
        first = before if marked[before] else points[0]
        last = after if marked[after] else points[-1]
        piece_points = np.arange(first, last + 1)
        low, high = piece_points[np.argmin(at[piece_points])], piece_points[np.argmax(at[piece_points])]
        piece: dict[str, object] = {"low": at[low], "high": at[high]}
        piece["low_by"] = _bound(special, end, low, piece_points)
        piece["high_by"] = _bound(special, end, high, piece_points)
        if "gait" in branch:
            gaits = branch["gait"].iloc[points].dropna().astype(str).mode()
            piece["gait"] = gaits.iloc[0] if len(gaits) else None
        pieces.append(piece)
    return pieces


def _bound(
    special: Shaped[np.ndarray, " points"],
    end: Shaped[np.ndarray, " points"],
    k: int,
    piece: Int[np.ndarray, " piece"],
) -> str:
    """Name what ends a range at point k of a piece: a special point, an end of the branch, or a kink."""
    if special[k] in MARKS:
        return str(special[k])
    if end[k]:
        return str(end[k])
    if k == 0:
        return "start"
    # a kink marks the step that leads to its record, so it ends a piece at its first record or after its last
    enters = k == piece[0] and special[k] == "kink"
    leaves = k == piece[-1] and k + 1 < len(special) and special[k + 1] == "kink"
    return "kink" if enters or leaves else ""
