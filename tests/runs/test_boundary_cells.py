"""The cells that a refinement simulates, and its inferred labels against those of a full grid."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitsweep.engine.sweep.boundary_cells import ALONE, UNKNOWN, Grid, inferred, wanted


def refined(full: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray, int]:
    """All labels, which cells were simulated, and in how many rounds."""
    known = np.full(grid.lengths, UNKNOWN)
    for rounds in itertools.count():
        need = wanted(known, grid)
        if not need.any():
            return inferred(known, grid), known != UNKNOWN, rounds
        known[need] = full[need]
    raise AssertionError


def neighbours(labels: np.ndarray, grid: Grid) -> np.ndarray:
    """Which cells have another label beside them, corners included, by shifting the whole grid."""
    beside = np.zeros(labels.shape, bool)
    for step in itertools.product((-1, 0, 1), repeat=len(grid.wraps)):
        shifted = labels
        outside = np.zeros(labels.shape, bool)
        for axis, by in zip(grid.wraps, step, strict=True):
            shifted = np.roll(shifted, by, axis)
            outside = np.roll(outside, by, axis)
            if by and not grid.wraps[axis]:
                edge = [slice(None)] * labels.ndim
                edge[axis] = slice(0, 1) if by == 1 else slice(-1, None)
                outside[tuple(edge)] = True
        beside |= (shifted != labels) & ~outside
    return beside


def waves(lengths: tuple[int, ...], seed: int, fine: int) -> np.ndarray:
    """Labels 0, 1, 2 of a random smooth function with `fine` waves across the grid at most."""
    random = np.random.default_rng(seed)
    angles = np.meshgrid(*[(np.arange(n) + 0.5) / n * 2 * np.pi for n in lengths], indexing="ij")
    value = np.zeros(lengths)
    for _ in range(4):
        waves_along = random.integers(-fine, fine + 1, len(lengths))
        turn = sum(k * angle for k, angle in zip(waves_along, angles, strict=True))
        value += random.normal() * np.cos(turn + random.uniform(0, 2 * np.pi))
    return np.digitize(value, [-0.5, 0.7])


@settings(max_examples=60)
@given(
    lengths=st.lists(st.integers(1, 23), min_size=1, max_size=3).map(tuple),
    wraps=st.lists(st.booleans(), min_size=3, max_size=3),
    coarse=st.sampled_from([2, 4, 8, 16]),
    seed=st.integers(0, 10**6),
    alone=st.booleans(),
)
def test_every_boundary_is_simulated_on_both_sides(lengths, wraps, coarse, seed, alone) -> None:
    """For any labels, even noise, no cell beside another label is inferred, and each keeps its own."""
    grid = Grid(lengths, dict(enumerate(wraps[: len(lengths)])), coarse)
    full = waves(lengths, seed, 4)
    if alone:
        full[full == 2] = ALONE
    labels, simulated, _ = refined(full, grid)
    assert (labels != UNKNOWN).all()
    np.testing.assert_array_equal(labels[simulated], full[simulated])
    assert simulated[neighbours(labels, grid)].all()
    assert simulated[labels == ALONE].all()


def test_a_part_of_the_cells_gives_all_of_the_picture() -> None:
    """Shapes wider than a box are found whole: the discs' radii and their distance are 1.5 boxes and more."""
    n = 120
    y, x = np.mgrid[:n, :n]
    full = np.zeros((n, n), int)
    for label, (row, column, radius) in enumerate([(30, 30, 20), (85, 50, 25), (30, 95, 13)], start=1):
        # the last disc but one wraps around neither edge; distances on the torus all the same
        gap = [np.abs((at - centre + n / 2) % n - n / 2) for at, centre in ((y, row), (x, column))]
        full[np.hypot(*gap) < radius] = label
    labels, simulated, rounds = refined(full, Grid((n, n), {0: True, 1: True}, 8))
    np.testing.assert_array_equal(labels, full)
    assert simulated.mean() < 0.15
    assert rounds <= 8


def test_panels_are_refined_independently() -> None:
    """The cells of a panel are those that it has by itself."""
    full = np.stack([waves((33, 40), seed, 1) for seed in (1, 2, 3)], axis=1)  # panels are the middle axis
    grid = Grid(full.shape, {0: True, 2: False}, 8)
    labels, simulated, _ = refined(full, grid)
    for panel in range(3):
        alone = Grid((33, 40), {0: True, 1: False}, 8)
        own_labels, own_simulated, _ = refined(full[:, panel], alone)
        np.testing.assert_array_equal(labels[:, panel], own_labels)
        np.testing.assert_array_equal(simulated[:, panel], own_simulated)


def test_axes_that_wrap() -> None:
    """A stripe over the seam is one region if the axis wraps, and has a boundary there if it does not."""
    full = np.zeros((1, 64), int)
    full[0, :12] = full[0, -12:] = 1
    _, closed, _ = refined(full, Grid((1, 64), {1: True}, 8))
    assert not closed[0, [1, 2, 61, 62]].any()
    full[0, -12:] = 0
    labels, closed, _ = refined(full, Grid((1, 64), {1: True}, 8))
    assert closed[0, [0, 63]].all()
    _, open_ended, _ = refined(full, Grid((1, 64), {1: False}, 8))
    assert not open_ended[0, [1, 2, 61, 62]].any()
    np.testing.assert_array_equal(labels, full)


def test_regions_that_can_be_missed() -> None:
    """A dot narrower than a box is missed unless a boundary touches it."""
    full = np.zeros((64, 64), int)
    full[:, 40:] = 1
    full[18:22, 18:22] = 2  # between the corners at 16 and 24
    grid = Grid((64, 64), {0: True, 1: True}, 8)
    labels, _, _ = refined(full, grid)
    assert not (labels == 2).any()
    labels, _, _ = refined(full, Grid((64, 64), {0: True, 1: True}, 4))
    np.testing.assert_array_equal(labels, full)
    full[18:22, 18:22] = 0
    full[18:22, 36:44] = 2  # over the edge at 40
    labels, _, _ = refined(full, grid)
    np.testing.assert_array_equal(labels, full)


def test_rounds_depend_only_on_known_labels() -> None:
    """If part of a round is run first, the rest follows, with the same final labels."""
    full = waves((50, 41), 7, 2)
    grid = Grid((50, 41), {0: True, 1: True}, 8)
    labels, simulated, _ = refined(full, grid)
    known = np.full(grid.lengths, UNKNOWN)
    random = np.random.default_rng(0)
    while (need := wanted(known, grid)).any():
        some = need & (random.random(need.shape) < 0.5)
        known[some] = full[some]
        np.testing.assert_array_equal(wanted(known, grid) & need, need & ~some)
    np.testing.assert_array_equal(inferred(known, grid), labels)
    np.testing.assert_array_equal(known != UNKNOWN, simulated)


@pytest.mark.parametrize("coarse", [0, 1, 3, 12, -8])
def test_boxes_that_cannot_be_halved_to_a_cell_are_refused(coarse: int) -> None:
    with pytest.raises(ValueError, match="power of two"):
        Grid((9, 9), {0: True, 1: True}, coarse)


@pytest.mark.parametrize(("wraps", "words"), [({}, "wraps is empty"), ({1: True}, "has axis 1")])
def test_grids_without_a_refined_axis_are_refused(wraps: dict[int, bool], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Grid((4,), wraps, 8)
