"""Stability quantifiers of a map with two wells, which are known in closed form."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.analysis.records import AnalysisError
from gaitsweep.examples.bouncing_ball import BouncingBall


class Wells(gs.MapModel):
    """x is pulled to the wells at -1 and 1, with the edge at `edge`; multipliers of the wells follow."""

    pull = gs.parameter("1", "pull", 0.2)
    edge = gs.parameter("1", "edge between the wells", 0.0)
    x = gs.variable("1", "place", 0.0)

    def image(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": s.x - p.pull * (s.x - p.edge) * (s.x**2 - 1.0)}


class Sheared(gs.MapModel):
    """A map with one multiplier, twice, and a shear, by which deviations grow before they decay."""

    shear = gs.parameter("1", "shear", 0.0)
    keeps = gs.parameter("1", "multiplier", 0.5)
    x = gs.variable("1", "first coordinate", 0.0)
    y = gs.variable("1", "second coordinate", 0.1)

    def image(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": p.keeps * s.x + p.shear * s.y, "y": p.keeps * s.y}


class NamedWells(Wells):
    """The same map, whose wells are gaits."""

    gaits = ("left", "right")

    def label(self, p: Any, at: Any) -> Any:
        return {"gait": jnp.where(at["x"] < 0.0, 0, 1)}


STARTS = np.linspace(-1.4, 1.4, 141)  # 0.02 apart


@pytest.fixture(scope="module")
def table() -> Any:
    run = gs.Settle(exponents=1, tolerance=1e-6)
    return gs.sweep(Wells(), x_0=STARTS, edge=[0.11, 0.31], run=run).table


def test_quantifiers_of_two_wells(table: Any) -> None:
    quantified: Any = gs.quantifiers(table, "edge", within=20.0)
    assert len(quantified) == 4
    for edge, both in quantified.groupby("edge"):
        # the well at -1 has the starts below the edge
        left, right = both.sort_values("rows", ascending=False).to_dict("records")
        shares = [np.mean(edge > STARTS), np.mean(edge < STARTS)]
        np.testing.assert_allclose([left["fraction"], right["fraction"]], shares)
        assert left["low"] < left["fraction"] < left["high"]
        decay = [-np.log(1.0 - 2.0 * 0.2 * (1.0 + edge)), -np.log(1.0 - 2.0 * 0.2 * (1.0 - edge))]
        np.testing.assert_allclose([left["resilience"], right["resilience"]], decay, rtol=0.01)
        # to the first start beyond the edge
        beyond = [np.min(STARTS[edge < STARTS]) + 1.0, 1.0 - np.max(STARTS[edge > STARTS])]
        np.testing.assert_allclose([left["least_shock"], right["least_shock"]], beyond, atol=1e-4)


@pytest.mark.slow
def test_the_resilience_of_a_refined_run_is_that_of_its_simulated_rows() -> None:
    run = gs.Settle(exponents=1, refine="boundary")
    refined = gs.sweep(NamedWells(), x_0={"linspace": [-1.4, 1.4, 141]}, edge=[0.11], run=run).table
    assert refined["status"].tolist().count("inferred") > 100
    quantified = gs.quantifiers(refined, "edge", label="gait")
    assert quantified["gait"].tolist() == ["left", "right"]
    decay = [-np.log(1.0 - 2.0 * 0.2 * (1.0 + 0.11)), -np.log(1.0 - 2.0 * 0.2 * (1.0 - 0.11))]
    np.testing.assert_allclose(quantified["resilience"], decay, rtol=0.01)


def test_convergence_times_are_those_of_the_rows(table: Any) -> None:
    quantified: Any = gs.quantifiers(table, "edge", within=30.0)
    for edge, both in quantified.groupby("edge"):
        for record, side in zip(both.sort_values("rows").to_dict("records"), (1.0, -1.0), strict=True):
            rows = table[(table["edge"] == edge) & ((table["x_end"] * side) > 0.0)]
            times = rows["t_end"].to_numpy(float)
            expected = [times.mean(), np.median(times), np.quantile(times, 0.95), times.max()]
            names = ("time_mean", "time_median", "time_tail", "time_most")
            np.testing.assert_allclose([record[name] for name in names], expected)
            assert record["within"] == pytest.approx(np.mean(times <= 30.0) * len(times) / len(STARTS))
            assert record["within"] < record["fraction"]


def test_what_does_not_follow_is_missing() -> None:
    plain = gs.sweep(Wells(), x_0=STARTS, edge=[0.1], run=gs.Settle()).table
    quantified = gs.quantifiers(plain, "edge")
    assert np.isnan(quantified[["resilience", "within"]].to_numpy(float)).all()
    without = gs.quantifiers(plain.drop(columns="x_end").assign(attractor="A"), "edge")
    assert np.isnan(without["least_shock"].to_numpy(float)).all()


@pytest.mark.slow
def test_deviations_of_a_non_normal_map_grow_before_they_decay(table: Any) -> None:
    """The nth power of ((m, s), (0, m)) has the norm m^n (c + sqrt(c^2 + 4)) / 2, with c = n s / m."""
    starts, keeps, n = np.linspace(-1.0, 1.0, 4), 0.8, np.arange(60)
    sheared = gs.sweep(Sheared(), y_0=starts, shear=[0.0, 1.0, 3.0], keeps=keeps, run=gs.Settle()).table
    quantified = gs.quantifiers(sheared, "shear", amplification=True)
    c = np.array([0.0, 1.0, 3.0])[:, None] * n / keeps
    exact = (keeps**n * (c + np.sqrt(c**2 + 4.0)) / 2.0).max(axis=1)
    assert exact[2] > 5.0
    np.testing.assert_allclose(quantified["amplification"], exact, rtol=1e-9)
    # a unit of y that is 10 times larger makes the shear as much stronger
    scaled = gs.quantifiers(sheared, "shear", scales={"y_0": 10.0}, amplification=True)
    c = np.array([0.0, 10.0, 30.0])[:, None] * n / keeps
    exact = (keeps**n * (c + np.sqrt(c**2 + 4.0)) / 2.0).max(axis=1)
    np.testing.assert_allclose(scaled["amplification"], exact, rtol=1e-9)
    # one coordinate has no shear
    np.testing.assert_array_equal(gs.quantifiers(table, "edge", amplification=True)["amplification"], 1.0)
    with pytest.raises(AnalysisError, match="has no job"):
        gs.quantifiers(pd.DataFrame(sheared.to_dict()), "shear", amplification=True)


def test_bad_arguments_are_refused(table: Any) -> None:
    with pytest.raises(AnalysisError, match=r"edges is not a column of this table.*edge"):
        gs.quantifiers(table, "edges")
    with pytest.raises(AnalysisError, match=r"within is -1 s, but must be above 0"):
        gs.quantifiers(table, "edge", within=-1.0)
    for amplification in (False, True):
        with pytest.raises(AnalysisError, match=r"scales\.x0 is not a start; did you mean x_0\?"):
            gs.quantifiers(table, "edge", scales={"x0": 0.2}, amplification=amplification)
        scale: Any
        for scale in (0.0, np.inf, "x"):
            with pytest.raises(AnalysisError, match=r"scale of x_0 is .*must be a number above 0"):
                gs.quantifiers(table, "edge", scales={"x_0": scale}, amplification=amplification)


def test_boundaries_are_smooth_or_intermingled_and_shared_or_not() -> None:
    """Stripes have straight borders, each of two stripes alone; outcomes by lot are everywhere."""
    n = 64
    x, y, drawn = (
        each.ravel() for each in np.meshgrid(np.arange(n), np.arange(n), [0.0, 1.0], indexing="ij")
    )
    lots = np.random.default_rng(4).integers(0, 3, x.size)
    outcome = np.where(drawn == 1.0, lots, np.searchsorted([20, 42], x, side="right"))
    names = np.array(["a", "b", "c"])[outcome]
    columns = {"x_0": x, "y_0": y, "drawn": drawn, "status": "settled", "t_end": 1.0, "gait": names}
    table = pd.DataFrame({"row": np.arange(x.size), **columns})
    quantified = gs.quantifiers(table, "drawn", label="gait")
    stripes, lots_of_each = quantified[["boundary_exponent", "wada"]].to_numpy(float).reshape(2, 3, 2)
    np.testing.assert_allclose(stripes[:, 0], 1.0, atol=0.05)
    assert stripes[:, 1].tolist() == [0.0, 0.5, 0.0]
    np.testing.assert_allclose(lots_of_each[:, 0], 0.0, atol=0.05)
    assert lots_of_each[:, 1].tolist() == [1.0, 1.0, 1.0]
    # two outcomes share their boundary anyway, and starts without those of the third form no grid
    two = table.iloc[np.flatnonzero(names != "c")]
    few = np.isnan(gs.quantifiers(two, "drawn", label="gait")[["wada", "boundary_exponent"]].to_numpy(float))
    assert few[:, 0].all()
    assert few[:, 1].tolist() == [False, False, True, True]


@pytest.mark.slow
def test_deviations_of_a_gait_of_two_crossings_grow_as_simulated_ones() -> None:
    """Deviations of 1e-6 in 180 directions at both crossings of a ball that bounces high and low in turns."""
    run = gs.Settle(max_cycles=400, tolerance=1e-6)
    table = gs.sweep(BouncingBall(), G=[1.6], run=run, phase_0=0.5, speed_0=3.6).table
    assert table["attractor_period"].tolist() == [2]
    labelled = table.assign(attractor="A")
    labelled.attrs = table.attrs
    quantified: Any = gs.quantifiers(labelled, "G", amplification=True)
    angles = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
    deviations = 1e-6 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    bounces, once = (gs.return_map(BouncingBall(), G=1.6, period=period) for period in (2, 1))
    largest = 1.0
    for crossing in bounces.orbit(bounces.fixed_points([0.5, 3.6]))[0]:
        centre, around = crossing[None], crossing + deviations
        for _ in range(30):
            centre, around = once(centre), once(around)
            difference = (around - centre + np.pi) % (2.0 * np.pi) - np.pi
            largest = max(largest, np.linalg.norm(difference, axis=1).max() / 1e-6)
    assert largest > 1.5
    assert quantified["amplification"].tolist() == [pytest.approx(largest, rel=1e-3)]


def test_the_share_in_time_of_a_label_with_outcomes_counts_times() -> None:
    """The table's column `outcome` is that of all rows, whatever their times."""
    columns = {"row": range(4), "k": 1.0, "x_0": [0.0, 0.1, 0.2, 0.3], "status": "settled"}
    table = pd.DataFrame({**columns, "t_end": [1.0, 2.0, 3.0, 4.0], "gait": "walk", "outcome": "walk"})
    quantified: Any = gs.quantifiers(table, "k", label="gait", within=1.5)
    assert quantified[["fraction", "within"]].to_numpy().tolist() == [[1.0, 0.25]]
    rows = gs.basins(table.drop(columns="outcome"), by="k").rows
    assert gs.quantifiers(rows, "k", label="gait", within=1.5)["within"].tolist() == [0.25]


