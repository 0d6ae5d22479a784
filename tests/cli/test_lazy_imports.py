"""Packages that a command does not need, and does not import."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
import threading
from importlib import metadata
from pathlib import Path

import pytest

from gaitsweep.lazy_imports import LAZY, Lazy, _without_rocm

ROOT = Path(__file__).parents[2]
COMMAND = """
import json, sys
from gaitsweep.cli.main import main
assert main(sys.argv[1:]) == 0
print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules})))
"""


@pytest.mark.parametrize(
    ("arguments", "absent"),
    [
        (["--help"], {*LAZY, "numpy", "pydantic", "llvmlite"}),
        (["check", "sweeps/quick_basins.yaml"], {*LAZY, "llvmlite"}),
    ],
    ids=["help", "check"],
)
def test_commands_do_not_import_what_they_do_not_need(arguments: list[str], absent: set[str]) -> None:
    command = [sys.executable, "-c", COMMAND, *arguments]
    # the first check of a model traces its functions, which later ones read from the cache
    *_, printed = (
        subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for _ in arguments
    )
    imported = set(json.loads(printed.splitlines()[-1]))
    assert not absent & imported


@pytest.mark.slow
def test_a_known_job_is_run_and_drawn_without_jax(tmp_path: Path) -> None:
    """Fig. 4 of Ambe 2021: opening, labels, self-check and analytic solutions come from stored programs."""
    few = [f"--set=vary.psi_{i}={{linspace: [0, 2*pi, 2], at: centre}}" for i in (1, 2, 3)]
    for name in ("first", "second", "third"):
        job = ["run", "sweeps/multilegged_solution_set.yaml", *few, "--out", str(tmp_path / name)]
        command = [sys.executable, "-c", COMMAND, *job]
        environment = {**os.environ, "GAITSWEEP_CACHE": str(tmp_path / "cache")}
        run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    imported = set(json.loads(run.stdout.splitlines()[-1]))
    assert "matplotlib" in imported
    assert "jax" not in imported


def test_jax_is_imported_without_reading_the_metadata_of_all_packages() -> None:
    program = """
import importlib.metadata, sys
every = importlib.metadata.distributions
from gaitsweep import lazy_imports
assert "jax" not in sys.modules
import jax
assert importlib.metadata.distributions is every
assert any(True for _ in every())
"""
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)


def test_modules_that_were_imported_before_jax_work_with_it() -> None:
    """Dataclasses are pytrees, functions are jitted, and programs are stored by the same settings of JAX."""
    program = """
import sys
import numpy as np
from gaitsweep import lazy_imports
with lazy_imports.lazy_packages():
    from gaitsweep.papers.ambe2021.multilegged.state import State
    from gaitsweep.papers.ambe2021.theory import gaits
    from gaitsweep.engine import devices, stored_traces
    devices.see_all_cores()
assert "jax" not in sys.modules and not isinstance(np.zeros(1), gaits.jax.Array)
before = stored_traces._settings()
import jax
assert jax.config.jax_num_cpu_devices == devices.usable_cores()
assert jax.tree.leaves(State(*range(7))) == list(range(7))
assert gaits.segments.lower and gaits.jax.Array is jax.Array
assert stored_traces._settings() == before
jax.config.update("jax_default_matmul_precision", "highest")
assert stored_traces._settings() != before
"""
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)


def test_a_lazy_name_stands_for_the_object() -> None:
    names = {"Name": Lazy({}, "json", "JSONDecoder")}
    lazy = names["Name"] = Lazy(names, "json", "JSONDecoder")
    assert lazy().decode("[1]") == [1]
    assert names["Name"] is json.JSONDecoder
    assert isinstance(json.JSONDecoder(), lazy)  # pyright: ignore[reportArgumentType]
    assert Lazy({}, "xml", "etree").__name__ == "xml.etree"


@pytest.mark.slow
def test_no_error_is_caught_by_a_lazy_name() -> None:
    """Python takes no name that stands for a class after `except`: it needs the attribute of its module."""
    for path in (ROOT / "gaitsweep").rglob("*.py"):
        module = ast.parse(path.read_text(encoding="utf-8"))
        imports = [node for node in module.body if isinstance(node, ast.ImportFrom)]
        lazy = {
            each.asname or each.name
            for node in imports
            if str(node.module).partition(".")[0] in LAZY
            for each in node.names
        }
        handlers = [node for node in ast.walk(module) if isinstance(node, ast.ExceptHandler)]
        caught = [kind for each in handlers for kind in getattr(each.type, "elts", [each.type])]
        assert not lazy & {kind.id for kind in caught if isinstance(kind, ast.Name)}, path


def test_modules_of_packages_are_found_by_all_forms_of_import() -> None:
    program = """
import sys
from gaitsweep import lazy_imports
names = {"__name__": "gaitsweep.any"}
lines = "matplotlib.dates", "matplotlib.ticker", "mpl_toolkits.axes_grid1.inset_locator as y"
with lazy_imports.lazy_packages():
    for line in lines:
        exec(f"import {line}", names)
assert not {"matplotlib", "mpl_toolkits"} & set(sys.modules)
assert names["matplotlib"].rcParams
assert names["matplotlib"].dates.DateFormatter and names["matplotlib"].ticker.Locator
assert names["y"].inset_axes.__name__ == "inset_axes"
"""
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)


def test_threads_that_import_jax_restore_the_search_for_packages() -> None:
    every, entered = metadata.distributions, threading.Event()

    def second() -> None:
        with _without_rocm():
            entered.set()
            left.wait(1.0)

    left, thread = threading.Event(), threading.Thread(target=second)
    with _without_rocm():
        thread.start()
        entered.wait(0.1)
    left.set()
    thread.join()
    assert metadata.distributions is every
