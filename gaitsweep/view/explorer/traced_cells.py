"""The starts of a map that are simulated again to be animated: an even subgrid, and cells at boundaries."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Int

from gaitsweep.view.explorer.start_map import StartMap


def boundary(shown: StartMap) -> Bool[np.ndarray, " records"]:
    """Whether a cell has a neighbour with another outcome in its slice; circular axes are closed."""
    assert shown.at is not None
    assert shown.edges is not None
    lengths = [len(edges) - 1 for edges in shown.edges]
    layer = np.zeros(len(shown.outcome), np.int64)
    for axis_of_slices in shown.slices:
        layer = layer * len(axis_of_slices.texts) + axis_of_slices.of_record
    _, layer = np.unique(layer, return_inverse=True)
    field = np.full((int(layer.max(initial=0)) + 1, *lengths), -1)
    at = (layer, shown.at[:, 0], shown.at[:, 1])
    field[at] = shown.outcome
    at_boundary = np.zeros(field.shape, bool)
    for axis, closed in ((1, shown.closed[0]), (2, shown.closed[1])):
        other = np.roll(field, -1, axis)
        differs = (field != other) & (field >= 0) & (other >= 0)
        if not closed:
            last = [slice(None)] * 3
            last[axis] = slice(-1, None)
            differs[tuple(last)] = False
        at_boundary |= differs | np.roll(differs, 1, axis)
    return at_boundary[at]


def spread(n: int) -> Int[np.ndarray, " n"]:
    """The numbers 0 to n-1, ordered so that the first k numbers are spread evenly for every k.

    Source: the sequence of van der Corput (1935) in base 2.
    """
    bits = max(1, int(n - 1).bit_length())
    numbers = np.arange(1 << bits)
    reversed_bits = np.zeros_like(numbers)
    for bit in range(bits):
        reversed_bits |= ((numbers >> bit) & 1) << (bits - 1 - bit)
    return reversed_bits[reversed_bits < n]


def subgrid(shown: StartMap) -> Int[np.ndarray, " records"]:
    """The records from a coarse grid of cells to ever finer ones, all slices in turn."""
    assert shown.at is not None
    assert shown.edges is not None
    level = np.zeros(len(shown.at), int)  # of the coarsest grid that has the cell
    longest = max(len(edges) - 1 for edges in shown.edges)
    spacing, number = 1, 0
    while spacing < longest:
        # shifted by half a spacing, so that coarse grids keep away from the edges of the map
        on_grid = ((shown.at - spacing // 2) % spacing == 0).all(axis=1)
        level[on_grid] = number
        spacing, number = 2 * spacing, number + 1
    rank = np.empty(len(level), np.int64)
    rank[spread(len(level))] = np.arange(len(level))
    return np.lexsort((rank, -level))


def cells_to_trace(
    shown: StartMap, simulated: Bool[np.ndarray, " records"], most: int
) -> tuple[Int[np.ndarray, " traced"], int]:
    """The records to animate, the most useful first, and the number of them at boundaries.

    Half of them are cells of a subgrid, the others are beside a boundary.

    Args:
        shown: the map.
        simulated: whether a record was simulated; others cannot be animated.
        most: largest number of records to animate.
    """
    even = subgrid(shown)
    even = even[simulated[even]]
    edge = np.flatnonzero(boundary(shown) & simulated)
    in_turn = even
    if len(edge):
        edge = edge[spread(len(edge))]
        in_turn = np.resize(edge, len(even))
    order: dict[int, None] = {}  # without repetitions, in the order of insertion
    for on_subgrid, beside_boundary in zip(even, in_turn, strict=True):
        order.setdefault(int(on_subgrid))
        order.setdefault(int(beside_boundary))
        if len(order) >= most:
            break
    chosen = np.array(list(order)[:most], np.int64)
    return chosen, int(np.isin(chosen, edge).sum())
