"""Figures of basin measures: from complete and poor tables, in jobs, and when they are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.job import JobError
from gaitsweep.plot import PlotError, draw
from gaitsweep.plot.gait_looks import hatches
from gaitsweep.table import load
from tests.support.basin_tables import grid_table
from tests.support.plot_tables import legend_texts, rendered
from tests.support.text_boxes import text_problems

TURN = 2 * np.pi


def table() -> pd.DataFrame:
    """Three gaits over a grid of starts in three panels; psi_1 settles at the number of the gait."""

    def gait(x: np.ndarray, y: np.ndarray, p: np.ndarray) -> np.ndarray:
        return (x + np.sin(y) > 1.0).astype(int) + (x + np.sin(y) > p)

    starts = grid_table((20, 24), gait, panels=[2.0, 3.0, 4.5])
    for i, end in ((1, starts["gait"].cat.codes), (2, 0 * starts["psi_1"])):
        starts[f"psi_{i}_end"] = end + 1e-3 * np.random.default_rng(i).normal(size=len(starts))
    return starts


@pytest.mark.slow
def test_values_of_a_numeric_hue_need_no_hatches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each hatch is compared with those before, which would take hours for the values of all cells."""
    named: list[str] = []

    def remembering(names: list[str]) -> dict[str, str]:
        named.extend(names)
        return hatches(names)

    monkeypatch.setattr("gaitsweep.plot.basin_maps.basin_heat_map.theme.hatches", remembering)
    rendered(draw("basin", table(), x="psi_1", y="psi_2", hue="psi_1_end", panels="p"))
    assert not named


def test_measures_over_panels() -> None:
    figure = draw("basin_measures", table(), panels="p")
    rendered(figure)
    shares, entropies, uncertain = figure.axes
    assert legend_texts(shares) == ["0", "1", "2"]
    assert len(uncertain.lines) == 3
    assert "exponent" in legend_texts(uncertain)[0]
    np.testing.assert_allclose(np.asarray(entropies.lines[0].get_xdata()), [2.0, 3.0, 4.5])


def test_many_panels_share_a_colour_bar() -> None:
    def gait(x: np.ndarray, y: np.ndarray, p: np.ndarray) -> np.ndarray:
        return (x + np.sin(y) > p).astype(int)

    many = grid_table((40, 40), gait, panels=list(np.linspace(2.0, 4.0, 8)))
    figure = draw("basin_measures", many, panels="p")
    rendered(figure)
    uncertain = figure.axes[2]
    assert uncertain.get_legend() is None
    (bar,) = uncertain.child_axes
    assert [text.get_text() for text in bar.get_xticklabels()] == ["$p$ = 2", "$p$ = 4"]
    assert "exponents" in uncertain.texts[0].get_text()


def test_measures_of_attractors() -> None:
    """Attractors are grouped from the settled states and matched between panels."""
    rendered(draw("basin_measures", table(), hue="attractor", panels="p"))
    figure = draw("basin_measures", table(), axes=["psi_1", "psi_2", "p"], hue="attractor")
    assert legend_texts(figure.axes[0]) == ["A1", "A2", "A3"]


def test_the_shock_is_drawn_as_it_is_measured() -> None:
    figure = draw("shock", table(), x="psi_1", y="psi_2", panels="p")
    rendered(figure)
    drawn = figure.axes[0].collections[-1].get_array()
    assert drawn is not None
    assert float(drawn.min()) == pytest.approx(TURN / 24)
    assert "smallest" in figure.axes[-1].get_ylabel()


@pytest.mark.slow("shock")
@pytest.mark.parametrize("kind", ["basin_measures", "shock"])
def test_poor_tables(kind: str) -> None:
    axes = {"x": "psi_1", "y": "psi_2"} if kind == "shock" else {"axes": ["psi_1", "psi_2"]}
    complete = table()
    one_panel = complete.loc[complete["p"] == 2.0]
    for poor in (
        complete.iloc[:0],
        one_panel.iloc[:1],
        one_panel.iloc[:37],
        one_panel.sample(60, random_state=0),
        one_panel.loc[one_panel["gait"] == "1"],
        one_panel.assign(status="fell"),
    ):
        rendered(draw(kind, poor, **axes))
    with pytest.raises(PlotError, match="did you mean gait"):
        draw(kind, one_panel, **axes, hue="gate")


