"""Jobs of the toy model in `tests/support/models/toy_model.py`."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.job import Job

TOY = "toy_model:Toy"
BASE: dict[str, Any] = {"name": "toy", "model": TOY, "run": {"kind": "settle"}}


def toy(**fields: Any) -> Job:
    """Make the job BASE with other fields."""
    return Job(**{**copy.deepcopy(BASE), **fields})


def columns_of(job: Job) -> dict[str, np.ndarray]:
    """Return the varied columns of all rows of a job."""
    design = job.design
    return design.at(np.arange(design.n_rows), design.names)


def written(folder: Path, text: str, name: str = "job.yaml") -> Path:
    """Write a file in a folder, and return its path."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


EVERY_AXIS: dict[str, Any] = {
    "restitution": {"linspace": [0, 0.5, 4], "at": "centre"},
    "zip": {"mass": [1, 2, 3], "stiffness": {"logspace": [1, 100, 3]}},
    "launch_1": {"values": [1, "launch_2*2", "sqrt(stiffness) + restitution**1.5"]},
    "sample": {
        "n": 5,
        "seed": 3,
        "method": "sobol",
        "of": {"launch_2": [0.5, "1+mass"], "preload": [0.1, 1]},
    },
    "ceiling": {"random": [10, 20, 2], "seed": 1},
}
EVERY = toy(structure={"N": 2}, vary=EVERY_AXIS)
