"""Conflicts of targets, on sets whose counts are known in closed form."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from gaitsweep.errors import ArgumentError
from gaitsweep.fitting.targets import conflicts


def circle(n: int = 3600) -> pd.DataFrame:
    """Sets on a circle of radius 2, so that x and y cannot both be 0; every other set meets z."""
    angle = 2.0 * np.pi * np.arange(n) / n
    z = np.where(np.arange(n) % 2 == 0, 0.3, 1e4)
    return pd.DataFrame(
        {"row": np.arange(n), "miss_x": 2 * np.cos(angle), "miss_y": 2 * np.sin(angle), "miss_z": z}
    )


def test_counts_and_nearest_misses_of_conflicting_targets() -> None:
    result = conflicts(circle())
    assert result.sets == 3600
    # |cos| <= 1/2 on a third of the circle, and not where |sin| <= 1/2
    assert result.together.to_numpy().tolist() == pytest.approx(
        np.array([[1200, 0, 600], [0, 1200, 600], [600, 600, 1800]]), abs=4
    )
    # where |x| = 1, y is 3^(1/2)
    np.testing.assert_allclose(
        result.nearest, [[0.0, np.sqrt(3.0), 0.3], [np.sqrt(3.0), 0.0, 0.3], [0.0, 0.0, 0.3]], atol=5e-3
    )
    assert set(result.most) in ({"x", "z"}, {"y", "z"})
    assert result.most_sets == pytest.approx(600, abs=2)


def test_searches_are_pooled_and_a_larger_error_removes_the_conflict() -> None:
    result = conflicts([circle(), circle(1800)], within=np.sqrt(2.0) + 1e-9, targets=["x", "y"])
    assert result.sets == 5400
    assert result.together.loc["x", "y"] == 8  # the four diagonals of each circle
    assert result.most == ("x", "y")
    in_another_order = circle(1800).reindex(columns=["miss_z", "miss_y", "miss_x", "row"])
    assert conflicts([circle(), in_another_order]).together.loc["x", "z"] == pytest.approx(900, abs=4)


def test_no_set_meets_a_target() -> None:
    table = pd.DataFrame({"row": [0, 1], "miss_x": [1e4, 3.0], "miss_y": [-5.0, 2.0]})
    result = conflicts([table])
    assert result.together.to_numpy().sum() == 0
    assert result.nearest.isna().all(axis=None)
    assert result.most == ()


def test_wrong_tables_and_targets_are_refused() -> None:
    with pytest.raises(ArgumentError, match="not the table of a search"):
        conflicts([pd.DataFrame({"row": [0]})])
    with pytest.raises(ArgumentError, match="within is 0, but must be above 0"):
        conflicts(circle(), within=0.0)
    with pytest.raises(ArgumentError, match="different targets: x, y, z and x"):
        conflicts([circle(), circle().drop(columns=["miss_y", "miss_z"])])
    with pytest.raises(ArgumentError, match="yy is not a target of the search; did you mean y"):
        conflicts([circle()], targets=["yy"])


def test_a_target_without_a_value_is_not_met_whatever_the_error() -> None:
    assert conflicts(circle(8), within=1e5).together.loc["z", "z"] == 4
