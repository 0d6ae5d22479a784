"""Result directories of traces made without simulating, for the tests of movies and poses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep import models
from gaitsweep.job import Job
from gaitsweep.papers.aoi2011.waist_quadruped.kinematics import HIP, KNEE
from gaitsweep.skeleton import Skeleton
from gaitsweep.table import ResultDirectory
from gaitsweep.table.manifest import Layout
from tests.support.sweeping import complete

CYCLE = 0.4  # s, the quadruped's
SPEED = 0.25  # m/s


def written(path: Path, job: Job, rows: list[pd.DataFrame]) -> Path:
    """A result directory as a run of this job leaves it, with these records."""
    with ResultDirectory.open(path, job.resolved(), Layout(job.hash(), len(rows), len(rows))) as directory:
        directory.write_part(0, pd.concat(rows, ignore_index=True))
    return path


def quadruped_signals(t: np.ndarray, yaw: float = 0.0) -> dict[str, np.ndarray]:
    """A trot at SPEED: limbs swing in diagonal pairs, feet a few millimetres above or below the ground."""
    phase = 2.0 * np.pi * t / CYCLE
    qpos = np.zeros((16, len(t)))
    qpos[0], qpos[1], qpos[2] = SPEED * t * np.cos(yaw), SPEED * t * np.sin(yaw), 0.131
    qpos[3], qpos[6] = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    qpos[11] = 0.05 * np.sin(phase)
    signals = {"waist": qpos[11], "roll": 0.0 * t, "pitch": 0.0 * t}
    for i in range(4):
        own = phase + np.pi * (i in (1, 2))
        bend = 1.0 if i < 2 else -1.0
        qpos[HIP[i]] = -0.59 * bend + 0.2 * np.cos(own)
        qpos[KNEE[i]] = bend * (1.18 + 0.3 * np.maximum(np.sin(own), 0.0))
        signals[f"phase_{i + 1}"] = np.mod(own, 2.0 * np.pi)
        signals[f"contact_{i + 1}"] = (np.sin(own) <= 0.0).astype(float)
    return signals | {f"q_{i}": row for i, row in enumerate(qpos)}


def quadruped_job(**fields: Any) -> Job:
    vary = {"link_length": {"values": [0.08, 0.09]}}
    run = {"kind": "trace", "duration": 0.8, "every": 0.01}
    numerics = {"method": "semi_implicit", "dt": 2.0e-4}
    return Job(
        **{"name": "trot", "model": "waist_quadruped", "vary": vary, "run": run, "numerics": numerics}
        | fields
    )


def quadruped_table(path: Path) -> Path:
    """Two rows: one of 0.8 s, and one that fell before anything was recorded."""
    t = 0.01 * np.arange(81)
    walking = pd.DataFrame(
        {"row": 0, "link_length": 0.08, "t": t, **quadruped_signals(t), "status": "complete"}
    )
    fallen = walking.iloc[:1].assign(row=1, link_length=0.09, status="fell")
    fallen.loc[:, "t":"q_15"] = np.nan
    return written(path, quadruped_job(), [walking, fallen])


def quadruped_skeleton(yaw: float = 0.0, **lengths: float) -> Skeleton:
    """The trot at 81 moments, with other lengths than Table I's where they are given."""
    t = 0.01 * np.arange(81)
    model = models.find("waist_quadruped")()
    values = {name: float(value[0]) for name, value in complete(model, lengths, 1).items()}
    skeleton = model.skeleton(values, quadruped_signals(t, yaw))
    assert skeleton is not None
    return skeleton
