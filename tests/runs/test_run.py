"""A job from its file to its table, as a user runs it: killed, interrupted, resumed, out of space."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.engine.sweep import sweep
from gaitsweep.runs import execute as runner
from gaitsweep.table import Snapshot
from tests.support import environment
from toy_model import launches

JOB = """
name: hops
model: toy_model:Toy
params: {restitution: 0.6}
vary:
  stiffness: {linspace: [2, 8, 12]}
  launch_1: {linspace: [0.2, 3.0, 40]}
run: {kind: settle, max_cycles: 400, tolerance: 1.0e-6}
numerics: {dt: 5.0e-4}
engine: {block: 32, lanes: 8}
"""


@pytest.fixture
def job_file(tmp_path: Path) -> Path:
    file = tmp_path / "hops.yaml"
    file.write_text(JOB)
    return file


def command(job_file: Path, out: Path, *more: str) -> tuple[list[str], dict[str, str]]:
    line = [sys.executable, "-m", "gaitsweep", "run", str(job_file), "--out", str(out), *more]
    return line, environment()


def run_and_stop(job_file: Path, out: Path, sent: signal.Signals) -> subprocess.Popen[str]:
    """Start a run, and send it a signal once two parts stand."""
    line, environment = command(job_file, out)
    process = subprocess.Popen(
        line, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    deadline = time.monotonic() + 120
    while len(list((out / "table").glob("part-*.parquet"))) < 2:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(sent)
    return process


def finish(job_file: Path, out: Path) -> str:
    line, environment = command(job_file, out)
    done = subprocess.run(line, env=environment, text=True, capture_output=True, timeout=300, check=True)
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_a_stopped_run_continues_to_the_same_table(
    job_file: Path, tmp_path: Path, sent: signal.Signals
) -> None:
    whole = gs.run(job_file, tmp_path / "whole").table
    out = tmp_path / "stopped"
    process = run_and_stop(job_file, out, sent)
    _, errors = process.communicate(timeout=60)
    if sent != signal.SIGKILL:
        assert process.returncode == 128 + sent
        assert f"{Snapshot.of(out).rows_safe} of 480 rows are safe" in errors
        assert "Run the same command to continue" in errors
        assert "Traceback" not in errors
    partial = gs.load(out)
    assert 64 <= len(partial) < len(whole)
    times = {path.name: path.stat().st_mtime_ns for path in (out / "table").glob("part-*")}
    printed = finish(job_file, out)
    assert "480 rows: 480 settled" in printed
    for name, since in times.items():  # what stood was not run again
        assert (out / "table" / name).stat().st_mtime_ns == since
    pd.testing.assert_frame_equal(gs.load(out), whole, check_exact=True)
    assert not [path for path in out.rglob(".*") if path.name != ".lock"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "run",
    [
        {"kind": "settle", "max_cycles": 400, "tolerance": 1e-6},
        {"kind": "return_map", "crossings": 40},
        {"kind": "trace", "duration": 20.0, "every": 0.25},
        {"kind": "staircase", "parameter": "mass", "path": [1, 2], "step": 0.25, "dwell": 4.0},
    ],
    ids=lambda run: run["kind"],
)
def test_finished_rows_of_a_block_of_all_rows_are_kept(
    job_file: Path, tmp_path: Path, run: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped again and again, rows being stored at once: no row that has ended is run again."""
    monkeypatch.setattr(sweep, "SAFE_WITHIN", 0.0)
    job = gs.Job(
        name="hops",
        model="toy_model:Toy",
        vary={"launch_1": {"linspace": [0.2, 3.0, 60]}},
        run=run,
        numerics={"method": "rk4", "dt": 5e-4},
        engine={"block": 1000, "lanes": 8},
        verify=0,
    )
    whole = gs.run(job, tmp_path / "whole").table
    out = tmp_path / "stopped"
    safe = stops = 0

    def stop(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        assert done >= safe
        if note != "compiling" and done >= safe + 15:
            raise KeyboardInterrupt

    while True:
        try:
            gs.run(job, out, on_progress=stop)
            break
        except KeyboardInterrupt:
            stops += 1
            held = Snapshot.of(out)
            assert held.rows_safe >= safe + 15
            assert held.rows_safe == 60 or held.rows_done == 0
            safe = held.rows_safe
    assert stops >= 2
    pd.testing.assert_frame_equal(gs.load(out), whole, check_exact=True)
    assert not list(out.glob("table/open-*"))


@pytest.mark.slow
def test_a_run_killed_after_its_last_part_is_completed(
    job_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figure = "figures=[{kind: basin, x: launch_1, y: stiffness}]"
    small = ["vary.stiffness={linspace: [2, 8, 2]}", figure]
    whole = gs.run(job_file, tmp_path / "whole", overrides=small)

    def killed(*_arguments: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "out"
    with monkeypatch.context() as patched:
        patched.setattr(runner, "sum_up", killed)
        with pytest.raises(KeyboardInterrupt):
            gs.run(job_file, out, overrides=small)
    assert Snapshot.of(out).complete
    assert "counts" not in Snapshot.of(out).manifest
    parts = {path: path.stat().st_mtime_ns for path in (out / "table").iterdir()}
    result = gs.run(job_file, out, overrides=small)
    assert parts == {path: path.stat().st_mtime_ns for path in (out / "table").iterdir()}
    for name in ("complete", "counts", "gaits", "quantities", "self_check"):
        assert result.manifest[name] == whole.manifest[name]
    drawn = {path: path.stat().st_mtime_ns for path in result.figures}
    assert len(drawn) == 1
    again = gs.run(job_file, out, overrides=small)
    assert drawn == {path: path.stat().st_mtime_ns for path in again.figures}
    again.figures[0].write_bytes(b"")
    gs.run(job_file, out, overrides=small)
    assert again.figures[0].stat().st_size > 1000


def test_a_complete_run_is_not_repeated(job_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = gs.run(job_file, out, overrides=["vary.stiffness={linspace: [2, 8, 2]}"])
    parts = {path: path.stat().st_mtime_ns for path in (out / "table").iterdir()}
    again = gs.run(job_file, out, overrides=["vary.stiffness={linspace: [2, 8, 2]}"])
    assert parts == {path: path.stat().st_mtime_ns for path in (out / "table").iterdir()}
    assert first.manifest == again.manifest
    assert again.manifest["complete"]
    assert repr(gs.Result(str(out))) == repr(again)
    assert sum(again.manifest["counts"].values()) == 80


def test_another_job_is_refused_with_both_hashes(job_file: Path, tmp_path: Path) -> None:
    small = "vary.stiffness={linspace: [2, 8, 2]}"
    first = gs.run(job_file, tmp_path / "out", overrides=[small])
    with pytest.raises(gs.TableError, match=first.manifest["job_hash"][:12]) as refusal:
        gs.run(job_file, tmp_path / "out", overrides=[small, "params.restitution=0.61"])
    assert "--out" in str(refusal.value)


def test_files_that_are_not_jobs_are_refused() -> None:
    with pytest.raises(gs.ArgumentError, match="job is a dict, but takes a Job or the path of its YAML file"):
        gs.run({"name": "a"})  # type: ignore[arg-type]
    with pytest.raises(gs.JobError, match=r"wrong_path\.yaml: does not exist"):
        gs.run("wrong_path.yaml")


def test_the_table_is_right(job_file: Path, tmp_path: Path) -> None:
    """Each row's own parameters reached it: the launch speed settles at kick/(1 - restitution)."""
    table = gs.run(job_file, tmp_path / "out", overrides=["vary.stiffness=[2, 5, 8]"]).table
    assert list(table["row"]) == list(range(120))
    expected = 0.25 * np.sqrt(table["stiffness"]) / 0.4
    np.testing.assert_allclose(table["launch_1_end"], expected, atol=1e-4)
    assert set(table["gait"]) == {"hop"}


@pytest.mark.slow
def test_ramp_and_return_map_tables(job_file: Path, tmp_path: Path) -> None:
    """Crossing tables carry crossing, time and pass; a formula that uses a moving parameter moves with it."""
    few = "vary.launch_1=[0.5, 2.0]"
    one = ["vary.stiffness=[4]", few]
    six = "run={kind: return_map, crossings: 6}"
    mapped = gs.run(job_file, tmp_path / "map", overrides=[*one, six]).table
    for row, first in enumerate((0.5, 2.0)):
        speeds = mapped.loc[mapped["row"] == row, "launch_1_n"]
        np.testing.assert_allclose(speeds, launches(first, 0.6, 0.5, 6), atol=1e-7)
    ramp = "run={kind: ramp, parameter: stiffness, path: [4, 9, 4], rate: 0.25}"
    path = job_file.with_name("ramp.yaml")
    path.write_text(JOB.replace("  stiffness: {linspace: [2, 8, 12]}\n", ""))
    ramped = gs.run(path, tmp_path / "ramp", overrides=[few, ramp, "numerics.dt=2e-3"]).table
    assert set(ramped["pass"]) == {0, 1}
    late = ramped[ramped["t"] > 10]
    # kick = 0.25 sqrt(stiffness/mass) follows the ramp, and the launch speed follows the kick
    followed = 0.25 * np.sqrt(late["stiffness"]) / 0.4
    assert np.abs(late["launch_1_n"] - followed).max() < 0.05
