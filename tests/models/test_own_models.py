"""A user's own model: its module and those beside it decide the hash, and are loaded anew when edited."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from collections.abc import Iterator
from pathlib import Path

import jax.numpy as jnp
import pytest

from gaitsweep import models
from gaitsweep.errors import JobError
from gaitsweep.job import Job, load_job
from gaitsweep.own_modules import modules_beside
from gaitsweep.runs import provenance
from gaitsweep.runs.prepare import prepare

MODEL = """\
import dataclasses
import toy_model
import {package}.springs as springs


@dataclasses.dataclass(frozen=True)
class Own(toy_model.Toy):
    def period(self, params):
        return springs.factor() * super().period(params)
"""
JOB = "name: a\nmodel: {package}_model:Own\nvary: {{launch_1: [1, 2]}}\nrun: {{kind: settle}}\n"


@pytest.fixture
def folder(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[tuple[Path, str]]:
    """A folder with a model that imports from a package beside it, under names that no other test uses."""
    package = f"own_{request.node.name.partition('[')[0]}"
    (tmp_path / package).mkdir()
    write(tmp_path / package / "__init__.py", "")
    write(
        tmp_path / package / "springs.py",
        "from . import numbers_of\n\n\ndef factor():\n    return numbers_of.TWO\n",
    )
    write(tmp_path / package / "numbers_of.py", "TWO = 2.0\n")
    write(tmp_path / package / "unused.py", "THREE = 3.0\n")
    write(tmp_path / f"{package}_model.py", MODEL.format(package=package))
    write(tmp_path / "job.yaml", JOB.format(package=package))
    yield tmp_path, package
    for name in [name for name in sys.modules if name.startswith(package)]:
        del sys.modules[name]


def write(file: Path, text: str) -> None:
    """Write a file, later than anything that was written before it."""
    file.write_text(text)
    write.clock += 10**9  # type: ignore[attr-defined]
    os.utime(file, ns=(write.clock, write.clock))  # type: ignore[attr-defined]


write.clock = 10**18  # type: ignore[attr-defined]


def found(folder: Path) -> tuple[Job, str]:
    job = load_job(folder / "job.yaml")
    return job, prepare(job).job_hash


def period(job: Job) -> float:
    model = job.design.model
    values = {name: jnp.asarray(column[0]) for name, column in job.design.values(0, 1)[0].items()}
    return float(model.period(model.params(values)))


def test_modules_beside_are_those_that_are_imported(folder: tuple[Path, str]) -> None:
    path, package = folder
    load_job(path / "job.yaml")
    beside = modules_beside(sys.modules[f"{package}_model"])
    own = [name for name in beside if name.startswith(package)]
    assert own == [package, f"{package}.numbers_of", f"{package}.springs", f"{package}_model"]
    assert not [name for name in beside if name.startswith(("jax", "numpy", "gaitsweep"))]


def test_modules_beside_are_found_in_the_folder_of_an_environment(tmp_path: Path) -> None:
    """`python -m venv .` makes an environment in the folder of the user's own files."""
    venv.create(tmp_path, symlinks=True, with_pip=False)
    write(tmp_path / "my_walker.py", "import my_legs\n")
    write(tmp_path / "my_legs.py", "LEGS = 2\n")
    code = (
        f"import sys; sys.path += {[str(tmp_path), *sys.path]!r}; import my_walker\n"
        "from gaitsweep.own_modules import installed, modules_beside\n"
        "print(*modules_beside(my_walker), installed(my_walker))"
    )
    python = [tmp_path / "bin" / "python", "-c", code]
    printed = subprocess.run(python, capture_output=True, text=True, check=True)
    assert printed.stdout.split() == ["my_legs", "my_walker", "False"]


@pytest.mark.slow
def test_an_edit_beside_the_model_is_another_job(folder: tuple[Path, str]) -> None:
    path, package = folder
    job, before = found(path)
    seconds = period(job)
    assert found(path)[1] == before
    write(path / package / "numbers_of.py", "TWO = 4.0\n")
    edited, after = found(path)
    assert after != before
    assert period(edited) == pytest.approx(2.0 * seconds, rel=1e-12)  # the new number is the one that runs
    write(path / package / "numbers_of.py", "TWO = 2.0\n")
    again, back = found(path)
    assert back == before
    assert period(again) == pytest.approx(seconds, rel=1e-12)


def test_modules_that_are_not_imported_do_not_count(folder: tuple[Path, str]) -> None:
    path, package = folder
    _, before = found(path)
    write(path / package / "unused.py", "THREE = 4.0\n")
    assert found(path)[1] == before


