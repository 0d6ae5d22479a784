"""Names of older versions: refused in jobs with the name of today, translated in result directories."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import gaitsweep as gs
from gaitsweep.cli.main import main
from gaitsweep.job import Job, JobError
from gaitsweep.schema.diagnostics import renamed
from gaitsweep.table import ResultDirectory, TableError
from gaitsweep.table.manifest import Layout

STAIRS = {"kind": "staircase", "parameter": "stiffness", "path": [4, 9, 4], "step": 2.5}
RAMP = {"kind": "ramp", "parameter": "stiffness", "path": [4, 9], "rate": 0.1}
TRACE = {"kind": "trace", "duration": 1, "every": 0.1}
REFUSED: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    ({"kind": "hold", "duration": 3}, {}, "fixed_time"),
    ({**STAIRS, "hold": 3}, {}, "run.hold is not a field of run (staircase) any more: it is called dwell"),
    ({**STAIRS, "dwell": 3, "first_hold": 4}, {}, "(staircase) any more: it is called first_dwell now."),
    ({**RAMP, "hold": 3}, {}, "run.hold is not a field of run (ramp) any more: it is called initial_dwell"),
    ({**TRACE, "hold": 3}, {}, "(trace) any more: it is called initial_dwell now."),
    (TRACE, {"method": "exact"}, "propagator"),
    (TRACE, {"method": "stabilised"}, "propagator6"),
]  # fmt: skip


@pytest.mark.parametrize(("run", "numerics", "words"), REFUSED)
def test_a_former_name_is_refused_with_the_name_of_today(
    run: dict[str, Any], numerics: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(JobError) as error:
        Job(name="x", model="toy_model:Toy", run=run, numerics=numerics)
    assert words in str(error.value)
    file = tmp_path / "job.yaml"
    file.write_text(f"name: x\nmodel: multilegged\nrun: {run}\nnumerics: {numerics}\n")
    assert main(["check", str(file)]) == 2


@pytest.mark.slow
def test_a_directory_of_an_older_version_opens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figures = [{"kind": "hysteresis", "y": "launch_1"}]
    run = {**STAIRS, "dwell": 8.0, "first_dwell": 9.0}
    job = Job(name="x", model="toy_model:Toy", run=run, figures=figures, verify=0)
    table = gs.run(job, tmp_path / "new").table
    former = job.resolved()
    former["run"] = {**STAIRS, "hold": 8.0, "first_hold": 9.0, "tolerance": 1e-3}
    former["numerics"] |= {"method": "stabilised"}
    path = tmp_path / "old"
    with ResultDirectory.open(path, former, Layout("0" * 64, 1, 1024)) as directory:
        directory.write_part(0, table)
        directory.update_manifest(complete=True)
    loaded = gs.load(path)
    assert loaded.attrs["job"]["run"] == renamed(former)["run"] == {**run, "tolerance": 1e-3}
    assert loaded.attrs["job"]["numerics"]["method"] == "propagator6"
    for command in ("plot", "info", "report"):
        assert main([command, str(path)]) == 0, capsys.readouterr().err
    with pytest.raises(TableError):
        gs.run(job, path)


def test_jobs_without_former_names_are_unchanged() -> None:
    for job in ({}, {"run": 3}, {"run": {"kind": []}}, {"run": {"kind": "settle"}, "numerics": {"dt": 1}}):
        assert renamed(job) is job
