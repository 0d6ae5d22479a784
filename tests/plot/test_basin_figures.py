"""Figures of basin measures: drawn from whole and poor tables, asked for in jobs, refused with a sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh

import gaitsweep as gs
from gaitsweep.job import JobError
from gaitsweep.plot import PlotError, draw
from gaitsweep.table import load
from tests.support.basin_tables import grid_table
from tests.support.job_tables import table_of
from tests.support.plot_tables import rendered
from tests.support.text_boxes import text_problems

TURN = 2 * np.pi


def table() -> pd.DataFrame:
    def gait(x: np.ndarray, y: np.ndarray, p: np.ndarray) -> np.ndarray:
        return (x + np.sin(y) > 1.0).astype(int) + (x + np.sin(y) > p)

    made = grid_table((20, 24), gait, panels=[2.0, 3.0, 4.5])
    for i, value in ((1, made["gait"].cat.codes), (2, 0 * made["psi_1"])):
        made[f"psi_{i}_end"] = value + 1e-3 * np.random.default_rng(i).normal(size=len(made))
    return made


def labels(axes: Axes) -> list[str]:
    legend = axes.get_legend()
    assert legend is not None
    return [text.get_text() for text in legend.get_texts()]


def test_measures_over_panels() -> None:
    figure = draw("basin_measures", table(), panels="p")
    rendered(figure)
    shares, entropies, uncertain = figure.axes
    assert labels(shares) == ["0", "1", "2"]
    assert len(uncertain.lines) == 3
    assert "exponent" in labels(uncertain)[0]
    np.testing.assert_allclose(np.asarray(entropies.lines[0].get_xdata()), [2.0, 3.0, 4.5])


def test_many_panels_are_told_apart_by_a_bar() -> None:
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
    """Grouped and followed from the settled states: the same shares as the labels'."""
    rendered(draw("basin_measures", table(), hue="attractor", panels="p"))
    figure = draw("basin_measures", table(), axes=["psi_1", "psi_2", "p"], hue="attractor")
    assert labels(figure.axes[0]) == ["A1", "A2", "A3"]


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
    named = {"x": "psi_1", "y": "psi_2"} if kind == "shock" else {"axes": ["psi_1", "psi_2"]}
    whole = table()
    one = whole.loc[whole["p"] == 2.0]
    for poor in (
        whole.iloc[:0],
        one.iloc[:1],
        one.iloc[:37],
        one.sample(60, random_state=0),
        one.loc[one["gait"] == "1"],
        one.assign(status="fell"),
    ):
        rendered(draw(kind, poor, **named))
    with pytest.raises(PlotError, match="did you mean gait"):
        draw(kind, one, **named, hue="gate")


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


@pytest.mark.parametrize("kind", ["basin", "gait_map"])
def test_cells_of_equal_ratios(kind: str) -> None:
    """A logspace axis is logarithmic, its cells are of equal ratios, and a missing one stays white."""
    axis = {"logspace": [1.0, 256.0, 9]}
    job = gs.Job(
        name="springs", model="toy_model:Toy", run={"kind": "settle"},
        vary={"stiffness": axis, "launch_1": {"linspace": [1.0, 4.0, 7]}},
    )  # fmt: skip
    made = table_of(job)
    made = made.loc[made["stiffness"].round(6) != 16.0]
    figure = draw(kind, made, x="stiffness", y="launch_1")
    rendered(figure)
    axes = figure.axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "linear")
    (cells,) = (each for each in axes.collections if isinstance(each, QuadMesh))
    across = np.asarray(cells.get_coordinates())[0, :, 0]
    np.testing.assert_allclose(across, 2.0 ** np.arange(-0.5, 9.0))
    drawn = np.asarray(cells.get_array())
    np.testing.assert_array_equal(drawn[:, :, 3].any(axis=0), np.arange(9) != 4)


def test_a_job_is_told_of_several_rows_in_a_logarithmic_cell() -> None:
    vary = {
        "stiffness": {"logspace": [1.0, 256.0, 9]},
        "launch_1": {"linspace": [1.0, 4.0, 7]},
        "restitution": [0.2, 0.8],
    }
    figure = {"kind": "basin", "x": "stiffness", "y": "launch_1"}
    with pytest.raises(JobError, match="leaves out restitution"):
        gs.Job(
            name="springs", model="toy_model:Toy", run={"kind": "settle"}, vary=vary, figures=[figure]
        )  # fmt: skip


@pytest.mark.slow
def test_jobs_ask_for_them(tmp_path: Path) -> None:
    angle = {"linspace": [0, TURN, 12], "at": "centre"}
    given = {
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
    result = gs.run(gs.Job(**given, figures=figures), tmp_path / "out")
    assert [figure.name for figure in result.figures] == ["basin_measures.png", "shock.png"]
    assert np.all(load(result.path)["status"].isin(["settled", "inferred"]))
    for wrong, said in (
        ({"kind": "basin_measures", "axes": ["theta_3"]}, "did you mean theta_1|did you mean theta_2"),
        ({"kind": "shock", "x": "theta_1", "y": "theta"}, "did you mean theta"),
        ({"kind": "basin_measures", "hue": "gate"}, "did you mean gait"),
    ):
        with pytest.raises(JobError, match=said):
            gs.Job(**given, figures=[wrong])
    attractor = {"kind": "basin_measures", "hue": "attractor"}
    with pytest.raises(JobError, match="infers rows"):
        gs.Job(**given, figures=[attractor])
    every_row = {**given, "run": {"kind": "settle", "max_cycles": 60}}
    gs.Job(**every_row, figures=[attractor])
