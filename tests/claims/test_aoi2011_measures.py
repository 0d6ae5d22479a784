"""The measures of Aoi 2011 on tables whose folds, fixed points and footfalls are known in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.analysis.records import AnalysisError
from gaitsweep.claims.measures import MeasureError, default_values, ratio_of_medians
from gaitsweep.errors import ArgumentError
from gaitsweep.papers.aoi2011 import (
    equation_measures,
    motion_measures,
    transition_measures,
)
from tests.support.hysteresis_tables import CENTRE, FOLD, map_table, settle_table, staircase_table

STAIR = 0.1


@pytest.fixture(scope="module")
def stairs() -> pd.DataFrame:
    return staircase_table(3)


@pytest.fixture(scope="module")
def maps() -> pd.DataFrame:
    """At -0.6 the lower point alone, at 0 both and one between, at 0.6 the upper one alone."""
    return map_table((-0.6, 0.0, 0.6), noise=1e-4)


def test_transitions_of_holds_are_the_folds(stairs: pd.DataFrame) -> None:
    """The lower branch is lost as the parameter rises to FOLD, the upper one as it falls to -FOLD."""
    up = transition_measures.transition_at(stairs, observable="delta_13", parameter="f", direction="rising")
    down = transition_measures.transition_at(
        stairs, observable="delta_13", parameter="f", direction="falling"
    )
    assert abs(up - FOLD) < STAIR
    assert abs(down + FOLD) < STAIR
    (width,) = transition_measures.hysteresis_widths(stairs, observable="delta_13", parameter="f")
    assert width == pytest.approx(up - down)
    with pytest.raises(AnalysisError, match="No row jumps"):
        transition_measures.transition_at(
            stairs.query("f < 0"), observable="delta_13", parameter="f", direction="rising"
        )


def test_widths_by_group_and_change_of_transitions(stairs: pd.DataFrame) -> None:
    """A table whose second half has its parameter moved by 0.3: both widths equal, transitions 0.3 apart."""
    moved = stairs.assign(f=stairs["f"] + 0.3, row=stairs["row"] + 3)
    both = pd.concat([stairs.assign(mass=1.0), moved.assign(mass=2.0)], ignore_index=True)
    both.attrs = stairs.attrs
    columns = ["row", "mass", *(name for name in both.columns if name not in ("row", "mass"))]
    both = both.loc[:, columns]
    result = transition_measures.hysteresis_widths(both, observable="delta_13", parameter="f", by="mass")
    assert result[0] == pytest.approx(result[1])
    change = transition_measures.least_change_of_transition(
        both, observable="delta_13", parameter="f", by=["mass"]
    )
    assert change == pytest.approx(0.3)
    rising = both.loc[both["pass"] == 0]
    with pytest.raises(AnalysisError, match="does not jump as f is falling"):
        transition_measures.least_change_of_transition(
            rising, observable="delta_13", parameter="f", by=["mass"]
        )


def test_the_range_in_which_both_branches_exist(stairs: pd.DataFrame) -> None:
    both = stairs.assign(mass=1.0)
    (width,) = transition_measures.bistable_ranges(
        both, observable="delta_13", parameter="f", apart=0.5, by="mass"
    )
    assert width == pytest.approx(2.0 * FOLD, abs=2.0 * STAIR)
    (none,) = transition_measures.bistable_ranges(
        both, observable="delta_13", parameter="f", apart=3.0, by="mass"
    )
    assert none == 0.0


def test_stairs_of_different_widths_count_by_their_widths() -> None:
    """Stairs 1, 1.1, 2 and 3 reach to the middles between them, from 0.95 to 3.5."""
    stairs = [1.0, 1.1, 2.0, 3.0]
    table = pd.DataFrame({"f": stairs * 2, "delta_13_n": [0.0] * 4 + [1.0] * 4, "settled": True, "mass": 1.0})
    options = {"observable": "delta_13", "parameter": "f", "apart": 0.5, "by": "mass"}
    for unit in (1.0, 1e-10, 1e6):
        of_unit = table.assign(f=table["f"] * unit)
        assert transition_measures.bistable_ranges(of_unit, **options) == pytest.approx([2.55 * unit])
    with pytest.raises(AnalysisError, match="No hold settled at mass = 1"):
        transition_measures.bistable_ranges(table.assign(settled=False), **options)
    with pytest.raises(AnalysisError, match="single stair"):
        transition_measures.bistable_ranges(table.assign(f=1.0), **options)
    with pytest.raises(AnalysisError, match="settled is not a column"):
        transition_measures.bistable_ranges(table.drop(columns="settled"), **options)


def test_directions_in_which_the_upper_branch_is_lost(stairs: pd.DataFrame) -> None:
    result = transition_measures.directions_of_loss(
        stairs, stairs, observable="delta_13", parameters=["f", "f"]
    )
    assert result == ["falling", "falling"]


def test_gaits_are_lost_at_the_folds() -> None:
    table = settle_table(np.linspace(-0.6, 0.6, 121).tolist(), (-1.0, 1.0), over="other")
    walk = transition_measures.gait_lost_at(table, parameter="f", gait="walk", direction="rising")
    trot = transition_measures.gait_lost_at(table, parameter="f", gait="trot", direction="falling")
    assert (walk, trot) == pytest.approx((FOLD, -FOLD), abs=0.006)
    mirrored = table.assign(f=-table["f"])
    width = transition_measures.gap_of_edges(mirrored, parameter="f", upper="trot", lower="walk")
    assert width == pytest.approx(2.0 * FOLD, abs=0.012)
    with pytest.raises(AnalysisError, match="trot is not lost as f is rising"):
        transition_measures.gait_lost_at(table, parameter="f", gait="trot", direction="rising")


@pytest.mark.slow
def test_fixed_points_of_return_maps(maps: pd.DataFrame) -> None:
    kinds = {
        f: transition_measures.kinds_of_fixed_points(maps, observable="delta_13", parameter="f", at=f)
        for f in (-0.6, 0.0, 0.6)
    }
    assert kinds == {-0.6: ["stable"], 0.0: ["stable", "unstable", "stable"], 0.6: ["stable"]}
    assert transition_measures.share_with_unstable_between(maps, observable="delta_13", parameter="f") == 1.0
    high = {"observable": "delta_13", "parameter": "f", "between": [CENTRE, CENTRE + 1.0]}
    assert transition_measures.stable_until(maps, **high, take="min") == 0.0
    assert transition_measures.stable_until(maps, **high, take="max") == 0.6
    with pytest.raises(AnalysisError, match="No stable fixed point"):
        transition_measures.stable_until(
            maps, observable="delta_13", parameter="f", between=[0.0, 1.0], take="max"
        )


def test_gaits_of_a_branch_are_in_order() -> None:
    """Stable as a trot to a fold, unstable to another, stable as a walk."""
    table = pd.DataFrame({
        "row": 0, "point": range(7), "f": [0.0, 1.0, 2.0, 1.0, 0.0, 1.0, 2.0],
        "stable": [True, True, False, False, False, True, True],
        "special": ["", "", "fold", "", "fold", "", ""], "end": ["", "", "", "", "", "", "range"],
        "gait": ["trot", "trot", "trot", "none", "walk", "walk", "walk"],
    })  # fmt: skip
    assert transition_measures.gaits_of_branch(table, parameter="f") == ["trot", "walk"]


def trace(lags: Sequence[float], broken: float = 0.0) -> pd.DataFrame:
    """Contacts of period 0.4 s: foot i lands `lags[i]` rad late, and `broken` s are missing in its stance."""
    t = np.arange(0.0, 2.0, 1e-3)
    columns: dict[str, object] = {"row": 0, "t": t}
    for foot, lag in enumerate(lags, start=1):
        since = np.mod(t - 0.4 * lag / (2.0 * np.pi), 0.4)
        columns[f"contact_{foot}"] = ((since < 0.3) & ~((since > 0.1) & (since < 0.1 + broken))).astype(float)
    return pd.DataFrame(columns)


@pytest.mark.parametrize("broken", [0.0, 0.015])
def test_lags_of_touchdowns(broken: float) -> None:
    """A break of 15 ms within the stance is not taken for a swing."""
    table = trace((0.0, np.pi, 2.0, 2.0 + np.pi), broken)
    result = motion_measures.touchdown_lags(table, row=0, pairs=[[1, 2], [1, 3], [3, 4]])
    np.testing.assert_allclose(result, [np.pi, 2.0, np.pi], atol=0.03)
    assert motion_measures.order_of_footfalls(table, row=0) == "1-3-2-4"
    together = trace((0.0, np.pi, np.pi - 0.1, 2.0 * np.pi - 0.1), broken)
    assert motion_measures.order_of_footfalls(together, row=0) == "1+4-2+3"


@pytest.mark.parametrize(
    ("first", "wanted"), [(0, "1+2+3-4"), (1, "1+2+4-3"), (2, "1+3+4-2"), (3, "1-2+3+4")]
)
def test_the_order_of_footfalls_does_not_depend_on_limb_1(first: int, wanted: str) -> None:
    """Three limbs land 0.15 rad after each other, so the last is not within 0.2 rad of the first."""
    lags = (0.0, 0.15, 0.3, np.pi)
    assert motion_measures.order_of_footfalls(trace(lags[first:] + lags[:first]), row=0) == wanted


def test_lags_are_on_the_requested_turn() -> None:
    """Foot 2 is 0.1 rad ahead of foot 1: -0.1 rad near 0, and 2 pi - 0.1 without."""
    table = trace((0.1, 0.0, 2.0, 3.0))
    for near, wanted in (([0.0], -0.1), (None, 2.0 * np.pi - 0.1)):
        result = motion_measures.touchdown_lags(table, row=0, pairs=[[1, 2]], near=near)
        np.testing.assert_allclose(result, [wanted], atol=0.03)


def test_no_lag_of_a_foot_that_lands_twice_a_cycle() -> None:
    table = trace((0.0, np.pi, 2.0, 2.0 + np.pi))
    t = table["t"].to_numpy()
    table["contact_3"] = (np.mod(t, 0.4) < 0.1) | ((np.mod(t, 0.4) > 0.16) & (np.mod(t, 0.4) < 0.32))
    with pytest.raises(AnalysisError, match="Foot 3 of row 0 does not touch down once a cycle"):
        motion_measures.touchdown_lags(table, row=0, pairs=[[1, 3]])


@pytest.mark.slow
def test_slip_is_that_of_the_rows_own_body(tmp_path: Path) -> None:
    """A body turned by 0.01 rad moves its hind feet by 0.01 times their distance from the axis."""
    wide = {"rear_hip_y": {"values": [0.05, 0.09]}}
    run = {"kind": "trace", "duration": 0.1, "every": 2.0e-2}
    table = gs.run(
        gs.Job(name="wide", model="waist_quadruped", vary=wide, run=run, verify=0), tmp_path / "out"
    ).table
    table[[f"contact_{i}" for i in range(1, 5)]] = 1.0
    table[[f"q_{i}" for i in range(16)]] = 0.0
    turned = table["t"] > 0.05
    table["q_3"], table["q_6"] = np.where(turned, np.cos(0.005), 1.0), np.where(turned, np.sin(0.005), 0.0)
    moved = []
    for row in (0, 1):
        part = table.loc[table["row"] == row]
        part.attrs = table.attrs
        moved.append(motion_measures.foot_slip(part, take="max"))
    squares = (np.array(moved) / (2.0 * np.sin(0.005))) ** 2
    assert squares[1] - squares[0] == pytest.approx(0.09**2 - 0.05**2, rel=1e-9)


@pytest.mark.slow
def test_slip_continues_through_a_bounce(tmp_path: Path) -> None:
    """On a body at 0.01 m/s, feet in contact for 1 s but for 40 ms slip by 0.01 m; but for 80 ms, by half."""
    run = {"kind": "trace", "duration": 0.1, "every": 2.0e-2}
    ran = gs.run(gs.Job(name="bounce", model="waist_quadruped", run=run, verify=0), tmp_path / "out").table
    t = np.linspace(0.0, 1.0, 1001)
    for break_, wanted in ((0.04, 0.01), (0.08, 0.005)):
        columns = {f"q_{i}": np.zeros_like(t) for i in range(16)} | {"q_0": 0.01 * t, "q_3": np.ones_like(t)}
        down = (np.abs(t - 0.5) > 0.5 * break_).astype(float)
        table = pd.DataFrame({"row": 0, "t": t, **columns, **{f"contact_{i}": down for i in range(1, 5)}})
        table.attrs = ran.attrs
        assert motion_measures.foot_slip(table) == pytest.approx(wanted, rel=0.1)


def test_path_and_slip() -> None:
    """A straight path with a sway of one cycle has no sideways share; a circle has that of its sagitta."""
    t = np.arange(0.0, 4.0, 1e-2)
    straight = pd.DataFrame({"row": 0, "t": t, "q_0": 0.2 * t, "q_1": 0.01 * np.sin(2.0 * np.pi * t / 0.4)})
    job = gs.Job(
        name="path",
        model="waist_quadruped",
        vary={"T_sw": {"values": [0.1, 0.07]}},  # s, a quarter of a cycle
        run={"kind": "trace", "duration": 4.0, "every": 1e-2},
    )
    straight.attrs["job"] = job.model_dump(mode="json")
    assert motion_measures.sideways_share(straight) < 1e-3
    shorter = straight.assign(row=1)
    assert motion_measures.sideways_share(shorter) > 3e-3
    sway = 0.01 * np.sin(2.0 * np.pi * t / 0.28)
    assert motion_measures.sideways_share(shorter.assign(q_1=sway)) < 1e-3
    with pytest.raises(AnalysisError, match="row 0 is shorter than a cycle"):
        motion_measures.sideways_share(straight.head(30))
    for wrong, reason in (
        (straight.head(0), "no rows"),
        (straight.assign(q_1=np.where(t > 2.0, np.nan, 0.0)), "row 0 lacks a position"),
        (straight.assign(q_0=0.0, q_1=0.0), "row 0 does not move"),
        (straight.head(1), "row 0 is shorter than a cycle"),
    ):
        with pytest.raises(AnalysisError, match=reason):
            motion_measures.sideways_share(wrong)
    turned = straight.assign(q_0=np.sin(t), q_1=1.0 - np.cos(t))
    assert motion_measures.sideways_share(turned) > 0.1


def test_values_of_gaits(stairs: pd.DataFrame) -> None:
    ratio = ratio_of_medians(stairs, column="t", where="gait == 'walk'", to="gait == 'trot'")
    assert ratio > 0.0
    spread = motion_measures.spread_over(stairs, column="delta_13_n", over="f", where="gait == 'trot'")
    assert 0.0 < spread < 0.3
    away = motion_measures.farthest_angle(stairs, column="delta_13_n", centre=CENTRE)
    assert away == pytest.approx(np.abs(stairs["delta_13_n"] - CENTRE).max())
    settled = settle_table((0.0,), (-1.0, 1.0), over="other")
    assert motion_measures.drift_from_start(settled, start="delta_13", end="delta_13_end") < 1e-6
    without = stairs.assign(delta_13_n=np.nan)
    with pytest.raises(AnalysisError, match="No record has a value of delta_13_n"):
        motion_measures.spread_over(without, column="delta_13_n", over="f", where="gait == 'trot'")
    fallen = settled.assign(delta_13_end=np.nan)
    with pytest.raises(AnalysisError, match="A row has no value of delta_13 or delta_13_end"):
        motion_measures.drift_from_start(fallen, start="delta_13", end="delta_13_end")
    moved = motion_measures.difference_of_gaits(
        settled, stairs, observable="delta_13", where="abs(f) < 0.01", gaits=["walk", "trot"]
    )
    assert moved < 0.01


def test_a_row_that_falls_does_not_keep_its_gait(stairs: pd.DataFrame) -> None:
    """It has no records of the stairs that it did not reach."""
    walks = stairs.assign(gait="walk")
    assert motion_measures.gait_kept(walks, gait="walk") == 1.0
    falls = walks.loc[(walks["row"] > 0) | (walks["stair"] < 5)]
    falls = falls.assign(status=np.where(falls["row"] == 0, "fell", "complete"))
    assert motion_measures.gait_kept(falls, gait="walk") == pytest.approx(2 / 3)


def test_constants() -> None:
    assert equation_measures.degrees_of_freedom() == 15
    assert default_values(model="waist_quadruped", names=["body_mass", "link_length"]) == [1.0, 0.08]
    np.testing.assert_allclose(equation_measures.waist_constants(f=2.0), [1.0, 1.0], rtol=1e-12)
    np.testing.assert_allclose(
        equation_measures.nominal_gait(beta=0.75), [0.75, 15.70796, 0.0746667, 0.1866667], rtol=1e-5
    )
    with pytest.raises(ArgumentError, match="masse is not a parameter"):
        default_values(model="waist_quadruped", names=["masse"])


@pytest.mark.slow
def test_equations() -> None:
    assert equation_measures.phase_rate_error() < 1e-12
    assert equation_measures.reset_error() < 1e-14
    assert equation_measures.torque_error(joints="waist") < 1e-10
    assert equation_measures.torque_error(joints="limbs") < 1e-9
    assert equation_measures.ground_force_error() < 1e-9
    assert equation_measures.angular_velocity_error() < 1e-7
    for of in ("kinetic_energy", "feet", "accelerations"):
        assert equation_measures.mechanics_error(of=of) < 1e-9


def test_an_equation_that_gives_nan_has_no_small_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(equation_measures, "phase_rates", lambda *_: np.full(4, np.nan))
    with pytest.raises(MeasureError, match="not finite"):
        equation_measures.phase_rate_error()


def test_angles_of_gaits_on_both_sides_of_the_branch_cut() -> None:
    settled = pd.DataFrame({"gait": ["trot"] * 4, "lag_end": [3.1, -3.1, 3.12, -3.12]})
    holds = pd.DataFrame({"gait": ["trot"] * 3, "lag_n": [-3.06, -3.06, -3.06], "row": [0, 1, 2]})
    difference = motion_measures.difference_of_gaits(
        settled, holds, observable="lag", where="row >= 0", gaits=["trot"]
    )
    assert difference == pytest.approx(np.pi - 3.06, abs=1e-12)
    held = pd.DataFrame({"f": [1, 1, 2, 2], "delta_13_n": [6.2, 6.25, 0.05, np.nan]})
    spread = motion_measures.spread_over(held, column="delta_13_n", over="f", where="f > 0")
    assert spread == pytest.approx(2.0 * np.pi + 0.05 - 6.225)
    with pytest.raises(AnalysisError, match="gait pace"):
        motion_measures.difference_of_gaits(
            settled, holds, observable="lag", where="row >= 0", gaits=["pace"]
        )
