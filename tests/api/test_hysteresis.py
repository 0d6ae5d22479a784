"""Hysteresis of a table: the folds and the area of a map in closed form, with the names left out."""

from __future__ import annotations

import numpy as np
import pytest
from pandas.testing import assert_frame_equal

import gaitsweep as gs
from tests.support.hysteresis_tables import AREA, FOLD, SCALE, ramp_table, settle_table, staircase_table

SETTLED = settle_table(np.linspace(-0.8, 0.8, 17).tolist(), [-1.2, 1.2])


@pytest.mark.parametrize("kind", ["staircase", "ramp"])
def test_transition_points_and_area(kind: str) -> None:
    """Intervals hold the folds (a ramp's come later, by its lag); the area is 3/2 of the phase's scale.

    Bounds: a step of the staircase (0.1), as an interval's width; the ramp's lag adds a tenth to the area.
    """
    table = staircase_table(1, hold=400) if kind == "staircase" else ramp_table()
    result = gs.hysteresis(table)
    assert set(result.transition_points["observable"]) == set(result.loops["observable"]) == {"delta_13"}
    for point in result.transition_points.to_dict("records"):
        fold = FOLD if point["direction"] == "rising" else -FOLD
        assert abs(0.5 * (point["low"] + point["high"]) - fold) < 0.1
    assert result.loops["area"].to_numpy() == pytest.approx(AREA * SCALE, rel=0.15)
    named = gs.hysteresis(table, "delta_13", "f")
    assert_frame_equal(named.transition_points, result.transition_points)


def test_settled_rows() -> None:
    """Each branch is lost at its fold, within a step of the parameter."""
    points = gs.hysteresis(SETTLED, parameter="f", start="delta_13").transition_points
    assert points["gait"].tolist() == ["trot", "walk"]
    for point, fold in zip(points.to_dict("records"), (-FOLD, FOLD), strict=True):
        assert point["low"] <= fold <= point["high"]
        assert point["high"] - point["low"] == pytest.approx(0.1)


def test_names_that_have_no_default_are_required() -> None:
    with pytest.raises(gs.UserError, match="name the column as parameter="):
        gs.hysteresis(SETTLED)
    with pytest.raises(gs.UserError, match="name the column of the start value"):
        gs.hysteresis(SETTLED, parameter="f")
    with pytest.raises(gs.UserError, match="observable is delta_13, but of settled rows gaits count"):
        gs.hysteresis(SETTLED, "delta_13", "f", start="delta_13")
    with pytest.raises(gs.UserError, match="start is delta_13, but passes select the branch"):
        gs.hysteresis(staircase_table(), "delta_13", "f", start="delta_13")
    with pytest.raises(gs.UserError, match="delta_31 is not a column of this table; did you mean delta_13"):
        gs.hysteresis(staircase_table(), "delta_31", "f")
