"""Extensions: packages that add models, figures, analyses, measures, jobs and claims, such as a paper's.

A package names its extension in its `pyproject.toml`:

    [project.entry-points."gaitsweep.extensions"]
    my_paper = "my_package:extension"
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

from gaitsweep.errors import UserError
from gaitsweep.lazy_imports import attach_stub

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "gaitsweep.extensions"
Style = tuple[str, str] | tuple[str, str, str]  # colour, marker, hatch
_ANALYSES = Path(__file__).with_name("analyses") / "__init__.py"
_CHECKOUT = Path(__file__).parents[1] / "pyproject.toml"


class ExtensionError(UserError):
    """An extension cannot be used; the message says whose it is and why."""


@dataclasses.dataclass(frozen=True)
class Extension:
    """Contribution of a package to gaitsweep. Modules are named, not imported, so that `--help` needs no JAX.

    Args:
        models: classes of models by the names that jobs use, each as "package.module:Class".
        figures: modules whose functions are decorated by `gaitsweep.plot.figure_kind`.
        run_kinds: modules whose classes are decorated by `gaitsweep.kinds.register`.
        analyses: modules with `app`, a `typer.Typer` whose commands `gaitsweep analyse` has.
        gait_styles: the colour and the Matplotlib marker of each gait, which all figures share; a third
            entry is the hatch of its areas, by default one that grey print needs.
        functions: what `gs.analyses` has, "package.module:function" or a whole module by name.
        measures: modules whose functions are decorated by `gaitsweep.claims.measure`.
        jobs: a folder of jobs, which `builtin:NAME` finds.
        configs: a folder of configs, which `builtin:NAME` finds.
        claims: a folder of tables of claims, NAME.yaml each, for `gaitsweep reproduce NAME`.
    """

    models: Mapping[str, str] = dataclasses.field(default_factory=dict)
    figures: tuple[str, ...] = ()
    run_kinds: tuple[str, ...] = ()
    analyses: tuple[str, ...] = ()
    gait_styles: Mapping[str, Style] = dataclasses.field(default_factory=dict)
    functions: Mapping[str, str] = dataclasses.field(default_factory=dict)
    measures: tuple[str, ...] = ()
    jobs: Path | None = None
    configs: Path | None = None
    claims: Path | None = None


@functools.cache
def extensions() -> Mapping[str, Extension]:
    """The extensions that are installed, by name, gaitsweep's own first.

    Raises:
        ExtensionError: one does not import, is no `Extension`, has a text in place of a tuple, or adds a
            model or a function of a name that is taken.
    """
    own_analyses = {*attach_stub("gaitsweep.analyses", str(_ANALYSES))[2]}
    by_name: dict[str, Extension] = {}
    owners: dict[tuple[str, str], str] = {}  # of models and functions
    for entry, owner in _entries():
        try:
            extension = entry.load()
        except Exception as error:  # another package's code may raise anything
            raise ExtensionError(
                f"The extension {entry.name} of {owner} cannot be imported ({type(error).__name__}: "
                f"{error}): repair it, or uninstall {owner}."
            ) from error
        if not isinstance(extension, Extension):
            raise ExtensionError(
                f"The extension {entry.name} of {owner} is {entry.value}, which is not a gaitsweep.Extension."
            )
        for field in ("figures", "run_kinds", "analyses", "measures"):
            if isinstance(module := getattr(extension, field), str):
                raise ExtensionError(
                    f"The extension {entry.name} of {owner} has {field}={module!r}, but must have a tuple of "
                    f"modules: ({module!r},)."
                )
        remedy = f"uninstall {owner} or the other package"
        if entry.name in by_name:
            raise ExtensionError(f"There are two extensions named {entry.name}: {remedy}.")
        for name in sorted(extension.functions.keys() & own_analyses):
            raise ExtensionError(
                f"The extension {entry.name} of {owner} has a function {name}, but gaitsweep.analyses has "
                f"its own {name}, which hides it: rename it, or uninstall {owner}."
            )
        for kind, names in (("model", extension.models), ("function", extension.functions)):
            for name in names:
                if (kind, name) in owners:
                    both = f"{owners[kind, name]} and {entry.name} both have a {kind} {name}"
                    raise ExtensionError(f"The extensions {both}: {remedy}.")
                owners[kind, name] = entry.name
        by_name[entry.name] = extension
    return MappingProxyType(by_name)


def model_paths() -> dict[str, str]:
    """The models of all extensions, "package.module:Class" by name."""
    return {name: path for extension in extensions().values() for name, path in extension.models.items()}


@functools.cache
def gait_styles() -> Mapping[str, Style]:
    """The styles of the gaits of all extensions; of a name that two have, the first one's."""
    styles: dict[str, Style] = {}
    for extension in extensions().values():
        styles = {**extension.gait_styles, **styles}
    return MappingProxyType(styles)


def import_all(kind: Literal["figures", "run_kinds", "analyses", "measures"]) -> None:
    """Import the modules of one kind of all extensions, which register what they define."""
    for extension in extensions().values():
        for name in getattr(extension, kind):
            importlib.import_module(name)


def folders(kind: Literal["jobs", "configs", "claims"]) -> list[Path]:
    """The folders of one kind of all extensions."""
    declared = (getattr(extension, kind) for extension in extensions().values())
    return list(dict.fromkeys(folder for folder in declared if folder is not None))


def _entries() -> list[tuple[EntryPoint, str]]:
    """The entry points of installed packages, each with its package; gaitsweep's own first.

    In a checkout, gaitsweep's own are those of its `pyproject.toml`.
    """
    installed = _installed()
    own = _of_checkout() or [entry for entry in installed if entry[1] == "gaitsweep"]
    return [*own, *(entry for entry in installed if entry[1] != "gaitsweep")]


def _of_checkout() -> list[tuple[EntryPoint, str]]:
    """The entry points of the checkout from which gaitsweep runs; none elsewhere."""
    import tomllib  # imports that `--help` does not need
    from importlib.metadata import EntryPoint

    if not _CHECKOUT.is_file():
        return []
    project = tomllib.loads(_CHECKOUT.read_text(encoding="utf-8")).get("project", {})
    declared = project["entry-points"][GROUP] if project.get("name") == "gaitsweep" else {}
    entries = (EntryPoint(name, value, GROUP) for name, value in declared.items())
    return [(entry, "gaitsweep") for entry in entries]


def _installed() -> list[tuple[EntryPoint, str]]:
    """The entry points of installed packages, and the package of each."""
    from importlib.metadata import entry_points

    entries = sorted(entry_points(group=GROUP), key=lambda entry: entry.name)
    return [(entry, "?" if entry.dist is None else entry.dist.name) for entry in entries]
