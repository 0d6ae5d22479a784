"""The command `examples`, builtin jobs and configs, and systems on which the package does not run."""

from __future__ import annotations

import ast
import fcntl
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import gaitsweep as gs
from gaitsweep.cli import main
from gaitsweep.cli.examples import KINDS, known_examples
from gaitsweep.errors import UnsupportedSystem
from gaitsweep.shipped import shipped
from gaitsweep.table.locks import BlockLocks

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_each_example_is_listed_with_a_line(capsys: Capture) -> None:
    assert main(["examples"]) == 0
    printed = capsys.readouterr().out
    for known_example in known_examples():
        assert f"\n  {known_example.name} " in printed
        assert known_example.about, known_example.name
        assert all(file.is_file() for file in known_example.files)
    assert {known_example.kind for known_example in known_examples()} == set(KINDS)
    names = [known_example.name for known_example in known_examples()]
    assert len(set(names)) == len(names)


@pytest.fixture
def fresh_modules(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules as in a process that has imported no model: other folders have models of the same names."""
    for name in ("hopper", "slip_runner", "lorenz"):
        monkeypatch.setitem(sys.modules, name, None)
        monkeypatch.delitem(sys.modules, name)


@pytest.mark.slow
@pytest.mark.usefixtures("fresh_modules")
def test_all_of_them_are_copied_and_work_where_they_are(capsys: Capture) -> None:
    for kind in KINDS:
        assert main(["examples", kind, "--to", "here"]) == 0
    printed = capsys.readouterr().out.splitlines()
    files = {file for example in known_examples() for file in example.files}
    assert len(printed) == len(list(Path("here").iterdir())) == len(files)
    assert not [each for each in Path("here").glob("*.yaml") if "../configs" in each.read_text()]
    hashes = [gs.load_job(each).hash() for each in (Path("here/quick_basins.yaml"), "builtin:quick_basins")]
    assert hashes[0] == hashes[1]
    assert gs.load_job("here/hopper.yaml").design.n_rows == 4096
    assert main(["check", "here/multilegged_search.yaml", "builtin:lorenz", "here/slip_runner.yaml"]) == 0
    # again: alike files stay, edited ones are not overwritten, and then none is written
    assert main(["examples", "hopper", "--to", "here"]) == 0
    Path("here/hopper.yaml").write_text("name: mine\n")
    Path("here/hopper.py").unlink()
    capsys.readouterr()
    assert main(["examples", "hopper", "--to", "here"]) == 2
    assert "here/hopper.yaml exists already" in capsys.readouterr().err
    assert not Path("here/hopper.py").exists()


def test_a_further_job_of_a_model_is_copied_with_the_model() -> None:
    assert main(["examples", "builtin:slip_runner_atlas"]) == 0  # with the prefix that `run` takes, too
    assert sorted(path.name for path in Path().iterdir()) == ["slip_runner.py", "slip_runner_atlas.yaml"]
    assert "\nmodel: slip_runner:" in Path("slip_runner_atlas.yaml").read_text()


def test_unknown_names_are_refused_with_the_near_miss(capsys: Capture) -> None:
    assert main(["examples", "slip_runer"]) == 2
    assert "did you mean slip_runner?" in capsys.readouterr().err
    assert main(["check", "builtin:quick_basin"]) == 2
    assert "did you mean builtin:quick_basins, which comes" in capsys.readouterr().err
    assert main(["check", "builtin:hoper"]) == 2
    assert "did you mean builtin:hopper, which comes" in capsys.readouterr().err
    assert main(["check", "builtin:of_nobody"]) == 2
    assert "does not exist; `gaitsweep examples` lists" in capsys.readouterr().err
    job = {"name": "a", "config": "builtin:ambe2012", "vary": {"psi_1": [1]}, "run": {"kind": "settle"}}
    with pytest.raises(
        gs.JobError, match=r"config names .*ambe2012\.yaml, which does not exist; did you mean"
    ):
        gs.Job(**{**job, "start": {"psi_2": 1, "psi_3": 1}})
    assert (
        gs.Job(**{**job, "config": "builtin:ambe2021", "start": {"psi_2": 1, "psi_3": 1}}).design.n_rows == 1
    )


def test_notebooks_name_no_file_of_a_checkout() -> None:
    for file in shipped("notebooks").glob("*.ipynb"):
        code = "".join(
            "".join(cell["source"])
            for cell in json.loads(file.read_text())["cells"]
            if cell["cell_type"] == "code"
        )
        for word in ("sweeps/", '"sweeps"', "configs/", '"configs"', "__file__", "../"):
            assert word not in code.replace("# configs/", ""), (file.name, word)


def test_windows_is_refused_in_a_sentence(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    assert main(["models"]) == 2
    assert "Windows is not supported; use WSL 2" in capsys.readouterr().err
    with pytest.raises(UnsupportedSystem, match="WSL 2"):
        _ = gs.sweep


def test_windows_is_refused_without_modules_that_it_lacks() -> None:
    code = (
        "import sys, multiprocessing, typer\n"  # which import modules of Windows there
        "sys.modules |= dict.fromkeys(('resource', 'fcntl'))\n"
        "sys.platform = 'win32'\n"
        "from gaitsweep.cli import main\n"
        "sys.exit(main(['models']))\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith("Windows is not supported; use WSL 2")


def test_rows_shared_by_processes_need_locks_of_open_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(fcntl, "F_OFD_SETLK")  # as on macOS
    with pytest.raises(UnsupportedSystem, match="run the job without --rows"):
        BlockLocks(Path())
    assert not list(Path().iterdir())


@pytest.mark.slow
def test_messages_name_only_pages_that_an_installation_has() -> None:
    """A wheel has no docs/; `gaitsweep examples NAME` copies the pages that messages name."""
    named = set()
    for file in (Path(gs.__file__).parent).rglob("*.py"):
        tree = ast.parse(file.read_text())
        alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}  # docstrings
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in alone:
                assert "docs/" not in node.value, (file, node.value)
                named |= set(re.findall(r"`gaitsweep examples (\w+)` copies", node.value))
                named |= set(re.findall(r"that `gaitsweep examples (\w+)`", node.value))
    assert named == {"own_model", "walker"} <= {example.name for example in known_examples()}
