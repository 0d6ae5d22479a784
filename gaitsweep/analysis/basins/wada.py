"""The Wada property of basins: whether every boundary point is one of all basins, by merging and by grids."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypedDict

import numpy as np
import pandas as pd
from jaxtyping import Shaped
from scipy.spatial import KDTree

from gaitsweep.analysis.basins.fractions import panels_and_axes
from gaitsweep.analysis.basins.grid import BasinGrid, find_grid
from gaitsweep.analysis.records import AnalysisError, outcome_labels, panels_of

BOX = 8  # steps along a side of the boxes of the grid method; a power of 2, halved by each refinement
RADIUS = 5.0  # distance in steps within which two boundaries count as the same


class BoundaryDistance(TypedDict):
    """A record of `Wada.merging`."""

    outcome: str
    other: str
    cells: int
    distance: float
    within: float


@dataclasses.dataclass(frozen=True)
class Wada:
    """Two tests of the Wada property on one grid, each with a record for every panel.

    `merging`: a record for each two outcomes (outcome, other, cells: of the boundary of `outcome` with all
    others merged, distance: from its farthest cell to the boundary of `other`, in steps, within: the share of
    its cells at most the radius away). The property holds at this resolution if every `distance` is at most
    the radius. `boxes`: a record for each refinement and number of basins from 2 (starts: along a side of a
    box, basins, boxes: that hold so many, share: of the boxes that hold two or more). The property shows as a
    share of boxes with all basins that rises to 1.
    """

    merging: pd.DataFrame
    boxes: pd.DataFrame


def wada(
    table: pd.DataFrame | Sequence[pd.DataFrame],
    axes: str | Sequence[str] | None = None,
    *,
    label: str = "gait",
    by: str | Sequence[str] = (),
    radius: float = RADIUS,
    box: int = BOX,
) -> Wada:
    """Test whether the basins of a table have the Wada property, by merging and by grids.

    Neither test is a proof: a boundary that parts company below the distance of two starts passes, and a Wada
    boundary of which a grid misses thin parts of a basin fails.

    Args:
        table: a settle table of which the starts of each panel form a grid.
        axes: the columns of the starts; by default the swept axes that are not in `by`.
        label: the column of the outcomes.
        by: columns of which each combination of values is a panel, tested separately.
        radius: distance in steps within which two boundaries count as the same.
        box: steps along a side of a box of the grid method, a power of 2.

    Raises:
        AnalysisError: the table does not have a column, its starts form no grid, it is narrower than a box,
            `box` is not a power of 2, or `radius` not above 0.

    Source: merging, Daza, Wagemakers and Sanjuan 2018, Sci. Rep. 8:9954; grids, Daza et al. 2015, Sci. Rep.
    5:16579, with the starts of the table in place of new ones.
    """
    if box < 2 or box & (box - 1):
        raise AnalysisError(f"box is {box}, but must be a power of 2: 2, 4, 8, ...")
    if not radius > 0.0:
        raise AnalysisError(f"radius is {radius:g} steps, but must be above 0.")
    table, by, axes = panels_and_axes(table, by, axes)
    labels = outcome_labels(table, label)
    merging, boxes = [], []
    for panel, rows in panels_of(table, by):
        grid = find_grid(table.iloc[rows], axes)
        if grid is None:
            raise AnalysisError(
                f"The starts along {', '.join(axes) or 'no axis'} do not form a grid: name the other "
                "axes as by."
            )
        if min(grid.lengths) <= box:
            raise AnalysisError(
                f"box is {box} steps, but the grid has {min(grid.lengths)} starts along an axis."
            )
        labels_of_panel = labels.iloc[rows].to_numpy()
        merging += [{**panel, **record} for record in boundaries_nearby(grid, labels_of_panel, radius)]
        boxes += [{**panel, **record} for record in _refined(grid, labels_of_panel, box)]
    return Wada(
        pd.DataFrame(merging, columns=[*by, "outcome", "other", "cells", "distance", "within"]),
        pd.DataFrame(boxes, columns=[*by, "starts", "basins", "boxes", "share"]),
    )


def boundaries_nearby(
    grid: BasinGrid, labels: Shaped[np.ndarray, " rows"], radius: float
) -> list[BoundaryDistance]:
    """The distances from the boundary of each basin, all others merged, to the boundaries of other basins.

    Args:
        grid: the grid.
        labels: the outcome of each row, (n,).
        radius: distance in steps within which two boundaries count as the same.

    Returns:
        The records of `Wada.merging`.
    """
    cells = np.stack(np.unravel_index(grid.place, grid.lengths), axis=1)
    period = [length if wraps else 0 for length, wraps in zip(grid.lengths, grid.wraps, strict=True)]
    names = pd.unique(labels)
    shares = [grid.shares_nearby(labels == name) for name in names]
    edges = [cells[(share > 0.0) & (share < 1.0)] for share in shares]
    trees = [KDTree(edge, boxsize=period) for edge in edges]
    records: list[BoundaryDistance] = []
    for name, edge in zip(names, edges, strict=True):
        for other_name, tree in zip(names, trees, strict=True):
            if other_name != name:
                away = tree.query(edge)[0]
                within = float(np.mean(away <= radius))
                pair = BoundaryDistance(
                    outcome=name, other=other_name, cells=len(edge), distance=away.max(), within=within
                )
                records.append(pair)
    return records


def _refined(grid: BasinGrid, labels: Shaped[np.ndarray, " rows"], box: int) -> list[dict[str, object]]:
    """The number of boxes that hold each number of basins, with twice as many starts at each refinement.

    Boxes tile the grid from its first start and share the starts on their sides; what is left over at the far
    end of an axis is not tested.
    """
    outcome = grid.filled(pd.factorize(labels)[0])
    tiles = [(length - 1) // box for length in grid.lengths]
    outcome = outcome[tuple(slice(tile * box + 1) for tile in tiles)]
    basins_of_grid = range(outcome.max() + 1)
    records = []
    for starts in [2**halving + 1 for halving in range(box.bit_length())]:
        stride = box // (starts - 1)
        coarse = outcome[(slice(None, None, stride),) * outcome.ndim]
        windows = np.lib.stride_tricks.sliding_window_view(coarse, (starts,) * outcome.ndim)
        windows = windows[(slice(None, None, starts - 1),) * outcome.ndim]
        inside = tuple(range(outcome.ndim, 2 * outcome.ndim))
        basins_in_box = sum((windows == basin).any(axis=inside).astype(int) for basin in basins_of_grid)
        crossed = max(int(np.sum(basins_in_box >= 2)), 1)
        for basins in range(2, len(basins_of_grid) + 1):
            boxes = int(np.sum(basins_in_box == basins))
            records.append({"starts": starts, "basins": basins, "boxes": boxes, "share": boxes / crossed})
    return records
