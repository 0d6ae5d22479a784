"""Runs that check themselves: rows repeated at half the step, what differs, and what lies on a boundary."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.cli import main
from gaitsweep.job import Job
from gaitsweep.runs import execute
from gaitsweep.runs.execute import run_job
from gaitsweep.runs.self_check import sample_rows
from gaitsweep.runs.self_check_report import sentence

HOLD = {"kind": "fixed_time", "duration": 40.0}
SETTLE = {"kind": "settle", "max_cycles": 2000, "tolerance": 1e-4}


def job(**fields: Any) -> Job:
    given: dict[str, Any] = {"name": "wells", "model": "double_well:DoubleWell", "run": HOLD, **fields}
    return Job(**given)


def checked(tmp_path: Path, *, warns: bool = False, **fields: Any) -> dict[str, Any]:
    told = pytest.warns(UserWarning, match="Self-check") if warns else contextlib.nullcontext()
    with told:
        result = gs.run(job(**fields), tmp_path / "out")
    found = result.manifest["self_check"]
    assert result.table.attrs["manifest"]["self_check"] == found
    return found


def test_a_step_that_does_not_matter_passes(tmp_path: Path) -> None:
    found = checked(tmp_path, vary={"x_0": {"linspace": [-0.9, 0.9, 20]}})
    assert found["verdict"] == "passed"
    assert found["rows"] == 20
    assert 0.0 < found["largest"]["x"] < 1e-9  # both end in the same wells, by steps of their own
    assert sentence(found).startswith("Self-check: 20 rows repeated with half the step: same status and gait")


def test_another_gait_at_half_the_step_is_told(tmp_path: Path) -> None:
    """The boundary lies at -lean dt: -5e-5 m, and -2.5e-5 m at half the step; starts between them differ."""
    starts = [-1e-4, -4e-5, -3e-5, -1e-5, 1e-4]
    found = checked(tmp_path, vary={"x_0": starts}, params={"lean": 1e-3}, warns=True)
    assert (found["verdict"], found["gait_differs"], found["sensitive"]) == ("warned", 2, 0)
    assert "2 came to another gait" in sentence(found)


def test_a_row_on_a_boundary_says_nothing_of_the_step(tmp_path: Path) -> None:
    """The same at 1e-8: a start moved by 1e-9 m comes to another well, too."""
    found = checked(
        tmp_path, vary={"x_0": [-4e-10, 0.3]}, params={"lean": 1e-8}, run={**HOLD, "duration": 60}
    )
    assert (found["verdict"], found["gait_differs"], found["sensitive"]) == ("passed", 0, 1)
    assert "1 on a boundary" in sentence(found)


def test_a_settled_row_that_moves_is_told(tmp_path: Path) -> None:
    """The well's bottom moves by lean dt / 4, 0.0125 m: more than ten tolerances."""
    fields: dict[str, Any] = {"vary": {"x_0": [0.5, 0.8]}, "params": {"lean": 1.0}}
    found = checked(tmp_path / "fine", run=SETTLE, warns=True, **fields)
    assert (found["verdict"], found["moved"], found["gait_differs"]) == ("warned", 2, 0)
    assert found["largest"]["x"] == pytest.approx(0.0125, rel=0.1)
    # from the well's bottom, which then moves by 2.5e-4 m: as much as settles
    still = checked(tmp_path / "still", run=SETTLE, vary={"x_0": [1.0]}, params={"lean": 0.02})
    assert still["verdict"] == "passed"


def test_strict_runs_fail_where_others_warn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = job(vary={"x_0": [-4e-5]}, params={"lean": 1e-3})
    with pytest.raises(gs.SelfCheckError, match="1 came to another gait"):
        gs.run(wrong, tmp_path / "out", strict=True)
    assert len(gs.load(tmp_path / "out")) == 1, "the table is complete"
    file = tmp_path / "job.yaml"
    file.write_text(
        "name: wells\nmodel: double_well:DoubleWell\nparams: {lean: 1.0e-3}\nvary: {x_0: [-4.0e-5]}\n"
        "run: {kind: fixed_time, duration: 40}\n"
    )
    options = ["run", str(file), "--out", str(tmp_path / "by command")]
    assert main(options) == 0
    assert "Warning: Self-check: 1 row" in capsys.readouterr().err
    assert main([*options, "--strict"]) == 3


