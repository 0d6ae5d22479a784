"""All commands. Each reads its options, calls the function that does the work, and prints the result.

Commands of a few lines are here, longer ones in files of their own, which `gaitsweep/cli/__init__.py` lists.
Each imports its dependencies when it runs, so that `--help` and `--version` do not load JAX and pandas.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option
from typer.core import TyperGroup

import gaitsweep
from gaitsweep.cli import analyse, models
from gaitsweep.cli.examples import examples
from gaitsweep.cli.fits import search, sensitivity
from gaitsweep.cli.options import Directory, Open, print_links, print_message
from gaitsweep.cli.reproduce import reproduce
from gaitsweep.cli.run import atlas, run
from gaitsweep.cli.views import WithStill, animate, explore
from gaitsweep.errors import EXIT_REFUSED, UserError
from gaitsweep.shipped import BUILTIN
from gaitsweep.shipped import job_file as shipped_or_own

if TYPE_CHECKING:
    from gaitsweep.plot import FigureStyle

# Commands by words for what they do, which users of other programs try.
_BY_MEANING = {
    **dict.fromkeys(("list", "ls", "jobs", "demo", "example", "copy", "init"), "examples"),
    **dict.fromkeys(("sweep", "simulate", "start", "resume", "continue"), "run"),
    **dict.fromkeys(("show", "status", "describe", "summary"), "info"),
    **dict.fromkeys(("draw", "figure", "figures"), "plot"),
    **dict.fromkeys(("movie", "video", "gif"), "animate"),
    **dict.fromkeys(("validate", "lint"), "check"),
    **dict.fromkeys(("new", "create", "template"), "new-model"),
    **dict.fromkeys(("fit", "optimise", "optimize"), "search"),
    **{name: f"analyse {name}" for name in ("hysteresis", "basins", "attractors", "quantifiers")},
    "analyze": "analyse", "parameters": "models", "view": "explore", "bibtex": "cite",
}  # fmt: skip


class _Commands(TyperGroup):
    """The commands, of which an unknown one is compared by meaning where none has a similar name."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        if args and args[0] in _BY_MEANING and args[0] not in self.commands:
            meant = _BY_MEANING[args[0]]
            # typer would add commands of similar spelling
            ctx.fail(f"No such command {args[0]!r}. Did you mean `gaitsweep {meant}`?")
        return super().resolve_command(ctx, args)


