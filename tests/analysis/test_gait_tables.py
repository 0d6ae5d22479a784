"""Gaits from traces, crossings and tables of ends, and the bouts of gaits while the speed changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.analysis.records import AnalysisError
from gaitsweep.papers.fukuoka2015.analysis.gait_bouts import gait_bouts, gaits_along
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import gaits_counted, gaits_in, own_gaits_in
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import Steadiness, gait_of, onsets_of
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, LEGS, family, signs
from tests.support.gait_traces import crossings_of, ends, trace_of, traces

ROOT = Path(__file__).parents[2]


def test_families() -> None:
    assert [family(gait) for gait in ("L-walk", "D-walk", "trot", "uL-canter", "RT-gallop", "unsteady")] == [
        "walk", "walk", "trot", "canter", "gallop", "unsteady",
    ]  # fmt: skip


def test_all_gaits_in_a_trace_with_their_parameters() -> None:
    result = gaits_in(traces())
    assert list(result["gait"]) == list(CHART)
    assert list(result.columns[:2]) == ["row", "sigma"]
    np.testing.assert_allclose(result["sigma"], 0.1 * np.arange(9))
    # the signals are piecewise linear between samples, so onsets are exact to rounding
    np.testing.assert_allclose(result["delta_1"], [0.2 * signs(gait)[0] for gait in CHART], atol=1e-9)
    np.testing.assert_allclose(result["period"], 0.5, rtol=1e-9)


def test_gaits_are_counted_over_parameters() -> None:
    """Nine rows, one of each gait, at two places with a seed each; each row counts once."""
    result = gaits_in(traces()).drop(columns="sigma")
    result.insert(1, "k2", np.arange(9) // 5 * 0.08)
    result.insert(2, "seed", np.arange(9))
    counted = gaits_counted(result)
    assert list(counted["k2"]) == [0.0, 0.08]
    assert list(counted.drop(columns="k2").sum(axis=1)) == [5, 4]
    assert list(gaits_counted(result.drop(columns=["k2", "seed"])).iloc[0]) == [1] * 9


def test_the_margin_of_ends_is_to_the_threshold_of_their_gait() -> None:
    """A row at the threshold 0.03 with shifts of 0.02 is 0.01 from another gait, not 0.05."""
    table = ends(np.full(2, 0.02), np.zeros(2), np.zeros(2))
    assert gaits_in(table)["margin"].tolist() == pytest.approx([0.05, 0.05])
    table = table.assign(margin=[0.01, 0.05]).iloc[::-1]  # records in another order than their rows
    assert gaits_in(table)["margin"].tolist() == [0.01, 0.05]


def test_gaits_of_another_model_are_counted_by_its_own_names() -> None:
    """Rows that failed count by their outcome; tables with several records of a row are left out."""
    table = pd.DataFrame({
        "row": [0, 1, 2, 3], "mass": [1.0, 1.0, 2.0, 2.0], "status": ["settled"] * 3 + ["fell"],
        "cycles": [9] * 4, "gait": ["walk", "hop", "walk", None],
        "outcome": ["walk", "hop", "walk", "failed"],
    })  # fmt: skip
    gaits = own_gaits_in(table)
    assert gaits is not None
    counted = gaits_counted(gaits)
    assert counted.to_dict("list") == {"mass": [1.0, 2.0], "failed": [0, 1], "hop": [1, 0], "walk": [1, 1]}
    assert own_gaits_in(table.assign(row=0)) is None
    assert own_gaits_in(traces()) is None


def test_signals_of_another_model_are_given_by_name() -> None:
    trace = traces().drop(columns=[f"u_f_{leg}" for leg in LEGS])
    with pytest.raises(AnalysisError, match="neither u_f_LF"):
        gaits_in(trace)
    feet = {leg: f"contact_{i + 1}" for i, leg in enumerate(LEGS)}
    result = gaits_in(trace, signals=feet, level=0.5, falling=True)
    assert list(result["gait"]) == list(CHART)
    np.testing.assert_allclose(result["delta_2"], [0.2 * signs(gait)[1] for gait in CHART], atol=0.01)


def test_all_gaits_in_crossings() -> None:
    table = pd.concat([crossings_of(gait, row=row) for row, gait in enumerate(CHART)])
    result = gaits_in(table)
    assert list(result["gait"]) == list(CHART)
    assert np.all(result["steady"])
    np.testing.assert_allclose(result["delta_1"], [0.2 * signs(gait)[0] for gait in CHART], atol=1e-9)
    assert list(gaits_in(table, thresholds=(0.3, 0.1))["gait"]) == ["trot"] * 9
    for threshold in (-0.1, 0.6, np.nan):
        with pytest.raises(AnalysisError, match=r"threshold is .* cycles, but must be from 0 to 0\.5"):
            gaits_in(table, thresholds=(0.07, threshold))


def test_a_table_of_ends_keeps_the_models_own_gait() -> None:
    delta = np.array([-0.2, -0.06, 0.0, 0.06, 0.2, 0.2])
    table = ends(delta, delta, delta)
    table["status"] = ["complete"] * 5 + ["fell"]
    table.loc[4, "gait"] = "unsteady"
    result = gaits_in(table)
    assert list(result["gait"]) == ["D-walk", "trot", "trot", "trot", "unsteady", "none"]
    assert list(result["gait_at_0.05"]) == ["D-walk", "D-walk", "trot", "L-walk", "unsteady", "none"]
    assert list(result["steady"]) == [True] * 4 + [False] * 2
    assert list(result["k2"]) == [0.08] * 6


def test_a_table_of_ends_has_no_time_and_no_other_criteria() -> None:
    table = ends(np.zeros(2), np.zeros(2), np.zeros(2))
    with pytest.raises(AnalysisError, match="window and steadiness"):
        gaits_in(table, window=(15.0, 24.0))
    with pytest.raises(AnalysisError, match="window and steadiness"):
        gaits_in(table, steadiness=Steadiness(length=0.9))


def test_bouts_of_a_walk_that_turns_into_a_trot() -> None:
    t = np.arange(0.0, 20.0, 2e-3)
    phases = np.cumsum(np.linspace(1.0, 4.0, len(t))) * 2e-3  # cycles, ever faster
    walk, trot = (trace_of(gait, duration=20.0, phases=phases) for gait in ("D-walk", "trot"))
    table = pd.concat([walk.loc[walk["t"] < 10.0], trot.loc[trot["t"] >= 10.0]], ignore_index=True)
    table["x"] = 0.05 * table["t"] ** 2
    table["v_d"], table["pass"] = 0.1 * table["t"], (table["t"] > 15.0).astype(int)
    table.attrs["job"] = {"run": {"parameter": "v_d"}}
    along = gaits_along(table)
    middle = along["t"].to_numpy()
    np.testing.assert_allclose(along["v_d"], 0.1 * middle, atol=1e-9)
    np.testing.assert_allclose(along["speed"], 0.1 * middle, rtol=1e-6)
    assert set(along.loc[along["end"] < 9.9, "gait"]) == {"D-walk"}
    assert set(along.loc[along["begin"] > 10.6, "gait"]) == {"trot"}
    bouts = gait_bouts(along, least=3)
    assert list(bouts["family"]) == ["walk", "trot"]
    # a window of three cycles of 0.4 s resolves the change to about half its length
    assert abs(0.5 * (bouts.loc[0, "end"] + bouts.loc[1, "begin"]) - 10.0) < 0.6
    assert bouts.loc[1, "pass_end"] == 1.0
    assert bouts.loc[0, "speed_end"] == pytest.approx(0.1 * bouts.loc[0, "end"], rel=1e-6)


def test_short_bouts_do_not_divide_longer_ones() -> None:
    along = pd.DataFrame({"row": 0, "family": list("aaaabbaaaacaaa"), "t": np.arange(14.0)})
    along = along.assign(begin=along["t"], end=along["t"])
    assert list(gait_bouts(along, least=2)["family"]) == ["a", "b", "a"]
    assert list(gait_bouts(along, least=3)["family"]) == ["a"]
    assert gait_bouts(along, least=20).empty


def test_trots_in_crossings_remain_trots_without_some_onsets() -> None:
    # RH begins alternately just after and just before LF, so that every other onset of it is not recorded
    table = crossings_of("trot", n=30)
    table["since_RH_n"] = np.where(table["crossing"] % 2, 1e-3, 0.5 - 1e-3)
    along = gaits_along(table)
    assert set(along["gait"]) == {"trot"}


def test_a_row_of_less_than_three_cycles_has_no_gaits_along() -> None:
    along = gaits_along(trace_of("trot", duration=0.9))
    assert along.empty
    assert set(along.columns) >= {"gait", "gait_at_0.05", "family"}


def test_onsets_without_a_time_have_no_windows() -> None:
    onsets = onsets_of(trace_of("trot", duration=4.0))
    unknown = pd.concat([onsets, onsets.tail(1).assign(leg="LF", t=np.nan)], ignore_index=True)
    pd.testing.assert_frame_equal(gaits_along(unknown), gaits_along(onsets))


def test_a_table_without_onsets_has_no_gaits() -> None:
    assert gait_of(pd.DataFrame({"row": [], "leg": [], "t": []})).empty


@pytest.mark.slow
def test_a_walk_and_a_trot_of_the_quadruped_with_a_waist(tmp_path: Path) -> None:
    """Delta_13 is 2.37 rad in the walk, 2.87 in the trot; left and right in antiphase."""
    path = ROOT / "sweeps/waist_quadruped_footprints.yaml"
    # its walk is farther from its trot than the paper's is
    config = f"config={ROOT / 'configs/aoi2011_2.yaml'}"
    job = gs.load_job(path, [config, "run.duration=3.0", "run.after_cycles=40", "verify=0"])
    table = gs.load(gs.run(job, tmp_path / "out").path)
    phases = {"RF": "phase_1", "LF": "phase_2", "RH": "phase_3", "LH": "phase_4"}
    result = gaits_in(table, signals=phases, level=1.5 * np.pi)
    assert list(result["gait"]) == ["D-walk", "trot"]
    # 0.03 rad between the phases when limb 3 lands and when limbs swing
    shift = np.array([2.37, 2.87]) / (2.0 * np.pi) - 0.5
    for name in ("delta_1", "delta_2"):
        np.testing.assert_allclose(result[name], shift, atol=0.015)
    np.testing.assert_allclose(result["period"], 0.4, atol=2e-3)