@pytest.mark.slow
def test_an_import_that_comes_with_an_edit_is_followed(folder: tuple[Path, str]) -> None:
    path, package = folder
    job, before = found(path)
    seconds = period(job)
    text = "from .unused import THREE\n\n\ndef factor():\n    return THREE\n"
    write(path / package / "springs.py", text)
    edited, after = found(path)
    assert after != before
    assert period(edited) == pytest.approx(1.5 * seconds, rel=1e-12)
    write(path / package / "unused.py", "THREE = 6.0\n")
    assert period(found(path)[0]) == pytest.approx(3.0 * seconds, rel=1e-12)


@pytest.mark.slow
def test_a_data_file_that_is_read_at_import_is_loaded_anew(folder: tuple[Path, str]) -> None:
    """The source is the same; the traced program is another."""
    path, package = folder
    data = path / package / "two.txt"
    write(data, "2.0")
    write(
        path / package / "numbers_of.py",
        f"from pathlib import Path\n\nTWO = float(Path({str(data)!r}).read_text())\n",
    )
    job, _ = found(path)
    program, length = prepare(job).program, period(job)
    write(data, "3.0")
    job, _ = found(path)
    assert period(job) == pytest.approx(1.5 * length, rel=1e-12)
    changed = prepare(job).program
    assert "period" in {name for name in changed if changed[name] != program[name]}
    assert changed["flow"] == program["flow"]


def test_a_missing_module(folder: tuple[Path, str]) -> None:
    path, package = folder
    nowhere = f"cannot be imported: no module of that name is installed or in {path}"
    for meant, misspelt in (
        (f"{package}_model", f"{package}_modle"),
        (f"{package}.springs", f"{package}.sprigns"),
    ):
        with pytest.raises(models.ModelError, match=rf"{nowhere}.* did you mean {meant}\?"):
            models.find(f"{misspelt}:Own", [path])
    with pytest.raises(models.ModelError) as error:
        models.find("zzzz:Own", [path])
    assert "did you mean" not in str(error.value)
    # not the model's module is missing, but one that it imports
    write(path / f"{package}_other.py", f"import {package}_numbers\n")
    where = rf"\({package}_other\.py, line 1\)"
    with pytest.raises(
        models.ModelError, match=f"ModuleNotFoundError {where}: No module named '{package}_numbers'"
    ):
        models.find(f"{package}_other:Own", [path])


CLOCKS = """\
import gaitsweep as gs


class NoPeriod(gs.DeclaredModel):
    omega = gs.parameter("rad/s", "frequency", 6.0)
    phase = gs.variable("rad", "phase", 0.0, circular=True)

    def flow(self, p, s):
        return {"phase": p.omega}

    @gs.event("a turn ends", section=True)
    def turn(self, p, s):
        return s.phase - 6.0


class NoRate(NoPeriod):
    def flow(self, p, s):
        speed = 2.0
        return {"phase": speed * p.rate}

    def period(self, p):
        return 1.0


class OtherPeriod(NoPeriod):
    def period(self, p):
        return 6.0 / p.frequency
"""


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("NoPeriod", r"lacks period\(self, params\), the nominal period of a cycle \(s\)"),
        ("NoRate", r"flow raises AttributeError \(\w+_clocks\.py, line 19\): .*no field rate"),
        ("OtherPeriod", r"period raises AttributeError \(\w+_clocks\.py, line 27\): .*no field frequency"),
    ],
)
def test_errors_name_what_is_missing_and_the_line(folder: tuple[Path, str], name: str, message: str) -> None:
    path, package = folder
    write(path / f"{package}_clocks.py", CLOCKS)
    write(path / "job.yaml", f"name: a\nmodel: {package}_clocks:{name}\nrun: {{kind: settle}}\n")
    with pytest.raises(JobError, match=message):
        load_job(path / "job.yaml")


def test_a_broken_edit_is_a_sentence(folder: tuple[Path, str]) -> None:
    path, package = folder
    before = found(path)[1]
    write(path / package / "numbers_of.py", "TWO = \n")
    with pytest.raises(models.ModelError, match="cannot be imported: SyntaxError"):
        models.find(f"{package}_model:Own", [path])
    write(path / package / "numbers_of.py", "TWO = 2.0\n")
    assert found(path)[1] == before


def test_provenance_has_everything_that_determines_results() -> None:
    versions = provenance.versions()
    for package in ("jax", "numpy", "scipy", "llvmlite", "mujoco", "mujoco-mjx"):
        assert versions[package][0].isdigit()
    assert "cuda-core" in versions
