"""The jobs of the planar quadruped's page: what their tables have to show, with new starts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.analysis.gaits.body_oscillation import body_oscillation
from gaitsweep.analysis.gaits.loading_rule import load_prediction, loading_rule, pairs_in
from gaitsweep.analysis.transitions.gait_bouts import gait_bouts, gaits_along
from gaitsweep.analysis.transitions.speed_transitions import speed_transitions
from gaitsweep.claims.measures.fukuoka2015 import share_in_order
from gaitsweep.expression import evaluate

SWEEPS = Path(__file__).parents[2] / "sweeps"
# The steady speeds without feedback over sigma that the ramps follow, m/s.
KNOTS = {0.275: 0.0, 0.507: 0.2, 0.787: 0.4, 0.969: 0.5, 1.287: 0.6, 1.895: 0.8, 2.535: 1.0, 2.8: 1.0}


def _table(tmp_path: Path, name: str, *overrides: str) -> pd.DataFrame:
    job = gs.load_job(SWEEPS / f"planar_quadruped_{name}.yaml", [*overrides, "figures=[]"])
    return gs.load(gs.run(job, tmp_path / name).path)


@pytest.mark.parametrize("name", ["ramp", "ramp_trace", "ramp_offset", "ramp_slow", "ramp_fast"])
def test_sigma_follows_the_wanted_speed(name: str) -> None:
    formula = gs.load_job(SWEEPS / f"planar_quadruped_{name}.yaml").params["sigma"]
    for speed, sigma in KNOTS.items():
        assert evaluate(formula, {"v_d": speed}) == pytest.approx(sigma, abs=1e-9)


@pytest.mark.slow
def test_gaits_follow_each_other_as_the_speed_rises_and_falls(tmp_path: Path) -> None:
    table = _table(tmp_path, "ramp", "vary.zip={seed: [30, 31], pair: [0, 1]}")
    assert set(table["status"]) == {"complete"}
    found = gait_bouts(gaits_along(table), least=3)
    assert [list(found.loc[found["row"] == row, "family"]) for row in (0, 1)] == [["trot"]] * 2
    for row in (2, 3):
        mine = found.loc[(found["row"] == row) & found["family"].isin(["walk", "trot", "canter", "gallop"])]
        order = list(mine["family"])
        # a trot may come back between the canters on the way up
        assert order[:3] == ["walk", "trot", "canter"]
        assert order[-4:] == ["gallop", "canter", "trot", "walk"]
        up = mine.loc[mine["family"] == "canter", "speed_begin"].iloc[0]
        # canters begin at 1.7 to 1.95 m/s as it rises and end at 1.47 as it falls: hysteresis
        assert up > mine["speed_end"].iloc[-3] + 0.1
        assert mine["speed_end"].iloc[-3] == pytest.approx(1.47, abs=0.1)


@pytest.mark.slow
def test_natural_canters_on_the_ramp_of_a_torso_heavy_behind(tmp_path: Path) -> None:
    table = _table(tmp_path, "ramp_offset", "vary.com_x=[-0.02]", "vary.zip={seed: [30, 31], pair: [0, 1]}")
    order = ["L-walk", "trot", "R-canter", "RT-gallop"]
    assert share_in_order(table, order=order, by="right") == 1.0
    found = speed_transitions(table).set_index("faster")
    # 1.67, 1.91 and 2.05 m/s from the page's starts
    assert found.loc["trot", "up"] == pytest.approx(1.67, abs=0.1)
    assert found.loc["canter", "up"] == pytest.approx(1.95, abs=0.15)
    assert found.loc["gallop", "width"] > 0.5


@pytest.mark.slow
def test_history_decides_between_small_and_large_shifts(tmp_path: Path) -> None:
    stairs = ["run.path=[0.83, 0.95, 0.83]", "vary.zip={seed: [30, 31], pair: [0, 1]}"]
    table = _table(tmp_path, "bistable", *stairs)
    larger = table[["delta_1_mean_n", "delta_2_mean_n"]].abs().max(axis=1)
    there = np.isclose(table["sigma"], 0.87)
    assert larger[there & (table["pass"] == 0)].max() < 0.13
    assert larger[there & (table["pass"] == 1)].min() > 0.2


@pytest.mark.slow
def test_loads_and_pitch_go_with_the_gaits(tmp_path: Path) -> None:
    axes = [
        "vary.k2=[0.08]",
        "vary.sigma={linspace: [0.05, 0.95, 7]}",
        "vary.zip={seed: [30, 31], pair: [0, 1]}",
    ]
    table = _table(tmp_path, "loads", *axes)
    told = loading_rule(pairs_in(table)).set_index("measure")
    # r = -.96 and all signs right over 21 speeds; a measure without the sign's meaning would have half
    assert told.loc["load_together", "r"] < -0.9
    assert told.loc["load_together", "right"] > 0.95
    assert told.loc["load_stance", "right"] > 0.9
    # tilt in late stance says nothing: the page has 42 to 46 %
    assert 0.2 < told.loc["tilt_together", "right"] < 0.7
    body = body_oscillation(table).set_index("gait")
    assert (body.loc[body.index.isin(["D-walk", "L-walk"]), "once"] < 0.001).all()
    gallops = body.loc[body.index.isin(["RT-gallop", "LT-gallop"])]
    assert len(gallops)
    assert (gallops["once"] > 4.0 * gallops["twice"]).all()


@pytest.mark.slow
def test_the_heavy_end_decides_between_walks_as_the_trots_loads_foretell(tmp_path: Path) -> None:
    axes = ["vary.com_x=[-0.06, -0.03, 0.03, 0.06]", "vary.sigma={linspace: [0.1, 0.4, 4]}"]
    table = _table(tmp_path, "offset", *axes, "vary.zip={seed: [30, 31], pair: [0, 1]}")
    fed_back = table.loc[table["k2"] > 0.0]
    steady = fed_back.loc[fed_back["gait"] != "unsteady"]
    wanted = np.where(steady["com_x"] > 0.0, "D-walk", "L-walk")
    assert len(steady) > 0.8 * len(fed_back)
    assert (steady["gait"].astype(str) == wanted).all()
    told = loading_rule(load_prediction(table), repeats=()).set_index("measure")
    assert told.loc["load_stance", "right"] == 1.0
    assert told.loc["load_stance", "r"] < -0.8
