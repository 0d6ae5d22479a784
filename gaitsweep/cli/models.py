"""The commands about models: what there are, one of your own to begin with, and its test."""

from __future__ import annotations

import importlib.util
import keyword
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gaitsweep.cli.new_files import NewFilesError, write_folder
from gaitsweep.errors import REFUSED, ArgumentError
from gaitsweep.shipped import EXAMPLES

if TYPE_CHECKING:
    from gaitsweep.dynamics.mjx.mjcf_model import MjcfModel

_STEPS = 300  # beside MuJoCo C
_TEMPLATE = "hopper"
_FILES = ("hopper.py", "hopper.yaml", "package_of_a_model/README.md", "package_of_a_model/test_hopper.py")

# The files of a paper's package, by their places in it.
_PAPER = {
    "README.md": "package_of_a_paper/README.md",
    "pyproject.toml": "package_of_a_paper/pyproject.toml",
    "hopper/__init__.py": "package_of_a_paper/extension.py",
    "hopper/model.py": "hopper.py",
    "hopper/figures.py": "package_of_a_paper/figures.py",
    "hopper/analyses.py": "package_of_a_paper/analyses.py",
    "hopper/measures.py": "package_of_a_paper/measures.py",
    "hopper/jobs/hopper_basins.yaml": "package_of_a_paper/job.yaml",
    "hopper/configs/hopper.yaml": "package_of_a_paper/config.yaml",
    "hopper/claims/hopper.yaml": "package_of_a_paper/claims.yaml",
    "tests/test_hopper.py": "package_of_a_paper/test_package.py",
}


def models(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="A model; all of them are listed if not given.")
    ] = None,
) -> None:
    """List the models, or the parameters, starts, observables and gaits of one."""
    from gaitsweep import models as registry
    from gaitsweep.cli import show

    if name is None:
        show.model_list([(known, registry.find(known)) for known in registry.names()])
    else:
        show.model(name, registry.find(name))


def new_model(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Lower case, a Python name: my_hopper.")],
    to: Annotated[
        Path, typer.Option("--to", metavar="DIR", help="Where its folder NAME goes; here by default.")
    ] = Path(),
) -> None:
    """Write a model of your own to begin with, a hopper: model, job, test and README in a folder NAME."""
    _write(to / name, name, {Path(each).name: each for each in _FILES})
    print(f"Try it: cd {to / name} && gaitsweep run {name}.yaml && pytest")


def new_paper(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Lower case, a Python name: goswami1998.")],
    to: Annotated[
        Path, typer.Option("--to", metavar="DIR", help="Where its folder NAME goes; here by default.")
    ] = Path(),
) -> None:
    """Write the package of a paper to begin with: model, jobs, figures, analyses, measures, claims, test."""
    _write(to / name, name, _PAPER)
    print(f"Try it: pip install -e {to / name} && gaitsweep reproduce {name} --quick")


def _write(folder: Path, name: str, files: Mapping[str, str]) -> None:
    """Write example files with another name in the place of the template's, and print their paths.

    Args:
        folder: the new folder.
        name: of the model or the paper.
        files: paths in `EXAMPLES` by the paths of the new files.
    """
    _refuse_name(name)
    texts = {}
    for file, example in files.items():
        text = (EXAMPLES / example).read_text(encoding="utf-8")
        texts[file.replace(_TEMPLATE, name)] = text.replace(_TEMPLATE, name).replace(
            _class_name(_TEMPLATE), _class_name(name)
        )
    write_folder(folder, texts)
    for file in texts:
        print(folder / file)


def _class_name(name: str) -> str:
    """The class of a model by the name of its module: `my_hopper` gives MyHopper."""
    return "".join(part.capitalize() for part in name.split("_"))


def check_model(
    name: Annotated[
        str, typer.Argument(metavar="MODULE:CLASS", help="package.module:attribute, or a registered name.")
    ],
    steps: Annotated[
        int | None, typer.Argument(metavar="[STEPS]", min=1, help="Steps beside MuJoCo C; 300 by default.")
    ] = None,
    against_c: Annotated[
        bool,
        typer.Option(
            "--against-c",
            help="Step a model of an MJCF beside MuJoCo C, STEPS from each keyframe and 8 random states.",
        ),
    ] = False,
) -> None:
    """Test a model against the contract, and try some rows: what is wrong, a sentence each."""
    from gaitsweep import models as registry
    from gaitsweep.cli import show
    from gaitsweep.dynamics.mjx.mjcf_model import MjcfModel
    from gaitsweep.models.conformity import faults

    if steps is not None and not against_c:
        raise ArgumentError(f"{steps} is a number of steps for --against-c, which is not given.")

    kind = registry.find(name)
    if against_c and not issubclass(kind, MjcfModel):
        raise ArgumentError(f"{name} has no MJCF: --against-c is for models that derive from MjcfModel.")
    found = faults(kind)
    for words in found:
        print(f"The model is {name}, {words}", file=sys.stderr)
    if found:
        raise typer.Exit(REFUSED)
    from gaitsweep.runs.trial import trial  # of a model without faults

    tried = trial(kind)
    for words in tried.faults:
        print(f"The model is {name}, {words}", file=sys.stderr)
    if tried.faults:
        raise typer.Exit(REFUSED)
    print(f"{name}: good, {show.extent_of(kind())}")
    for remark in tried.remarks:
        print(remark)
    model = kind()
    if against_c:
        assert isinstance(model, MjcfModel)
        _step_against_c(name, model, steps or _STEPS)
    else:
        for caveat in model.caveats():
            print(f"Warning: {caveat}", file=sys.stderr)


def _step_against_c(name: str, model: MjcfModel, steps: int) -> None:
    """Print how a model of an MJCF moves beside MuJoCo C; it ends with REFUSED where it moves otherwise."""
    from gaitsweep.dynamics.mjx.against_c import compare
    from gaitsweep.dynamics.mjx.refusals import cautions

    for caution in cautions(model.mjx_body.mj_model):
        print(f"Warning: {caution}", file=sys.stderr)
    found = compare(model, steps)
    for parting in found.partings:
        print(parting, file=sys.stderr)
    agree = found.starts - len(found.partings)
    print(
        f"{name}: {agree} of {found.starts} motions of {steps} steps agree with MuJoCo C to 1e-5; largest "
        f"difference before a motion parts {found.largest:.1e}"
    )
    if found.wrong:
        raise typer.Exit(REFUSED)


def _refuse_name(name: str) -> None:
    from gaitsweep import models as registry

    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        near = re.sub(r"\W+", "_", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)).strip("_").lower()
        hint = f"; did you mean {near}?" if re.fullmatch(r"[a-z][a-z0-9_]*", near) and near != name else "."
        raise NewFilesError(
            f"The name {name!r} is no name of a Python module: it takes lower-case letters, digits and "
            f"underscores, a letter first{hint}"
        )
    if name in registry.names():
        raise NewFilesError(f"The name {name} is that of a model of gaitsweep: choose another.")
    known = importlib.util.find_spec(name)
    if known is not None and known.origin is not None:
        raise NewFilesError(f"The name {name} is that of a module of this Python: choose another.")
