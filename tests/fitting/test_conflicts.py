"""Targets that exclude each other, on sets for which this is known."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from gaitsweep.errors import ArgumentError
from gaitsweep.fitting.conflicts import conflicts


def circle(n: int = 3600) -> pd.DataFrame:
    """Sets on a circle of radius 2: x and y cannot both be 0, and z is what half of them has."""
    angle = 2.0 * np.pi * np.arange(n) / n
    z = np.where(np.arange(n) % 2 == 0, 0.3, 1e4)
    return pd.DataFrame(
        {"row": np.arange(n), "miss_x": 2 * np.cos(angle), "miss_y": 2 * np.sin(angle), "miss_z": z}
    )


def test_targets_that_exclude_each_other() -> None:
    found = conflicts([circle()])
    assert found.sets == 3600
    # |cos| <= 1/2 on a third of the circle, and not where |sin| <= 1/2
    assert found.together.to_numpy().tolist() == pytest.approx(
        np.array([[1200, 0, 600], [0, 1200, 600], [600, 600, 1800]]), abs=4
    )
    # where |x| = 1, y is 3^(1/2)
    np.testing.assert_allclose(
        found.nearest, [[0.0, np.sqrt(3.0), 0.3], [np.sqrt(3.0), 0.0, 0.3], [0.0, 0.0, 0.3]], atol=5e-3
    )
    assert set(found.most) in ({"x", "z"}, {"y", "z"})
    assert found.most_sets == pytest.approx(600, abs=2)


def test_several_searches_count_together_and_a_wider_error_reconciles_them() -> None:
    found = conflicts([circle(), circle(1800)], within=np.sqrt(2.0) + 1e-9, targets=["x", "y"])
    assert found.sets == 5400
    assert found.together.loc["x", "y"] == 8  # the four diagonals of each circle
    assert found.most == ("x", "y")


def test_no_set_meets_anything() -> None:
    table = pd.DataFrame({"row": [0, 1], "miss_x": [1e4, 3.0], "miss_y": [-5.0, 2.0]})
    found = conflicts([table])
    assert found.together.to_numpy().sum() == 0
    assert found.nearest.isna().all(axis=None)
    assert found.most == ()


def test_refusals() -> None:
    with pytest.raises(ArgumentError, match="not the table of a search"):
        conflicts([pd.DataFrame({"row": [0]})])
    with pytest.raises(ArgumentError, match="different targets: x, y, z and x"):
        conflicts([circle(), circle().drop(columns=["miss_y", "miss_z"])])
    with pytest.raises(ArgumentError, match="yy is not a target of the search; did you mean y"):
        conflicts([circle()], targets=["yy"])
