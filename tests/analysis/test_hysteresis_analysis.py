"""Jumps, edges and loop areas of a map whose folds are known in closed form (hysteresis_tables)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gaitsweep.analysis.records import AnalysisError
from gaitsweep.analysis.transitions.hysteresis import (
    hysteresis,
    loop_area,
    transition_points,
    transition_points_by_gait,
    why_no_jump,
)
from gaitsweep.analysis.transitions.jumps import irregular_passes, jump_intervals, jumps, largest_jumps
from tests.support.hysteresis_tables import (
    AREA,
    FOLD,
    SCALE,
    STATUSES,
    ramp_table,
    roots,
    settle_table,
    staircase_table,
)

JUMP = np.sqrt(3) * SCALE  # rad, at a fold: from x = -1/sqrt(3) to 2/sqrt(3)


def lag(steps: int, eps: float = 0.2, top: float = 0.8) -> float:
    """Delay of a ramp beyond its fold: u' = mu + sqrt(3) u^2 has its pole at Airy's first zero."""
    return 2.338 * (2 * top / steps / eps) ** (2 / 3) / 3 ** (1 / 6)


@pytest.mark.parametrize("centre", [2.6, 0.05])  # the second has a branch on either side of 0
@pytest.mark.parametrize("hold", [400, 60, 20])  # the shorter ones do not settle near the folds
def test_the_interval_of_a_staircase_contains_the_fold(centre: float, hold: int) -> None:
    table = staircase_table(3, hold=hold, centre=centre)
    result = jumps(table, "delta_13", "f")
    assert result.groupby(["row", "pass"]).size().tolist() == [1] * 6
    for jump in result.to_dict("records"):
        rises = jump["direction"] == "rising"
        assert rises == (jump["pass"] == 0)
        fold = (FOLD if rises else -FOLD) - 0.01 * jump["row"]
        assert jump["low"] <= fold <= jump["high"]
        assert jump["high"] - jump["low"] < (0.101 if hold == 400 else 0.401)  # stairs are 0.1 apart
        x = -1 / np.sqrt(3) if rises else 1 / np.sqrt(3)
        # the branches, which bend most near the folds, go on by up to 0.11 rad within the interval
        assert jump["size"] == pytest.approx(JUMP if rises else -JUMP, abs=0.12)
        assert np.mod(jump["before"] - centre - SCALE * x + np.pi, 2 * np.pi) - np.pi == pytest.approx(
            0, abs=0.1
        )
        assert 0 <= min(jump["before"], jump["after"]) <= max(jump["before"], jump["after"]) < 2 * np.pi


@pytest.mark.parametrize("steps", [1000, 4000])
@pytest.mark.parametrize("centre", [2.6, 0.05])
def test_a_ramp_jumps_after_the_fold_by_its_lag(steps: int, centre: float) -> None:
    result = jumps(ramp_table(steps=steps, centre=centre), "delta_13", "f")
    assert result["direction"].tolist() == ["rising", "falling"]  # and none for the transient before it moves
    for sign, jump in zip((1, -1), result.to_dict("records"), strict=True):
        first, last = sorted([sign * jump["low"], sign * jump["high"]])
        assert first > FOLD
        # The pole of the fold's own dynamics comes a little before the end: another third of the lag is left
        # for the way to the other branch.
        assert first < FOLD + lag(steps) < last + 0.35 * lag(steps)
        assert last < FOLD + 1.6 * lag(steps)
        assert sign * jump["size"] == pytest.approx(0.8 * JUMP, rel=0.15)  # from a tenth to nine tenths of it


def test_a_ramp_in_a_large_unit_asks_for_a_smaller_jump() -> None:
    """The least jump of a ramp is in the observable's own unit, such as rad or m/s."""
    table = ramp_table(steps=1000).rename(columns={"delta_13_n": "speed_n"})
    small = table.assign(speed_n=0.01 * table["speed_n"])
    assert not len(jumps(small, "speed", "f"))
    assert "0.0077 at most: give a smaller least" in why_no_jump(small, "speed", "f")
    assert len(jumps(small, "speed", "f", 0.0015)) == 2
    assert "give a smaller" not in why_no_jump(small.assign(speed_n=0.5), "speed", "f")


