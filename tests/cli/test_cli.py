"""The command line: output, exit codes, and error messages of one sentence."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from typer.core import TyperGroup
from typer.main import get_command

import gaitsweep as gs
from gaitsweep.cli import main
from gaitsweep.cli.commands import app
from gaitsweep.cli.progress import shown_progress
from gaitsweep.cli.show import axes, duration, size
from gaitsweep.compiling_threads import compiling, purpose_of_compiling
from gaitsweep.errors import Terminated, UserError
from gaitsweep.job import Job
from gaitsweep.runs.progress import progress_lines, steps_per_second
from gaitsweep.runs.sentences import settings_of, status_sentence
from gaitsweep.table import ResultDirectory, TableError, WriteError
from gaitsweep.table.manifest import Layout

JOB = """\
name: toy
model: multilegged
vary:
  psi_1: {linspace: [0, 2*pi, 5], at: centre}
  psi_2: {values: [1.0, 2.0]}
  psi_3: {values: [3.0]}
run: {kind: settle, max_cycles: 10}
"""
PNG = b"\x89PNG\r\n\x1a\nonly the report reads it, and it does not look inside"
Capture = pytest.CaptureFixture[str]


class FakeRunner(types.ModuleType):
    """Stands for `gaitsweep.runs.execute`: writes a table at once, and keeps what it was asked."""

    RESULTS = Path("results")

    class RunError(UserError):
        pass

    class FigureError(UserError):
        exit_code = 1
        drawn = (Path("results/toy/figures/basin.png"),)

    def __init__(self) -> None:
        super().__init__("gaitsweep.runs.execute")
        self.calls: list[tuple[Job, Path | None]] = []
        self.error: BaseException | None = None
        self.error_after_blocks = 0

    def run_job(
        self,
        job: Job,
        out: Path | None = None,
        *,
        on_progress: Callable[..., None] | None = None,
        on_message: Callable[[str], None] | None = None,
        strict: bool = False,
        cluster: None = None,
    ) -> Path:
        self.calls.append((job, out))
        path = out or self.RESULTS / job.name
        if self.error is not None and not self.error_after_blocks:
            raise self.error
        with ResultDirectory.open(path, job.resolved(), Layout(job.hash(), 10, 4)) as directory:
            for number in directory.missing_blocks():
                if self.error is not None and number == self.error_after_blocks:
                    raise self.error
                rows = np.arange(*directory.layout.rows_of(number), dtype=np.int64)
                status = np.where(rows == 3, "fell", "settled")
                directory.write_part(number, pd.DataFrame({"row": rows, "status": status}))
                if on_progress is not None:
                    on_progress(directory.rows_done, 10, 2.5, directory.rows_done / 10, "")
            directory.update_manifest(device="1 x cpu (cpu)", timings={"run_s": 1.25})
        self.draw_figures(path)
        return path

    def draw_figures(
        self, path: Path, style: object = None, folder: Path | None = None, fields: object = ()
    ) -> list[Path]:
        figure = (folder or Path(path) / "figures") / "basin.png"
        figure.parent.mkdir(exist_ok=True)
        figure.write_bytes(PNG)
        return [figure]

    def estimate(self, job: Job) -> types.SimpleNamespace:
        return types.SimpleNamespace(
            rows=10,
            simulated=10,
            records=10,
            records_longer=10,
            blocks=3,
            memory_bytes=35e6,
            disk_bytes=2100,
            seconds=185.0,
            seconds_longer=185.0,
            seconds_most=185.0,
            self_check_s=0.0,
            lanes=256,
            device="cpu",
            engine="xla",
        )


@pytest.fixture
def runner(monkeypatch: pytest.MonkeyPatch) -> FakeRunner:
    fake = FakeRunner()
    monkeypatch.setitem(sys.modules, "gaitsweep.runs.execute", fake)
    monkeypatch.setitem(sys.modules, "gaitsweep.runs.figures", fake)
    needs = types.ModuleType("gaitsweep.runs.estimate")
    needs.estimate = fake.estimate  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "gaitsweep.runs.estimate", needs)
    return fake


@pytest.fixture
def job_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("job.yaml").write_text(JOB)
    return Path("job.yaml")


@pytest.fixture
def finished(job_file: Path, runner: FakeRunner, capsys: Capture) -> Path:
    assert main(["run", str(job_file)]) == 0
    capsys.readouterr()
    return Path("results/toy")


def refused(capsys: Capture, code: int, arguments: list[str]) -> str:
    """Run a command that must fail with `code`, and give its sentence."""
    assert main(arguments) == code
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "Traceback" not in printed.err
    assert "Usage:" not in printed.err
    return printed.err


def test_version_and_help(capsys: Capture) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("gaitsweep ")
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for command in ("run", "plot", "animate", "explore", "info", "models", "check", "report", "schema"):
        assert f"\n  {command} " in text


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["nonsense"], "No such command 'nonsense'"),
        (["list"], "Did you mean `gaitsweep examples`?"),
        (["hysteresis", "results/x"], "Did you mean `gaitsweep analyse hysteresis`?"),
        (["run"], "Missing argument 'JOB.yaml'"),
        (["run", "job.yaml", "--foo"], "No such option: --foo"),
        (["run", "job.yaml", "--out"], "--out"),
        (["run", "job.yaml", "more.yaml"], "unexpected extra argument"),
        (["run", "missing.yaml"], "missing.yaml: does not exist"),
        (["run", "job.yaml", "--set", "run.max_cycle=3"], "max_cycles"),
        (["run", "job.yaml", "--engine", "warp"], "warp"),
        (["check"], "Missing argument"),
        (["check", "missing.yaml"], "does not exist"),
        (["models", "multileg"], "did you mean multilegged?"),
        (["info", "nowhere"], "does not exist"),
        (["info", "job.yaml"], "is not a directory"),
        (["report", "."], "has no manifest.json"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(
    arguments: list[str],
    sentence: str,
    job_file: Path,
    runner: FakeRunner,
    capsys: Capture,
) -> None:
    text = refused(capsys, 2, arguments)
    assert sentence in text
    assert text.count("\n") == 1
    assert not runner.calls
    assert [path.name for path in Path().iterdir()] == ["job.yaml"]


def test_run_prints_a_summary(job_file: Path, runner: FakeRunner, capsys: Capture) -> None:
    assert main(["run", str(job_file)]) == 0
    printed = capsys.readouterr()
    figure = Path("results/toy/figures/basin.png").resolve()
    assert printed.err == f"Link: file://{figure}\n"  # and no bar where nobody looks
    assert printed.out.splitlines() == [
        "10 rows: 9 settled, 1 fell.",
        "Shares: 90 % settled, 10 % fell.",
        "Table: results/toy/table (3 parts).",
        "Figure: results/toy/figures/basin.png",
    ]


def test_run_hands_its_options_on(job_file: Path, runner: FakeRunner) -> None:
    arguments = ["--out", "here", "--set", "run.max_cycles=7", "--set", "params.beta=0.7", "--engine", "xla"]
    assert main(["run", str(job_file), *arguments]) == 0
    job, out = runner.calls[0]
    assert out == Path("here")
    assert job.run.max_cycles == 7  # type: ignore[union-attr]
    assert job.params["beta"] == 0.7
    assert job.engine.name == "xla"


def test_a_dry_run_does_not_simulate(job_file: Path, runner: FakeRunner, capsys: Capture) -> None:
    assert main(["run", str(job_file), "--dry-run"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "rows    10 in 3 blocks",
        "engine  xla on cpu, 256 lanes",
        "memory  about 35 MB",
        "disk    about 2.1 kB",
        "time    about 3.1 min",
    ]
    assert not runner.calls
    assert not Path("results").exists()


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (TableError("The directory is another job's."), 2),
        (WriteError("The disk is full."), 1),
        (FakeRunner.RunError("There is no such device."), 2),
    ],
)
def test_failures_while_running(
    error: Exception, code: int, job_file: Path, runner: FakeRunner, capsys: Capture
) -> None:
    runner.error = error
    text = refused(capsys, code, ["run", str(job_file)])
    assert text == f"{error}\n"


def test_a_signal_has_its_own_code(job_file: Path, runner: FakeRunner) -> None:
    runner.error = Terminated()
    assert main(["run", str(job_file)]) == 143


def test_a_figure_that_fails_leaves_the_others(
    finished: Path, runner: FakeRunner, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def refuse(path: Path, style: object, folder: object, fields: object) -> list[Path]:
        raise runner.FigureError("figures[1] (shock): no.")

    monkeypatch.setattr(runner, "draw_figures", refuse)
    assert main(["plot", str(finished)]) == 1
    printed = capsys.readouterr()
    assert printed.out == "results/toy/figures/basin.png\n"
    assert printed.err == "figures[1] (shock): no.\n"


def test_a_fault_of_ours_keeps_its_traceback(job_file: Path, runner: FakeRunner) -> None:
    runner.error = ZeroDivisionError("a bug")
    with pytest.raises(ZeroDivisionError):
        main(["run", str(job_file)])


@pytest.mark.parametrize("command", [["--version"], ["models"]])
def test_a_full_or_closed_output_is_a_sentence(
    command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    with open("/dev/full", "w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert main(command) == 1
        assert "output cannot be written: the disk is full" in capsys.readouterr().err
    monkeypatch.setattr(sys, "stdout", None)
    assert main(command) == 0
    reader, writer = os.pipe()
    os.close(reader)
    with open(writer, "w") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        with contextlib.suppress(SystemExit):  # of typer, which ends by itself here
            assert main(command) == 1
    assert not capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (MemoryError(), 1, "memory"),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes."), 1, "memory"),
        (RuntimeError("can't start new thread"), 1, "memory"),
        (PermissionError(13, "Permission denied", "/a/file"), 1, "/a/file cannot be used: permission denied"),
    ],
)
def test_errors_of_the_operating_system_are_one_sentence(
    job_file: Path, runner: FakeRunner, capsys: Capture, error: Exception, code: int, told: str
) -> None:
    runner.error = error
    assert main(["run", str(job_file)]) == code
    assert told in capsys.readouterr().err


def test_a_working_directory_that_is_gone_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert main(["check", "builtin:quick_basins"]) == 1
    assert "working directory" in capsys.readouterr().err


def test_a_small_limit_of_memory_is_refused_before_a_compiler_ends_the_process(
    job_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (10**9, 10**9))
    assert main(["check", str(job_file)]) == 2
    assert "1.0 GB" in capsys.readouterr().err


def test_ctrl_c_prints_how_to_continue(job_file: Path, runner: FakeRunner, capsys: Capture) -> None:
    runner.error = KeyboardInterrupt()
    assert "Stopped before anything was written" in refused(capsys, 130, ["run", str(job_file)])
    runner.error_after_blocks = 2
    text = refused(capsys, 130, ["run", str(job_file)])
    assert text == "Stopped: 8 of 10 rows are safe in results/toy. Run the same command to continue.\n"
    runner.error = None
    assert main(["run", str(job_file)]) == 0
    assert "10 rows: 9 settled, 1 fell." in capsys.readouterr().out


def test_the_bar_shows_rows_rate_and_note() -> None:
    screen = io.StringIO()
    with shown_progress(console=Console(file=screen, force_terminal=True, width=80)) as bar:
        bar(2000, 10000, 0.0, 0.2, "compiling")
        bar(2500, 10000, 123.456, 0.26, "2.4 million steps/s; 2048 rows so far: 1500 trot")
    shown = screen.getvalue()
    for piece in (
        "2000/10000 rows",
        "20 % ",
        "compiling",
        "2500/10000 rows",
        "26 % of the work",
        "123 rows/s",
    ):
        assert piece in shown
    assert "2.4 million steps/s; 2048 rows so far: 1500 trot" in shown
    assert max(len(line) for line in re.sub(r"\x1b\[[0-9;?]*[A-Za-z]|\r", "\n", shown).splitlines()) <= 80


@pytest.mark.parametrize(
    ("rate", "text"),
    [
        (2.44e6, "2.4 million steps/s"),
        (53_123.0, "53 000 steps/s"),
        (47.1, "47 steps/s"),
        (0.31, "0.31 steps/s"),
    ],
)
def test_slow_steps_are_not_zero_million(rate: float, text: str) -> None:
    """A body in an MJCF makes some thousands of steps a second."""
    assert steps_per_second(rate) == text


def test_the_bar_says_that_the_main_thread_compiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gaitsweep.cli.progress._SHOWN_AFTER", 0.0)
    screen = io.StringIO()
    with shown_progress(console=Console(file=screen, force_terminal=True, width=80)) as bar:
        with compiling():
            time.sleep(0.3)  # before the first progress
        bar(0, 10, 0.0, 0.0, "0.1 million steps/s")
        with purpose_of_compiling("the self-check"):
            with purpose_of_compiling("a part of it"):
                pass
            with compiling():
                time.sleep(0.3)
    assert "compiling for 0 s" in screen.getvalue()
    assert "compiling the self-check for 0 s" in screen.getvalue()
    assert "0.1 million steps/s" in screen.getvalue()


# Python's own handlers of signals wait for the end of such a function, as for LLVM's and XLA's.
STOPPED_IN_COMPILED_CODE = """
import hashlib, signal, time
from gaitsweep.cli.progress import stoppable_progress
from gaitsweep.compiling_threads import compiling

