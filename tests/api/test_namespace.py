"""The names of `import gaitsweep as gs`: exactly its API, imported at first use, typed, never rebound."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

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


PUBLIC = (
    "gaitsweep",
    "gaitsweep.analyses",
    "gaitsweep.claims",
    "gaitsweep.cli",
    "gaitsweep.contract",
    "gaitsweep.dynamics",
    "gaitsweep.dynamics.matsuoka",
    "gaitsweep.dynamics.mjx",
    "gaitsweep.dynamics.tree",
    "gaitsweep.expression",
    "gaitsweep.near_miss",
    "gaitsweep.plot",
    "gaitsweep.status",
)


def test_names() -> None:
    names = vars(gs)["__all__"]
    assert dir(gs) == sorted(names) == sorted(set(names))
    for name in names:
        assert getattr(gs, name) is not None
    with pytest.raises(AttributeError, match="nothing"):
        _ = gs.nothing  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("name", PUBLIC)
def test_public_modules(name: str) -> None:
    module = importlib.import_module(name)
    assert set(module.__all__) <= set(dir(module))
    for public in module.__all__:
        assert getattr(module, public) is not None
    with pytest.raises(AttributeError, match="nothing"):
        _ = module.nothing


def test_kinds_of_figures_are_listed() -> None:
    """Kinds of extensions too; each name is a function, also where a module has the same name."""
    assert {"basin", "footprints", "solution_set", "figure_kind"} <= set(dir(gs.plot))
    assert all(callable(getattr(gs.plot, kind)) for kind in gs.plot.FIGURES)


def papers() -> list[Path]:
    """The files of papers and examples, which a user could have written."""
    root = Path(gs.__file__).parent
    goswami = root.parent / "docs/papers"
    return [file for folder in (root / "papers", root / "examples", goswami) for file in folder.rglob("*.py")]


def test_papers_import_the_public_api_alone() -> None:
    """As a user's own package: public modules, and of these the names in `__all__`."""
    for file in papers():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                ours = [alias.name for alias in node.names if alias.name.startswith("gaitsweep")]
                assert ours in ([], ["gaitsweep"]), (file, node.lineno)
            elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "gaitsweep":
                assert node.module is not None
                if node.module.startswith("gaitsweep.papers") or file.parent.name == "papers":
                    continue  # a paper's own modules; papers/__init__.py finds the folders of the checkout
                assert node.module in PUBLIC, (file, node.lineno, node.module)
                listed = set(importlib.import_module(node.module).__all__)
                assert {alias.name for alias in node.names} <= listed, (file, node.lineno)


def test_no_module_outside_papers_names_a_paper() -> None:
    # (?<!l): Lambert is no paper
    named = re.compile(r"multilegged|waist|planar.?quadruped|(?<!l)ambe|aoi|fukuoka", re.IGNORECASE)
    root = Path(gs.__file__).parent
    for file in root.rglob("*"):
        if file.is_dir() or "papers" in file.relative_to(root).parts or file.suffix == ".pyc":
            continue
        text = file.read_text(encoding="utf-8")
        if file.relative_to(root).parts[0] == "dynamics":  # its docstrings cite the sources of equations
            text = re.sub(r'""".*?"""', "", text, flags=re.DOTALL)
        assert (found := named.search(text)) is None, (file, found)


def test_no_module_rebinds_a_function() -> None:
    """An imported submodule replaces an attribute of its package that has the same name."""
    for module in pkgutil.walk_packages(gs.__path__, "gaitsweep."):
        # the command line runs when it is imported, and the painter fixes MuJoCo's OpenGL for the process
        if not module.name.endswith(("__main__", "mujoco_painter")):
            importlib.import_module(module.name)
    for name in PUBLIC:
        package = importlib.import_module(name)
        modules = {module.name for module in pkgutil.iter_modules(getattr(package, "__path__", ()))}
        stub = Path(str(package.__file__)).with_suffix(".pyi")
        imports = ast.walk(ast.parse(stub.read_text(encoding="utf-8"))) if modules and stub.exists() else ()
        for node in imports:
            if isinstance(node, ast.ImportFrom) and node.module != name:
                assert not modules & {alias.asname for alias in node.names}, name
    assert not hasattr(gs.plot, "basins")  # nor a module where a near miss is proposed
    assert not {module.name for module in pkgutil.iter_modules(gs.plot.__path__)} & set(gs.plot.FIGURES)


def imported_by(code: str, *names: str) -> list[str]:
    """The modules among `names` that a new Python process has imported after some code."""
    code = f"{code}\nimport sys; print(*[name for name in {names} if name in sys.modules])"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    return shown.splitlines()[-1].split()


def test_the_import_is_light() -> None:
    """So that `gaitsweep --help` does not wait for JAX and pandas."""
    assert not imported_by("import gaitsweep", "jax", "pandas", "matplotlib")


def test_reading_a_job_is_light() -> None:
    """Even a job with figures needs neither SciPy's subpackages nor MuJoCo, which are slow to import."""
    heavy = ("scipy.stats", "scipy.optimize", "scipy.signal", "scipy.ndimage", "scipy.spatial", "mujoco")
    assert not imported_by("import gaitsweep.job, gaitsweep.plot.kinds", *heavy)


def test_a_sweep_imports_no_figures() -> None:
    """Nor the explorer, movies or a cluster: they would double the time of a first small sweep."""
    heavy = ("matplotlib", "gaitsweep.plot.kinds", "gaitsweep.view", "gaitsweep.fitting", "distributed")
    assert not imported_by("import gaitsweep as gs; gs.sweep, gs.run, gs.Settle, gs.Job, gs.Result", *heavy)


def test_help_reads_no_extension() -> None:
    code = "from gaitsweep.cli import main; main(['--help'])"
    assert not imported_by(code, "gaitsweep.papers", "jax", "pandas")


@pytest.mark.slow
def test_types_from_a_users_side(tmp_path: Path) -> None:
    """The package is typed (`py.typed`): calls give known types, and wrong ones are found by pyright."""
    script = tmp_path / "script.py"
    script.write_text(USER_SCRIPT + "\n".join([*WRONG, ""]))
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


@pytest.mark.parametrize(
    ("place", "name", "near"),
    [
        (gs, "retrun_map", "return_map"),
        (gs.models, "Multilegge", "Multilegged"),
        (gs.analyses, "atractors", "attractors"),
        (gs.plot, "footprint", "footprints"),
    ],
)
def test_a_wrong_public_name_has_a_near_miss(place: Any, name: str, near: str) -> None:
    with pytest.raises(AttributeError, match=f"did you mean {near}"):
        getattr(place, name)