def test_noise_is_not_a_jump() -> None:
    result = jumps(ramp_table(2, steps=2000, noise=0.03), "delta_13", "f")
    assert result.groupby("row").size().tolist() == [2, 2]


@pytest.mark.parametrize("steps", [60, 1000])
def test_a_steep_branch_is_not_a_jump(steps: int) -> None:
    table = ramp_table(steps=steps)
    table["delta_13_n"] = np.mod(1.3 + 1.5 * table["f"], 2 * np.pi)  # 2.4 rad on each way
    assert not len(jumps(table, "delta_13", "f"))
    stairs = staircase_table(stairs=5)
    stairs["delta_13_n"] = np.mod(1.3 + 1.5 * stairs["f"], 2 * np.pi)  # 0.6 rad a stair
    assert not len(jumps(stairs, "delta_13", "f"))
    assert len(jumps(staircase_table(stairs=4), "delta_13", "f")) == 2


@pytest.mark.parametrize("values", [[0.0, 1.0], [0.0, 1.0, 1.1], [0.0, 0.0, 0.1, 1.1]])
def test_a_staircase_of_few_holds_jumps(values: list[float]) -> None:
    """One or two changes have no quartile: the larger one is compared with the other, if there is one."""
    holds = len(values)
    table = pd.DataFrame({"row": 0, "pass": 0, "stair": range(holds), "f": np.arange(holds), "v_n": values})
    gaits = ["walk" if value < 0.5 else "trot" for value in values]
    assert jumps(table, "v", "f")["size"].tolist() == [1.0]
    assert jumps(table.assign(gait=gaits), "v", "f", None)["size"].tolist() == [1.0]
    # of two holds in one gait the change may be that of a smooth branch
    assert len(jumps(table, "v", "f", None)) == (holds > 2)
    even = table.assign(v_n=np.arange(holds))
    assert len(jumps(even, "v", "f")) == (holds == 2)


def test_edges_are_medians_over_rows_with_their_range() -> None:
    # the folds of row 3 lie 0.03 lower: at -0.415 they fall into the next interval
    table = staircase_table(4)
    result = transition_points(table, "delta_13", "f")
    assert result["direction"].tolist() == ["rising", "falling"]
    assert result[["low", "high"]].to_numpy().ravel() == pytest.approx([0.3, 0.4, -0.5, -0.3])
    assert result[["lowest", "highest"]].to_numpy().ravel() == pytest.approx([0.3, 0.4, -0.5, -0.3])
    assert result[["rows", "of"]].to_numpy().tolist() == [[4, 4], [4, 4]]
    table.insert(1, "mass", np.where(table["row"] < 2, 1.0, 1.2))
    apart = transition_points(table, "delta_13", "f", by=["mass"])
    assert apart["mass"].tolist() == [1.0, 1.0, 1.2, 1.2]
    assert apart["of"].tolist() == [2] * 4
    assert jumps(table, "delta_13", "f")["mass"].tolist() == [1.0] * 4 + [1.2] * 4
    assert len(transition_points(table, "delta_13", "f", least=0.9)) == 0  # no jump is that large
    with pytest.raises(AnalysisError, match="least is 0, but must be above 0"):
        transition_points(table, "delta_13", "f", least=0.0)