def test_rows_without_a_start_are_no_shock() -> None:
    """As of joined tables, one of which does not have the axis."""
    columns = {"row": range(3), "k": 1.0, "x_0": [0.0, 0.5, np.nan], "status": "settled", "t_end": 1.0}
    table = pd.DataFrame({**columns, "x_end": [0.0, 1.0, 2.0], "gait": ["walk", "trot", "pace"]})
    quantified: Any = gs.quantifiers(table, "k", label="gait").set_index("gait")
    assert quantified.loc["walk", "least_shock"] == 0.5
    assert quantified.loc["trot", "least_shock"] == 1.0


def test_rows_that_did_not_settle_are_no_third_basin() -> None:
    """A strip of them between two basins; inside one of three stripes its edges are that one's boundary."""
    x, y = (each.ravel() for each in np.meshgrid(np.arange(64), np.arange(64), indexing="ij"))
    status = np.where(np.abs(x - 31.5) < 2.0, "cycle_limit", "settled")
    columns = {"row": np.arange(x.size), "k": 1.0, "x_0": x, "y_0": y, "status": status, "t_end": 1.0}
    table = pd.DataFrame(columns)
    two: Any = gs.quantifiers(table.assign(gait=np.where(x < 32, "a", "b")), "k", label="gait")
    assert np.isnan(two["wada"].to_numpy(float)).all()
    stripes = np.array(["a", "b", "c"])[np.searchsorted([10, 50], x, side="right")]
    three: Any = gs.quantifiers(table.assign(gait=stripes), "k", label="gait")
    assert three["wada"].tolist() == [0.0, 0.25, 0.0]


