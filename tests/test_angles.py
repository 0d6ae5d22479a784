"""Angles: differences, means and cuts of the circle."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from gaitsweep.angles import TURN, branch_cut, is_circular, mean_direction, unwrap_from, wrapped_difference


def test_differences_are_wrapped() -> None:
    np.testing.assert_allclose(
        wrapped_difference(np.array([0.1 - 6.2, 6.2 - 0.1, np.pi, -np.pi])),
        [TURN - 6.1, 6.1 - TURN, -np.pi, -np.pi],
    )


def test_the_circular_mean() -> None:
    assert mean_direction(np.array([0.1, TURN - 0.1])) == pytest.approx(0.0, abs=1e-12)
    assert mean_direction(np.array([0.3, TURN - 0.1])) == pytest.approx(0.1, abs=1e-12)
    assert np.isnan(mean_direction(np.array([])))
    assert mean_direction(np.array([-1e-17])) == 0.0  # not 2 pi


def test_angles_that_cancel_have_no_mean() -> None:
    assert np.isnan(mean_direction(np.array([0.3, 0.3 + np.pi])))
    assert np.isnan(mean_direction(TURN * np.arange(30) / 30))
    assert mean_direction(np.array([0.0, np.pi - 1e-6])) == pytest.approx(0.5 * np.pi, abs=1e-5)


def test_the_circle_is_cut_where_no_angles_are() -> None:
    assert branch_cut(np.array([2.2, 2.5, 3.0])) == 0.0
    assert branch_cut(np.array([np.nan])) == 0.0
    across = np.array([6.0, 6.2, 0.1, 0.4])
    line = unwrap_from(across, branch_cut(across))
    assert (np.diff(line) > 0).all()
    assert np.ptp(line) == pytest.approx(0.4 + TURN - 6.0)
    assert np.abs(line).max() < 1.0  # around zero, not around 2 pi
    below = TURN - np.array([5e-4, 7e-4])  # in phase, a little late
    for others in ([], [np.pi, 3.1], [1.0, 2.5, 3.1, 4.5]):
        values = np.array([*below, *others])
        line = unwrap_from(values, branch_cut(values))
        assert line == pytest.approx([-5e-4, -7e-4, *others])
    assert branch_cut(np.array([5.65, 5.7, 3.1])) == 0.0  # 1.8 pi is not 0
    for noise in (-1e-9, 0.0, 1e-9):  # of gaps alike in width, that which keeps the usual range
        apart = np.mod(np.array([0.0, 1e-9, np.pi]) + noise, TURN)
        assert unwrap_from(apart, branch_cut(apart)) == pytest.approx([0.0, 0.0, np.pi], abs=1e-8)


def test_angles_are_recognised_by_the_quantities_or_by_name() -> None:
    table = pd.DataFrame()
    assert is_circular(table, "delta_13_n")
    assert is_circular(table, "psi_1")
    assert not is_circular(table, "speed_n")
    table.attrs["quantities"] = {"delta": {"circular": False}, "heading": {"circular": True}}
    assert not is_circular(table, "delta")
    assert is_circular(table, "heading_n")
