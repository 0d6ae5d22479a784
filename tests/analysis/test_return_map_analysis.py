"""Fixed points, ghosts and branches of maps that are known in closed form (hysteresis_tables)."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from gaitsweep.analysis.records import AnalysisError
from gaitsweep.analysis.transitions.return_map import branches, drift, fixed_points, ghosts, pairs
from gaitsweep.angles import wrapped_difference
from tests.support.hysteresis_tables import CENTRE, FOLD, SCALE, TURN, delta, map_table, roots, with_attrs

EPS = 0.05


def slopes(x: np.ndarray, eps: float = EPS) -> np.ndarray:
    return 1 + eps * (1 - 3 * x**2)


def test_pairs_are_successive_crossings_of_one_row() -> None:
    table = map_table([0.0, 0.2], starts=3, crossings=5, centre=0.05)
    table.insert(2, "mass", 1.0)
    result = pairs(table, "delta_13")
    assert list(result.columns) == ["row", "f", "mass", "crossing", "value", "next", "change"]
    assert result.groupby("row").size().tolist() == [4] * 6
    np.testing.assert_allclose(
        wrapped_difference((result["next"] - result["value"] - result["change"]).to_numpy()), 0.0, atol=1e-12
    )
    assert np.max(result["change"].abs()) < 0.1  # though some go over 2 pi
    assert result["value"].between(0, TURN).all()
    gap = table.loc[table["crossing"] != 3]
    assert pairs(gap, "delta_13").groupby("row")["crossing"].apply(list).tolist() == [[1, 4]] * 6
    assert pairs(table.sample(frac=1.0, random_state=1), "delta_13").equals(result)
    lost = table.assign(delta_13_n=table["delta_13_n"].where(table["crossing"] != 3))
    assert len(pairs(lost, "delta_13")) == 12
    with pytest.raises(AnalysisError, match=r"Row 0 has several records of crossing 1.* gs\.concat"):
        pairs(pd.concat([table, table], ignore_index=True), "delta_13")


def test_rows_that_fell_lose_their_last_crossings() -> None:
    table = map_table(starts=4, crossings=30)
    table.loc[table["row"] == 2, "status"] = "fell"
    assert pairs(table, "delta_13").groupby("row").size().tolist() == [29, 29, 19, 29]


@pytest.mark.parametrize("centre", [CENTRE, 0.05])
@pytest.mark.parametrize("f", [-0.5, -0.2, 0.0, 0.2])
def test_fixed_points_without_noise(f: float, centre: float) -> None:
    table = map_table([f], starts=60, crossings=60, centre=centre)
    result = fixed_points(table, "delta_13")
    x = roots(f)
    away = wrapped_difference(result["value"].to_numpy() - delta(x, centre))
    # What is left is the curve's bending: bandwidth^2/10 times eps |6 x| / SCALE over the slope of the drift.
    assert np.abs(away).max() < 0.002
    np.testing.assert_allclose(result["slope"], slopes(x), atol=0.01)
    assert result["stable"].tolist() == (slopes(x) < 1).tolist()


@pytest.mark.slow
def test_errors_agree_with_the_scatter() -> None:
    """Over 30 seeds, deviations in units of their errors scatter by 1, or by 1.6 where the map bends."""
    x = roots(0.1)
    of_slope, of_value = [], []
    for seed in range(30):
        result = fixed_points(map_table([0.1], noise=0.01, seed=seed), "delta_13")
        assert result["stable"].tolist() == [True, False, True]
        of_slope.append((result["slope"] - slopes(x)) / result["slope_error"])
        of_value.append((result["value"] - delta(x)) / result["value_error"])
    for deviations in (np.array(of_slope), np.array(of_value)):
        spread = np.sqrt((deviations**2).mean(axis=0))
        assert (spread > 0.6).all()
        assert (spread < 1.8).all()


def test_a_fixed_point_with_data_on_one_side_is_found() -> None:
    table = map_table(starts=60, crossings=200)
    table = table.loc[table["row"] > 32]  # all from above the unstable point and below the stable one
    table = table.loc[table["row"] < 50]
    result = fixed_points(table, "delta_13")
    assert result["value"].tolist() == [pytest.approx(2.9, abs=2e-3)]
    assert result["slope"].item() == pytest.approx(0.9, abs=0.01)


def test_an_alternating_row_at_a_fixed_point_does_not_bias_the_slope() -> None:
    """As for the quadruped, one start stays at the unstable point, with readings on alternate sides."""
    table = map_table(starts=24, crossings=60)
    table = table.loc[np.abs(table["delta_13_n"] - 2.6) > 0.03]
    jitter = 0.002 * (-1.0) ** np.arange(60) * np.linspace(0.5, 1.5, 60)
    lingering = {
        "row": 99,
        "f": 0.0,
        "crossing": np.arange(60),
        "status": "complete",
        "delta_13_n": 2.6 + jitter,
    }
    table = with_attrs(pd.concat([table, pd.DataFrame(lingering)], ignore_index=True), "return_map")
    result = fixed_points(table, "delta_13", by="f")
    assert result["stable"].tolist() == [True, False, True]
    assert result["value"].tolist() == pytest.approx([2.3, 2.6, 2.9], abs=0.005)
    # what is left of the readings' own slope, which is -1
    assert result["slope"].tolist() == pytest.approx([0.9, 1.05, 0.9], abs=0.02)
    assert not len(ghosts(table, "delta_13", by="f"))


def test_gaps_of_the_data_have_no_fixed_point() -> None:
    table = map_table(starts=20, crossings=200)
    apart = table.loc[np.abs(table["delta_13_n"] - 2.6) > 0.12]  # nothing about the unstable point
    assert fixed_points(apart, "delta_13")["stable"].tolist() == [True, True]
    settled = table.loc[table["crossing"] > 190]
    settled = settled.loc[np.abs(settled["delta_13_n"] - 2.9) < 1e-4]
    assert not len(fixed_points(settled, "delta_13"))  # all stand still in one place: no slope to tell


def test_a_slope_below_minus_one_is_unstable() -> None:
    table = map_table(starts=300, crossings=2, eps=1.1)  # slope 1 - 2.2 at both ends
    result = fixed_points(table, "delta_13", bandwidth=0.02)
    assert result["slope"].to_numpy() == pytest.approx([-1.2, 2.1, -1.2], abs=0.03)
    assert not np.any(result["stable"])


@pytest.mark.slow("1.0", "3.0", "6.2")
@pytest.mark.parametrize("shift", [0.0, 1.0, 3.0, 6.2])
def test_maps_of_the_whole_circle(shift: float) -> None:
    """X' = x + eps sin(x - shift), started all around: one fixed point of each kind, wherever the cut is."""
    x = np.linspace(0, TURN, 120, endpoint=False) + 0.01
    course = [x]
    for _ in range(20):
        x = x + 0.1 * np.sin(x - shift)
        course.append(x)
    values = np.mod(np.array(course).T, TURN).ravel()
    row, crossing = np.repeat(np.arange(120), 21), np.tile(np.arange(21), 120)
    table = pd.DataFrame({"row": row, "crossing": crossing, "delta_13_n": values})
    result = fixed_points(table, "delta_13").sort_values("stable")
    assert result["stable"].tolist() == [False, True]
    np.testing.assert_allclose(
        wrapped_difference(result["value"].to_numpy() - [shift, shift + np.pi]), 0.0, atol=2e-3
    )
    np.testing.assert_allclose(result["slope"], [1.1, 0.9], atol=2e-3)
    assert not len(ghosts(table, "delta_13"))


