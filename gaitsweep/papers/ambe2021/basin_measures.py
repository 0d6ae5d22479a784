"""Measures of the basins of the three gaits on slices of psi_3."""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Bool, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from gaitsweep.claims import MeasureError, masked, measure
from gaitsweep.papers.ambe2021.theory.gaits import WAVES


@measure
def slice_shares(table: pd.DataFrame, *, slice: int) -> list[float]:
    """Shares of direct, source and retrograde waves on one slice of psi_3, in their order, from 0 (1)."""
    gaits = np.asarray(_slice(table, slice)["gait"], str)
    return [float(np.mean(gaits == gait)) for gait in WAVES]


@measure
def largest_part(table: pd.DataFrame, *, slice: int) -> list[float]:
    """Shares of the starts of direct, source, retrograde in one connected part, on the torus (1).

    Parts with at most one cell between them count as one, since the grid does not resolve the gap.
    """
    cells = _slice(table, slice).pivot(index="psi_2", columns="psi_1", values="gait").to_numpy()
    return [float(max(_parts(cells == gait)) / np.count_nonzero(cells == gait)) for gait in WAVES]


def _slice(table: pd.DataFrame, number: int) -> pd.DataFrame:
    """The rows of one value of psi_3, numbered in ascending order."""
    values = np.unique(table["psi_3"])
    if number >= len(values):
        raise MeasureError(f"The table has no slice {number}: psi_3 has {len(values)} values.")
    return masked(table, table["psi_3"] == values[number])


def _parts(mask: Bool[np.ndarray, "rows columns"]) -> Int[np.ndarray, " parts"]:
    """The numbers of cells of the connected parts of a mask on the torus; gaps of one cell do not part."""
    if not mask.any():
        raise MeasureError("A gait does not occur on the slice.")
    cell = np.arange(mask.size).reshape(mask.shape)
    shifts = [(down, right) for down in range(3) for right in range(-2, 3) if (down, right) > (0, 0)]
    pairs = []
    for shift in shifts:
        back = tuple(-cells for cells in shift)  # np.roll moves the neighbour at `shift` to the cell itself
        both = mask & np.roll(mask, back, (0, 1))
        pairs.append((cell[both], np.roll(cell, back, (0, 1))[both]))
    i, j = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    graph = coo_matrix((np.ones(len(i)), (i, j)), shape=(mask.size, mask.size))
    _, labels = connected_components(graph, directed=False)
    return np.unique(labels[mask.ravel()], return_counts=True)[1]
