"""Branches of the models' gaits: where gaits are lost, against the theory and against holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.continuation import continuation
from gaitsweep.analysis.continuation.stable_ranges import range_of_gait, stable_ranges
from gaitsweep.analysis.records import AnalysisError
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.job import load_job
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from gaitsweep.plot.bifurcations.continuation import stable_ranges as draw
from gaitsweep.plot.columns import PlotError

SWEEPS = Path(__file__).parents[2] / "sweeps"


@pytest.fixture(scope="module")
def direct(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """The direct gait over m_B for several frequencies and inner masses at once, to behind its fold."""
    changes = [
        "vary={zip: {omega: [0.2, 0.4], m: [1.0, 1.02]}}",
        "run.path=[0.97, 1.04]",
        "run.step=0.08",
        "run.most=20",
        "verify=0",
    ]
    job = load_job(SWEEPS / "multilegged_continuation_grid.yaml", changes)
    return gs.load(gs.run(job, out=tmp_path_factory.mktemp("direct")).path)


@pytest.mark.slow
def test_direct_gait_is_lost_where_the_end_masses_reach_the_inner_one(direct: pd.DataFrame) -> None:
    """The paper's condition m_B < m, of its theory for omega -> 0, is a fold of the full model's branch.

    It lies behind m by a share that falls with omega and is below 0.0015 at Table 1's: the direct gait's own
    m_B at the start of the branch is 3 % off.
    """
    assert set(direct["end"]) == {"", "most"}
    result = range_of_gait(direct, "m_B", "direct")
    assert result["row"].tolist() == [0, 1]
    assert set(result["low_by"]) == {"start"}
    assert set(result["high_by"]) == {"fold"}
    beyond = result["high"].to_numpy() / [1.0, 1.02] - 1.0
    assert np.all(beyond > 0.0)
    assert np.all(beyond < 1.5e-3)
    assert beyond[0] < beyond[1]
    # one multiplier is 1 at a fold, and the gait is unstable behind it
    folds = direct[direct["special"] == "fold"]
    np.testing.assert_allclose(folds["multiplier_re"], 1.0, atol=1e-5)
    for row, at in zip(folds["row"], folds["point"], strict=True):
        branch = direct[direct["row"] == row]
        assert branch.loc[branch["point"] < at, "stable"].all()
        assert not branch.loc[branch["point"] > at, "stable"].any()


@pytest.mark.slow
def test_gaits_of_a_branch_are_read(direct: pd.DataFrame) -> None:
    assert set(direct.loc[direct["point"] == 0, "gait"]) == {"direct"}
    with pytest.raises(AnalysisError, match="Stable here: direct"):
        range_of_gait(direct, "m_B", "retrograde")


@pytest.mark.slow
def test_figure_of_stable_ranges(direct: pd.DataFrame) -> None:
    """A filled area ends at marked folds, and without a mark at the end of the parameter's range."""
    figure = draw(direct, x="m_B", y="omega")
    lines = figure.axes[0].get_lines()
    marks = np.concatenate([np.asarray(line.get_xdata()) for line in lines if line.get_marker() == "o"])
    folds = direct.loc[direct["special"] == "fold", "m_B"]
    np.testing.assert_allclose(np.sort(marks), np.sort(folds))
    drawn = np.concatenate([np.asarray(line.get_xdata(), float) for line in lines])
    assert np.nanmin(drawn) > 0.99


def test_figure_where_two_gaits_are_stable() -> None:
    """Walk is stable up to 2 and trot from 1 on, at two values of the other parameter; then no gait is."""
    branch = pd.DataFrame({"point": range(3), "stable": True, "special": "", "end": ["", "", "lost"]})
    parts = [
        branch.assign(row=2 * k + trot, up=0.1 * k, gait=("walk", "trot")[trot], r=trot + np.arange(3.0))
        for k in range(2)
        for trot in range(2)
    ]
    table = pd.concat(parts, ignore_index=True)
    figure = draw(table, x="r", y="up")
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert named == ["walk stable", "trot stable", "walk and trot stable"]
    both = np.asarray(figure.axes[0].collections[-1].get_paths()[0].vertices)
    assert [float(both[:, 0].min()), float(both[:, 0].max())] == [1.0, 2.0]
    more = table.query("gait == 'walk'").assign(row=lambda t: t["row"] + 4)
    beside = draw(pd.concat([table, more.assign(r=more["r"] + 1.5)]), x="r", y="up")
    walk = np.asarray(beside.axes[0].collections[0].get_paths()[0].vertices)
    assert [float(walk[:, 0].min()), float(walk[:, 0].max())] == [0.0, 3.5]
    with pytest.raises(PlotError, match=r"walk at up = 0: stable in separate ranges of r"):
        draw(pd.concat([table, more.assign(r=more["r"] + 5.0)]), x="r", y="up")
    with pytest.raises(PlotError, match="not numeric"):
        draw(table, x="r", y="gait")
    none = draw(table.assign(stable=False), x="r", y="up")
    assert "no stable gait" in none.axes[0].texts[0].get_text()