signal.signal(signal.SIGINT, signal.default_int_handler)
with stoppable_progress("rows", lambda: "Stopped: 3 of 8 rows are safe."):
    with compiling():
        print("begun", flush=True)
        hashlib.pbkdf2_hmac("sha256", b"", b"", 200_000_000)
"""


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_stop_does_not_wait_for_a_compilation(sent: signal.Signals, code: int) -> None:
    command = [sys.executable, "-c", STOPPED_IN_COMPILED_CODE]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "begun\n"
    process.send_signal(sent)
    _, errors = process.communicate(timeout=20)
    assert (process.returncode, errors) == (code, "Stopped: 3 of 8 rows are safe.\n")


def test_without_a_terminal_progress_is_a_line_every_half_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, log = iter([0.0, 1.0, 21.0, 31.0, 41.0, 71.0, 72.0, 105.0]), io.StringIO()
    monkeypatch.setattr("gaitsweep.runs.progress.time.monotonic", lambda: next(clock))
    lines = progress_lines(file=log)
    for done in (2000, 3000, 3500, 4000, 5500):
        lines(done, 10000, 50.0, done / 10000, "2.4 million steps/s")
    lines(1, 10, 0.0, 0.1, "")  # the next run of the same command
    lines(7, 10, 0.0, 0.7, "")
    assert log.getvalue().splitlines() == [
        "3500/10000 rows, 35 %, 50 rows/s, 130 s left, 2.4 million steps/s",
        "5500/10000 rows, 55 %, 50 rows/s, 90 s left, 2.4 million steps/s",
        "7/10 rows, 70 %",  # whose first rise has nothing before it
    ]


def test_help_comes_by_h_too(capsys: Capture) -> None:
    """Of the program, a command, a group and an extension's command."""
    for command in ([], ["run"], ["analyse"], ["analyse", "gaits"]):
        shown = []
        for flag in ("-h", "--help"):
            assert main([*command, flag]) == 0, command
            shown.append(capsys.readouterr().out)
        assert shown[0] == shown[1]
        assert "Usage: gaitsweep" in shown[0]