def test_irregular_rows_are_excluded() -> None:
    """An irregular row may jump anywhere; a row that turns back once may reach a third gait."""
    table = staircase_table(3)
    wandering = table["row"] == 0
    wild = np.where(np.arange(np.sum(wandering)) % 3 == 0, 0.4, 5.9)
    table.loc[wandering, "delta_13_n"] = wild
    assert len(jumps(table.loc[wandering], "delta_13", "f")) > 10
    assert largest_jumps(table, "delta_13", "f")["row"].tolist() == [1, 1, 2, 2]
    result = transition_points(table, "delta_13", "f")
    assert result.drop(columns="of").equals(
        transition_points(table.loc[~wandering], "delta_13", "f").drop(columns="of")
    )
    assert result[["rows", "of"]].to_numpy().tolist() == [[2, 3], [2, 3]]
    table.loc[(table["row"] == 1) & (table["stair"] == 16), "delta_13_n"] -= 0.3
    assert 1 in largest_jumps(table, "delta_13", "f")["row"].tolist()


def test_a_jump_at_the_turn_belongs_to_the_pass_back() -> None:
    """The interval joins the last stair up and the first one down."""
    table = staircase_table()
    table.loc[table["stair"] >= 17, "delta_13_n"] = 1.0
    result = jumps(table, "delta_13", "f")
    assert result.iloc[-1][["pass", "direction"]].tolist() == [1, "falling"]
    assert result.iloc[-1][["low", "high"]].tolist() == pytest.approx([0.7, 0.8])


@pytest.mark.parametrize("centre", [2.6, 0.05])
def test_loop_area_against_the_closed_form(centre: float) -> None:
    stairs = loop_area(staircase_table(stairs=161, hold=1500, centre=centre), "delta_13", "f")
    # Stairs are 0.01 apart: each fold lies up to half of it, 0.5 % of the area, from the middle of its jump.
    assert stairs["area"].item() == pytest.approx(SCALE * AREA, rel=0.012)
    assert stairs["signed"].item() == pytest.approx(-SCALE * AREA, rel=0.012)  # the rising branch is below
    assert stairs[["low", "high"]].to_numpy().ravel() == pytest.approx([-0.8, 0.8])
    ramp = loop_area(ramp_table(steps=4000, centre=centre), "delta_13", "f")["area"].item()
    assert ramp == pytest.approx(SCALE * (AREA + 2 * lag(4000) * np.sqrt(3)), rel=0.01)


@pytest.mark.parametrize("name", ["x_n", "psi_n"])
def test_branches_that_cross_between_two_values(name: str) -> None:
    """At the turn the second branch is 1/2, so their difference is linear from -1 to 1/2."""
    table = pd.DataFrame({"row": 0, "pass": [0, 0, 1, 1], "stair": range(4), "f": [0.0, 1.0, 1.0, 0.0]})
    loops = loop_area(table.assign(**{name: [0.0, 1.0, 0.0, 1.0]}), name, "f")
    assert loops["area"].item() == pytest.approx(1.0 / 3.0 + 1.0 / 12.0, rel=1e-12)
    assert loops["signed"].item() == pytest.approx(-1.0 / 4.0, rel=1e-12)


def test_branches_of_angles_that_pass_half_a_turn_do_not_cross() -> None:
    """Their difference goes from 0 to -3 rad, and on by half a turn to 3 rad."""
    table = pd.DataFrame({"row": 0, "pass": [0] * 3 + [1] * 3, "stair": range(6)})
    table["f"], table["psi_n"] = [0.0, 1.0, 2.0, 2.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.0, 3.0, -3.0]
    assert loop_area(table, "psi_n", "f")["area"].item() == pytest.approx(1.5 + 3.0, rel=1e-12)


def test_half_a_turn_has_one_sign_in_all_rows() -> None:
    """Rows that differ by the origin of their angle alone; the falling pass has values of its own."""
    speed, turned = [1.0, 2.0, 3.0, 4.0, 4.0, 3.5, 2.5, 1.0], np.pi * np.array([0, 0, 0, 1, 1, 1, 1, 0])
    rows = pd.DataFrame({"pass": [0] * 4 + [1] * 4, "stair": range(8), "speed": speed})
    tables = [rows.assign(row=k, psi_n=np.mod(0.7 * k + turned, 2.0 * np.pi)) for k in range(9)]
    table = pd.concat(tables, ignore_index=True)
    signed = loop_area(table, "psi_n", "speed")["signed"].to_numpy()
    np.testing.assert_allclose(signed, signed[0], rtol=1e-12)