@pytest.mark.slow("-0.44-0.5773502691896258")
@pytest.mark.parametrize(("f", "x"), [(0.44, -1 / np.sqrt(3)), (-0.44, 1 / np.sqrt(3))])
def test_ghosts_are_where_two_fixed_points_vanished(f: float, x: float) -> None:
    table = map_table([f], starts=60, crossings=100, noise=0.002)
    result = ghosts(table, "delta_13")
    assert result["value"].tolist() == [pytest.approx(float(delta(x)), abs=0.01)]
    least = np.sign(f) * EPS * SCALE * (abs(f) - FOLD)  # 8e-4 rad a crossing
    bending = EPS / SCALE * np.sqrt(3) * 0.05**2 / 5  # the curve's second derivative, times bandwidth^2/10
    assert result["drift"].item() == pytest.approx(least, abs=bending + 3 * result["drift_error"].item())
    assert np.sign(result["drift"].item()) == np.sign(f)
    assert fixed_points(table, "delta_13")["stable"].tolist() == [True]
    assert not len(ghosts(table, "delta_13", near=1e-5))


@pytest.mark.parametrize(("unit", "slow"), [(1e-3, False), (1.0, True), (1e3, True), (1e3, False)])
def test_ghosts_do_not_depend_on_the_unit(unit: float, slow: bool) -> None:
    """X' = x + f + 0.3 x^2 between -1 and 1: its least change is slow if it is below a hundredth of 2."""
    x = np.linspace(-1.0, 0.9, 100)
    after = x + (0.01 if slow else 0.1) + 0.3 * x**2
    values = unit * np.stack([x, after], axis=1).ravel()
    row, crossing = np.repeat(np.arange(100), 2), np.tile([0, 1], 100)
    table = pd.DataFrame({"row": row, "crossing": crossing, "height_n": values})
    result = ghosts(table, "height")
    assert (len(result) == 1) == slow
    if slow:
        assert result["value"].item() == pytest.approx(0.0, abs=0.02 * unit)


