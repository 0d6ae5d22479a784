"""Shares of the gaits over sets of parameters, and their figure, from tables."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import QuadMesh

from gaitsweep import plot
from gaitsweep.analysis.records import AnalysisError
from gaitsweep.papers.ambe2021.analysis.gait_shares import gait_shares, sets_by_conditions
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import chain_of, chains_of


def table(**more: list[float]) -> pd.DataFrame:
    """Four starts for each of three end masses: below, inside and above the paper's conditions."""
    gaits = [
        ["none"] * 4,
        ["direct", "source", "source", "retrograde"],
        ["source", "source", "none", "source"],
    ]
    rows = [
        (m_B, start, gait) for m_B, came in zip((0.4, 0.8, 1.1), gaits, strict=True)
        for start, gait in enumerate(came)
    ]  # fmt: skip
    frame = pd.DataFrame(rows, columns=["m_B", "psi_1", "gait"])
    frame = pd.DataFrame({"row": np.arange(12), "m_B": frame.m_B, **more, "psi_1": frame.psi_1 * 1.0})
    ends = {f"psi_{i}_end": 0.0 for i in (1, 2, 3)}
    return frame.assign(status="settled", **ends, gait=[gait for _, _, gait in rows])


def test_shares_are_listed_with_the_conditions() -> None:
    shares = gait_shares(table())
    assert shares["m_B"].tolist() == [0.4, 0.8, 1.1]
    assert shares[["direct", "source", "retrograde", "elsewhere"]].to_numpy().tolist() == [
        [0.0, 0.0, 0.0, 1.0], [0.25, 0.5, 0.25, 0.0], [0.0, 0.75, 0.0, 0.25],
    ]  # fmt: skip
    for name in ("conditions", "direct_hold", "retrograde_hold"):
        assert shares[name].tolist() == [False, True, False]
    assert shares["source_hold"].tolist() == [False, True, True]  # above m it is left, for N = 3
    # Wilson's interval of 2 in 4 by hand, z = 1.96: 0.5 -+ 0.35
    assert shares.loc[1, "source_low"] == pytest.approx(0.15, abs=1e-3)
    assert shares.loc[1, "source_high"] == pytest.approx(0.85, abs=1e-3)
    assert shares.loc[0, "direct_high"] == pytest.approx(1.96**2 / (4 + 1.96**2), abs=1e-3)


def test_starts_without_swept_parameters_are_one_set() -> None:
    shares = gait_shares(table().drop(columns="m_B"))
    assert shares[["direct", "source", "retrograde"]].to_numpy().tolist() == [[1 / 12, 5 / 12, 1 / 12]]
    assert sets_by_conditions(table().drop(columns="m_B"))["sets"].tolist() == [1]


def test_each_set_has_the_interval_of_its_own_starts() -> None:
    """No start comes to the direct wave: the interval ends higher for one start than for four."""
    some = table().query("m_B == 0.4 or (m_B == 1.1 and psi_1 == 0)")
    assert gait_shares(some)["direct_high"].tolist() == pytest.approx([0.49, 0.79], abs=5e-3)


def test_sets_are_counted_by_the_conditions() -> None:
    """Inside the conditions all three gaits; above them the source wave alone; below them none."""
    sets = sets_by_conditions(table())
    assert sets["conditions"].tolist() == [True, False, False]
    assert sets[["direct_hold", "source_hold"]].to_numpy().tolist() == [
        [True, True], [False, True], [False, False],
    ]  # fmt: skip
    assert sets[["sets", "with_all", "with_any"]].to_numpy().tolist() == [[1, 1, 1], [1, 0, 1], [1, 0, 0]]
    assert sets["source"].tolist() == [0.5, 0.75, 0.0]


def test_the_chain_of_a_table_follows_its_jobs_formulas() -> None:
    some = table(kappa=[50.0] * 6 + [200.0] * 6)
    some.attrs["job"] = {"params": {"a": 0.5, "m_1": "m_B - 0.1", "kappa_end": "1.1*kappa"}}
    chains = chains_of(some, some.loc[:, ["m_B", "kappa"]])
    assert np.asarray(chains.m_1) == pytest.approx(some["m_B"] - 0.1)
    assert np.asarray(chains.m_end) == pytest.approx(some["m_B"])
    assert np.asarray(chains.kappa_end) == pytest.approx(1.1 * some["kappa"])
    assert np.asarray(chains.a_end) == pytest.approx(0.5)
    first = chain_of(some)
    assert (first.m_1, first.kappa_1, first.a_1) == pytest.approx((0.3, 50.0, 0.5))
    some.attrs["job"] = {"params": {"m_1": "m_X"}}
    with pytest.raises(AnalysisError, match="m_1 has no value"):
        chain_of(some)