def test_a_loop_has_an_area_where_angles_at_one_value_cancel() -> None:
    """As at a turn where an angle jumps by half a turn; the branch is linear over that value."""
    table = pd.DataFrame({"row": 0, "pass": [0] * 5 + [1] * 5, "stair": range(10)})
    table["f"] = [0.0, 1.0, 2.0, 3.0, 4.0, 4.0, 3.0, 2.0, 1.0, 0.0]
    table["psi_n"] = [0.0, 0.0, 0.0, 0.0, np.pi, 0.0, 0.0, 0.0, 0.0, 0.0]
    (loop,) = loop_area(table, "psi_n", "f").to_dict("records")
    assert (loop["area"], loop["low"], loop["high"]) == (0.0, 0.0, 3.0)


def test_a_row_that_fell_gives_no_jump_of_its_fall() -> None:
    table = ramp_table(2, steps=1000)
    end = (table["row"] == 1) & (table["crossing"] > 500)
    table = table.loc[~(end & (table["crossing"] > 508))]
    falling = table.loc[end, "crossing"].to_numpy() - 500
    table.loc[end, "delta_13_n"] += 0.2 * falling  # what eight crossings before a fall may look like
    table.loc[table["row"] == 1, "status"] = "fell"
    result = jumps(table, "delta_13", "f")
    assert result["row"].tolist() == [0, 0]
    area = loop_area(table, "delta_13", "f").set_index("row")["area"]
    assert area.loc[0] > 0.4
    assert np.isnan(area.loc[1])
    assert transition_points(table, "delta_13", "f")["of"].tolist() == [2, 2]


def test_holds_without_a_crossing_are_skipped() -> None:
    table = staircase_table()
    table.loc[table["stair"] == 3, "delta_13_n"] = np.nan
    table.loc[table["stair"] == 11, "delta_13_n"] = np.nan  # f = 0.3, the last before the fold
    result = jumps(table, "delta_13", "f")
    assert result.iloc[0][["low", "high"]].tolist() == pytest.approx([0.2, 0.4])
    nothing = table.assign(delta_13_n=np.nan)
    nothing.attrs = table.attrs
    for empty in (nothing, table.iloc[:0], ramp_table(steps=10).iloc[:1]):
        assert list(jumps(empty, "delta_13", "f").columns) == list(result.columns)
        assert not len(jumps(empty, "delta_13", "f"))
        assert not len(transition_points(empty, "delta_13", "f"))
        assert not len(loop_area(empty, "delta_13", "f"))


