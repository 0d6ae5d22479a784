"""The commands `new-model` and `check-model`: files, reports and error messages."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from gaitsweep.cli import main
from gaitsweep.cli.show import structure_field
from tests.support.installed_packages import install, run_module

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def refused(capsys: Capture, *arguments: str, code: int = 2) -> str:
    assert main(list(arguments)) == code
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "Traceback" not in printed.err
    return printed.err


def test_a_new_model_is_a_folder_of_four_files(capsys: Capture) -> None:
    assert main(["new-model", "my_hopper", "--to", "models"]) == 0
    printed = capsys.readouterr().out
    folder = Path("models/my_hopper")
    names = {"README.md", "my_hopper.py", "my_hopper.yaml", "test_my_hopper.py"}
    assert {each.name for each in folder.iterdir()} == names
    assert all(str(folder / name) in printed for name in names)
    assert not [each for each in folder.parent.iterdir() if each.name != "my_hopper"]
    texts = [each.read_text() for each in folder.iterdir()]
    assert "class MyHopper(DeclaredModel)" in (folder / "my_hopper.py").read_text()
    assert all("my_hopper" in text or "MyHopper" in text for text in texts)
    assert not any(word in text for text in texts for word in (" hopper", "Hopper:", "`hopper", "my_my"))
    assert main(["check-model", "my_hopper:MyHopper"]) == 2, "it is not in this folder"
    capsys.readouterr()
    kept = texts[0]
    assert "models/my_hopper exists" in refused(capsys, "new-model", "my_hopper", "--to", "models")
    assert next(folder.iterdir()).read_text() == kept


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("MyHopper", "did you mean my_hopper?"),
        ("Class", "beginning with a letter."),
        ("my-hopper", "did you mean my_hopper?"),
        ("3legs", "letter."),
        ("../out", "Python module"),
        ("class", "Python module"),
        ("multilegged", "gaitsweep"),
        ("json", "this Python"),
        ("numpy", "this Python"),
    ],
)
def test_bad_names_are_refused(name: str, sentence: str, capsys: Capture) -> None:
    assert sentence in refused(capsys, "new-model", name)
    assert not list(Path().iterdir())


def test_no_files_remain_if_writing_fails(capsys: Capture) -> None:
    Path("file").write_text("")
    assert "could not be written" in refused(capsys, "new-model", "mine", "--to", "file")
    assert [each.name for each in Path().iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("bounds", "text"),
    [({"low": 1}, "[1, inf)"), ({"high": 8}, "(-inf, 8]"), ({"low": 1, "high": 8}, "[1, 8]"), ({}, "")],
)
def test_bounds_of_a_structure_field(bounds: dict[str, int], text: str) -> None:
    made = dataclasses.make_dataclass("Made", [("N", int, dataclasses.field(default=3, metadata=bounds))])
    assert structure_field(dataclasses.fields(made)[0]) == ("N", "3", text, "")


@pytest.mark.slow
def test_a_new_model_runs_at_once(tmp_path: Path) -> None:
    run_module(tmp_path, "gaitsweep", "new-model", "jumper")
    folder = tmp_path / "jumper"
    checked = run_module(folder, "gaitsweep", "check-model", "jumper:Jumper")
    assert checked.startswith("jumper:Jumper: valid, 4 parameters")
    assert "32 cycle_limit. cycle_limit is no failure: 12 cycles are too few" in checked
    printed = run_module(folder, "gaitsweep", "run", "jumper.yaml", "--set", "verify=4")
    assert "4096 rows" in printed
    assert (folder / "results/jumper/figures/basin.png").exists()
    assert "3 passed" in run_module(folder, "pytest", "-q", "-p", "no:cacheprovider")


MODEL = """\
import dataclasses
import jax.numpy as jnp
from gaitsweep import DeclaredModel, event, parameter, variable


class Good(DeclaredModel):
    g = parameter("m/s2", "gravity", 9.81)
    z = variable("m", "height", 1.0)
    v = variable("m/s", "speed")

    def flow(self, p, s):
        return {"z": s.v, "v": -p.g}

    @event("lands", section=True)
    def landing(self, p, s):
        return -s.z

    @landing.jump
    def bounce(self, p, s):
        return s.replace(z=0.0, v=jnp.abs(s.v))

    def period(self, p):
        return jnp.sqrt(8.0 / p.g)
