"""The tables of an atlas: gaits, branches, bifurcations on them, and curves in two parameters."""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Bool

Mask = Bool[np.ndarray, " records"]


def atlas_tables(table: pd.DataFrame, parameter: str) -> dict[str, pd.DataFrame]:
    """Divide the table of an atlas.

    Args:
        table: the table of a run of kind atlas.
        parameter: the parameter along which its branches are followed.

    Returns:
        `gaits`: all gaits where they were searched, one record each. `branches`: one record for each point;
        `number` is the branch. `points`: the bifurcations on branches, once each. `curves`: the bifurcations
        in the plane of two parameters, one record for each point; `number` is the curve.
    """
    part = table["part"].astype(str)
    on_branch = (part == "branch").to_numpy(bool)
    masks = {
        "gaits": on_branch & (table["found"] >= 0).to_numpy(bool),
        "branches": on_branch,
        "points": on_branch & _bifurcations(table, parameter),
        "curves": ~on_branch & (part != "").to_numpy(bool),
    }
    return {name: table.iloc[np.flatnonzero(mask)].reset_index(drop=True) for name, mask in masks.items()}


def _bifurcations(table: pd.DataFrame, parameter: str) -> Mask:
    """Mask of the records of bifurcations, without those that repeat another branch's.

    A parent's flip is met again where its doubled gait ends, and a pitchfork that ends a branch is on the
    symmetric branch as well.
    """
    special, end = (table[name].astype(str) for name in ("special", "end"))
    places = list(zip(table["row"], special, table[parameter].round(9), strict=True))
    others = {place for place, why in zip(places, end, strict=True) if why != "pitchfork"}
    repeated = [
        why == "flip" or (why == "pitchfork" and place in others)
        for place, why in zip(places, end, strict=True)
    ]
    return ~special.isin(["", "nan", "kink"]).to_numpy(bool) & ~np.array(repeated, bool)