def test_jumps_of_observables_that_are_not_angles() -> None:
    table = staircase_table()
    table["speed_n"] = np.where(table["delta_13_n"] > 2.6, 7.0, 1.0)
    result = jumps(table, "speed", "f", least=1.0)
    assert result["size"].tolist() == [6.0, -6.0]
    assert loop_area(table, "speed", "f")["area"].item() == pytest.approx(6.0 * 0.7, abs=1e-9)


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_all_jumps_of_a_pass_are_found_whatever_their_unit(scale: float) -> None:
    """Steps of 0.002 on the branches; jumps of 0.102 and 0.9, and of 0.04, which changes the gait."""
    speed = np.round(np.linspace(1.0, 3.0, 21), 9)
    rises = 0.02 * speed + 0.04 * (speed > 1.25) + 0.1 * (speed > 1.55) + 0.9 * (speed > 2.25)
    gait = np.where(speed > 1.25, "trot", "walk")
    table = pd.DataFrame({"row": 0, "pass": 0, "stair": range(21), "speed": speed, "gait": gait})
    table["x_n"], table["settled"], table["status"] = scale * rises, True, "complete"
    found = jump_intervals(table, "x", "speed")
    assert found[["low", "high"]].to_numpy().tolist() == [[1.2, 1.3], [1.5, 1.6], [2.2, 2.3]]
    assert jump_intervals(table.assign(gait="walk"), "x", "speed")["low"].tolist() == [1.5, 2.2]


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e3])
def test_transition_points_do_not_depend_on_the_unit(scale: float) -> None:
    """A branch that swings by 0.04 about 0 and 2, and a row that jumps to and fro between them."""
    f = np.concatenate([np.arange(20.0), np.arange(19.0, -1.0, -1.0)])
    up = np.concatenate([f[:20] >= 12, f[20:] >= 8])
    values = 2.0 * np.stack([up, np.arange(40) % 10 < 5]) + 0.02 * np.sin(1.3 * f)
    stairs = {"pass": np.repeat([0, 1], 20), "stair": np.arange(40), "f": f}
    table = pd.concat([pd.DataFrame({"row": k, **stairs, "x_n": scale * values[k]}) for k in (0, 1)])
    points = hysteresis(table, "x", "f").transition_points
    assert points[["pass", "low", "high", "rows"]].to_numpy().tolist() == [[0, 11, 12, 1], [1, 7, 8, 1]]
    assert irregular_passes(table, "x", "f").to_numpy().tolist() == [[1, 0], [1, 1]]


def test_a_slow_hold_of_a_row_on_one_branch_is_no_jump() -> None:
    """A branch of slope 0.01 whose last hold is 0.02 off, beside a row that jumps by 1."""
    stairs = np.arange(13)
    branch = 0.01 * stairs - 0.02 * (stairs == 12)
    parts = [
        pd.DataFrame({"row": row, "pass": 0, "stair": stairs, "f": 0.1 * stairs, "x_n": values})
        for row, values in enumerate([branch, 0.01 * stairs + (stairs > 5)])
    ]
    table = pd.concat(parts).assign(settled=True, status="complete", gait="pace")
    assert jumps(table, "x", "f", None)["row"].tolist() == [1]


@pytest.mark.parametrize("least", [None, 0.3])
def test_a_smooth_slope_over_unsettled_holds_is_no_jump(least: float | None) -> None:
    f = np.concatenate([np.arange(4), 3 - np.arange(1, 8)]) / 6
    table = pd.DataFrame({"row": 0, "pass": [0] * 4 + [1] * 7, "stair": range(11), "f": f, "settled": False})
    assert jumps(table.assign(y_n=1.5 * f + 0.1 * f**2), "y", "f", least).empty
    lost = table.assign(y_n=1.5 * f + 0.1 * f**2 + 3.0 * (f < -0.1))
    assert jumps(lost, "y", "f", least)["pass"].tolist() == [1]


@pytest.mark.parametrize("missing", [False, None, np.nan, pd.NA])
def test_a_hold_without_a_flag_has_not_settled(missing: Any) -> None:
    """A jump of 2 by way of an unsettled hold at 1 is one jump."""
    value = 0.01 * np.arange(9) + np.repeat([0.0, 1.0, 2.0], [4, 1, 4])
    table = pd.DataFrame({"row": 0, "pass": 0, "stair": range(9), "f": 0.1 * np.arange(9), "y_n": value})
    table["settled"] = pd.Series([True] * 4 + [missing] + [True] * 4, dtype=object)
    assert jumps(table, "y", "f", 0.3)["size"].tolist() == [pytest.approx(2.02)]


def test_missing_columns_are_refused() -> None:
    table = staircase_table()
    with pytest.raises(
        AnalysisError, match=r"delta_31 is not a column of this table; did you mean delta_13_n\?"
    ):
        jumps(table, "delta_31", "f")
    with pytest.raises(AnalysisError, match="mass is not a column"):
        transition_points(table, "delta_13", "f", by=["mass"])
    with pytest.raises(AnalysisError, match="beta is not a column"):
        loop_area(table, "delta_13", "beta")