app = typer.Typer(
    cls=_Commands,
    help="Parameter sweeps of legged locomotion: from a job file to tables and figures.\n\n"
    f"Begin with `gaitsweep run {BUILTIN}quick_basins`, which takes seconds; `gaitsweep examples` lists "
    f"the shipped jobs, which need no file: {BUILTIN}NAME.",
    no_args_is_help=True,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


# Options of `plot` whose names differ from those of the style's fields.
_OPTION_OF_FIELD = {"--colours": "--colour", "--marks": "--no-marks"}


def _print_version(requested: bool) -> None:
    """Print the version and exit, if asked to."""
    if requested:
        print(f"gaitsweep {gaitsweep.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Take the options that come before a command."""


app.command()(run)
app.command()(atlas)


@app.command()
def plot(
    directory: Directory,
    width: Annotated[
        str | None, Option("--width", help="Width: column (85 mm), page (180 mm), or mm.")
    ] = None,
    height: Annotated[float | None, Option("--height", help="Height of each figure, in mm.")] = None,
    formats: Annotated[
        list[str], Option("--format", help="File format: png, pdf or svg; may be repeated.")
    ] = [],  # noqa: B006 - typer does not change it
    dpi: Annotated[int | None, Option("--dpi", help="Pixels per inch of png files (150).")] = None,
    colours: Annotated[
        list[str], Option("--colour", metavar="GAIT=COLOUR", help="Colour of a gait; may be repeated.")
    ] = [],  # noqa: B006 - typer does not change it
    panel_columns: Annotated[
        int | None, Option("--panel-columns", help="Number of panels beside each other.")
    ] = None,
    panel_letters: Annotated[
        bool, Option("--panel-letters", help="Write a, b, ...; other letters: --set 'panel_letters=[d, e]'.")
    ] = False,
    hatches: Annotated[
        bool | None, Option("--hatches/--no-hatches", help="Hatch areas of gaits, for grey print (default).")
    ] = None,
    no_marks: Annotated[
        bool, Option("--no-marks", help="Omit the remark on an incomplete or doubtful table.")
    ] = False,
    fields: Annotated[
        list[str],
        Option(
            "--set", metavar="FIELD=VALUE", help="Any other field of figures: title=none, shares=false, ..."
        ),
    ] = [],  # noqa: B006 - typer does not change it
    out: Annotated[
        Path | None, Option("--out", metavar="FOLDER", help="Folder of the files (DIR/figures).")
    ] = None,
    open_it: Open = False,
) -> None:
    """Draw the figures of a table again, without simulation."""
    from gaitsweep.plot.figure_style import read_style
    from gaitsweep.runs.figures import FigureError
    from gaitsweep.table import Snapshot

    style = read_style(
        width=width,
        height=height,
        format=formats or None,
        dpi=dpi,
        colours=dict(map(_named_colour, colours)) or None,
        panel_columns=panel_columns,
        panel_letters=panel_letters or None,
        hatches=hatches,
        marks=False if no_marks else None,
    )
    job = Snapshot.of(directory).job
    try:
        paths = _drawn(directory, style, fields, out, of_search="search" in job)
    except FigureError as error:
        for path in error.drawn:
            print(path)
        raise
    for path in paths:
        print(path)
    print_links(paths, open_them=open_it)
    if not paths:
        text = (
            f"The job of {directory} has no figures: add `figures:` to {directory}/job.yaml, and plot again."
        )
        if "sensitivity" in job:
            text = f"`gaitsweep sensitivity` draws the figures of {directory}: run it again."
        print_message(text)


def _drawn(
    directory: Path, style: FigureStyle, fields: list[str], out: Path | None, *, of_search: bool
) -> list[Path]:
    """Draw the figures of a result directory; those of a search have neither a style nor another folder."""
    if not of_search:
        from gaitsweep.runs.figures import draw_figures

        return draw_figures(directory, style=style, folder=out, fields=fields)
    from gaitsweep.fitting.search import draw_again

    options = {"--out": out, "--set": fields or None, **{f"--{field}": value for field, value in style}}
    for option, value in options.items():
        if value is not None:
            name = _OPTION_OF_FIELD.get(option, option.replace("_", "-"))
            raise typer.BadParameter("is not for the figures of a search.", param_hint=name)
    return draw_again(directory)


def _named_colour(text: str) -> tuple[str, str]:
    """The gait and the colour of `--colour GAIT=COLOUR`; refuses other texts."""
    gait, equals, colour = text.partition("=")
    if not equals:
        raise typer.BadParameter(
            f"is {text}, but must be GAIT=COLOUR, such as trot=#0072B2.", param_hint="--colour"
        )
    return gait, colour


app.command(cls=WithStill)(animate)
app.command()(explore)
app.add_typer(analyse.app, name="analyse")


@app.command()
def info(
    directory: Directory,
    columns: Annotated[
        bool, Option("--columns", help="Print the unit and the meaning of each column instead.")
    ] = False,
) -> None:
    """Print the contents of a result directory and its provenance."""
    from gaitsweep.cli import show
    from gaitsweep.table import Snapshot

    snapshot = Snapshot.of(directory)
    if columns:
        show.columns_of(snapshot)
    else:
        print(show.directory(snapshot))


app.command()(examples)
app.command()(models.models)
app.command()(models.new_model)
app.command()(models.new_paper)
app.command()(models.check_model)


@app.command()
def check(
    job_files: Annotated[
        list[Path], Argument(metavar="JOB.yaml...", parser=shipped_or_own, help="One or more jobs.")
    ],
) -> None:
    """Check jobs without running them, and print one line for each."""
    from gaitsweep.job import JobError

    valid = True
    for job_file in job_files:
        try:
            print(f"{job_file}: valid, {_size_of(job_file)}")
        except JobError as error:  # which names its file
            valid = False
            print_message(str(error))
        except UserError as error:  # such as a package that a method needs
            valid = False
            print_message(f"{job_file}: {error}")
    if not valid:
        raise typer.Exit(EXIT_REFUSED)


def _size_of(job_file: Path) -> str:
    """The number of a job's rows or sets, in words, after printing warnings about its rows.

    Raises:
        JobError: the job is not valid.
    """
    from gaitsweep.dynamics.mjcf import OfMjcf
    from gaitsweep.job import load_job
    from gaitsweep.job.row_remarks import remarks_on_rows
    from gaitsweep.schema.yaml_document import read_document

    fields = read_document(job_file).data
    if "search" in fields:
        from gaitsweep.fitting.search_job import load_search

        search = load_search(job_file)
        rows = search.fit.population().rows_of_a_set
        sets = search.options.budget
        return f"{sets} set{'s' * (sets != 1)} of {rows} row{'s' * (rows != 1)}"
    if "sensitivity" in fields:
        from gaitsweep.fitting.sensitivity_job import load_sensitivity

        return f"{load_sensitivity(job_file).design.n_rows} sets"
    job = load_job(job_file)
    model = job.design.model.original
    remarks = model.remarks if isinstance(model, OfMjcf) else ()
    for remark in (*remarks, *remarks_on_rows(job.design, job.model)):
        print_message(f"Warning: {job_file}: {remark}")
    return f"{job.design.n_rows} row{'s' * (job.design.n_rows != 1)}"


@app.command()
def report(directory: Directory, open_it: Open = False) -> None:
    """Write report.html: job, counts, figures, provenance.

    The page is written into the result directory.
    """
    from gaitsweep.view.report import write_report

    path = write_report(directory)
    print(path)
    print_links([path], open_them=open_it)


@app.command()
def cite(
    directory: Annotated[
        Path | None, Argument(metavar="DIR", help="Result directory; by default gaitsweep alone.")
    ] = None,
) -> None:
    """Print BibTeX entries and a sentence on methods."""
    from gaitsweep.runs.citation import citation_of, tool_entry

    text, missing = (tool_entry(), []) if directory is None else citation_of(directory)
    print(text)
    if "howpublished" in text:
        print_message(
            "gaitsweep has no DOI and no public address: the entry has its version, and the commit if known. "
            "Name your source of it, if your journal asks for one."
        )
    for sentence in missing:
        print_message(sentence)


app.command()(reproduce)
app.command()(search)
app.command()(sensitivity)


@app.command(name="schema")
def write_schema(
    out: Annotated[
        Path | None, Option("--out", metavar="FILE", help="Output file; by default the schema is printed.")
    ] = None,
) -> None:
    """Write the JSON schema of job files, for editors."""
    from gaitsweep.fitting.schema import schema
    from gaitsweep.table import WriteError, reason, replace_file

    text = json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"
    if out is None:
        print(text, end="")
        return
    try:
        replace_file(out, lambda file: file.write(text.encode()))
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        why = reason(error) if isinstance(error, OSError) else str(error)
        raise WriteError(f"{out} could not be written: {why}.") from error
    print(out)
