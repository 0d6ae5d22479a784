"""The quadruped with a swing along half an ellipse: the paper's trot and walk, and a pace that stands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

import gaitsweep as gs

CONFIG = Path(__file__).parents[2] / "configs" / "aoi2011_phases.yaml"


@pytest.mark.slow
def test_phases_of_trot_walk_and_pace_are_the_papers(tmp_path: Path) -> None:
    """Fig. 5 but for the pace's phase, with located events, and beyond each edge."""
    places = {"f": [2.0, 2.6, 2.6, 3.2, 2.9, 3.05, 2.45, 2.25, 2.0, 3.2]}
    places["delta_13"] = [3.1, 3.1, 2.55, 2.55, 3.1, 3.1, 2.55, 2.55, 0.3, 0.3]
    rows = {
        "name": "phases",
        "config": str(CONFIG),
        "vary": {"zip": {name: {"values": values} for name, values in places.items()}},
        "run": {"kind": "settle", "max_cycles": 330, "max_time": 127, "tolerance": 1e-5},
        "verify": 0,
    }
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(rows))
    table = gs.run(tmp_path / "job.yaml", tmp_path / "out").table
    phases = np.angle(np.exp(1j * (table["delta_13_end"] - 2.0))) + 2.0
    assert set(table["status"].astype(str)) == {"settled"}
    trot, walk = [0, 1, 4, 7], [2, 3, 5, 6]
    assert np.abs(phases[trot] - 3.1).max() < 0.08
    assert np.abs(phases[walk] - 2.7).max() < 0.08
    # the paper's pace is at .6
    assert np.abs(phases[[8, 9]]).max() < 0.1
    assert np.abs(table["speed_end"][trot] - 0.177).max() < 0.003
