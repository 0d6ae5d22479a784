"""The command `gaitsweep search`, and other commands on searches: output, exit codes, refusals."""

from __future__ import annotations

import importlib.util
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import jsonschema
import pytest
import yaml
from pandas.testing import assert_frame_equal

import gaitsweep as gs
from gaitsweep.cli import main
from gaitsweep.cli.show_fits import search_outcome
from gaitsweep.fitting.search import run_search
from gaitsweep.fitting.search_job import read_search
from tests.support import environment

JOB = """\
name: toy_search
model: toy_model:Toy
params: {restitution: 0.5}
run: {kind: settle, max_cycles: 60, tolerance: 1e-9}
search:
  free: {kick: [0.1, 3.0], stiffness: {low: 1, high: 20, log: true}}
  targets:
    speed: {kind: value, of: launch_1, at: {mass: 1}, wanted: 1.6, error: 0.01}
  method: sobol
  budget: 48
  population: 16
"""
SWEEPS = Path(__file__).parents[2] / "sweeps"
Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def job_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A search in the working directory."""
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "job.yaml"
    file.write_text(JOB)
    return file


@pytest.mark.slow
def test_a_search_runs_and_is_shown_again(capsys: Capture) -> None:
    """Its sets, its figures, and the targets that are met together."""
    assert main(["search", "job.yaml"]) == 0
    text = capsys.readouterr().out
    assert "48 sets: 48 complete, 0 failed." in text
    assert "Table: results/toy_search/table" in text
    assert main(["info", "results/toy_search"]) == 0
    assert "48 of 48, complete" in capsys.readouterr().out
    figure = Path("results/toy_search/figures/misses.png")
    figure.unlink()
    assert main(["plot", "results/toy_search", "--width", "column"]) == 2  # its figures take no style
    assert "--width" in capsys.readouterr().err
    assert main(["plot", "results/toy_search"]) == 0
    assert str(figure) in capsys.readouterr().out
    assert figure.is_file()
    assert main(["analyse", "targets", "results/toy_search", "--within", "10"]) == 0
    text = capsys.readouterr().out
    assert "of 48" in text.splitlines()[0]
    assert "meets: 1 (speed;" in text
    assert main(["analyse", "targets", "results/toy_search", "--target", "sped"]) == 2
    assert "sped is not a target of the search; did you mean speed?" in capsys.readouterr().err
    assert main(["report", "results/toy_search"]) == 0
    # another budget is another search
    assert main(["search", "job.yaml", "--set", "search.budget=10"]) == 2
    assert "results/toy_search contains the table of another job" in capsys.readouterr().err
    assert len(gs.load("results/toy_search")) == 48


def test_one_set_is_singular() -> None:
    fields = yaml.safe_load(JOB)
    fields["search"] |= {"budget": 1, "finalists": 1}
    text = search_outcome(run_search(read_search(fields, Path.cwd()), "out", figures=False))
    assert text.startswith("1 set: 1 complete, 0 failed.")
    assert "times the lowest (1 of 1):" in text


def test_other_commands_name_the_search(capsys: Capture) -> None:
    assert main(["check", "job.yaml"]) == 0
    assert capsys.readouterr().out == "job.yaml: valid, 48 sets of 1 row\n"
    assert main(["run", "job.yaml"]) == 2
    refused = capsys.readouterr().err
    assert refused.startswith("job.yaml, line 5: search belongs to another command")
    assert "`gaitsweep search`" in refused
    assert not Path("results").exists()


def test_a_dry_run_writes_no_files(capsys: Capture) -> None:
    assert main(["search", "job.yaml", "--dry-run"]) == 0
    text = capsys.readouterr().out
    assert "48, 16 at a time" in text
    assert "rows of a set  1\n" in text
    assert "steps" in text
    assert not Path("results").exists()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("search.budget=0", "job.yaml, --set search.budget=0: search.budget is 0, but must be"),
        ("search.free={}", "search.free is an empty mapping"),
        (
            "search.targets.speed.of=apx",
            "search.targets.speed.of is apx, which is unknown; did you mean apex?",
        ),
        ("search.method=annealing", "search.method is"),
        ("vary.mass=[1, 2]", "vary has no place beside search"),
    ],
)
def test_wrong_searches_are_refused_in_a_sentence(change: str, sentence: str, capsys: Capture) -> None:
    assert main(["search", "job.yaml", "--set", change]) == 2
    refused = capsys.readouterr()
    assert sentence in refused.err
    assert refused.out == ""
    assert not Path("results").exists()


def test_lines_of_the_file_are_named(job_file: Path, capsys: Capture) -> None:
    written = yaml.safe_load(JOB)
    del written["search"]["targets"]["speed"]["at"]
    job_file.write_text(yaml.safe_dump(written, sort_keys=False))
    assert main(["search", "job.yaml"]) == 2
    assert "job.yaml, line 19: search.targets.speed.at is missing" in capsys.readouterr().err


def test_the_schema_has_the_search(capsys: Capture) -> None:
    assert main(["schema"]) == 0
    whole = json.loads(capsys.readouterr().out)
    search = whole["properties"]["search"]
    assert set(search["required"]) == {"free", "targets", "budget"}
    for file in sorted(SWEEPS.glob("*_search.yaml")):
        written = yaml.safe_load(file.read_text())
        for name, field in written.get("search", {}).items():
            assert name in search["properties"]
            if name == "targets":
                kinds = search["properties"]["targets"]["additionalProperties"]["anyOf"]
                for target in field.values():
                    (fields,) = [
                        k["properties"] for k in kinds if k["properties"]["kind"]["const"] == target["kind"]
                    ]
                    assert set(target) <= set(fields)


def test_the_schema_takes_the_shipped_fits(capsys: Capture) -> None:
    assert main(["schema"]) == 0
    reader = jsonschema.Draft202012Validator(json.loads(capsys.readouterr().out))
    files = sorted(
        [*SWEEPS.glob("*_search.yaml"), *SWEEPS.glob("*_front.yaml"), *SWEEPS.glob("*_sensitivity.yaml")]
    )
    assert len(files) >= 3
    for file in files:
        assert not list(reader.iter_errors(yaml.safe_load(file.read_text())))
    wrong = yaml.safe_load(files[-1].read_text())
    wrong["sensitivity"]["method"] = "sobbol"
    assert list(reader.iter_errors(wrong))
    robust = yaml.safe_load(JOB)
    robust["search"]["robust"] = {"within": 0.1, "targets": ["speed"], "wanted": 1.0, "error": 0.1}
    robust["search"]["targets"]["speed"] |= {"wanted": "pi/2", "at": {"mass": "2/2"}}
    assert not list(reader.iter_errors(robust))
    robust["search"]["robust"]["withn"] = 0.1
    assert list(reader.iter_errors(robust))


@pytest.mark.slow
@pytest.mark.parametrize(("stop", "code"), [(signal.SIGINT, 130), (signal.SIGKILL, -9)])
def test_a_stopped_command_continues(stop: signal.Signals, code: int, capsys: Capture) -> None:
    long = ["search", "job.yaml", "--set", "search.budget=2000"]
    process = subprocess.Popen(
        [sys.executable, "-m", "gaitsweep", *long],
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
    )
    table = Path("results/toy_search/table")
    deadline = time.monotonic() + 120
    while process.poll() is None and len(list(table.glob("part-*.parquet"))) < 3:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(stop)
    _, said = process.communicate(timeout=60)
    assert process.returncode == code
    if stop == signal.SIGINT:
        assert "Run the same command to continue" in said
    assert main(long) == 0
    assert main([*long, "--out", "whole"]) == 0
    assert_frame_equal(gs.load("results/toy_search"), gs.load("whole"), check_exact=True)


def test_check_works_without_the_package_of_a_method(
    job_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "cma" else find(name))
    Path("evolved.yaml").write_text(JOB.replace("method: sobol", "method: cma"))
    assert main(["check", "evolved.yaml", str(job_file)]) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("evolved.yaml: search.method cma needs the package cma: pip install")
    assert f"{job_file}: valid, 48 sets" in printed.out