@pytest.mark.slow
def test_branches_over_the_parameter() -> None:
    values = np.round(np.linspace(-0.6, 0.6, 13), 3)
    table = map_table(values, starts=60, crossings=60, noise=0.002)
    result = branches(table, "delta_13", "f")
    assert result.groupby("f").size().tolist() == [3 if abs(f) < FOLD else 1 for f in values]
    kinds = result.groupby("branch").agg(stable=("stable", "nunique"), low=("f", "min"), high=("f", "max"))
    assert kinds["stable"].tolist() == [1, 1, 1]
    assert sorted(zip(kinds["low"], kinds["high"], strict=True)) == [(-0.6, 0.3), (-0.3, 0.3), (-0.3, 0.6)]


@pytest.mark.slow
def test_the_drift_has_values_only_where_there_are_points_and_by_column() -> None:
    table = map_table([-0.2, 0.2], starts=60, crossings=60)
    result = drift(table, "delta_13", by="f")
    for f, part in result.groupby("f"):
        x = (part["value"].to_numpy() - CENTRE) / SCALE
        inside = np.abs(x) < 1.3
        exact = EPS * SCALE * (float(str(f)) + x - x**3)
        np.testing.assert_allclose(part["drift"][inside], exact[inside], atol=5e-4)
        np.testing.assert_allclose(np.diff(part["value"]), 0.01, atol=1e-9)
    assert len(drift(table, "delta_13", by=["f", "status"])) == len(result)


def test_an_observable_that_is_not_an_angle() -> None:
    table = map_table(starts=60, crossings=60)
    table["speed_n"] = 10 * (table["delta_13_n"] - CENTRE) / SCALE  # from -15 to 15 m/s
    result = fixed_points(table, "speed")
    assert result["value"].to_numpy() == pytest.approx([-10.0, 0.0, 10.0], abs=0.3)
    assert result["stable"].tolist() == [True, False, True]


def test_values_before_a_fall_do_not_join_branches() -> None:
    """Two fixed points 8 m/s apart are two branches, also where a row that fell had a speed of 1000 km/s."""
    table = map_table([-0.2, 0.2], starts=20, crossings=30)
    table["speed_n"] = 8.0 * (table["f"] > 0.0) + 0.5 * np.cos(table["row"]) * 0.8 ** table["crossing"]
    assert branches(table, "speed", "f")["branch"].tolist() == [0, 1]
    last = (table["row"] == 0) & (table["crossing"] == table["crossing"].max())
    table.loc[table["row"] == 0, "status"] = "fell"
    table.loc[last, "speed_n"] = 1e6
    assert branches(table, "speed", "f")["branch"].tolist() == [0, 1]


def test_each_row_may_have_a_map_of_its_own() -> None:
    table = map_table(starts=3, crossings=60)
    assert len(fixed_points(table, "delta_13", by="row").columns) == 7
    assert pairs(table, "delta_13", by="row").equals(pairs(table, "delta_13"))
    by_crossing = pairs(table, "delta_13", by=["crossing", "f"])
    pd.testing.assert_frame_equal(by_crossing, pairs(table, "delta_13"))


def test_poor_tables() -> None:
    table = map_table(starts=3, crossings=3)
    nothing = with_attrs(table.assign(delta_13_n=np.nan), "return_map")
    for poor in (table, table.iloc[:0], nothing, table.loc[table["crossing"] == 1]):
        assert not len(fixed_points(poor, "delta_13", by="f"))
        assert not len(ghosts(poor, "delta_13", by="f"))
        assert list(branches(poor, "delta_13", "f").columns)[-1] == "branch"
        assert "drift" in drift(poor, "delta_13").columns
    with pytest.raises(AnalysisError, match="near is -1, but must be above 0"):
        ghosts(table, "delta_13", near=-1.0)
    with pytest.raises(AnalysisError, match="beta is not a column"):
        fixed_points(table, "delta_13", by="beta")
    with pytest.raises(AnalysisError, match=r"did you mean delta_13_n\?"):
        pairs(table, "delta_12")
