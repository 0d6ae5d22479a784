"""Shares of a job's rows, run by processes beside each other into one directory."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest
from test_run import JOB, command

import gaitsweep as gs
from gaitsweep.runs.job_array import blocks_of, run_rows
from gaitsweep.runs.prepare import RunError
from gaitsweep.table import Snapshot, TableError, examination
from gaitsweep.table.directory import SharedWriter
from gaitsweep.table.locks import BlockLocks, Lock
from gaitsweep.table.manifest import Layout

OVERRIDES = ["vary.launch_1={linspace: [0.2, 3.0, 10]}", "verify=4"]  # 120 rows in blocks of 32


@pytest.fixture
def job(tmp_path: Path) -> gs.Job:
    file = tmp_path / "hops.yaml"
    file.write_text(JOB)
    return gs.load_job(file, OVERRIDES)


@pytest.mark.slow
def test_shares_of_the_rows_make_the_table(job: gs.Job, tmp_path: Path) -> None:
    """The last share completes the table: manifest, self-check and all, equal to the bit."""
    whole = gs.run(job, tmp_path / "whole")
    out = tmp_path / "shares"
    for rows in ("64:96", "0:64", "0:32"):
        run_rows(job, rows, out)
        assert not Snapshot.of(out).complete
    run_rows(job, "96:128", out)
    shares = gs.Result(out)
    pd.testing.assert_frame_equal(shares.table, whole.table, check_exact=True)
    for name in ("complete", "counts", "gaits", "quantities", "self_check", "job_hash"):
        assert shares.manifest[name] == whole.manifest[name]
    hidden = {path.name for path in out.rglob(".*")} | {path.name for path in out.glob("SHA256SUMS.*")}
    assert hidden == {".lock"}
    subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=out, check=True)


def test_a_finished_range_is_not_run_again(job: gs.Job, tmp_path: Path) -> None:
    out = tmp_path / "shares"
    run_rows(job, "0:64", out)
    stamps = {file: file.stat().st_mtime_ns for file in (out / "table").iterdir()}
    damaged = out / "table" / "part-00001.parquet"
    damaged.write_bytes(damaged.read_bytes()[:-1])
    run_rows(job, "0:64", out)
    again = {file: file.stat().st_mtime_ns for file in (out / "table").iterdir()}
    assert [file for file in again if again[file] != stamps[file]] == [damaged]
    assert Snapshot.of(out).rows_done == 64


def test_parts_of_two_directories_become_one_table(job: gs.Job, tmp_path: Path) -> None:
    """Where no directory is shared: the parts and their digests are copied together, and the job run."""
    whole = gs.run(job, tmp_path / "whole").table
    run_rows(job, "0:64", tmp_path / "a")
    run_rows(job, "64:128", tmp_path / "b")
    for file in (tmp_path / "b").glob("SHA256SUMS.*"):
        shutil.copy(file, tmp_path / "a" / f"{file.name}b")  # this process has written both
    for file in (tmp_path / "b" / "table").iterdir():
        shutil.copy(file, tmp_path / "a" / "table")
    stamps = {file: file.stat().st_mtime_ns for file in (tmp_path / "a" / "table").iterdir()}
    merged = gs.run(job, tmp_path / "a").table
    assert stamps == {file: file.stat().st_mtime_ns for file in (tmp_path / "a" / "table").iterdir()}
    pd.testing.assert_frame_equal(merged, whole, check_exact=True)


def test_rows_that_another_process_runs_are_refused_by_its_name(job: gs.Job, tmp_path: Path) -> None:
    out = tmp_path / "shares"
    run_rows(job, "0:32", out)
    with BlockLocks(out) as locks:
        assert locks.take(2, "process 7 on elsewhere")
        with pytest.raises(TableError, match=r"Rows 64 to 95 of .* are being run by process 7 on elsewhere"):
            run_rows(job, "32:96", out)
    run_rows(job, "32:96", out)


def test_a_whole_run_and_a_share_exclude_each_other(
    job: gs.Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gaitsweep.runs.job_array.PATIENCE", 0.0)
    out = tmp_path / "shares"
    run_rows(job, "0:32", out)
    share, second = Lock(out, shared=True), Lock(out, shared=True)
    with pytest.raises(TableError, match=r"Another run \(process \d+ on .*\) is writing"):
        gs.run(job, out)
    share.release()
    second.release()
    whole = Lock(out)
    with pytest.raises(TableError, match="is writing"):
        run_rows(job, "32:64", out)
    whole.release()


@pytest.mark.slow
def test_one_of_two_processes_completes_the_table(tmp_path: Path) -> None:
    file = tmp_path / "hops.yaml"
    file.write_text(JOB)
    more = [word for override in OVERRIDES for word in ("--set", override)]
    out = tmp_path / "shares"
    lines = [command(file, out, *more, "--rows", rows) for rows in ("0:64", "64:128")]
    both = [
        subprocess.Popen(line, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        for line, environment in lines
    ]
    printed = [process.communicate(timeout=120) for process in both]
    assert [process.returncode for process in both] == [0, 0], printed
    assert any("120 rows: 120 settled" in said for said, _ in printed)
    assert gs.Result(out).manifest["complete"]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("10:64", "did you mean --rows 0:64?"),
        ("0:70", "did you mean --rows 0:96?"),
        ("64", "write the first row and the row after the last, --rows 0:32"),
        ("128:160", "this job has the rows 0 to 119"),
        ("32:32", "names no row"),
    ],
)
def test_other_rows_are_refused(rows: str, said: str) -> None:
    with pytest.raises(RunError) as refusal:
        blocks_of(rows, Layout("", 120, 32))
    assert said in str(refusal.value)


def test_the_last_share_may_end_at_the_table_or_beyond() -> None:
    layout = Layout("", 120, 32)
    assert list(blocks_of("96:120", layout)) == list(blocks_of("96:128", layout)) == [3]
    assert list(blocks_of("0:128", layout)) == [0, 1, 2, 3]


def test_a_part_has_the_same_bytes_whoever_writes_it(job: gs.Job, tmp_path: Path) -> None:
    whole = gs.run(job, tmp_path / "whole").path
    run_rows(job, "32:64", tmp_path / "share")
    name = "table/part-00001.parquet"
    assert (whole / name).read_bytes() == (tmp_path / "share" / name).read_bytes()


def test_locks_of_blocks_count_starts(tmp_path: Path) -> None:
    with BlockLocks(tmp_path) as mine, BlockLocks(tmp_path) as theirs:
        assert mine.take(100_000, "me")
        mine.begin(100_000)
        assert not theirs.take(100_000, "you")
        assert theirs.take(99_999, "you")
        assert theirs.unfinished_starts(100_000) == (1, "me")
        mine.close()  # as when its process is killed
        assert theirs.take(100_000, "you")
        theirs.begin(100_000)
        assert theirs.unfinished_starts(100_000) == (2, "you")
        theirs.end(100_000)
        assert theirs.unfinished_starts(100_000).starts == 0


def test_a_writer_sees_only_sound_parts(job: gs.Job, tmp_path: Path) -> None:
    run = gs.run(job, tmp_path / "whole")
    writer = SharedWriter(run.path, Layout.of(run.manifest))
    assert writer.has(3)
    assert not writer.has(4)
    assert not SharedWriter(run.path, Layout("f" * 64, 120, 32)).has(3)


def test_the_digests_of_a_table_are_read_once_for_all_its_parts(
    job: gs.Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Read for each part, they would cost the square of the number of parts."""
    run = gs.run(job, tmp_path / "whole")
    reads: list[Path] = []
    read = examination.read_digests
    monkeypatch.setattr(examination, "read_digests", lambda folder: reads.append(folder) or read(folder))
    assert SharedWriter(run.path, Layout.of(run.manifest)).missing_blocks(range(5)) == [4]
    assert reads == [run.path]


def test_a_share_ends_well_while_another_process_completes_the_table(
    job: gs.Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gaitsweep.runs.job_array.PATIENCE", 0.0)
    out = tmp_path / "shares"
    run_rows(job, "0:96", out)
    others = Lock(out, shared=True)  # another process has not left yet
    assert run_rows(job, "96:128", out) == out
    others.release()
    assert Snapshot.of(out).rows_done == 120
    run_rows(job, "96:128", out)
    assert gs.Result(out).manifest["complete"]
