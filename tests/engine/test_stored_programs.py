"""Stored programs of a model are used as long as nothing that decides them has changed."""

from __future__ import annotations

import importlib
import itertools
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.api.keywords import job_of
from gaitsweep.cache_folder import cache_folder
from gaitsweep.engine import stored_traces
from gaitsweep.engine.content import depends_on, lasting_content
from gaitsweep.engine.kernel.row_functions import over_rows, stored_function
from gaitsweep.engine.stored_traces import stored
from gaitsweep.runs.prepare import prepare

MODEL = """
{imports}
import jax.numpy as jnp
import gaitsweep as gs
from {beside} import STIFFNESS

class Spring(gs.DeclaredModel):
    q = gs.parameter("1/s", "rate", 1.0)
    k = gs.parameter("1", "no part of the flow", 1.0)
    x = gs.variable("m", "position", 1.0)
    v = gs.variable("m/s", "speed", 0.0)

    def flow(self, p, s):
        {statement}
        return {{"x": s.v, "v": -(p.q**2) * STIFFNESS * s.x}}

    @gs.event("v rises through 0", section=True)
    def turns(self, p, s):
        return s.v

    def period(self, p):
        return 2.0 * jnp.pi / p.q
"""
_NUMBERS = itertools.count()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder from which modules are imported, beside a cache."""
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(stored_traces, "cache_folder", cache_folder)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def spring(folder: Path, imports: str = "", statement: str = "", stiffness: float = 1.0) -> Any:
    """A model of a module, and of another one beside it."""
    name = f"stored_spring_{next(_NUMBERS)}"
    (folder / f"{name}_beside.py").write_text(f"STIFFNESS = {stiffness}\n")
    text = MODEL.format(imports=imports, statement=statement, beside=f"{name}_beside")
    (folder / f"{name}.py").write_text(text)
    return importlib.import_module(name).Spring()


READS = {
    "environment": ("import os", "float(os.environ.get('STIFFNESS', '1'))"),
    "clock": ("from time import time", "time()"),
    "file": ("", "open('stiffness')"),
    "array of a file": ("import numpy", "numpy.load('stiffness')"),
    "import": ("", "import os"),
    "computed name": ("", "getattr(gs, 'stiffness', 1.0)"),
    "another package": ("import yaml", "yaml.safe_load('1.0')"),
    "draw": ("import numpy", "numpy.random.default_rng().normal()"),
}


@pytest.mark.parametrize("name", READS)
def test_models_that_read_what_no_digest_holds_are_not_stored(folder: Path, name: str) -> None:
    assert lasting_content(spring(folder)) is not None
    assert lasting_content(spring(folder, *READS[name])) is None


def test_models_without_a_source_or_with_a_data_file_are_not_stored(folder: Path) -> None:
    model = spring(folder)
    of_session: Any = type("Spring", (type(model),), {"__module__": "__main__"})
    assert lasting_content(of_session()) is None
    depends_on(model, [folder / "table.csv"])
    assert lasting_content(model) is None


def test_a_model_that_reads_a_named_tuple_is_stored(folder: Path) -> None:
    imports = (
        "from typing import NamedTuple\n\nclass Gains(NamedTuple):\n    k: float = 1.0\n\ngains = Gains()\n"
    )
    assert lasting_content(spring(folder, imports, "gains.k")) is not None


def test_an_edited_module_beside_a_model_is_another_content(folder: Path) -> None:
    model = spring(folder)
    before = lasting_content(model)
    (folder / f"{type(model).__module__}_beside.py").write_text("STIFFNESS = 1.0  # edited\n")
    assert lasting_content(model) not in (before, None)


def test_programs_of_a_function_are_stored_by_its_code(folder: Path) -> None:
    def doubled(source: str) -> Any:
        name = f"stored_function_{next(_NUMBERS)}"
        (folder / f"{name}.py").write_text(source)
        return importlib.import_module(name).doubled

    function = doubled("def doubled(x):\n    return 2.0 * x\n")
    content = lasting_content(function)
    assert content not in (None, lasting_content(doubled("def doubled(x):\n    return x + x\n")))
    assert lasting_content(function, 3) not in (None, content)
    assert lasting_content(doubled("import os\ndef doubled(x):\n    return x * len(os.environ)\n")) is None
    np.testing.assert_array_equal(stored_function(function)(np.arange(3.0)), [0.0, 2.0, 4.0])
    assert len(list((folder / "cache").rglob("doubled_*"))) == 1


def test_a_function_of_rows_follows_what_it_reads(folder: Path) -> None:
    name = f"stored_function_{next(_NUMBERS)}"
    (folder / f"{name}.py").write_text("gain = 2.0\ndef scaled(x):\n    return gain * x\n")
    module: Any = importlib.import_module(name)
    of_rows = stored_function(module.scaled)
    assert of_rows(np.ones(2)).tolist() == [2.0, 2.0]
    module.gain = 3.0
    assert of_rows(np.ones(2)).tolist() == [3.0, 3.0]


def test_results_are_stored_by_what_decides_them(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model, calls = spring(folder), itertools.count()

    def work_out() -> list[int]:
        return [next(calls)]

    assert stored("name", model, (1.0,), work_out) == stored("name", model, (1.0,), work_out) == [0]
    assert stored("name", model, (2.0,), work_out) == [1]
    assert stored("other", model, (1.0,), work_out) == [2]
    monkeypatch.setattr(stored_traces, "_SOURCES", "another version")
    assert stored("name", model, (1.0,), work_out) == [3]


@pytest.mark.slow
def test_what_moves_a_parameter_decides_a_program(folder: Path) -> None:
    """A staircase or ramp with the same values has the same content, and with other values another."""
    model = spring(folder)

    def of_drive(run: Any, **values: Any) -> str | None:
        return lasting_content(
            model, prepare(job_of(model, {"x_0": [1.0, 2.0], **values}, run=run)).spec.drive
        )

    def stairs(highest: float, dwell: float = 5.0) -> gs.Staircase:
        return gs.Staircase(parameter="q", path=[1.0, highest], step=0.5, dwell=dwell)

    ramp = gs.Ramp(parameter="q", path=[1.0, 2.0], rate=0.1)
    contents = [
        of_drive(stairs(2.0)),
        of_drive(stairs(3.0)),
        of_drive(stairs(2.0, dwell=6.0)),
        of_drive(stairs(2.0), k="2 * q"),
        of_drive(stairs(2.0), k="3 * q"),
        of_drive(ramp),
        of_drive(gs.Settle()),
    ]
    assert None not in contents
    assert len(set(contents)) == len(contents)
    assert of_drive(stairs(2.0)) == contents[0]


def test_damaged_entries_are_worked_out_again(folder: Path) -> None:
    model, calls = spring(folder), itertools.count()
    assert stored("name", model, (), lambda: next(calls)) == 0
    (file,) = (folder / "cache" / "programs").iterdir()
    for n, damaged in enumerate((b"", b"5", file.read_bytes()[:-1], b"\0" * 33), start=1):
        file.write_bytes(damaged)
        assert stored("name", model, (), lambda: next(calls)) == n


def test_a_stored_program_has_the_same_bits(folder: Path) -> None:
    model, x = spring(folder), np.random.default_rng(0).normal(size=(2, 50))

    def function(values: Any) -> Any:
        return {"a": model.period(model.params({"q": values["q"], "k": 1.0})), "b": [values["x"] / 3.0, None]}

    given = {"q": x[0], "x": x[1]}
    traced = over_rows(function)(given)
    for _ in range(2):
        again = over_rows(function, "function", model)(given)
        np.testing.assert_array_equal(again["a"], traced["a"])
        np.testing.assert_array_equal(again["b"][0], traced["b"][0])
    assert len(list((folder / "cache" / "programs").iterdir())) == 1


SCRIPT = """
import gaitsweep as gs
from spring import Spring
# fine tolerances: whether taylor is faster is decided from a trace, too
fine = {"rtol": 1e-12, "atol": 1e-12}
result = gs.sweep(Spring(), q=[0.5, 1.0, 2.0], x_0=1.0, run=gs.FixedTime(duration=3.0), numerics=fine)
print(result.table[["x_end", "v_end"]].to_numpy().tolist())
"""


@pytest.mark.slow
def test_another_process_traces_nothing_and_an_edited_model_anew(tmp_path: Path) -> None:
    def run(stiffness: float) -> tuple[int, str]:
        """The number of traces of the flow, and the table."""
        (tmp_path / "beside.py").write_text(f"STIFFNESS = {stiffness}\n")
        paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
        place = {**os.environ, "GAITSWEEP_CACHE": str(tmp_path / "cache"), "PYTHONPATH": paths}
        command = [sys.executable, "-c", SCRIPT]
        done = subprocess.run(command, cwd=tmp_path, env=place, check=True, capture_output=True, text=True)
        *traced, table = done.stdout.splitlines()
        assert set(traced) <= {"traced"}
        return len(traced), table

    text = MODEL.format(imports="", statement='print("traced")', beside="beside")
    (tmp_path / "spring.py").write_text(text)
    first, table = run(1.0)
    assert first > 0
    assert run(1.0) == (0, table)
    edited, other = run(4.0)
    assert edited > 0
    assert other != table
