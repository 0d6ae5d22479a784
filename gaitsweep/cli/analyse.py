"""The commands `gaitsweep analyse NAME`: each prints one analysis of a result directory.

Each imports its analysis when it runs, so that `--help` does not load JAX and pandas.
"""

from __future__ import annotations

import importlib
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option
from typer.core import TyperGroup
from typer.main import get_group

from gaitsweep.cli.options import Directory
from gaitsweep.extension import ExtensionError, extensions

if TYPE_CHECKING:
    import pandas as pd


class _Analyses(TyperGroup):
    """The commands of gaitsweep and of its extensions, which are loaded at the first use of a command."""

    _of_extensions: dict[str, Any] | None = None

    @property
    def commands(self) -> dict[str, Any]:  # pyright: ignore[reportIncompatibleVariableOverride]
        if self._of_extensions is None:
            self._of_extensions = _commands_of_extensions(self._own)
        return self._own | self._of_extensions

    @commands.setter
    def commands(self, own: dict[str, Any]) -> None:
        self._own = own
        self._of_extensions = None


app = typer.Typer(
    cls=_Analyses, help="Analyse a table and print the results.", no_args_is_help=True, rich_markup_mode=None
)

Observable = Annotated[
    str | None,
    Option("--observable", metavar="NAME", help="Observable at the section; by default the figure's."),
]
Parameter = Annotated[
    str | None, Option("--parameter", metavar="NAME", help="Varying parameter; by default the job's.")
]

GroupColumns = Annotated[
    list[str] | None,
    Option("--by", metavar="COLUMN", help="Column whose values are analysed separately; may be repeated."),
]


def result_table(directory: Path) -> pd.DataFrame:
    """Load the table of a result directory."""
    from gaitsweep.table import load

    return load(directory)


def print_table(table: pd.DataFrame, digits: int = 4, *, index: bool = False) -> None:
    """Print a data frame.

    Args:
        table: the data frame.
        digits: decimal places of its numbers.
        index: whether its index is printed as a column.
    """
    print(table.round(digits).to_string(index=index))


@app.command()
def targets(
    directories: Annotated[
        list[Path], Argument(metavar="DIR...", help="Result directories of searches for the same targets.")
    ],
    within: Annotated[
        float, Option("--within", metavar="X", help="Largest miss of a met target, in reading errors.")
    ] = 1.0,
    target: Annotated[
        list[str] | None,
        Option("--target", metavar="NAME", help="Analyse only this target; may be repeated."),
    ] = None,
) -> None:
    """Count the sets of a search that meet pairs of targets.

    Print the smallest misses too.
    """
    from gaitsweep.fitting.targets import conflicts

    pairs = conflicts([result_table(directory) for directory in directories], within, target)
    print(f"Number of sets, of {pairs.sets}, that meet both the target of the row and that of the column:")
    print_table(pairs.together, index=True)
    print("\nSmallest miss of the column's target among the sets that meet the row's, in reading errors:")
    print_table(pairs.nearest, 2, index=True)
    print(
        f"\nLargest number of targets that a set meets: {len(pairs.most)} "
        f"({', '.join(pairs.most) or 'none'}; {pairs.most_sets} of {pairs.sets} sets)."
    )


@app.command()
def summary(
    directory: Directory,
    by: Annotated[list[str], Option("--by", metavar="COLUMN", help="Column of groups; may be repeated.")],
    of: Annotated[
        list[str] | None,
        Option(
            "--of",
            metavar="COLUMN",
            help="Column whose median, minimum and maximum are printed; may be repeated.",
        ),
    ] = None,
) -> None:
    """Count rows and print ranges of columns by group.

    A group is, for example, a gait; the median and the range of each column are printed, of angles in the
    turn in which those of a group are nearest to each other.
    """
    from gaitsweep.analysis.records import AnalysisError, require, require_numbers
    from gaitsweep.angles import in_nearest_turn, is_circular

    table = result_table(directory)
    of = list(dict.fromkeys(of or ()))
    require(table, *by)
    require_numbers(table, *of)
    columns_of = {name: [name, f"{name}_least", f"{name}_largest"] for name in of}
    names = [*by, "rows", *(column for columns in columns_of.values() for column in columns)]
    if repeated := next((name for name in names if names.count(name) > 1), None):
        raise AnalysisError(
            f"The result would have two columns {repeated}: name a column once, by --by or --of."
        )
    for name in of:
        if is_circular(table, name):
            values = table.groupby(by, observed=True, dropna=False)[name]
            table[name] = values.transform(in_nearest_turn)
    groups = table.groupby(by, observed=True, dropna=False)
    counts = groups.size().to_frame("rows")
    for name, columns in columns_of.items():
        counts[columns] = groups[name].agg(["median", "min", "max"])
    print_table(counts.reset_index(), 6)


