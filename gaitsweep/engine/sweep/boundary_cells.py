"""Selection of the cells of a grid that must be simulated, and the labels of the other cells.

The grid is laid out in boxes of `coarse` cells a side, and their corners are simulated first. A box in which
two labels are known (in a corner, on a side that a finer neighbour shares, or inside) is halved along one
refined axis, and the corners of its halves are simulated; those that are mixed are halved along the next
axis, and so on, until all cells of a mixed box are known. A box whose known labels agree passes its label to
its unknown cells. So both sides of every boundary in the result are simulated; a region that lies entirely
between the corners of a box and touches no simulated cell of its sides is missed. The selection follows from
the known labels alone and does not depend on their order.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Int

UNKNOWN = -1  # not simulated
ALONE = -2  # simulated, with a label that no other cell gets
_NONE = np.iinfo(np.int32).max  # above every label

Sides = dict[int, int]  # cells along the side of a box, by refined axis


@dataclasses.dataclass(frozen=True)
class Grid:
    """A grid of rows with some refined axes; each cell along the other axes is a separate panel.

    Args:
        lengths: the cells along each axis.
        wraps: for each refined axis, by its place, whether its last cell and its first are neighbours.
        coarse: the cells along a side of the first boxes, a power of two.

    Raises:
        ValueError: no axis is refined, a refined axis is not one of the grid, or `coarse` is not a power of
            two.
    """

    lengths: tuple[int, ...]
    wraps: dict[int, bool]
    coarse: int

    def __post_init__(self) -> None:
        if not self.wraps:
            raise ValueError("wraps is empty, but must have at least one refined axis.")
        for axis in self.wraps:
            if not 0 <= axis < len(self.lengths):
                raise ValueError(
                    f"wraps has axis {axis}, but the grid has the axes 0 to {len(self.lengths) - 1}."
                )
        if self.coarse < 2 or self.coarse & (self.coarse - 1):
            raise ValueError(f"coarse is {self.coarse}, but must be a power of two, at least 2.")

    def levels(self) -> Iterator[tuple[Sides, Sides]]:
        """The sides of boxes and of their halves, the widest first."""
        sides = dict.fromkeys(self.wraps, self.coarse)
        while max(sides.values()) > 1:
            for axis in self.wraps:
                halved = {**sides, axis: sides[axis] // 2}
                yield sides, halved
                sides = halved

    def corners(self, axis: int, side: int) -> tuple[Int[np.ndarray, " corners"], int]:
        """The corners of boxes along an axis, and the number of boxes between them.

        Args:
            axis: the axis, by its place.
            side: the cells along a side of the boxes.
        """
        length = self.lengths[axis]
        points = np.arange(0, length, side)
        if self.wraps[axis]:
            return points, len(points)
        points = np.unique(np.append(points, length - 1))
        return points, max(len(points) - 1, 1)


def wanted(known: Int[np.ndarray, " *cells"], grid: Grid) -> Bool[np.ndarray, " *cells"]:
    """The cells to simulate next, from the known labels; none when every cell is decided.

    Args:
        known: integers of the grid's shape: a label >= 0 or ALONE for simulated cells, else UNKNOWN.
        grid: the grid.

    Returns:
        A mask of cells of the same shape; only UNKNOWN cells are set.
    """
    first = dict.fromkeys(grid.wraps, grid.coarse)
    needed = np.zeros(grid.lengths, bool)
    needed[_points(grid, first)] = True
    for sides, halved in grid.levels():
        low, high = _spans(known, grid, sides)
        mixed = low < high
        for axis, side in sides.items():
            points, count = grid.corners(axis, side)
            corners, _ = grid.corners(axis, halved[axis])
            box = np.searchsorted(points, corners, side="right") - 1
            # a corner of a half that is also a corner of a box belongs to the box before it, too
            before = box - np.isin(corners, points)
            before = before % count if grid.wraps[axis] else np.maximum(before, 0)
            mixed = mixed.take(np.minimum(box, count - 1), axis) | mixed.take(before, axis)
        needed[_points(grid, halved)] |= mixed
    return needed & (known == UNKNOWN)


def inferred(known: Int[np.ndarray, " *cells"], grid: Grid) -> Int[np.ndarray, " *cells"]:
    """The label of every cell: its own, or that of the box that contains it, else UNKNOWN.

    Args:
        known: integers of the grid's shape: a label >= 0 or ALONE for simulated cells, else UNKNOWN.
        grid: the grid.
    """
    labels = np.array(known)
    for sides, _ in grid.levels():
        low, high = _spans(known, grid, sides)
        label_of_box = np.where(low == high, low, UNKNOWN)
        for axis, side in sides.items():
            points, count = grid.corners(axis, side)
            box = np.searchsorted(points, np.arange(grid.lengths[axis]), side="right") - 1
            label_of_box = label_of_box.take(np.minimum(box, count - 1), axis)
        labels = np.where(labels == UNKNOWN, label_of_box, labels)
    return labels


def _points(grid: Grid, sides: Sides) -> tuple[Int[np.ndarray, " ..."], ...]:
    """The corners of boxes, as an index of the grid's arrays."""
    places = []
    for axis, length in enumerate(grid.lengths):
        places.append(grid.corners(axis, sides[axis])[0] if axis in sides else np.arange(length))
    return np.ix_(*places)


def _spans(
    known: Int[np.ndarray, " *cells"], grid: Grid, sides: Sides
) -> tuple[Int[np.ndarray, " *boxes"], Int[np.ndarray, " *boxes"]]:
    """The lowest and the highest known label in each box, including its sides.

    They always differ around an ALONE cell; if no label is known, low > high.
    """
    low = np.where(known == UNKNOWN, _NONE, np.where(known == ALONE, UNKNOWN, known)).astype(np.int32)
    high = np.where(known == ALONE, _NONE, known).astype(np.int32)
    for axis, side in sides.items():
        points, count = grid.corners(axis, side)
        far = points[np.arange(1, count + 1) % len(points)]
        low = np.minimum(np.minimum.reduceat(low, points[:count], axis), low.take(far, axis))
        high = np.maximum(np.maximum.reduceat(high, points[:count], axis), high.take(far, axis))
    return low, high
