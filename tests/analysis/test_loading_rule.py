"""The rule of leg loading on tables whose loads, tilts and shifts are known."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest

from gaitsweep.analysis.records import AnalysisError
from gaitsweep.papers.fukuoka2015.analysis.gait_bouts import body_oscillation
from gaitsweep.papers.fukuoka2015.analysis.loading_rule import (
    MEASURES,
    load_prediction,
    loading_rule,
    pairs_in,
    wilson_interval,
)
from tests.support.gait_traces import ends, trace_of


def _judged(table: pd.DataFrame, **options: object) -> pd.DataFrame:
    return loading_rule(table, **options).set_index("measure")  # pyright: ignore


@pytest.mark.parametrize("hits", [0, 3, 70, 200])
def test_interval_of_a_share_is_scipys(hits: int) -> None:
    expected = binomtest(hits, 200).proportion_ci(0.95, "wilson")
    assert wilson_interval(hits / 200, 200) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_agreement_of_tables_with_and_without_the_rule() -> None:
    delta = np.linspace(-0.25, 0.25, 41)
    axes = {"sigma": np.arange(41.0)}
    message = _judged(ends(delta, -50.0 * delta, 0.1 * delta, axes=axes))
    assert message.loc["load_stance", "r"] == pytest.approx(-1.0)
    assert message.loc["load_stance", "right"] == 1.0
    assert message.loc["tilt_late", "r"] == pytest.approx(1.0)
    assert message.loc["tilt_late", "right"] == 0.0
    assert message.loc["load_stance", "pairs"] == 82
    assert message.loc["load_stance", "cases"] == 41
    assert message.loc["load_stance", "shifted"] == 2 * (np.abs(delta) > 0.07).sum()
    # Wilson's interval of 30 right of 30, not of 60: both pairs of a row are one draw
    assert message.loc["load_stance", "right_low"] == pytest.approx(30 / (30 + 1.96**2), abs=1e-3)
    assert "load_together" not in message.index


@pytest.mark.filterwarnings("error")
def test_a_load_that_is_the_same_in_all_rows_has_no_correlation() -> None:
    delta = np.linspace(-0.25, 0.25, 5)
    message = _judged(ends(delta, np.full(5, 7.0), delta, axes={"sigma": np.arange(5.0)}))
    assert np.isnan(message.loc["load_stance", ["r", "r_low", "r_high"]].to_numpy(float)).all()


@pytest.mark.slow
def test_intervals_of_a_correlation_are_those_of_fishers_transform_where_rows_are_independent() -> None:
    random = np.random.default_rng(3)
    n, rho = 400, -0.6
    x = random.standard_normal(n)
    delta = 0.08 * (rho * x + np.sqrt(1.0 - rho**2) * random.standard_normal(n))
    table = ends(np.clip(delta, -0.45, 0.45), x, x, axes={"sigma": np.arange(float(n))})
    message = _judged(table).loc["load_late"]
    z, half = np.arctanh(message["r"]), 1.96 / np.sqrt(n - 3)
    # 4 000 draws give the ends of a bootstrap's interval to about a tenth of its half width
    assert message["r_low"] == pytest.approx(np.tanh(z - half), abs=0.02)
    assert message["r_high"] == pytest.approx(np.tanh(z + half), abs=0.02)
    # repeating every row ten times as another seed tells nothing new
    again = pd.concat([table.assign(row=table["row"] + n * seed, seed=seed) for seed in range(4)])
    again.insert(2, "seed", again.pop("seed"))
    repeated = _judged(again).loc["load_late"]
    assert repeated["cases"] == n
    assert repeated["r_low"] == pytest.approx(message["r_low"], abs=0.02)
    assert _judged(again, repeats=()).loc["load_late", "r_high"] < message["r_high"] - 0.02


def test_only_rows_with_a_gait_count_and_values_are_judged_separately() -> None:
    delta = np.array([-0.2, 0.2, 0.2, -0.2])
    table = ends(delta, np.array([1.0, -1.0, 5.0, 5.0]), delta, axes={"sigma": np.arange(4.0)})
    table.loc[2, "gait"], table.loc[3, "status"] = "unsteady", "fell"
    assert set(pairs_in(table)["row"]) == {0, 1}
    assert _judged(table).loc["load_late", "right"] == 1.0
    table["k2"] = [0.0, 0.08, 0.08, 0.08]
    message = loading_rule(table, split="k2")
    assert list(message["k2"].unique()) == [0.0, 0.08]
    assert np.isnan(message["r"]).all()  # one case each
    with pytest.raises(AnalysisError, match="k3 is not a column"):
        loading_rule(table, split="k3")


@pytest.mark.parametrize("gait", ["D-walk", "L-walk", "trot", "RT-gallop"])
def test_loads_and_tilt_of_a_trace(gait: str) -> None:
    loads = {"LF": 30.0, "LH": 10.0, "RF": 22.0, "RH": 25.0}
    trace = trace_of(gait, 0.2, loads=loads, pitch=0.03)
    trace.insert(1, "sigma", 0.5)
    pairs = pairs_in(trace).set_index("pair_number")
    assert set(MEASURES) <= set(pairs.columns)
    fore_less_hind = {1: 22.0 - 10.0, 2: 30.0 - 25.0}
    for number, difference in fore_less_hind.items():
        # what is constant in stance is what its mean is, up to the sample at the swing's beginning
        for name in ("load_late", "load_stance"):
            assert pairs.loc[number, name] == pytest.approx(difference, abs=0.5)
        assert pairs.loc[number, "load_together"] == pytest.approx(difference, abs=0.5)
        for name in ("tilt_together", "tilt_late", "tilt_stance"):
            assert pairs.loc[number, name] == pytest.approx(0.03)


def test_together_is_before_the_first_of_a_pair_and_late_before_each() -> None:
    """Hind legs of a D-walk swing 0.2 cycles before fore legs, on which load grows along their stance."""
    trace = trace_of("D-walk", 0.2, duration=10.0)
    trace.insert(1, "sigma", 0.5)
    for leg in ("LF", "RF"):
        onset = trace["t"].loc[(trace[f"u_f_{leg}"] > 0.0) & (trace[f"u_f_{leg}"].shift() <= 0.0)].to_numpy()
        until = np.append(onset, np.inf)[np.searchsorted(onset, trace["t"], side="right")] - trace["t"]
        stands = np.isfinite(until) & (trace[f"u_f_{leg}"] <= 0.0)
        trace[f"F_{leg}"] = np.where(stands, 10.0 + 100.0 * until, 10.0)  # N, falling by 100 N/s
    pairs = pairs_in(trace)
    # the middle of the last 75 ms lies 37.5 ms before the end: 3.75 N; together is 0.1 s earlier: 10 N more
    # a sample of 2 ms is 0.2 N
    np.testing.assert_allclose(pairs["load_late"], 3.75, atol=0.2)
    np.testing.assert_allclose(pairs["load_together"], 13.75, atol=0.2)


def test_loads_of_a_trot_predict_the_walk() -> None:
    cells = {"sigma": np.repeat(np.arange(10.0), 2), "seed": np.tile([0.0, 1.0], 10)}
    load = np.linspace(-4.0, 4.0, 10)[cells["sigma"].astype(int)]
    trots = ends(0.02 * np.ones(20), load, load, k2=0.0, axes=cells)
    walks = ends(-0.05 * load, 0.0 * load, load, axes=cells).assign(row=lambda table: table["row"] + 20)
    result = load_prediction(pd.concat([trots, walks], ignore_index=True))
    # loads of +-0.44 and +-1.33 N make shifts below the threshold: those rows trot, and foretell nothing
    assert list(result["sigma"]) == [0.0, 1.0, 2.0, 7.0, 8.0, 9.0]
    assert list(result["gait"]) == ["L-walk"] * 3 + ["D-walk"] * 3
    message = loading_rule(result, split="k2", repeats=()).set_index("measure")
    assert message.loc["load_stance", "r"] == pytest.approx(-1.0)
    assert message.loc["load_stance", "right"] == 1.0
    # a cell in which starts come to different walks says nothing either
    walks.loc[walks["sigma"] == 9.0, "gait"] = ["L-walk", "D-walk"]
    assert 9.0 not in set(load_prediction(pd.concat([trots, walks], ignore_index=True))["sigma"])
    with pytest.raises(AnalysisError, match="k2 = 0"):
        load_prediction(walks)
    # k2 alone varies: all rows are at one place
    one, other = (part.query("sigma == 0").drop(columns="sigma") for part in (trots, walks))
    result = load_prediction(pd.concat([one, other], ignore_index=True))
    assert result[["k2", "gait", "delta", "load_stance"]].to_numpy().tolist() == [[0.08, "L-walk", 0.2, -4.0]]


def test_how_often_the_body_pitches_in_a_cycle() -> None:
    trace = trace_of("trot", period=0.37)
    cycles = trace["t"] / 0.37
    trace["pitch"] = 0.3 + 0.02 * np.sin(2 * np.pi * cycles + 1.0) + 0.005 * np.cos(4 * np.pi * cycles)
    trace.insert(1, "sigma", 0.5)
    result = body_oscillation(trace).iloc[0]
    # whole cycles end between samples of 2 ms, 16 cycles of 185 samples
    assert result["once"] == pytest.approx(0.02, abs=1e-4)
    assert result["twice"] == pytest.approx(0.005, abs=1e-4)
    assert result["gait"] == "trot"
    assert body_oscillation(trace.assign(u_f_RH=-1.0)).empty