@app.command()
def attractors(directory: Directory) -> None:
    """Group the settled rows by attractor.

    Print how well the gaits agree with the groups.
    """
    from gaitsweep.analysis.basins import attractors as analysis

    table = result_table(directory)
    groups = analysis.attractors(table)
    print_table(groups.summary)
    if "gait" in table.columns:
        share = analysis.agreement(table, groups.column)
        print(f"{100 * share:.2f} % of the rows have the most frequent gait of their attractor.")


@app.command()
def basins(directory: Directory, by: GroupColumns = None) -> None:
    """Print sizes and entropies of basins on a grid.

    Outcome fractions with intervals, basin entropies and the uncertainty exponent.
    """
    from gaitsweep.analysis.basins import measures

    measured = measures.basins(result_table(directory), by=by or ())
    for table in (measured.fractions, measured.panels, measured.uncertainty):
        print_table(table)
        print()


@app.command()
def steps_to_fall(
    directory: Directory,
    by: GroupColumns = None,
    after: Annotated[
        int, Option("--after", metavar="N", help="Steps from the start that do not count.")
    ] = 10,
) -> None:
    """Print mean numbers of steps to a fall.

    Rows differ in the seeds of their grounds; `--by` names what else differs.
    """
    from gaitsweep.analysis import falls

    print_table(falls.steps_to_fall(result_table(directory), by or (), after=after))


@app.command()
def quantifiers(directory: Directory, parameter: Parameter = None) -> None:
    """Print how stable each attractor is along a parameter.

    Shares of its basin with intervals, times of convergence, resilience and the least fatal shock.
    """
    from gaitsweep.analysis.basins import quantifiers as analysis

    table = result_table(directory)
    parameter = parameter or _from_job(table, "--parameter", "orbit", "x", [])
    print_table(analysis.quantifiers(table, parameter))


@app.command()
def wada(directory: Directory, by: GroupColumns = None) -> None:
    """Print a test of the Wada property of basins.

    It compares the boundaries of basins after merging the others.
    """
    from gaitsweep.analysis.basins.basin_boundaries import wada as wada_of

    print_table(wada_of(result_table(directory), by=by or ()))


@app.command()
def hysteresis(
    directory: Directory,
    observable: Observable = None,
    parameter: Parameter = None,
    least: Annotated[
        float | None,
        Option(
            "--least", metavar="X", help="Least change that counts as a jump; by default as in the figure."
        ),
    ] = None,
    by: GroupColumns = None,
) -> None:
    """Print jumps and hysteresis of a ramp or staircase.

    Jumps are those between branches, by default for each value of the parameters that differ between rows;
    loops have areas.
    """
    from gaitsweep.analysis.records import AnalysisError
    from gaitsweep.analysis.transitions.hysteresis import loop_area, transition_points, why_no_jump
    from gaitsweep.plot import FIGURES
    from gaitsweep.plot.columns import varying_parameters

    table = result_table(directory)
    run = table.attrs.get("job", {}).get("run", {}).get("kind")
    if run is not None and run not in FIGURES["hysteresis"].runs:
        raise AnalysisError(
            f"{directory} is the table of a run of kind {run}, which is no staircase or ramp: no parameter "
            "moves while a row runs. Run it with run: {kind: staircase, ...}. `gaitsweep analyse "
            "gait-transitions` tells where gaits of settled rows are lost along a parameter."
        )
    recorded = [str(name).removesuffix("_n") for name in table.columns if str(name).endswith("_n")]
    observable = observable or _from_job(table, "--observable", "hysteresis", "y", recorded)
    parameter = parameter or _from_job(table, "--parameter", "hysteresis", "parameter", [])
    figures = table.attrs.get("job", {}).get("figures") or []
    of_figures = {
        figure.get("least")
        for figure in figures
        if (figure["kind"], figure.get("y")) == ("hysteresis", observable)
    }
    if least is None and len(of_figures) == 1:
        least = of_figures.pop()
    by = varying_parameters(table) if by is None else by
    points = transition_points(table, observable, parameter, least, by)
    if len(points):
        print(f"Largest jump of {observable} in each pass, medians over the rows that jump:")
        print_table(points)
    else:
        print(why_no_jump(table, observable, parameter, least))
    loops = loop_area(table, observable, parameter)
    if len(loops):
        print(f"\nArea between a pass of {parameter} and the next, of each row:")
        print_table(loops)


