"""Basins of the multi-legged chain: refined against full, intervals of a coarse grid, attractors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.analysis.basins.attractors import agreement, attractors
from gaitsweep.analysis.basins.fractions import fractions
from gaitsweep.analysis.basins.measures import basins
from gaitsweep.api.run import run
from gaitsweep.job import load_job

pytestmark = pytest.mark.slow
SWEEPS = Path(__file__).parents[2] / "sweeps"
# `gaitsweep run sweeps/multilegged_basins.yaml`: direct, retrograde and source starts of 9 801, by slice
WHOLE = ((4246, 675, 4880), (1861, 2366, 5574), (466, 4913, 4422))


def sliced(cells: int, *more: str) -> list[str]:
    return [f"vary.psi_{i}={{linspace: [0, 2*pi, {cells}], at: centre}}" for i in (1, 2)] + list(more)


@pytest.fixture(scope="module")
def coarse(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    out = tmp_path_factory.mktemp("coarse") / "out"
    return run(SWEEPS / "multilegged_basins.yaml", out, overrides=sliced(33)).table


def test_a_refined_run_has_the_full_runs_picture(coarse: pd.DataFrame, tmp_path: Path) -> None:
    """At least 99.5 % of cells equal; simulated rows to the last bit.

    An edge takes a share of the cells in proportion to their size: 15 % at 99 x 99, thrice that at 33 x 33.
    """
    job = SWEEPS / "multilegged_refined_basins.yaml"
    third = coarse["psi_3"] == coarse["psi_3"].iloc[0]
    coarse = coarse.loc[third].reset_index(drop=True)
    overrides = sliced(33, "run.coarse=4", f"vary.psi_3=[{float(coarse['psi_3'].iloc[0])}]")
    refined = run(job, tmp_path / "out", overrides=overrides).table
    simulated = (refined["status"] == "settled").to_numpy()
    assert np.mean(refined["gait"] == coarse["gait"]) >= 0.995
    assert simulated.mean() < 0.45
    ends = [name for name in coarse if name.endswith("_end")]
    pd.testing.assert_frame_equal(refined.loc[simulated, ends], coarse.loc[simulated, ends], check_exact=True)


def test_intervals_of_a_coarse_grid_contain_the_fine_grids_shares(coarse: pd.DataFrame) -> None:
    """33 x 33 cells against the 99 x 99 of the figure; the intervals are 2.5 % wide at most."""
    result = fractions(coarse, by="psi_3")
    whole = [number / 9801 for panel in WHOLE for number in panel]
    wide = result.sort_values(["psi_3", "outcome"])
    assert wide["outcome"].tolist() == ["direct", "retrograde", "source"] * 3
    assert (wide["low"].to_numpy() <= whole).all()
    assert (wide["high"].to_numpy() >= whole).all()
    assert np.max(wide["high"] - wide["low"]) < 0.026


def test_boundaries_are_not_fractal(coarse: pd.DataFrame) -> None:
    """The interval of the exponent of every slice contains 1, and the boundary entropy is below ln 2."""
    panels = basins(coarse, by="psi_3").panels
    assert np.all(panels["exponent_low"] < 1.0)
    assert np.all(panels["exponent_high"] > 1.0)
    assert np.all(panels["boundary_entropy"] < np.log(2.0))


def test_the_gaits_lines_are_the_attractors(coarse: pd.DataFrame) -> None:
    """Three lines, with the classifier's labels but at their corners, which it gives away by another rule."""
    result = attractors(coarse)
    assert result.summary["kind"].tolist() == ["line"] * 3
    assert agreement(coarse, result.column) > 0.95
    # lines are 4 rad long (3.9 in the analysis); a torus's straight distance would end at pi
    assert result.summary["extent"].between(3.5, 4.5).all()


def test_the_locked_state_is_an_attractor_of_its_own(tmp_path: Path) -> None:
    """A grid on which psi_2 is 0 exactly, where legs 2 and 3 can lock."""
    job = load_job(
        SWEEPS / "multilegged_basins.yaml",
        [
            "vary.psi_1={linspace: [0, 2*pi, 25]}",
            "vary.psi_2=[0, 0.2]",
            "vary.psi_3={linspace: [0, 2*pi, 25]}",
            "figures=[]",
        ],
    )
    table = gs.run(job, tmp_path / "out").table
    locked = ((table["gait"] == "locked") & (table["status"] == "settled")).to_numpy()
    assert locked.sum() > 20
    result = attractors(table)
    own = result.column.loc[locked].unique()
    assert len(own) == 1
    state = result.summary.set_index("attractor").loc[own[0]]
    assert state["kind"] == "point"
    assert state["rows"] == locked.sum()
    np.testing.assert_allclose(state[["psi_1_end", "psi_3_end"]].astype(float), [5.209, 1.074], atol=0.01)
