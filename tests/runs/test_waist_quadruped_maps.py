"""The quadruped's return maps, run from their jobs, against where holds of 120 s lose each gait."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.analysis.transitions.return_map import branches, fixed_points

SWEEPS = Path(__file__).parents[2] / "sweeps"


# those of the jobs' figures
BANDWIDTH = 0.015  # rad; at beta = 0.7515 the trot and the unstable gait are 0.04 rad apart
OF_THE_MAP = 0.03  # rad


@pytest.mark.slow
def test_branches_over_beta_end_where_staircases_lose_the_gaits(tmp_path: Path) -> None:
    """Walk ends between 0.7485 and 0.7490, trot between 0.7520 and 0.7525 (waist_quadruped_beta_edges).

    Between the two edges an unstable branch lies between the stable ones, and meets them there.
    """
    job = SWEEPS / "waist_quadruped_beta_branches.yaml"
    small = "vary.beta={values: [0.7480, 0.7490, 0.7500, 0.7515, 0.7530]}"
    table = gs.run(job, tmp_path / "out", overrides=[small, "verify=0"]).table
    result = branches(table, "delta_13", "beta", BANDWIDTH)
    stable = {beta: part["value"].to_numpy() for beta, part in result.loc[result["stable"]].groupby("beta")}
    assert stable[0.7480].min() > 3.0, "the trot alone"
    assert stable[0.7530].max() < 2.7, "the walk alone"
    middle = result.loc[result["beta"] == 0.75].sort_values("value")
    assert middle["stable"].tolist() == [True, False, True]
    # by the fixed points of holds, and the slopes by the map's own derivative (test_return_map_jacobian.py)
    np.testing.assert_allclose(middle["value"].iloc[[0, 2]], [2.739, 3.066], atol=2e-3)
    np.testing.assert_allclose(middle["slope"].iloc[[0, 2]], [0.954, 0.934], atol=0.01)
    for beta, edge in ((0.7490, 2.757), (0.7515, 3.052)):
        assert np.abs(stable[beta] - edge).min() < 0.005, "the gait that is about to be lost is there yet"
        assert len(stable[beta]) >= 2


@pytest.mark.slow
def test_the_map_does_not_depend_on_the_time_since_the_start(tmp_path: Path) -> None:
    """From 17.5 cycles on it does not: the maps from cycle 40, 45 and 50 on are the same.

    Fixed points within 0.0005 rad, slopes of stable ones within .02. At cycle 17, while it is held, delta_13
    is still where it was started, to 0.1 rad.
    """
    job = SWEEPS / "waist_quadruped_return_map.yaml"
    changed = ["run.after_cycles=16", "run.crossings=94", "vary.f={values: [2.6]}", "verify=0"]
    table = gs.run(job, tmp_path / "out", overrides=changed).table
    held = table.loc[table["crossing"] == 17, "delta_13_n"].to_numpy()
    wanted = np.unique(table["delta_13"])
    np.testing.assert_allclose(np.sort(held), wanted, atol=0.1)
    read = []
    for first in (40, 45, 50):
        part = table.loc[(table["crossing"] >= first) & (table["crossing"] < first + 60)]
        points = fixed_points(part, "delta_13", bandwidth=OF_THE_MAP).sort_values("value")
        assert points["stable"].tolist() == [True, False, True]
        read.append(points[points["stable"]])
    for other in (read[0], read[2]):
        np.testing.assert_allclose(other["value"], read[1]["value"], atol=5e-4)
        np.testing.assert_allclose(other["slope"], read[1]["slope"], atol=0.02)
