"""Staircases as jobs: their table, their resumption, and those that are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.job import Job, JobError
from gaitsweep.runs.estimate import estimate
from gaitsweep.runs.execute import run_job
from gaitsweep.table import Snapshot

STAIRS = {"kind": "staircase", "parameter": "stiffness", "path": [4, 9, 4], "step": 2.5, "dwell": 12.0}


def job(**fields: Any) -> Job:
    plain = {"name": "steps", "model": "toy_model:Toy", "run": STAIRS, "numerics": {"dt": 1e-2}}
    return Job(**{**plain, "vary": {"launch_1": [0.5, 1.0, 2.0]}, **fields})


@pytest.mark.slow
def test_the_table_of_a_staircase(tmp_path: Path) -> None:
    """Formulas follow the moving parameter, labels are those at each stair's value."""
    table = gs.run(job(run={**STAIRS, "dwell": 25.0}), tmp_path / "out").table
    moved = ["stair", "pass", "stiffness", "t", "crossing", "settled", "slowest", "status", "stalled_by"]
    assert list(table.columns) == ["row", "launch_1", *moved, "launch_1_n", "gait", "apex"]
    assert table["stair"].dtype == np.int64
    assert table["settled"].dtype == bool
    assert list(table["row"]) == [0] * 5 + [1] * 5 + [2] * 5
    for _, part in table.groupby("row"):
        assert list(part["stair"]) == [0, 1, 2, 3, 4]
        assert list(part["pass"]) == [0, 0, 0, 1, 1]
        assert list(part["stiffness"]) == [4.0, 6.5, 9.0, 6.5, 4.0]
        assert list(part["t"]) == [25.0, 50.0, 75.0, 100.0, 125.0]
        assert np.all(np.diff(part["crossing"]) > 10)
    assert np.all(table["settled"])
    assert set(table["status"]) == {"complete"}
    assert set(table["gait"]) == {"hop"}
    launch = 0.25 * np.sqrt(table["stiffness"]) / 0.5
    np.testing.assert_allclose(table["launch_1_n"], launch, atol=1e-4)
    apex = np.sqrt(0.25 + table["launch_1_n"] ** 2 / table["stiffness"]) - 0.5
    np.testing.assert_allclose(table["apex"], apex, rtol=1e-12)


@pytest.mark.slow
def test_rows_that_fall_keep_the_stairs_that_they_ended(tmp_path: Path) -> None:
    """One falls at once and has one record without numbers, one when the kick grows, one not at all."""
    run = {**STAIRS, "parameter": "kick", "path": [0.5, 2.0], "step": 0.5}
    vary = {"zip": {"ceiling": [0.1, 0.8, 100.0], "launch_1": [2.0, 1.0, 1.0]}}
    table = gs.run(job(run=run, vary=vary, start={}), tmp_path / "out").table
    rows = [part for _, part in table.groupby("row")]
    assert [list(part["stair"]) for part in rows] == [[0], [0, 1], [0, 1, 2, 3]]
    assert [set(part["status"]) for part in rows] == [{"fell"}, {"fell"}, {"complete"}]
    assert rows[0][["kick", "t", "launch_1_n", "gait", "apex"]].isna().to_numpy().all()
    assert not np.any(rows[0]["settled"])
    assert rows[1][["kick", "t", "launch_1_n", "gait", "apex"]].notna().to_numpy().all()


@pytest.mark.slow
def test_a_stair_without_a_crossing_has_no_gait(tmp_path: Path) -> None:
    """Without a crossing the observables are those of an earlier stair, which have no gait of this one."""
    table = gs.run(job(run={**STAIRS, "dwell": 0.1, "step": 0.5}), tmp_path / "out").table
    crossed = table.groupby("row")["crossing"].diff().fillna(table["crossing"]) > 0
    assert 0 < np.sum(crossed) < len(table)
    assert np.all(table["gait"].notna() == crossed)
    assert not np.any(table["settled"])