@pytest.fixture
def beside(monkeypatch: pytest.MonkeyPatch) -> None:
    """The self-check runs beside the rows, as on a card."""
    monkeypatch.setattr(execute, "_rows_leave_the_host_idle", lambda _: True)


def test_beside_the_rows_it_finds_the_same(tmp_path: Path, beside: None) -> None:
    fields: dict[str, Any] = {"vary": {"x_0": [-1e-4, -4e-5, -3e-5, 1e-4]}, "params": {"lean": 1e-3}}
    found = checked(tmp_path / "beside", warns=True, **fields)
    table = gs.load(tmp_path / "beside/out")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(execute, "_rows_leave_the_host_idle", lambda _: False)
        assert checked(tmp_path / "after", warns=True, **fields) == found
    assert found["gait_differs"] == 2
    pd.testing.assert_frame_equal(gs.load(tmp_path / "after/out"), table, check_exact=True)


def test_its_failure_beside_the_rows_is_raised_and_the_table_stands(
    tmp_path: Path, beside: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any) -> dict[str, Any]:
        raise RuntimeError("no check")

    monkeypatch.setattr(execute, "self_check", fails)
    with pytest.raises(RuntimeError, match="no check"):
        gs.run(job(vary={"x_0": [0.5, 0.8]}), tmp_path / "out")
    assert gs.load(tmp_path / "out").attrs["complete"]
    monkeypatch.undo()
    again = gs.run(job(vary={"x_0": [0.5, 0.8]}), tmp_path / "out")
    assert again.manifest["self_check"]["verdict"] == "passed"


def test_stopped_rows_stop_it(tmp_path: Path, beside: None, monkeypatch: pytest.MonkeyPatch) -> None:
    told = threading.Event()

    def endless(_ready: Any, _count: int, progress: Callable[[Any], None]) -> dict[str, Any]:
        while True:
            told.set()
            progress(None)
            time.sleep(0.001)

    def stop(*_: Any, **__: Any) -> None:
        assert told.wait(10.0)
        raise KeyboardInterrupt

    monkeypatch.setattr(execute, "self_check", endless)
    with pytest.raises(KeyboardInterrupt):
        run_job(job(vary={"x_0": [0.5, 0.8]}), tmp_path / "out", progress=stop)


def test_it_can_be_turned_off_and_is_no_part_of_the_hash(tmp_path: Path) -> None:
    off = job(vary={"x_0": [-4e-5]}, params={"lean": 1e-3}, verify=0)
    assert gs.run(off, tmp_path / "out").manifest["self_check"] == {"rows": 0, "verdict": "off"}
    on = job(vary={"x_0": [-4e-5]}, params={"lean": 1e-3})
    assert on.hash() == off.hash()
    with pytest.warns(UserWarning, match="Self-check"):
        assert gs.run(on, tmp_path / "out").manifest["self_check"]["verdict"] == "warned"


def test_rows_that_do_not_settle_are_compared_over_their_first_crossings(tmp_path: Path) -> None:
    fields: dict[str, Any] = {"vary": {"x_0": [0.5]}, "params": {"lean": 0.1}}
    found = checked(tmp_path, run={"kind": "return_map", "crossings": 12}, **fields)
    # by explicit Euler, crossing k of the coarse step is step k, not the same time: all that is told
    assert found["largest"]["x"] > 0.0
    assert found["verdict"] == "passed"


@pytest.mark.parametrize("count", [4, 8, 32, 50])
def test_a_sample_has_the_ends_of_each_axis(count: int) -> None:
    vary = {"x_0": {"linspace": [-1, 1, 40]}, "lean": {"linspace": [0, 1e-3, 25]}}
    plan = job(vary=vary).plan
    rows = sample_rows(plan, count)
    assert rows.size == np.unique(rows).size == count
    assert rows.min() >= 0
    assert rows.max() < plan.n_rows
    first, second = rows // 25, rows % 25
    assert {0, 39} <= set(first.tolist())
    assert {0, 24} <= set(second.tolist())
    if count == 32:  # and no large part of the box is left out
        for axis, length in ((first, 40), (second, 25)):
            assert np.max(np.diff(np.unique(np.sort(axis)))) <= 0.25 * length
    assert sample_rows(plan, 10**6).size == plan.n_rows
