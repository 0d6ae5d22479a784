"""Which gaits a parameter set shows: counts and speeds of a small table by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from gaitsweep.analysis.records import AnalysisError
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import repertoire

ROWS = [
    # com_x, gait, speed, status
    (0.1, "D-walk", 0.4, "complete"),
    (0.1, "trot", 1.0, "complete"),
    (0.0, "trot", 0.9, "complete"),
    (0.1, "R-canter", 1.8, "complete"),
    (0.1, "L-canter", 2.0, "complete"),
    (0.1, "RT-gallop", 2.5, "complete"),
    (0.0, "unsteady", 1.2, "complete"),
    (0.0, "trot", 1.4, "fell"),
]


def table() -> pd.DataFrame:
    return pd.DataFrame(ROWS, columns=["com_x", "gait", "speed_end", "status"])


def test_counts_add_up_to_the_rows() -> None:
    result = repertoire(table(), ["com_x"]).set_index("com_x")
    assert list(result.index) == [0.1, 0.0]
    assert result.loc[0.1, ["rows", "gaits", "D-walk", "trot", "fell", "unsteady"]].tolist() == [
        5,
        5,
        1,
        1,
        0,
        0,
    ]
    # a row that fell has no gait
    assert result.loc[0.0, ["rows", "gaits", "trot", "fell", "unsteady"]].tolist() == [3, 1, 1, 1, 1]


def test_a_parameter_set_has_a_column() -> None:
    with pytest.raises(AnalysisError, match="sets is empty"):
        repertoire(table(), [])


def test_the_order_over_speed() -> None:
    result = repertoire(table(), ["com_x"]).set_index("com_x")
    assert result.loc[0.1, "speed_canter"] == pytest.approx(1.9)
    assert bool(result.loc[0.1, "in_order"])
    assert not result.loc[0.0, "in_order"]
    assert np.isnan(result.loc[0.0, "speed_walk"])
    swapped = table().replace({"speed_end": {0.4: 1.1}})
    assert not np.any(repertoire(swapped, ["com_x"])["in_order"])


def test_rows_without_a_value_are_a_set() -> None:
    """Joined tables have no value of a parameter that one of them does not vary."""
    rows = table().replace({"com_x": {0.0: np.nan}})
    assert repertoire(rows, ["com_x"])["rows"].tolist() == [5, 3]


def test_a_missing_column_is_named() -> None:
    with pytest.raises(AnalysisError, match="torso"):
        repertoire(table(), ["torso"])