def test_where_each_gait_is_lost() -> None:
    table = settle_table(np.linspace(-0.8, 0.8, 33), [-1.0, 1.0])  # 0.05 apart
    result = transition_points_by_gait(table, "f", "delta_13").set_index("gait")
    trot, walk = result.loc["trot"], result.loc["walk"]
    assert trot[["direction", "kept", "lost"]].tolist() == [
        "falling",
        pytest.approx(-0.35),
        pytest.approx(-0.4),
    ]
    assert walk[["direction", "kept", "lost"]].tolist() == ["rising", pytest.approx(0.35), pytest.approx(0.4)]
    for edge, fold in ((trot, -FOLD), (walk, FOLD)):
        assert edge["low"] < fold < edge["high"]


def test_rows_that_reached_their_limit_are_ignored() -> None:
    table = settle_table(np.linspace(-0.8, 0.8, 33), [-1.0, 1.0])
    beyond = (table["f"] > 0.38) & (table["f"] < 0.48) & (table["delta_13"] < 2.6)
    table.loc[beyond, ["status", "gait"]] = ["cycle_limit", "walk"]  # held by the ghost, still called a walk
    result = transition_points_by_gait(table, "f", "delta_13").set_index("gait")
    assert result.loc["walk", ["low", "high"]].tolist() == pytest.approx([0.35, 0.5])
    for last_label in ("none", "walk"):  # a row that fell has lost its gait
        table.loc[beyond, ["status", "gait"]] = ["fell", last_label]
        result = transition_points_by_gait(table, "f", "delta_13").set_index("gait")
        assert result.loc["walk", ["low", "high"]].tolist() == pytest.approx([0.35, 0.4])


def test_edges_by_gait_of_several_sets_of_rows() -> None:
    table = settle_table(np.linspace(-0.8, 0.8, 33), [-1.0, 1.0], others=(0.75, 0.80))
    result = transition_points_by_gait(table, "f", "delta_13", by=["beta"])
    for edge in result.to_dict("records"):
        fold = (FOLD if edge["gait"] == "walk" else -FOLD) - 4 * (edge["beta"] - 0.75)
        assert edge["low"] < fold < edge["high"]
    assert len(result) == 4
    assert not len(transition_points_by_gait(table.iloc[:0], "f", "delta_13"))
    assert not len(
        transition_points_by_gait(table.assign(gait=pd.Categorical(["none"] * len(table))), "f", "delta_13")
    )
    with pytest.raises(AnalysisError, match="start is not a column"):
        transition_points_by_gait(table, "f", "start")


def test_the_synthetic_tables_satisfy_their_map() -> None:
    assert len(roots(0.38)) == 3
    assert len(roots(0.39)) == 1
    assert set(ramp_table(steps=10)["status"].unique()) <= set(STATUSES)