@app.command()
def gait_transitions(
    directory: Directory,
    parameter: Parameter = None,
    start: Annotated[
        str | None,
        Option("--start", metavar="NAME", help="Start that selects the branch; by default the figure's."),
    ] = None,
) -> None:
    """Print the parameter values at which gaits are lost.

    They follow from settled rows along a parameter.
    """
    from gaitsweep.analysis.records import axes_of
    from gaitsweep.analysis.transitions.hysteresis import transition_points_by_gait
    from gaitsweep.plot.columns import varying_parameters

    table = result_table(directory)
    parameter = parameter or _from_job(table, "--parameter", "gait_transitions", "x", axes_of(table))
    start = start or _from_job(table, "--start", "gait_transitions", "start", axes_of(table), parameter)
    others = [name for name in varying_parameters(table) if name not in (parameter, start)]
    print_table(transition_points_by_gait(table, parameter, start, by=others))


def _from_job(
    table: pd.DataFrame, option: str, kind: str, field: str, names: list[str], excluded: str | None = None
) -> str:
    """The value of an option that a table's job gives: its run, its figures of a kind, or the only name.

    Args:
        table: the table.
        option: the option, for the message.
        kind: kind of the figures.
        field: field of the run and of the figures.
        names: the allowed values if neither has one.
        excluded: a name that is not allowed.

    Raises:
        ArgumentError: the job gives none, or several.
    """
    from gaitsweep.errors import ArgumentError

    job = table.attrs.get("job", {})
    of_run = [job.get("run", {}).get(field)]
    of_figures = [figure.get(field) for figure in job.get("figures", []) if figure["kind"] == kind]
    candidates: list[str] = []
    for source in (of_run, of_figures, names):  # the first that has any decides
        candidates = list(dict.fromkeys(str(value) for value in source if value and value != excluded))
        if candidates:
            break
    if len(candidates) == 1:
        return candidates[0]
    named = f"the job names {' and '.join(candidates)}" if candidates else "the job does not name it"
    raise ArgumentError(f"{option} is not given, and {named}: give {option} NAME.")


def _commands_of_extensions(own: Collection[str]) -> dict[str, Any]:
    """The commands of extensions, by name.

    Args:
        own: the names of gaitsweep's commands.

    Raises:
        ExtensionError: an extension cannot be used, or has a command of a name that is taken.
    """
    commands: dict[str, Any] = {}
    owners = dict.fromkeys(own, "gaitsweep")
    for owner, extension in extensions().items():
        group = typer.Typer(rich_markup_mode=None)
        for module in extension.analyses:
            group.registered_commands.extend(importlib.import_module(module).app.registered_commands)
        for name, command in get_group(group).commands.items():
            if name in owners:
                raise ExtensionError(
                    f"{owners[name]} and the extension {owner} both have a command "
                    f"`gaitsweep analyse {name}`: rename it, or uninstall {owner}."
                )
            owners[name] = owner
            commands[name] = command
    return commands
