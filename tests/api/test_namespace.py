"""What `import gaitsweep as gs` offers: exactly its API, imported lazily, typed, never rebound."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import gaitsweep as gs

USER_SCRIPT = """\
import numpy as np
import gaitsweep as gs

chain = gs.models.MultileggedReduced(N=3)
one = gs.simulate(chain, psi_1=1.0, psi_2=2.0, psi_3=3.0, duration=60)
reveal_type(one)
axis = np.linspace(0, 6.2, 33)
result = gs.sweep(chain, psi_1=axis, psi_2=axis, psi_3=3.1, run=gs.Settle(max_cycles=150))
reveal_type(result.table)
reveal_type(result.plot.basin(x="psi_1", y="psi_2"))
reveal_type(gs.basins(result.table).fractions)
mapping = gs.return_map(chain, beta=0.8)
reveal_type(mapping(np.zeros(3)))
reveal_type(mapping.fixed_points({"psi_1": 1.0}).converged)
reveal_type(gs.hysteresis(result.table).loops)
reveal_type(gs.run("job.yaml").path)
reveal_type(gs.__version__)
"""
TYPES = (
    *("DataFrame", "DataFrame", "Figure", "DataFrame", "ndarray", "ndarray", "DataFrame"),
    *("Path", "str"),
)
WRONG = {
    "gs.Settle(max_cycle=150)": "max_cycle",
    'gs.run("job.yaml").plot.basin(x="psi_1")': "y",
    "gs.nothing": "nothing",
    'gs.simulate("multilegged")': "duration",
}


def test_names() -> None:
    assert dir(gs) == sorted(gs.__all__) == sorted(set(gs.__all__))
    for name in gs.__all__:
        assert getattr(gs, name) is not None
    imports = [
        each
        for each in ast.walk(ast.parse(Path(gs.__file__).read_text()))
        if isinstance(each, ast.ImportFrom)
    ]
    typed = {alias.name for each in imports for alias in each.names if alias.asname is not None}
    assert typed | {"__version__"} == set(gs.__all__), "a type checker sees other names than Python"
    with pytest.raises(AttributeError, match="nothing"):
        _ = gs.nothing  # pyright: ignore[reportAttributeAccessIssue]


def test_no_module_rebinds_a_function() -> None:
    """An imported submodule becomes an attribute of its package, whatever stood there."""
    for module in pkgutil.walk_packages(gs.__path__, "gaitsweep."):
        if not module.name.endswith("__main__") and "painter" not in module.name:
            importlib.import_module(module.name)
    for name in ("run", "sweep", "simulate", "basins", "return_map", "hysteresis", "load", "sensitivity"):
        assert callable(getattr(gs, name)), name


def test_the_import_is_light() -> None:
    """`gaitsweep --help` has to answer before JAX and pandas could be imported."""
    code = "import sys, gaitsweep; print([m for m in ('jax', 'pandas', 'matplotlib') if m in sys.modules])"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.strip() == "[]"


def test_reading_a_job_is_light() -> None:
    """A job needs every kind of figure, but neither SciPy's parts nor MuJoCo, which are as slow as JAX."""
    heavy = ("scipy.stats", "scipy.optimize", "scipy.signal", "scipy.ndimage", "scipy.spatial", "mujoco")
    code = f"import sys, gaitsweep.job, gaitsweep.plot; print([m for m in {heavy} if m in sys.modules])"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.strip() == "[]"


@pytest.mark.slow
def test_types_from_a_users_side(tmp_path: Path) -> None:
    """The package is typed (`py.typed`): calls give known types, and wrong ones are found by pyright."""
    script = tmp_path / "script.py"
    wrong = "\n".join(f"{line}" for line in WRONG)
    script.write_text(f"{USER_SCRIPT}{wrong}\n")
    repository = Path(gs.__file__).parents[1]
    (tmp_path / "pyrightconfig.json").write_text(f'{{"extraPaths": ["{repository}"]}}')
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, str(script)]
    shown = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False).stdout
    lines = shown.splitlines()
    types = [line for line in lines if "information: Type of" in line]
    assert len(types) == len(TYPES), shown
    for line, name in zip(types, TYPES, strict=True):
        assert name in line.rpartition(" is ")[2], line
    errors = [line for line in lines if "error:" in line]
    assert len(errors) == len(WRONG), shown
    for line, word in zip(errors, WRONG.values(), strict=True):
        assert word in line, line


def test_py_typed_is_in_the_package() -> None:
    assert (Path(gs.__file__).parent / "py.typed").exists()