def test_a_pass_that_turns_back_twice_is_irregular() -> None:
    """A pass that turns back once is regular: a branch may rise and fall."""
    table = staircase_table(3)
    assert not len(irregular_passes(table, "delta_13", "f"))
    up = (table["pass"] == 0).to_numpy()
    bump = np.where(np.arange(up.sum()) < up.sum() // 2, 2.3, 2.6)
    bump[-3:] = 2.3
    table.loc[up & (table["row"] == 1), "delta_13_n"] = bump[: (up & (table["row"] == 1)).sum()]
    wild = up & (table["row"] == 2).to_numpy()
    table.loc[wild, "delta_13_n"] = 2.5 + 0.1 * np.resize([1, -1, -1, 1], wild.sum())
    assert irregular_passes(table, "delta_13", "f").to_numpy().tolist() == [[2, 0]]
    assert not len(irregular_passes(table, "delta_13", "f", least=0.3))
    points = transition_points(table, "delta_13", "f")
    assert points.loc[points["direction"] == "falling", "rows"].tolist() == [3]


@pytest.mark.parametrize("made", [staircase_table, ramp_table])
def test_a_branch_may_slope_against_its_jumps(made: Callable[[int], pd.DataFrame]) -> None:
    """Each branch falls by more than `least` on either side of a jump up, and the course turns back twice."""
    table = made(2)
    jumped = largest_jumps(table, "delta_13", "f")
    table["delta_13_n"] -= 0.8 * table["f"]
    assert not len(irregular_passes(table, "delta_13", "f"))
    tilted = largest_jumps(table, "delta_13", "f")
    assert tilted[["row", "pass", "direction"]].equals(jumped[["row", "pass", "direction"]])
    assert (np.sign(tilted["size"]) == np.sign(jumped["size"])).all()
    np.testing.assert_allclose(tilted[["low", "high"]], jumped[["low", "high"]], atol=0.1 + 1e-9)  # a stair


def test_gaits_may_be_numbers() -> None:
    """The numbers of gaits, also as whole numbers, have the transition points of their names."""
    table = settle_table(np.linspace(-0.8, 0.8, 33), [-1.0, 1.0])
    named = transition_points_by_gait(table, "f", "delta_13")
    number = {"trot": 1, "walk": 2}
    numbered = table.assign(gait=[number.get(name, 0) for name in table["gait"].astype(str)])
    result = transition_points_by_gait(numbered, "f", "delta_13")
    edges = ["direction", "kept", "lost", "rows"]
    for name in named["gait"]:
        of_name, of_number = named["gait"] == name, result["gait"] == str(number[name])
        assert (
            result.loc[of_number, edges].to_numpy().tolist() == named.loc[of_name, edges].to_numpy().tolist()
        )


def test_columns_that_vary_within_a_row_are_no_axes() -> None:
    table = staircase_table()
    with pytest.raises(AnalysisError, match="delta_13_n is not a swept axis"):
        transition_points(table, "delta_13", "f", by=["delta_13_n"])


def test_a_last_pass_closes_its_loop_with_the_one_before() -> None:
    """Of 0.2 to 2, to -1.6 and back to 2: the second loop has the whole range; noise of pi makes no jump."""
    up, down = np.linspace(0.2, 2.0, 19), np.linspace(2.0, -1.6, 37)
    f = np.concatenate([up, down[1:], down[::-1][1:]])
    number = np.repeat([0, 1, 2], [19, 36, 36])
    value = np.where(number == 1, 1.0, 0.0)
    table = pd.DataFrame({"row": 0, "pass": number, "stair": np.arange(f.size), "f": f, "speed_n": value})
    loops = loop_area(table.assign(status="complete", cycles=9), "speed", "f")
    np.testing.assert_allclose(loops["area"], [1.8 - 0.05, 3.6 - 0.05], atol=0.06)
    assert loops["low"].tolist() == pytest.approx([0.2, -1.6])
    still = table.assign(status="complete", cycles=9, speed_n=np.pi + 1e-15 * np.arange(f.size) % 3e-15)
    assert not len(jumps(still, "speed", "f", least=None))


def test_rows_without_a_value_of_an_axis_are_a_combination_of_their_own() -> None:
    """As of joined tables, one of which does not have the axis."""
    table = staircase_table(2)
    table.insert(1, "mass", np.where(table["row"] == 0, 1.0, np.nan))
    points = transition_points(table, "delta_13", "f", by="mass")
    assert points["mass"].isna().tolist() == [False, False, True, True]
    assert points[["rows", "of"]].to_numpy().tolist() == [[1, 1]] * 4


def test_the_least_jump_has_no_meaning_for_settled_rows() -> None:
    table = settle_table(np.linspace(-0.8, 0.8, 9), [-1.0, 1.0])
    with pytest.raises(AnalysisError, match=r"least is 0\.3, but of settled rows gaits count"):
        hysteresis(table, parameter="f", start="delta_13", least=0.3)
