"""The command of a complete job prints its stored output, until a file on which it depends changes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

import gaitsweep as gs
from gaitsweep.cli import main, stored_output
from gaitsweep.cli import run as cli_run
from gaitsweep.job import Job
from gaitsweep.runs import execute

JOB = """
name: few
model: multilegged_reduced
start: {psi_3: 3.0}
vary: {psi_1: {linspace: [1, 5, 3]}, psi_2: {linspace: [1, 5, 2]}}
run: {kind: settle}
figures:
  - {kind: basin, x: psi_1, y: psi_2}
"""
Capture = pytest.CaptureFixture[str]


@pytest.fixture
def few(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path / "cache"))
    Path("few.yaml").write_text(JOB)
    assert main(["run", "few.yaml"]) == 0
    return Path("results/few")


def _loaded(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """A list to which each command from now on appends whether it printed stored output."""
    loaded: list[bool] = []
    load_output = stored_output.load_output

    def recorded(command: list[str]) -> tuple[str, str] | None:
        output = load_output(command)
        loaded.append(output is not None)
        return output

    monkeypatch.setattr(stored_output, "load_output", recorded)
    return loaded


def test_the_same_command_prints_the_same(
    few: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    capsys.readouterr()
    loaded = _loaded(monkeypatch)
    assert main(["run", "few.yaml"]) == 0
    assert loaded == [True]
    printed = capsys.readouterr().out
    assert printed.startswith(
        "6 rows: 6 settled.\nGaits: 3 source, 2 direct, 1 retrograde.\nTable: results/few/"
    )
    assert printed.endswith("Figure: results/few/figures/basin.png\n")


def test_gaits_are_those_of_rows_that_settled(few: Path, capsys: Capture) -> None:
    """Of six rows, one settles within 30 cycles; a cycle limit ends the others while they still change."""
    capsys.readouterr()
    command = ["run", "few.yaml", "--out", "short", "--set", "run.max_cycles=30", "--set", "verify=0"]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "\nGaits: 1 direct; 5 rows that failed or did not settle are not counted.\n" in printed
    assert main(["info", "short"]) == 0
    assert "1 direct; 5 rows" in capsys.readouterr().out
    assert "gait: direct 1, 5 failed or not settled" in repr(gs.Result("short"))


def _edited_job(_: Path) -> None:
    Path("few.yaml").write_text(JOB + "# a remark\n")


def _damaged_part(few: Path) -> None:
    part = next((few / "table").iterdir())
    part.write_bytes(part.read_bytes()[:-1] + b"!")


def _gone_figure(few: Path) -> None:
    (few / "figures/basin.png").unlink()


def _new_file(few: Path) -> None:
    (few / "table/part-00001.parquet").write_bytes(b"")


def _altered_output(_: Path) -> None:
    (stored,) = Path("cache/complete").glob("*.json")
    stored.write_bytes(stored.read_bytes().replace(b"6 settled", b"5 settled"))


@pytest.mark.slow("_gone_figure", "_new_file")
@pytest.mark.parametrize("change", [_edited_job, _damaged_part, _gone_figure, _new_file, _altered_output])
def test_after_any_change_the_command_runs_as_a_whole(
    few: Path, change: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    change(few)
    loaded = _loaded(monkeypatch)
    main(["run", "few.yaml"])
    assert loaded == [False]
    main(["run", "few.yaml"])
    main(["run", "few.yaml"])
    assert (few / "figures/basin.png").is_file()


def test_a_job_that_is_edited_while_it_runs_is_another_job(
    few: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its outcome is that of the old text, so that the new one is refused as without stored output."""
    run_job = execute.run_job

    def edited_meanwhile(*arguments: Any, **options: Any) -> Path:
        Path("few.yaml").write_text(JOB.replace("psi_3: 3.0", "psi_3: 2.9"))
        return run_job(*arguments, **options)

    _edited_job(few)  # the output of the first text is stored
    with monkeypatch.context() as patched:
        patched.setattr(execute, "run_job", edited_meanwhile)
        assert main(["run", "few.yaml"]) == 0
    capsys.readouterr()
    loaded = _loaded(monkeypatch)
    assert main(["run", "few.yaml"]) == 2
    assert loaded == [False]
    assert "of another job" in capsys.readouterr().err


def test_another_device_is_another_command(few: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = _loaded(monkeypatch)
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=false")
    assert main(["run", "few.yaml"]) == 0
    assert loaded == [False]


@pytest.mark.slow
def test_an_edited_profile_of_the_ground_is_another_job(few: Path, capsys: Capture) -> None:
    """The outcome on the old ground is not printed; the table of another job is refused as without it."""
    Path("profile.csv").write_text("x,z\n0,0\n1,0.001\n")
    Path("profile.yaml").write_text(
        "name: profile\nmodel: gaitsweep.examples.compass_walker:CompassWalker\nground: {file: profile.csv}\n"
        "run: {kind: fixed_time, duration: 0.1}\nverify: 0\n"
    )
    assert main(["run", "profile.yaml"]) == 0
    Path("profile.csv").write_text("x,z\n0,0\n1,0.002\n")
    capsys.readouterr()
    assert main(["run", "profile.yaml"]) == 2
    assert "of another job" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("model", "repeatable"),
    [("multilegged_reduced", True), ("gaitsweep.examples.hopper:Hopper", True), ("body.yaml", False)],
)
def test_output_of_a_model_file_is_not_stored(model: str, repeatable: bool) -> None:
    """A model file refers to an MJCF with files of its own, whose changes stored output would not see."""
    job = SimpleNamespace(model=model, figures=[])
    assert cli_run._is_repeatable(cast(Job, job), ["engine: kernel"]) is repeatable


def test_options_are_refused_for_a_complete_job_too(few: Path, capsys: Capture) -> None:
    refused = {
        "--collect": "--collect",
        "--block-limit 5": "--block-limit",
        "--rows 0:3 --cluster local:2": "cannot be combined",
        "--rows three": "three",
        "--cluster nowhere": "nowhere",
    }
    for options, named in refused.items():
        capsys.readouterr()
        assert main(["run", "few.yaml", *options.split()]) == 2
        assert named in capsys.readouterr().err
