"""Choice of the starts that are simulated again: an even subgrid, and starts beside a boundary."""

from __future__ import annotations

import numpy as np

from gaitsweep.view.explorer.start_map import StartMap


def boundary(shown: StartMap) -> np.ndarray:
    """Whether a cell has a neighbour with another outcome in its slice, (n,); circular axes are closed."""
    assert shown.at is not None
    assert shown.edges is not None
    lengths = [len(edges) - 1 for edges in shown.edges]
    layer = np.zeros(len(shown.outcome), np.int64)
    for each in shown.slices:
        layer = layer * len(each.texts) + each.of_record
    _, layer = np.unique(layer, return_inverse=True)
    field = np.full((int(layer.max(initial=0)) + 1, *lengths), -1)
    at = (layer, shown.at[:, 0], shown.at[:, 1])
    field[at] = shown.outcome
    beside = np.zeros(field.shape, bool)
    for axis, closed in ((1, shown.closed[0]), (2, shown.closed[1])):
        other = np.roll(field, -1, axis)
        differs = (field != other) & (field >= 0) & (other >= 0)
        if not closed:
            last = [slice(None)] * 3
            last[axis] = slice(-1, None)
            differs[tuple(last)] = False
        beside |= differs | np.roll(differs, 1, axis)
    return beside[at]


def spread(n: int) -> np.ndarray:
    """The numbers 0 to n-1, (n,), ordered so that the first k numbers are spread evenly for every k.

    Source: the sequence of van der Corput (1935) in base 2.
    """
    bits = max(1, int(n - 1).bit_length())
    numbers = np.arange(1 << bits)
    reversed_bits = np.zeros_like(numbers)
    for bit in range(bits):
        reversed_bits |= ((numbers >> bit) & 1) << (bits - 1 - bit)
    return reversed_bits[reversed_bits < n]


def subgrid(shown: StartMap) -> np.ndarray:
    """The records (n,) from a coarse grid of cells to ever finer ones, all slices in turn."""
    assert shown.at is not None
    assert shown.edges is not None
    level = np.full(len(shown.at), 0)
    longest = max(len(edges) - 1 for edges in shown.edges)
    step, steps = 1, 0
    while step < longest:
        # cells of the middle of each coarser one, so that the grid keeps away from the edges of the map
        on = ((shown.at - step // 2) % step == 0).all(axis=1)
        level[on] = steps
        step, steps = 2 * step, steps + 1
    mixed = np.empty(len(level), np.int64)
    mixed[spread(len(level))] = np.arange(len(level))
    return np.lexsort((mixed, -level))


def cells_to_trace(shown: StartMap, simulated: np.ndarray, most: int) -> tuple[np.ndarray, int]:
    """The records to animate, the most useful first, and the number of them at boundaries.

    Half of them are cells of a subgrid, the others are beside a boundary.

    Args:
        shown: the map.
        simulated: whether a record was simulated, (n,); others cannot be animated.
        most: largest number of records to animate.
    """
    even = subgrid(shown)
    even = even[simulated[even]]
    edge = np.flatnonzero(boundary(shown) & simulated)
    edge = edge[spread(len(edge))] if len(edge) else edge
    order: dict[int, None] = {}
    for first, second in zip(even, np.resize(edge, len(even)) if len(edge) else even, strict=True):
        order.setdefault(int(first))
        order.setdefault(int(second))
        if len(order) >= most:
            break
    chosen = np.array(list(order)[:most], np.int64)
    return chosen, int(np.isin(chosen, edge).sum())