@pytest.mark.slow
def test_an_interrupted_staircase_continues_to_the_same_table(tmp_path: Path) -> None:
    asked = job(vary={"launch_1": {"linspace": [0.3, 2.0, 9]}}, engine={"block": 2, "lanes": 3})
    whole = gs.run(asked, tmp_path / "whole").table
    shares = []

    def stop(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        shares.append(fraction)
        if done >= 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_job(asked, tmp_path / "stopped", on_progress=stop)
    # the four rows may lie in four blocks, none of them complete: they are safe, but no part of the table yet
    assert 4 <= Snapshot.of(tmp_path / "stopped").rows_safe < 9
    assert shares == sorted(shares)
    assert any(share * 9 % 1.0 > 0.0 for share in shares), "running rows count in part"
    run_job(asked, tmp_path / "stopped")
    pd.testing.assert_frame_equal(gs.load(tmp_path / "stopped"), whole, check_exact=True)


@pytest.mark.slow
def test_the_estimate_of_a_staircase() -> None:
    needs = estimate(job(run={**STAIRS, "step": 0.05}))
    assert needs.rows == 3
    assert needs.records == 3 * 201
    # a table is compressed: each record has at least two numbers of its own
    assert needs.disk_bytes >= 3 * 201 * 8 * 2
    assert 0 < needs.seconds <= needs.seconds_most


def test_a_staircase_is_a_job_like_others() -> None:
    asked = job()
    assert "stiffness" not in asked.resolved()["params"]
    assert Job(**asked.resolved()).hash() == asked.hash()
    assert job(run={**STAIRS, "first_dwell": 30.0}).hash() != asked.hash()


BAD = [
    ({"parameter": "stifness"}, {}, ["run.parameter is stifness", "did you mean stiffness?"]),
    ({"parameter": "launch_1"}, {}, ["run.parameter is launch_1", "start value of toy"]),
    ({}, {"params": {"stiffness": 4}}, ["params.stiffness is fixed, but run.parameter moves it"]),
    ({}, {"vary": {"stiffness": [4, 5]}}, ["vary.stiffness varies, but run.parameter moves it"]),
    ({"step": 0}, {}, ["run.step is 0, but must be above 0"]),
    ({"step": -0.1}, {}, ["run.step is -0.1, but must be above 0"]),
    ({"dwell": 0}, {}, ["run.dwell is 0, but must be above 0"]),
    ({"first_dwell": -1}, {}, ["run.first_dwell is -1, but must be above 0"]),
    ({"tolerance": 0}, {}, ["run.tolerance is 0, but must be above 0"]),
    ({"path": [4]}, {}, ["run.path has 1 items, but must have at least 2"]),
    ({"path": [4, 9, 9, 4]}, {}, ["run.path[2] is 9, like the value before it"]),
    ({"path": [4, -1]}, {}, ["run.path[1] is -1, but must be above 0 (spring, in N/m)"]),
    ({"path": [4, "stiffness"]}, {}, ["run.path[1]", "stiffness moves in this run"]),
    ({}, {"params": {"kick": "8-stiffness"}}, ["params.kick is", "where the staircase has stiffness = 9"]),
    # at both ends 5.25
    (
        {},
        {"params": {"kick": "(stiffness-6.5)**2-1"}},
        ["params.kick is", "stiffness = 5.5625"],
    ),
    # below 0 between 6 and 6.2 alone
    ({}, {"params": {"kick": "(stiffness-6.1)**2-0.01"}}, ["params.kick is", "stiffness = 6.03125"]),
    ({"step": 1e-4}, {}, ["run.step is 0.0001, which gives 100001 stairs; at most 10000 are allowed"]),
    ({"step": 1e-320}, {}, ["run.step is", "at most 10000 are allowed"]),
    ({"dwells": 3}, {}, ["run.dwells is not a field of run (staircase); did you mean dwell?"]),
    (
        {},
        {"figures": [{"kind": "basin", "x": "launch_1", "y": "t"}]},
        ["needs a run of kind settle", "not staircase", "Figures of staircase for ", "hysteresis"],
    ),
]


@pytest.mark.parametrize(("run", "fields", "words"), BAD)
def test_a_staircase_that_cannot_be_run(
    run: dict[str, Any], fields: dict[str, Any], words: list[str]
) -> None:
    with pytest.raises(JobError) as error:
        job(run={**STAIRS, **run}, **fields)
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize("rows", [1000, 100_000, 250_000])
def test_a_formula_of_many_rows_is_checked_between_the_turns(rows: int) -> None:
    fields = {"params": {"kick": "(stiffness-6.5)**2-1+0*mass"}, "vary": {"mass": {"linspace": [1, 2, rows]}}}
    with pytest.raises(JobError, match="where the staircase has stiffness"):
        job(**fields)


@pytest.mark.parametrize("missing", ["parameter", "path", "step", "dwell"])
def test_required_fields_of_a_staircase(missing: str) -> None:
    with pytest.raises(JobError, match=rf"run\.{missing} is missing: "):
        job(run={name: value for name, value in STAIRS.items() if name != missing})


@pytest.mark.slow
def test_a_period_may_be_a_plain_number() -> None:
    class Turning(gs.DeclaredModel):
        omega = gs.parameter("rad/s", "frequency", 3.0)
        phase = gs.variable("rad", "phase", 0.0, circular=True)

        def flow(self, p: Any, s: Any) -> Any:
            return {"phase": p.omega}

        @gs.event("turn", section=True)
        def turn(self, p: Any, s: Any) -> Any:
            return s.phase - 2.0 * np.pi

        @turn.jump
        def back(self, p: Any, s: Any) -> Any:
            return s.replace(phase=s.phase - 2.0 * np.pi)

        def period(self, p: Any) -> Any:
            return 2.0

    run = gs.Staircase(parameter="omega", path=[3.0, 4.0], step=1.0, dwell=30.0)
    assert gs.sweep(Turning, run=run).table["crossing"].tolist() == [14, 33]