def test_rows_that_did_not_settle_have_no_outcome() -> None:
    """One of two rows of a trot ended at the limit of cycles; none of the walk's has settled in time."""
    columns = {"row": range(4), "k": 1.0, "x_0": [0.0, 0.1, 0.2, 0.3], "t_end": [9.0, 9.0, 1.0, 1.0]}
    statuses = ["settled", "settled", "settled", "cycle_limit"]
    table = pd.DataFrame({**columns, "status": statuses, "gait": ["walk", "walk", "trot", "trot"]})
    quantified: Any = gs.quantifiers(table.assign(x_end=np.nan), "k", label="gait", within=2.0).set_index(
        "gait"
    )
    assert quantified["rows"].to_dict() == {"trot": 1, "walk": 2}
    assert quantified["fraction"].to_dict() == {"trot": 0.25, "walk": 0.5}
    assert quantified.loc["walk", ["within", "within_low"]].tolist() == [0.0, 0.0]
    assert quantified.loc["walk", "within_high"] == pytest.approx(0.4899, abs=1e-4)  # Wilson's, of 0 of 4
    assert np.isnan(quantified["least_shock"].to_numpy(float)).all()  # no state at the end is known
    with pytest.raises(AnalysisError, match="withn is an option of the search for attractors"):
        gs.quantifiers(table, "k", label="gait", withn=2.0)


def test_inferred_rows_have_no_attractor_and_no_time(table: Any) -> None:
    gaits = table.assign(gait=np.where(table["x_end"] < 0.0, "left", "right"))
    gaits.attrs = table.attrs
    inferred = (gaits["x_0"] < -1.0) & (gaits["edge"] == 0.11)
    gaits.loc[inferred, "status"] = "inferred"
    gaits.loc[inferred, ["t_end", "x_end"]] = np.nan
    with pytest.raises(AnalysisError, match="no state that identifies an attractor"):
        gs.quantifiers(gaits, "edge")
    with pytest.raises(AnalysisError, match="inferred rows, which have no time"):
        gs.quantifiers(gaits, "edge", label="gait", within=20.0)
    with pytest.raises(gs.plot.PlotError, match="no state that identifies an attractor"):
        gs.plot.basin_measures(gaits, hue="attractor", panels="edge")
    quantified = gs.quantifiers(gaits, "edge", label="gait").set_index(["edge", "gait"])
    np.testing.assert_allclose(quantified.loc[(0.11, "left"), "fraction"], np.mean(STARTS < 0.11))
    assert quantified["time_mean"].isna().tolist() == [True, False, False, False]
