"""The ranges of a parameter in which branches of steady gaits are stable, and what ends them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from gaitsweep.analysis.gaits.records import AnalysisError, require

# What a continuation marks on a branch, between pieces of different stability.
MARKS = frozenset({"fold", "corner", "flip", "neimark_sacker", "branch_point"})
LEAST = 0.02  # of the width that a table's branches have: a narrower piece is none


def stable_ranges(table: pd.DataFrame, parameter: str, least: float = LEAST) -> pd.DataFrame:
    """The pieces of each branch on which it is stable, in the order in which they were followed.

    A piece's range goes out to its outermost points, folds and the like at its ends included. It may go on
    over a bend or a jump of the map, as the gait does in a run.

    Args:
        table: a continuation's table.
        parameter: the column of the parameter along which branches were followed.
        least: the least width of a piece, as a share of that of all branches.

    Returns:
        One record a piece: row, gait (the commonest on it, where the table has it), low and high (the
        parameter's), low_by and high_by (a mark's name; kink beside a bend or jump of the map; start where
        the branch begins; range, most, closed or lost where it ends; or nothing, where stability changes
        unmarked).

    Raises:
        AnalysisError: a column is not there.
    """
    require(table, "row", "point", parameter, "stable", "special", "end")
    table = table.dropna(subset=["stable"]).sort_values(["row", "point"], kind="stable")
    width = np.ptp(table[parameter].to_numpy(float)) if len(table) else 0.0
    found = []
    for row, branch in table.groupby("row", sort=True):
        found += [{"row": row, **each} for each in _pieces(branch, parameter)]
    names = ["row", *(["gait"] if "gait" in table else []), "low", "high", "low_by", "high_by"]
    pieces = pd.DataFrame(found, columns=pd.Index(names))
    wide = pieces["high"].to_numpy(float) - pieces["low"].to_numpy(float) > least * width
    return pieces.iloc[np.flatnonzero(wide)].reset_index(drop=True)


def edges(table: pd.DataFrame, parameter: str, gait: str, least: float = LEAST) -> pd.DataFrame:
    """Where one gait is stable in each row: row, low, high, low_by, high_by, its widest piece.

    Raises:
        AnalysisError: a column is not there, or no branch is stable in that gait.
    """
    require(table, "gait")
    ranges = stable_ranges(table, parameter, least)
    mine = ranges.iloc[np.flatnonzero(ranges["gait"] == gait)]
    if not len(mine):
        known = ", ".join(sorted(set(ranges["gait"]))) or "none"
        raise AnalysisError(f"no branch is stable in the gait {gait}. Stable here: {known}.")
    by_width = mine.assign(width=mine["high"] - mine["low"]).sort_values(["row", "width"], kind="stable")
    return by_width.drop_duplicates("row", keep="last").drop(columns=["gait", "width"]).reset_index(drop=True)


def _pieces(branch: pd.DataFrame, parameter: str) -> list[dict[str, object]]:
    at = branch[parameter].to_numpy(float)
    special = branch["special"].fillna("").to_numpy(str)
    end = branch["end"].fillna("").to_numpy(str)
    marked = np.isin(special, list(MARKS))
    inner = np.flatnonzero(branch["stable"].to_numpy(bool) & ~marked)
    pieces = []
    for points in np.split(inner, np.flatnonzero(np.diff(inner) > 1) + 1):
        if not points.size:
            continue
        first = max(points[0] - 1, 0) if marked[max(points[0] - 1, 0)] else points[0]
        after = min(points[-1] + 1, len(at) - 1)
        last = after if marked[after] else points[-1]
        mine = np.arange(first, last + 1)
        low, high = mine[np.argmin(at[mine])], mine[np.argmax(at[mine])]
        ends = {f"{name}_by": _by(special, end, k) for name, k in (("low", low), ("high", high))}
        piece: dict[str, object] = {"low": at[low], "high": at[high], **ends}
        if "gait" in branch:
            piece["gait"] = branch["gait"].iloc[points].astype(str).mode().iloc[0]
        pieces.append(piece)
    return pieces


def _by(special: np.ndarray, end: np.ndarray, k: int) -> str:
    """What is at a point that ends a range."""
    if special[k] in MARKS:
        return str(special[k])
    if end[k]:
        return str(end[k])
    if k == 0:
        return "start"
    beside = special[k : k + 2]
    return "kink" if "kink" in beside else ""