def test_pieces_of_branches() -> None:
    """Stable to a fold, unstable to a corner, stable again over a kink to the end of the range."""
    table = pd.DataFrame(
        {
            "row": 0,
            "point": range(9),
            "r": [0.0, 1.0, 2.0, 1.5, 0.5, 0.8, 1.2, 2.5, 3.0],
            "stable": [True, True, False, False, True, True, True, True, True],
            "special": ["", "", "fold", "", "corner", "", "", "kink", ""],
            "end": [""] * 8 + ["range"],
            "gait": ["trot"] * 3 + ["none"] * 2 + ["walk"] * 4,
        }
    )
    result = stable_ranges(table, "r")
    assert result["gait"].tolist() == ["trot", "walk"]
    assert result[["low", "high"]].to_numpy().tolist() == [[0.0, 2.0], [0.5, 3.0]]
    assert result[["low_by", "high_by"]].to_numpy().tolist() == [["start", "fold"], ["corner", "range"]]
    assert not len(stable_ranges(table.assign(stable=False), "r"))
    with pytest.raises(AnalysisError, match="speciel"):
        stable_ranges(table.rename(columns={"special": "speciel"}), "r")


def test_a_branch_followed_in_both_directions_has_one_range() -> None:
    """From the start at 0 it is stable up to the end at 4, and down to a fold at -2; a kink is passed."""
    columns = ["direction", "point", "r", "stable", "special", "end"]
    ahead = [(1, k, float(k), True, "", "range" if k == 4 else "") for k in range(5)]
    back = [(-1, 0, 0.0, True, "", ""), (-1, 1, -1.0, True, "kink", ""), (-1, 2, -2.0, True, "fold", "")]
    back += [(-1, 3, -1.5, False, "", ""), (-1, 4, -1.0, False, "", "lost")]
    table = pd.DataFrame([*ahead, *back], columns=columns).assign(row=0)
    (piece,) = stable_ranges(table, "r").to_dict("records")
    assert piece == {"row": 0, "low": -2.0, "high": 4.0, "low_by": "fold", "high_by": "range"}
    unstable_ahead = table.assign(stable=table["stable"] & (table["r"] <= 0.0))
    for kink, bound in ((1, "kink"), (2, "")):  # the step from 0 to 1 or the next
        special = table["special"].mask(table["r"] == kink, "kink")
        (piece,) = stable_ranges(unstable_ahead.assign(special=special), "r").to_dict("records")
        assert (piece["high"], piece["high_by"]) == (0.0, bound)
    at_end = table.loc[(table["direction"] < 0) | (table["point"] < 2)].assign(row=0)
    at_end.loc[at_end["direction"] > 0, "r"] = 0.0  # it starts at an end of the range
    (piece,) = stable_ranges(at_end, "r").to_dict("records")
    assert (piece["high"], piece["high_by"]) == (0.0, "start")
    mirrored = table.assign(direction=-table["direction"], r=-table["r"])
    (piece,) = stable_ranges(mirrored, "r").to_dict("records")
    assert piece == {"row": 0, "low": -4.0, "high": 2.0, "low_by": "range", "high_by": "fold"}


@pytest.fixture(scope="module")
def quadruped() -> BatchedReturnMap:
    return BatchedReturnMap(WaistQuadruped(), numerics=Numerics(dt=3e-4))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parameter", "fixed", "begin", "towards", "delta_13", "lost"),
    [
        ("f", {}, 2.80, 1, 2.77, (2.84, 2.86)),
        ("beta", {"f": 2.6}, 0.7486, -1, 2.39, (0.7475, 0.7480)),
    ],
    ids=["trot, f rising", "walk, beta falling"],
)
def test_stability_limits_agree_with_those_of_staircases(
    quadruped: BatchedReturnMap,
    parameter: str,
    fixed: dict[str, float],
    begin: float,
    towards: int,
    delta_13: float,
    lost: tuple[float, float],
) -> None:
    """The last stable point of a branch lies in the interval in which holds of 120 s lose its gait.

    Holds are simulated forward, with no derivative: sweeps/waist_quadruped_2_edges.yaml and
    _2_beta_edges.yaml.
    """
    points, _ = quadruped.settled({"delta_13": delta_13}, {**fixed, parameter: begin}, 25)
    within = {"f": (2.0, 3.2), "beta": (0.745, 0.756)}[parameter]
    table = continuation(
        quadruped,
        points,
        fixed,
        parameter=parameter,
        within=within,
        begin=begin,
        towards=towards,
        steps=ArclengthSteps(0.02, 0.05, 4e-3, most=10),
    )
    unstable = table["point"].to_numpy()[~table["stable"].to_numpy(bool)]
    # it has gone around: towards the edge, and back on the unstable side
    assert unstable.size
    at = table[parameter].to_numpy(float)[: unstable[0] + 1]
    last = towards * np.max(towards * at)
    assert lost[0] < last < lost[1]
