"""The command `examples`: lists and copies the jobs, models, configs, notebooks and pages of gaitsweep."""

from __future__ import annotations

import dataclasses
import re
import shutil
import textwrap
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from gaitsweep import near_miss
from gaitsweep.cli.new_files import add_files
from gaitsweep.errors import ArgumentError
from gaitsweep.extension import folders
from gaitsweep.shipped import BUILTIN, EXAMPLES, portable_text, shipped

KINDS = ("models", "notebooks", "jobs", "configs", "pages")
_PAGES = ("own_model", "walker")  # of the documentation, which messages name
_NOTES = {
    "models": "small models to start your own from, each with a job",
    "notebooks": "introductions to the papers' models and to writing your own",
    "jobs": "the papers' figures, and further studies",
    "configs": "the papers' parameters: `config: builtin:NAME` in a job",
    "pages": "pages of the documentation on models of your own",
}


@dataclasses.dataclass(frozen=True)
class Example:
    """The files that `gaitsweep examples NAME` copies, and a line that describes them."""

    name: str
    kind: str
    files: tuple[Path, ...]
    about: str


def examples(
    name: Annotated[
        str | None,
        Argument(
            metavar="NAME",
            help="Example to copy: a name in the list, or a kind, such as models, for all of it.",
        ),
    ] = None,
    to: Annotated[
        Path, Option("--to", metavar="DIR", help="Folder for the files; by default the current one.")
    ] = Path(),
) -> None:
    """List or copy the jobs, models and notebooks shipped.

    Without NAME they are listed, with the configs; with it they are copied.
    """
    known = known_examples()
    if name is None:
        _list(known)
        return
    name = name.removeprefix(BUILTIN)
    chosen = [example for example in known if name in (example.name, example.kind)]
    if not chosen:
        near = near_miss.suggestion(name, [*KINDS, *(example.name for example in known)])
        raise ArgumentError(f"{name} is not an example{near}")
    files = {file.name: portable_text(file) for example in chosen for file in example.files}
    for path in add_files(to, files):
        print(path)


def known_examples() -> list[Example]:
    """All examples, by kind and name."""
    models = sorted(EXAMPLES.glob("*.yaml"))
    notebooks = sorted(shipped("notebooks").glob("*.ipynb"))
    known = [Example(job.stem, "models", _with_its_files(job), _first_line(job)) for job in models]
    known += [Example(file.stem, "notebooks", (file,), _title(file)) for file in notebooks]
    for kind in ("jobs", "configs"):
        files = [file for folder in folders(kind) for file in folder.glob("*.yaml")]
        for file in sorted(files, key=lambda file: file.name):
            known.append(Example(file.stem, kind, (file,), _first_line(file)))
    pages = (shipped("docs") / f"{name}.md" for name in _PAGES)
    return [*known, *(Example(page.stem, "pages", (page,), _first_line(page)) for page in pages)]


def _with_its_files(job: Path) -> tuple[Path, ...]:
    """The model of an example's job, its MJCF file if it has one, and the job."""
    text = job.read_text(encoding="utf-8")
    of_module = re.search(r"^model: *gaitsweep\.examples\.(\w+):", text, re.MULTILINE)
    files = (
        [job.with_name(of_module[1]).with_suffix(suffix) for suffix in (".py", ".xml")] if of_module else []
    )
    if of_file := re.search(r"^model: *(walkers/\w+\.yaml)", text, re.MULTILINE):
        model_file = job.parent / of_file[1]
        files += [model_file.with_suffix(".xml"), model_file]
    return tuple(file for file in (*files, job) if file.is_file())


def _list(known: list[Example]) -> None:
    """Print the names of examples by kind, each with its description."""
    width = shutil.get_terminal_size((140, 0)).columns  # that many where there is no terminal
    for kind in KINDS:
        of_kind = [example for example in known if example.kind == kind]
        print(f"{kind}: {_NOTES[kind]}")
        names = max(len(example.name) for example in of_kind)
        for example in of_kind:
            about = textwrap.shorten(example.about, max(width - names - 4, 20), placeholder=" ...")
            print(f"  {example.name:<{names}}  {about}".rstrip())
        print()
    print("gaitsweep examples NAME --to DIR copies an example, gaitsweep examples models all models;")
    print(f"gaitsweep run {BUILTIN}NAME runs a job without a copy.")


def _first_line(file: Path) -> str:
    """The first line of the comment of a YAML file, or the title of a page, at its beginning."""
    first = file.read_text(encoding="utf-8").partition("\n")[0]
    return first.lstrip("# ").strip() if first.startswith("#") else ""


def _title(file: Path) -> str:
    """The title of a notebook."""
    title = re.search(r'"# (.*?)(?:\\n)?"', file.read_text(encoding="utf-8"))
    return title.group(1) if title else ""