@pytest.mark.parametrize(
    ("rows", "entropies", "uncertain"),
    [
        ("random", "no complete grid", "no complete grid"),
        ("narrow", "narrower than", "too narrow"),
        ("one gait", None, "no boundary"),
    ],
)
def test_an_empty_panel_says_why(rows: str, entropies: str | None, uncertain: str) -> None:
    one = table().query("p == 2.0")
    poor = {
        "random": one.sample(60, random_state=0),
        "narrow": one.loc[one["psi_1"] < 0.8],
        "one gait": one.assign(gait="1"),
    }[rows]
    figure = draw("basin_measures", poor, axes=["psi_1", "psi_2"], width="column")
    assert text_problems(figure) == []
    for axes, reason in zip(figure.axes[1:], (entropies, uncertain), strict=True):
        assert reason is None or reason in " ".join(axes.texts[0].get_text().split())


@pytest.mark.slow
def test_figures_of_a_job(tmp_path: Path) -> None:
    angle = {"linspace": [0, TURN, 12], "at": "centre"}
    fields = {
        "name": "landscape",
        "model": "landscape_model:Landscape",
        "vary": {"shift": [0.3, 2.0], "theta_2": angle, "theta_1": angle},
        "run": {"kind": "settle", "max_cycles": 60, "refine": "boundary", "coarse": 4},
        "numerics": {"dt": 0.05},
        "engine": {"name": "xla"},
    }
    figures = [
        {"kind": "basin_measures", "axes": ["theta_1", "theta_2"], "panels": "shift"},
        {"kind": "shock", "x": "theta_1", "y": "theta_2", "panels": "shift"},
    ]
    result = gs.run(gs.Job(**fields, figures=figures), tmp_path / "out")
    assert [figure.name for figure in result.figures] == ["basin_measures.png", "shock.png"]
    assert np.all(load(result.path)["status"].isin(["settled", "inferred"]))
    for wrong, message in (
        ({"kind": "basin_measures", "axes": ["theta_3"]}, "did you mean theta_1|did you mean theta_2"),
        ({"kind": "shock", "x": "theta_1", "y": "theta"}, "did you mean theta"),
        ({"kind": "basin_measures", "hue": "gate"}, "did you mean gait"),
    ):
        with pytest.raises(JobError, match=message):
            gs.Job(**fields, figures=[wrong])
    attractor = {"kind": "basin_measures", "hue": "attractor"}
    with pytest.raises(JobError, match="infers rows"):
        gs.Job(**fields, figures=[attractor])
    every_row = {**fields, "run": {"kind": "settle", "max_cycles": 60}}
    gs.Job(**every_row, figures=[attractor])


def test_missing_values_of_a_hue_or_of_panels_are_drawn() -> None:
    one = table().query("p == 2.0")
    axes = {"x": "psi_1", "y": "psi_2"}
    first = one["row"] == one["row"].min()
    some_fell = one.assign(status=np.where(first, "fell", "settled"), right=one["psi_1"] > 3.0)
    figure = draw("basin", some_fell, **axes, hue="right")
    rendered(figure)
    assert [text.split()[0] for text in legend_texts(figure)] == ["failed"]  # the others are on a scale
    rendered(draw("recovery", one.assign(recovery=pd.Series("recovered", one.index).where(first)), **axes))
    without = one.assign(gait=pd.Series("walk", one.index).where(first))
    assert [text.split()[0] for text in legend_texts(draw("basin", without, **axes))] == ["walk", "none"]
    rendered(draw("gait_map", without, **axes))
    rendered(draw("basin_measures", table().assign(p=lambda t: t["p"].where(t["p"] > 2.0)), panels="p"))
