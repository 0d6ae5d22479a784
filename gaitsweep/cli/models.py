"""The commands about models: a list of models, templates of models and papers, and a test."""

from __future__ import annotations

import importlib.util
import keyword
import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from gaitsweep.cli.new_files import NewFilesError, write_folder
from gaitsweep.cli.options import NewFolder, print_message
from gaitsweep.errors import EXIT_REFUSED, ArgumentError
from gaitsweep.shipped import EXAMPLES, portable_text

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
        str | None, Argument(metavar="NAME", help="Model to describe; by default all models are listed.")
    ] = None,
) -> None:
    """List all models, or describe one model.

    Its parameters, starts, observables and gaits.
    """
    from gaitsweep import models as registry
    from gaitsweep.cli import show

    if name is None:
        show.model_list([(model, registry.find(model)) for model in registry.names()])
    else:
        show.model(name, registry.find(name))


def new_model(
    name: Annotated[str, Argument(metavar="NAME", help="Name in lower case, valid in Python: my_hopper.")],
    to: NewFolder = Path(),
) -> None:
    """Write a template of your own model.

    A hopper in a folder NAME: model, job, test and README.
    """
    _write(to / name, name, {Path(example).name: example for example in _FILES})
    print(f"Try it: cd {shlex.quote(str(to / name))} && gaitsweep run {name}.yaml && pytest")


def new_paper(
    name: Annotated[str, Argument(metavar="NAME", help="Name in lower case, valid in Python: goswami1998.")],
    to: NewFolder = Path(),
) -> None:
    """Write a template of a paper's package.

    It has a model, jobs, figures, analyses, measures, claims and a test.
    """
    _write(to / name, name, _PAPER)
    print(f"Try it: pip install -e {shlex.quote(str(to / name))} && gaitsweep reproduce {name} --quick")


def _write(folder: Path, name: str, files: Mapping[str, str]) -> None:
    """Write example files with a new name instead of the template's, and print their paths.

    Args:
        folder: the new folder.
        name: the name of the model or the paper.
        files: mapping from the paths of the new files to paths in `EXAMPLES`.
    """
    _refuse_name(name)
    texts = {}
    for file, example in files.items():
        text = portable_text(EXAMPLES / example).replace(_TEMPLATE, name)
        texts[file.replace(_TEMPLATE, name)] = text.replace(_class_name(_TEMPLATE), _class_name(name))
    write_folder(folder, texts)
    for file in texts:
        print(folder / file)


def _class_name(name: str) -> str:
    """The name of a model's class from that of its module: `my_hopper` gives MyHopper."""
    return "".join(part.capitalize() for part in name.split("_"))


def check_model(
    name: Annotated[
        str, Argument(metavar="MODULE:CLASS", help="Model: package.module:attribute, or a registered name.")
    ],
    steps: Annotated[
        int | None, Argument(metavar="[STEPS]", min=1, help="Number of steps of --against-c; 300 by default.")
    ] = None,
    against_c: Annotated[
        bool,
        Option(
            "--against-c",
            help="Compare STEPS steps of an MJCF model with MuJoCo C, from each keyframe and 8 random "
            "states.",
        ),
    ] = False,
) -> None:
    """Test a model against the contract and run some rows.

    Print one sentence for each error.
    """
    from gaitsweep import models as registry
    from gaitsweep.cli import show
    from gaitsweep.dynamics.mjx.mjcf_model import MjcfModel
    from gaitsweep.models.value_faults import faults

    if steps is not None and not against_c:
        raise ArgumentError(f"STEPS is {steps}, but is allowed only with --against-c.")

    kind = registry.find(name)
    if against_c and not issubclass(kind, MjcfModel):
        raise ArgumentError(
            f"{name} has no MJCF: --against-c applies only to models that derive from MjcfModel."
        )
    print_message("Evaluating the model's functions over the ranges of its parameters and starts.")
    _refuse_faults(name, faults(kind))
    from gaitsweep.runs.model_trial import trial  # of a model without faults

    tried = trial(kind, print_message)
    model = kind()
    _refuse_faults(name, tried.faults)
    print(f"{name}: valid, {show.extent_of(model)}")
    for remark in dict.fromkeys(tried.remarks):
        print(remark)
    if against_c:
        assert isinstance(model, MjcfModel)
        _step_against_c(name, model, steps or _STEPS)
    else:
        if notice := model.caveats_notice:
            print_message(notice)
        for caveat in model.caveats():
            print_message(f"Warning: {caveat}")


def _refuse_faults(name: str, faults: Sequence[str]) -> None:
    """Print a sentence for each fault of a model, and exit with EXIT_REFUSED if there are any."""
    for fault in faults:
        print_message(f"The model is {name}, {fault}")
    if faults:
        raise typer.Exit(EXIT_REFUSED)


def _step_against_c(name: str, model: MjcfModel, steps: int) -> None:
    """Compare an MJCF model with MuJoCo C and print the result; exit with EXIT_REFUSED if they differ."""
    from gaitsweep.dynamics.mjx.against_c import compare
    from gaitsweep.dynamics.mjx.refusals import cautions

    for caution in cautions(model.mjx_body.mj_model):
        print_message(f"Warning: {caution}")
    print_message("Compiling the steps of the MJCF, which takes about a minute.")
    comparison = compare(model, steps)
    for divergence in comparison.divergences:
        print_message(str(divergence))
    agree = comparison.starts - len(comparison.divergences)
    print(
        f"{name}: {agree} of {comparison.starts} motions of {steps} steps agree with MuJoCo C within 1e-5; "
        f"the largest difference before a divergence is {comparison.largest:.1e}"
    )
    if comparison.caused:
        raise typer.Exit(EXIT_REFUSED)


def _refuse_name(name: str) -> None:
    """Refuse the name of a new model or paper that Python cannot import, or that another one has."""
    from gaitsweep import models as registry

    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        near = re.sub(r"\W+", "_", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)).strip("_").lower()
        allowed = re.fullmatch(r"[a-z][a-z0-9_]*", near) and not keyword.iskeyword(near)
        hint = f"; did you mean {near}?" if allowed else "."
        raise NewFilesError(
            f"The name {name!r} is not valid for a Python module: use lower-case letters, digits and "
            f"underscores, beginning with a letter{hint}"
        )
    if name in registry.names():
        raise NewFilesError(
            f"A model named {name} comes with gaitsweep or an installed paper: choose another name."
        )
    installed = importlib.util.find_spec(name)
    if installed is not None and installed.origin is not None:
        raise NewFilesError(f"A module named {name} is installed in this Python: choose another name.")
