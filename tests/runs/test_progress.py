"""Progress of runs: estimates follow measurements, and finished blocks are counted by gait."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.engine.recorders.recorder import RunningRows
from gaitsweep.runs.prepare import prepare
from gaitsweep.runs.progress import percent, progress_lines, so_far
from gaitsweep.table import MemoryTable, ResultDirectory
from tests.support.toy_directories import block_frame, open_toy

# 400 starts of the hopper in blocks of eight.
HOPS: dict[str, Any] = {
    "name": "hops",
    "model": "gaitsweep.examples.hopper:Hopper",
    "vary": {"launch_0": {"linspace": [2.0, 8.0, 400]}},
    "run": {"kind": "settle", "max_cycles": 400},
    "engine": {"block": 8, "lanes": 8},
    "verify": 0,
}


def test_before_a_row_has_ended_its_limit_is_its_length() -> None:
    job = gs.Job(**HOPS)
    recorder = job.run.recorder(job.design.model)
    running = RunningRows(np.array([40, 100]), np.zeros(2, np.int64), np.zeros(2))
    assert recorder.progress(running, 0.0).tolist() == [0.1, 0.25]
    assert recorder.progress(running, 50.0).tolist() == [0.8, 0.95]


@pytest.mark.slow
def test_reports_of_a_run(tmp_path: Path) -> None:
    reports: list[tuple[int, int, float, float, str]] = []
    job = gs.Job(**HOPS)
    result = gs.run(job, tmp_path, on_progress=lambda *now: reports.append(now))
    table = result.table
    assert reports[0] == (0, 400, 0.0, 0.0, "compiling")
    for done, total, rate, fraction, _ in reports:
        assert (rate > 0.0) <= (done > 0)
        assert done / total <= fraction + 1e-12
        assert fraction <= min(done + 0.95 * 16, total) / total + 1e-12  # 8 lanes a device
    tallies = [note.partition("; ")[2] for *_, note in reports if "so far" in note]
    finished = [int(text.split()[0]) for text in tallies]
    assert finished == sorted(finished)
    assert {number % 8 for number in finished} == {0}  # of whole blocks
    settled = table.loc[table["status"] == "settled", "attractor_period"].value_counts()
    assert result.manifest["periods"] == {str(period): number for period, number in settled.items()}
    context = prepare(job)
    with ResultDirectory.open(tmp_path, job.resolved(engine=context.engine), context.layout) as directory:
        counted = directory.tally("outcome")
    assert counted == {name: number for name, number in table["outcome"].value_counts().items() if number}


def test_a_tally_reads_each_new_part_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_toy(tmp_path / "toy") as directory:
        assert directory.tally("outcome") == {}
        total: dict[str, int] = {}
        for number in directory.missing_blocks():
            frame = block_frame(*directory.layout.rows_of(number))
            directory.write_part(number, frame)
            for name in frame["outcome"].astype(str):
                total[name] = total.get(name, 0) + 1
            assert directory.tally("outcome") == total
        assert sum(total.values()) == 10
        monkeypatch.setattr("gaitsweep.table.directory.read_file", lambda *_: pytest.fail("read twice"))
        assert directory.tally("outcome") == total
        assert directory.tally(None) == directory.counts()


def test_each_column_has_a_tally_of_its_own(tmp_path: Path) -> None:
    frame = block_frame(0, 4).assign(gait=pd.Categorical(["trot", None, "trot", "walk"]))
    with open_toy(tmp_path / "toy") as directory:
        directory.write_part(0, frame)
        assert directory.tally("gait") == {"trot": 2, "walk": 1}  # without the row that has no gait
        assert directory.tally("outcome") == dict(frame["outcome"].astype(str).value_counts())
        assert directory.tally("recovery") == {}  # a column that this part lacks
    memory = MemoryTable({}, directory.layout)
    memory.write_encoded(0, memory.encoded(0, frame))
    assert memory.tally("gait") == {"trot": 2, "walk": 1}
    for column in ("outcome", "cycles"):  # in one order where counts are equal
        assert list(memory.tally(column).items()) == list(directory.tally(column).items())
    assert memory.tally("recovery") == {}


def test_words() -> None:
    assert percent(128, 300, 0.43) == "43 %"
    assert percent(0, 300, 0.39) == "39 % of the work"
    assert percent(2999, 3000, 2999 / 3000) == "99 %"
    assert percent(3000, 3000, 1.0) == "100 %"
    assert so_far({}) == ""
    assert so_far({"trot": 1}) == "; 1 row so far: 1 trot"
    assert so_far(dict.fromkeys("abcdefg", 2)) == "; 14 rows so far: 2 a, 2 b, 2 c, 2 d, 2 e, ..."


def test_the_time_left_counts_from_the_first_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compilation takes 100 s here; from 10 % on, 10 % take 30 s."""
    clock, log = iter([0.0, 0.0, 100.0, 101.0, 131.0]), io.StringIO()
    monkeypatch.setattr("gaitsweep.runs.progress.time.monotonic", lambda: next(clock))
    lines = progress_lines(file=log)
    for fraction in (0.0, 0.0, 0.1, 0.2):
        lines(int(100 * fraction), 100, 0.0, fraction, "")
    assert log.getvalue().splitlines() == ["0/100 rows, 0 %", "20/100 rows, 20 %, 240 s left"]