@pytest.mark.slow
def test_curves_and_maps_show_the_edges_of_the_conditions() -> None:
    (axes,) = plot.draw("gait_shares", table(), x="m_B").axes
    lines = {line.get_label(): np.asarray(line.get_data(), float) for line in axes.get_lines()}
    assert lines["source"][1].tolist() == [0.0, 0.5, 0.75]
    edges = [float(data[0][0]) for label, data in lines.items() if str(label).startswith("_")]
    assert sorted(edges) == pytest.approx([0.5, 1.0])
    some = table(kappa=[50.0, 200.0] * 6)
    *maps, bar = plot.draw("gait_shares", some, x="m_B", y="kappa").axes
    assert [each.get_title() for each in maps] == ["direct", "source", "retrograde", "none of these"]
    assert bar.get_ylabel() == "share of starts"
    limits = [np.asarray(path.vertices) for each in maps[3].collections[1:] for path in each.get_paths()]
    assert [np.ptp(limit, axis=0).argmin() for limit in limits] == [0, 0, 1]  # two upright, one across
    assert [limits[0][0, 0], limits[1][0, 0], limits[2][0, 1]] == pytest.approx([0.5, 1.0, 9.8 / 0.4])
    with pytest.raises(plot.PlotError, match="m_b"):
        plot.draw("gait_shares", some, x="m_b")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("x", "values", "limits"),
    [
        ("m", (0.5, 1.0, 2.5), [0.9, 1.8]),
        ("m_1", (0.4, 0.8, 1.1), [1.0]),  # the tail's mass, 0.9, is above m/2
        ("g", (5.0, 20.0, 60.0), [40.0]),
        ("L", (0.2, 0.5, 1.0), [0.4]),
        ("a", (0.05, 0.4, 1.2), [0.098, 1.0]),
        ("beta", (0.6, 0.7, 0.8), []),
    ],
)
def test_limits_are_drawn_over_each_parameter_of_the_conditions(
    x: str, values: tuple[float, ...], limits: list[float]
) -> None:
    some = table().rename(columns={"m_B": x}).assign(**{x: np.repeat(values, 4)})
    (axes,) = plot.draw("gait_shares", some, x=x).axes
    dashed = [line for line in axes.get_lines() if line.get_linestyle() == "--"]
    drawn = sorted(float(np.asarray(line.get_xdata())[0]) for line in dashed)
    assert drawn == pytest.approx(limits)


@pytest.mark.slow
def test_values_in_equal_ratios_have_logarithmic_axes() -> None:
    some = table(kappa=[20.0, 80.0, 320.0, 320.0] * 3)
    some.attrs["job"] = {"vary": {"kappa": {"logspace": [20, 320, 3]}}}
    direct, *_ = plot.draw("gait_shares", some, x="m_B", y="kappa").axes
    assert (direct.get_xscale(), direct.get_yscale()) == ("linear", "log")
    mesh = direct.collections[0]
    assert isinstance(mesh, QuadMesh)
    corners = np.asarray(mesh.get_coordinates())
    assert corners[:, 0, 1] == pytest.approx([10.0, 40.0, 160.0, 640.0])
    (axes,) = plot.draw("gait_shares", some, x="kappa").axes
    assert axes.get_xscale() == "log"
    places = [float(np.asarray(line.get_xdata(), float)[0]) for line in axes.get_lines()]
    assert any(place == pytest.approx(9.8 / 0.4) for place in places)


@pytest.mark.slow
@pytest.mark.parametrize("number", [60, 1600])
def test_a_map_of_scattered_sets_shows_points_or_bins(number: int) -> None:
    sets = np.random.default_rng(2).uniform([0.3, 20.0], [1.2, 200.0], (number, 2))
    gait = np.where(sets[:, 0] < 0.6, "direct", "source")
    rows = pd.DataFrame({"m_B": sets[:, 0], "kappa": sets[:, 1], "psi_1": 0.0, "gait": gait})
    rows = rows.assign(status="settled", **{f"psi_{i}_end": 0.0 for i in (1, 2, 3)})
    direct, *_ = plot.draw("gait_shares", rows, x="m_B", y="kappa").axes
    points = direct.collections[0]
    if number > 1000:  # 20 x 20 bins of four sets
        shares = np.ma.asarray(points.get_array())
        assert shares.shape == (20, 20)
        across = np.linspace(sets[:, 0].min(), sets[:, 0].max(), 21)
        assert (shares[:, across[1:] < 0.6].compressed() == 1.0).all()
        assert (shares[:, across[:-1] >= 0.6].compressed() == 0.0).all()
        return
    shown = {
        tuple(np.round(place, 9)): share
        for place, share in zip(np.asarray(points.get_offsets()), np.asarray(points.get_array()), strict=True)
    }
    assert shown == {
        tuple(np.round(place, 9)): float(name == "direct") for place, name in zip(sets, gait, strict=True)
    }


def test_a_map_over_a_start_is_refused() -> None:
    with pytest.raises(plot.PlotError, match=r"y is psi_1, which is not a swept parameter.*m_B"):
        plot.draw("gait_shares", table(), x="m_B", y="psi_1")


def test_a_table_of_another_model_is_refused() -> None:
    table = pd.DataFrame({"row": [0], "k": 1.0, "status": "settled", "gait": "walk", "x_end": 0.0})
    with pytest.raises(AnalysisError, match="not of the multi-legged chain"):
        gait_shares(table)
    with pytest.raises(AnalysisError, match="no rows"):
        gait_shares(table.assign(psi_1_end=0.0).iloc[:0])
