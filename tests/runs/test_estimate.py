"""Estimates of rows, records and disk by a dry run, against the files of a small run of each kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import pyarrow.parquet as pq
import pytest

import gaitsweep as gs
from gaitsweep.cli import show
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.engine.sweep.lane_scheduler import LaneScheduler
from gaitsweep.job import Job
from gaitsweep.kinds.continuation import DERIVATIVE
from gaitsweep.runs.estimate import estimate
from gaitsweep.runs.execute import run_job
from gaitsweep.table import load

GRID = {"launch_1": {"linspace": [1, 2, 5]}, "preload": {"linspace": [0.5, 0.9, 4]}}
FINE = {"launch_1": {"linspace": [1, 2, 33]}, "preload": {"linspace": [0.5, 0.9, 33]}}
MOVED = {"parameter": "stiffness", "path": [4, 9, 4]}
TRACE = {"kind": "trace", "duration": 3, "every": 0.02}
BOX = {"sample": {"n": 1000, "of": {"launch_1": [1, 2], "preload": [0.5, 0.9]}}}
BRANCH = {"kind": "continuation", "parameter": "stiffness", "path": [4, 9], "settle": 20}
KINDS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "settle": ({"kind": "settle"}, FINE),
    "settle a sample": ({"kind": "settle"}, BOX),
    "refine": ({"kind": "settle", "refine": "boundary", "over": ["launch_1", "preload"]}, FINE),
    "fixed time": ({"kind": "fixed_time", "duration": 3}, GRID),
    "trace": (TRACE, GRID),
    "trace that moves": ({**TRACE, **MOVED, "rate": 4}, GRID),
    "ramp": ({"kind": "ramp", **MOVED, "rate": 0.5}, GRID),
    "return map": ({"kind": "return_map", "crossings": 50, "after_cycles": 3}, GRID),
    "staircase": ({"kind": "staircase", **MOVED, "step": 0.5, "dwell": 2}, GRID),
    "continuation": (BRANCH, {"preload": [0.5, 0.9]}),
}  # fmt: skip


@pytest.mark.slow("continuation", "ramp", "return map", "staircase", "trace that moves", "trace")
@pytest.mark.parametrize("name", KINDS)
def test_records_and_disk_within_a_factor_of_three(name: str, tmp_path: Path) -> None:
    run, vary = KINDS[name]
    job = Job(name="x", model="toy_model:Toy", run=run, vary=vary, verify=0)
    needs = estimate(job)
    folder = run_job(job, tmp_path / "out") / "table"
    parts = sorted(folder.glob("part-*.parquet"))
    records = sum(pq.read_metadata(part).num_rows for part in parts)
    written = sum(part.stat().st_size for part in parts)
    assert needs.rows == job.design.n_rows
    assert needs.blocks == len(parts)
    assert 1 / 3 < needs.records / records < 3
    assert 1 / 3 < needs.disk_bytes / written < 3
    assert 0.0 < needs.seconds <= 1.01 * needs.seconds_most
    assert (needs.self_check_rows, needs.self_check_s) == (0, 0.0)
    assert needs.simulated < needs.rows if name == "refine" else needs.simulated == needs.rows


def test_an_estimate_that_fails_ends_its_lanes(monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[LaneScheduler] = []
    monkeypatch.setattr(LaneScheduler, "shut_down", lambda pool: ended.append(pool))
    monkeypatch.setattr(LaneScheduler, "advance_all", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        estimate(Job(name="x", model="toy_model:Toy", run={"kind": "settle"}, vary=GRID))
    assert len(ended) == 1


def test_the_self_check_counts() -> None:
    job = Job(name="x", model="toy_model:Toy", run={"kind": "settle"}, vary={"preload": [0.5, 0.7, 0.9]})
    needs = estimate(job)
    assert needs.self_check_rows == 3
    assert needs.compile_s < needs.self_check_s < needs.seconds - needs.compile_s
    words = "self-check of 3 rows (rows that end as cycle_limit add up to 3 reruns)"
    assert words in show.estimate(needs)
    assert (
        needs.seconds_most > needs.seconds + needs.compile_s
    )  # the reruns of these have programs of their own


def test_the_rows_that_a_self_check_may_add_are_named() -> None:
    vary = {"preload": {"linspace": [0.5, 0.9, 6]}}
    job = Job(name="x", model="toy_model:Toy", run={"kind": "settle"}, vary=vary, verify=3)
    needs = estimate(job)
    assert needs.added_rows == 3
    assert "reruns; up to 3 others are added if none of its rows ends soundly)" in show.estimate(needs)
    crossings = job.model_copy(update={"run": {"kind": "return_map", "crossings": 50}})
    assert estimate(crossings).added_rows == 0


CUSP = {"kind": "continuation", "parameter": "r", "path": [-1.0, 1.0], "settle": 20}


@pytest.mark.parametrize(
    ("model", "fields", "folds"),
    [
        ("toy_model:Toy", {"run": BRANCH, "vary": {"preload": [0.5, 0.9]}}, False),
        ("cusp_flow:CuspFlow", {"run": CUSP, "params": {"a": 1.0}, "start": {"x_0": -1.0}}, True),
    ],
)
@pytest.mark.slow
def test_evaluations_of_branches_within_a_factor_of_two(
    model: str, fields: dict[str, Any], folds: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A branch without folds takes the likely number of cycles, one with two folds up to the larger one.

    A branch whose folds are smooth is not followed again, for which the larger number has a factor of 3.
    """
    flown = 0.0

    def counted(name: str) -> Any:
        whole = getattr(BatchedReturnMap, name)

        def evaluate(self: BatchedReturnMap, points: Any, *values: Any) -> Any:
            nonlocal flown
            slopes = DERIVATIVE * (len(self.coordinates) + 1) if name == "linearised" else 0.0
            flown += len(points) * (1.0 + slopes) / self.integration.factor
            return whole(self, points, *values)

        return evaluate

    for name in ("images", "linearised"):
        monkeypatch.setattr(BatchedReturnMap, name, counted(name))
    job = Job(name="x", model=model, verify=0, numerics={"method": "rk4", "dt": 2e-2}, **fields)
    table = load(run_job(job, tmp_path))
    assert ("fold" in set(table["special"])) is folds
    cost, rows = job.run.cost(job.design, 1.0, 1.0), job.design.n_rows
    evaluated, settling = flown / rows, job.run.settle  # type: ignore[union-attr]
    assert cost.longer is not None
    assert cost.longer_records is not None
    if folds:
        assert cost.likely < settling + evaluated < cost.longer
        assert (cost.longer - settling) / 6.0 < evaluated
        assert 0.5 < cost.longer_records * rows / len(table) < 2.0
    else:
        assert 0.5 < cost.likely / (settling + evaluated) < 2.0
        assert 0.5 < cost.records * rows / len(table) < 2.0


class Timeless(gs.DeclaredModel):
    """A model whose period is unknown."""

    p = gs.parameter("1", "anything", 1.0)
    x = gs.variable("1", "anything else", 0.0, scale=1.0)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": p.p}

    def period(self, p: Any) -> Any:
        return jnp.nan * p.p


def test_rows_without_a_period_are_estimated() -> None:
    run = {"kind": "ramp", "parameter": "p", "path": [1, 2], "rate": 0.5}
    needs = estimate(Job(name="x", model=f"{__name__}:Timeless", run=run, vary={"x_0": [0, 1]}, verify=0))
    assert needs.records >= 2
    assert needs.seconds > 0.0
