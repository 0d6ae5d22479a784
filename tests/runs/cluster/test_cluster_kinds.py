"""Every run kind on a cluster gives the table of one process, to the bit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.kinds import RUN_KINDS
from gaitsweep.table import Snapshot

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

MASSES: dict[str, Any] = {
    "model": "toy_model:Toy",
    "params": {"restitution": 0.6},
    "vary": {"launch_1": {"linspace": [0.2, 3.0, 20]}},
    "numerics": {"method": "rk4", "dt": 2e-3},
    "engine": {"block": 6, "lanes": 8},
}
ANGLE = {"linspace": [0, "2*pi", 24], "at": "centre"}
JOBS: dict[str, dict[str, Any]] = {
    "settle": {**MASSES, "run": {"kind": "settle", "max_cycles": 60, "states": True}},
    "settle, exponents": {
        "model": "gaitsweep.examples.henon:Henon",
        "vary": {"a": {"linspace": [1.0, 1.4, 40]}},
        "run": {"kind": "settle", "max_cycles": 300, "exponents": 2},
        "engine": {"block": 10, "lanes": 16},
    },
    "settle, refined": {
        "model": "landscape_model:Landscape",
        "vary": {"theta_2": ANGLE, "theta_1": ANGLE},
        "run": {"kind": "settle", "max_cycles": 60, "refine": "boundary"},
        "numerics": {"method": "rk4", "dt": 2e-3},
        "engine": {"block": 50, "lanes": 16},
    },
    "fixed_time": {**MASSES, "run": {"kind": "fixed_time", "duration": 20.0}},
    "trace": {**MASSES, "run": {"kind": "trace", "duration": 10.0, "every": 0.25}},
    "return_map": {**MASSES, "run": {"kind": "return_map", "crossings": 12}},
    "ramp": {**MASSES, "run": {"kind": "ramp", "parameter": "mass", "path": [1, 2, 1], "rate": 0.1}},
    "perturb": {
        **MASSES,
        "vary": {"push_speed_1": {"linspace": [-0.3, 0.5, 20]}},
        "run": {"kind": "perturb", "push": ["speed_1"], "max_cycles": 60, "tolerance": 1e-3},
    },
    "staircase": {
        **MASSES,
        "run": {"kind": "staircase", "parameter": "mass", "path": [1, 2], "step": 0.25, "dwell": 6.0},
    },
    "continuation": {
        **MASSES,
        "vary": {"launch_1": [0.5, 1.0, 2.0]},
        "run": {"kind": "continuation", "parameter": "stiffness", "path": [2, 8], "settle": 20},
        "engine": {"block": 1},
    },
    "atlas": {
        "model": "gaitsweep.examples.bouncing_ball:BouncingBall",
        "vary": {"restitution": [0.45, 0.5, 0.55]},
        "run": {
            "kind": "atlas",
            "parameter": "G",
            "path": [0.9, 1.6],
            "at": 1.2,
            "ranges": {"phase_0": [0, "2*pi"], "speed_0": [0, 6]},
            "periods": 1,
            "depth": 0,
            "budget": 128,
        },
        "engine": {"block": 1},
    },
}


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


def test_all_run_kinds_are_tested() -> None:
    assert {job["run"]["kind"] for job in JOBS.values()} == set(RUN_KINDS)


@pytest.mark.parametrize("kind", JOBS)
def test_the_table_is_that_of_one_process(client: Any, kind: str, tmp_path: Path) -> None:
    job = gs.Job(name="kinds", verify=0, **JOBS[kind])
    whole, run = gs.run(job, tmp_path / "whole"), gs.run(job, tmp_path / "out", client=client)
    pd.testing.assert_frame_equal(run.table, whole.table, check_exact=True)
    assert run.manifest.get("refinement") == whole.manifest.get("refinement")
    for part in whole.path.rglob("*.parquet"):
        assert (run.path / part.relative_to(whole.path)).read_bytes() == part.read_bytes()
    files = [{file.relative_to(each.path) for file in each.path.rglob("*")} for each in (whole, run)]
    assert files[1] - files[0] == set()


def test_a_refined_run_continues_inside_its_round(client: Any, tmp_path: Path) -> None:
    job = gs.Job(name="kinds", verify=0, **JOBS["settle, refined"])
    whole = gs.run(job, tmp_path / "whole").table
    rounds = tmp_path / "out" / "refinement"

    def stop(*_: Any) -> None:
        if len(list(rounds.glob("round-01/table/part-*"))) >= 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        gs.run(job, tmp_path / "out", on_progress=stop, client=client)
    stamps = {part: part.stat().st_mtime_ns for part in rounds.rglob("part-*")}
    assert stamps
    run = gs.run(job, tmp_path / "out", client=client)
    assert all(part.stat().st_mtime_ns == since for part, since in stamps.items())
    pd.testing.assert_frame_equal(run.table, whole, check_exact=True)
    assert Snapshot.of(run.path).complete