@pytest.mark.slow
def test_no_help_is_cut_on_a_terminal_of_80_columns(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """The line of each command in its list, and the help of each option, are whole."""
    monkeypatch.setenv("COLUMNS", "80")

    def screen(command: list[str]) -> str:
        assert main([*command, "--help"]) == 0
        shown = capsys.readouterr().out
        assert max(map(len, shown.splitlines())) <= 80
        return shown

    root = get_command(app)
    assert isinstance(root, TyperGroup)
    analyse = root.commands["analyse"]
    assert isinstance(analyse, TyperGroup)
    for path, group in ([], root), (["analyse"], analyse):
        listed = screen(path)
        for name, each in group.commands.items():
            sentence = " ".join((each.help or "").partition("\n\n")[0].split())
            assert re.search(rf"^  {name} +{re.escape(sentence)}$", listed, re.MULTILINE), name
            words = "".join(screen([*path, name]).split())
            for parameter in each.params:
                help_text = getattr(parameter, "help", None) or ""
                assert "".join(help_text.split()) in words, (name, parameter.name)


@pytest.mark.slow
def test_sweep_and_run_print_progress_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """In a notebook or a script they go to standard error."""
    monkeypatch.setattr("gaitsweep.runs.progress.INTERVAL", 0.0)
    gs.sweep("multilegged_reduced", psi_1=[1.0], psi_2=2.0, psi_3=3.0, run=gs.Settle(max_cycles=3), verify=0)
    assert "1/1 rows, 100 %" in capsys.readouterr().err


def test_check_has_a_line_for_each_job(job_file: Path, capsys: Capture) -> None:
    Path("bad.yaml").write_text(JOB.replace("multilegged", "multilegs"))
    assert main(["check", "job.yaml", "bad.yaml", "job.yaml"]) == 2
    printed = capsys.readouterr()
    assert printed.out == "job.yaml: valid, 10 rows\n" * 2
    assert printed.err.startswith("bad.yaml, line 2: model is multilegs")
    assert printed.err.count("\n") == 1
    assert main(["check", "job.yaml"]) == 0


def test_models_lists_and_describes(capsys: Capture) -> None:
    assert main(["models"]) == 0
    assert "multilegged" in capsys.readouterr().out
    assert main(["models", "multilegged"]) == 0
    text = capsys.readouterr().out
    lines = {line.split()[0]: line for line in text.splitlines() if line.strip()}
    for piece in ("N/m", "100", "(0, inf)", "spring between neighbours", "Table 1"):
        assert piece in lines["kappa"]
    for piece in ("parameters", "start", "observables", "signals", "gaits:", "[0, 1]", "2*sqrt(kappa)"):
        assert piece in text


def test_info_describes_a_directory(finished: Path, capsys: Capture) -> None:
    assert main(["info", str(finished)]) == 0
    text = capsys.readouterr().out
    for piece in (
        "toy (model multilegged)",
        "10 of 10, complete",
        "fell",
        "The body fell: the model's function `failed` became true.",
        "1 x cpu (cpu)",
        "1.25 s to run",
        "figures/basin.png",
    ):
        assert piece in text
    assert main(["info", str(finished), "--columns"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["status", "how", "the", "row", "ended"] in lines
    (finished / "table" / "part-00001.parquet").write_bytes(b"PAR1")
    assert main(["info", str(finished)]) == 0
    text = capsys.readouterr().out
    assert "6 of 10, not complete" in text
    assert "damaged" in text


def test_statuses_name_the_limits_of_the_job_and_the_periods() -> None:
    def said(status: str, run: dict[str, object], **known: Any) -> str:
        return status_sentence(status, {"run": run}, known)

    assert (
        said("cycle_limit", {"max_cycles": 150})
        == "The row reached run.max_cycles, 150 cycles, without settling."
    )
    assert said("time_limit", {"max_time": 12.5}) == "The row reached run.max_time, 12.5 s."
    fallen = {"status": {"meaning": "how the row ended; fell: the trunk sank below `fallen` = 0.5 m"}}
    assert said("fell", {}, quantities=fallen) == "The body fell: the trunk sank below `fallen` = 0.5 m."
    fallen["status"]["meaning"] = "how the row ended; fell: whether a knee is down"
    tested = "The body fell: the model's function `failed` became true. It tests whether a knee is down."
    assert said("fell", {}, quantities=fallen) == tested
    assert "the column `settled`" in said("complete", {"kind": "staircase"})
    by_period = said("time_limit", {"max_time": None})
    assert by_period == "The row reached four nominal periods for each allowed cycle and ten more."
    fixed = said("settled", {}, periods={"1": 47})
    assert "47 at a fixed point" in fixed
    assert "orbit" not in fixed
    assert said("settled", {}, periods={"1": 40, "3": 7}).endswith(
        "40 at a fixed point, 7 on an orbit of 3 crossings."
    )
    assert said("settled", {}) == gs.Status.settled.sentence  # of a table that does not count them
    assert said("cycle_limit", {}) == gs.Status.cycle_limit.sentence
    assert "write numerics.method: tsit5" in said("not_a_number", {}, method="taylor")
    assert said("not_a_number", {}, method="tsit5") == gs.Status.not_a_number.sentence


def test_settings_have_units_and_omit_unknown_ones() -> None:
    manifest = {
        "method": "rk4", "dt": [0.002, 0.003], "precision": "float64", "engine": "xla", "lanes": 64,
        "timings": {"compile_s": 6.4777, "run_s": 1.25, "attempts": 6889356},
        "versions": {"jax": "0.10.2", "cuda-core": "not installed"}, "block": 60,
    }  # fmt: skip
    assert settings_of(manifest) == {
        "integration": "rk4, steps of 0.002 to 0.003 s, float64",
        "computed by": "engine xla, 64 trajectories at a time",
        "time": "6.48 s to compile, 1.25 s to run, 6889356 steps",
        "versions": "jax 0.10.2",
        "files": "parts of 60 rows",
    }


def test_axes_are_printed_with_their_numbers_of_points() -> None:
    together = {"names": ["m_1", "m_end"], "length": 3, "drawn": False}
    drawn = {"names": ["psi_1"], "length": 64, "drawn": True}
    assert axes([together, drawn]) == "m_1 and m_end (3) x psi_1 (64, drawn)"


def test_a_missing_platform_is_one_sentence(job_file: Path) -> None:
    command = [sys.executable, "-m", "gaitsweep", "check", str(job_file)]
    environment = os.environ | {"JAX_PLATFORMS": "abacus"}
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert "JAX_PLATFORMS is abacus, but JAX finds no such device here." in result.stderr
    assert result.stderr.count("\n") == 1


def test_plot_draws_from_the_table(finished: Path, capsys: Capture) -> None:
    assert main(["plot", str(finished)]) == 0
    assert capsys.readouterr().out == "results/toy/figures/basin.png\n"


@pytest.mark.parametrize(("works", "said"), [(True, ""), (False, "No browser opened here: copy the link.\n")])
@pytest.mark.parametrize(
    ("command", "file"),
    [("report", "report.html"), ("plot", "figures/basin.png"), ("run", "figures/basin.png")],
)
def test_written_files_are_opened_on_request(
    command: str, file: str, works: bool, said: str, finished: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:  # fmt: skip
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda link: opened.append(link) or works)
    arguments = [command, "job.yaml" if command == "run" else str(finished)]
    for _ in range(2):  # the second run prints what the first one stored
        assert main(arguments) == 0
    assert opened == []
    capsys.readouterr()
    assert main([*arguments, "--open"]) == 0
    link = f"file://{(finished / file).resolve()}"
    assert opened == [link]
    assert capsys.readouterr().err == f"Link: {link}\n{said}"


def test_a_report_needs_no_other_file(finished: Path, capsys: Capture) -> None:
    job = (finished / "job.yaml").read_text()
    (finished / "job.yaml").write_text(job.replace("name: toy", "name: <script>toy"))
    assert main(["report", str(finished)]) == 0
    assert capsys.readouterr().out == "results/toy/report.html\n"
    text = (finished / "report.html").read_text()
    assert base64.b64encode(PNG).decode() in text
    assert "<script>" not in text
    assert "http" not in text
    for piece in ("&lt;script&gt;toy", "10 rows", "90.0 %", "hash of the job", "max_cycles: 10"):
        assert piece in text


def test_the_schema_is_written(tmp_path: Path, capsys: Capture) -> None:
    assert main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert {"name", "model", "vary", "run"} <= set(schema["properties"])
    assert main(["schema", "--out", str(tmp_path / "schema.json")]) == 0
    assert json.loads((tmp_path / "schema.json").read_text()) == schema
    assert main(["schema", "--out", str(tmp_path / "nowhere" / "schema.json")]) == 1
    assert "no such file" in capsys.readouterr().err


def test_claims_are_named(capsys: Capture) -> None:
    assert main(["reproduce", "ambe2021", "--claims", " , "]) == 2
    assert "--claims: names no claim" in capsys.readouterr().err


def test_formats_of_sizes_and_durations() -> None:
    assert [duration(seconds) for seconds in (0.5, 90, 119, 120, 3600, 7200, 200_000)] == [
        "0.5 s",
        "90 s",
        "119 s",
        "2 min",
        "60 min",
        "2 h",
        "2.3 days",
    ]
    assert [size(number) for number in (12, 35e6, 4.2e12)] == ["12 bytes", "35 MB", "4.2 TB"]
    assert size(999.7e3) == "1 MB"


@pytest.mark.slow
def test_the_process_itself_refuses_without_a_traceback(tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("name: [")
    command = [sys.executable, "-m", "gaitsweep", "run", str(tmp_path / "bad.yaml")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert "bad.yaml" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["bad.yaml"]