"""
BAD = {
    "": "valid, 1 parameter, 1 start, 1 observable, 2 signals, 1 gait",
    "N: int = 3": "annotates N",
    "g = parameter('', 'gravity', 9.81)": "whose g has no unit",
    "gaits = ()": "at least one name",
    "def period(self, p): return -p.g": "its function period returns -9.81",
    "def period(self, p): return jnp.sqrt(-p.g)": "its function period returns nan",
    "def flow(self, p, s): return {'z': 1.0 / s.v}": "its function flow returns inf for z",
    "def label(self, p, at): return {'gait': jnp.asarray(4)}": "label returns gait 4",
    "def failed(self, p, s): return s.z > 0.0": "its function failed returns True for its default start",
    "def failed(self, p, s): return s.z > 0.0 if p.g > 1 else s.z": "Use jnp.where",
    "def jump(self, p, s, fired): return s.replace(z=0.0)": "jump changes z",
    "def section(self, p, s, fired): return ~fired[0]": "section closes a cycle",
    "z = variable('m', 'height', 'log(0-1)')": "has a default without a value",
    "def flow(self, p, s): return {'height': s.v}": "height",
}


@pytest.mark.slow("0", "4")
@pytest.mark.parametrize("number", range(len(BAD)))
def test_faults_of_a_model_are_one_sentence(number: int, tmp_path: Path, capsys: Capture) -> None:
    line, sentence = list(BAD.items())[number]
    module = f"own_model_{number}"
    text = MODEL + (f"\n\nclass Mine(Good):\n    {line}\n" if line else "\n\nclass Mine(Good):\n    pass\n")
    (tmp_path / f"{module}.py").write_text(text)
    code = main(["check-model", f"{module}:Mine"])
    printed = capsys.readouterr()
    assert code == (2 if line else 0)
    assert sentence in (printed.err if line else printed.out)
    if line:
        assert printed.err.splitlines()[-1].startswith(f"The model is {module}:Mine, ")
        assert all(splitline.endswith(".") for splitline in printed.err.splitlines())


def test_objects_that_are_not_models_are_refused_as_by_a_job(capsys: Capture) -> None:
    assert "did you mean multilegged?" in refused(capsys, "check-model", "multileged")
    assert "cannot be imported" in refused(capsys, "check-model", "nowhere:Model")


def test_check_warns_of_a_jobs_own_rows(tmp_path: Path, capsys: Capture) -> None:
    """The job is good, but the second row begins below the floor."""
    (tmp_path / "falls.py").write_text(MODEL)
    Path("falls.yaml").write_text(
        "{name: falls, model: falls:Good, vary: {z_0: [1, -1]}, run: {kind: settle}}"
    )
    assert main(["check", "falls.yaml"]) == 0
    printed = capsys.readouterr()
    assert printed.out == "falls.yaml: valid, 2 rows\n"
    (printed,) = printed.err.splitlines()
    assert printed.startswith("Warning: falls.yaml: ")
    assert "event 'lands' at the start of row 1 (z_0 = -1)" in printed


@pytest.mark.slow
def test_a_new_paper_is_an_extension_like_any_other(tmp_path: Path) -> None:
    run_module(tmp_path, "gaitsweep", "new-paper", "my_paper")
    site = install(tmp_path, "./my_paper")
    assert "my_paper" in run_module(tmp_path, "gaitsweep", "models", site=site)
    printed = run_module(tmp_path, "gaitsweep", "reproduce", "my_paper", "--quick", site=site)
    assert "2 of 3 claims reproduced, 1 not reproduced" in printed
    table = "results/reproduce_my_paper/quick/basins"
    drawn = {each.stem for each in (tmp_path / table / "figures").glob("*.png")}
    assert drawn == {"basin", "my_paper_launches"}
    assert "2:1" in run_module(tmp_path, "gaitsweep", "analyse", "my-paper-launches", table, site=site)
    assert "3 passed" in run_module(tmp_path, "pytest", "-q", "-p", "no:cacheprovider", "my_paper", site=site)
