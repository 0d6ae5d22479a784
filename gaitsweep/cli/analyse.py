"""The commands `gaitsweep analyse NAME`: each prints one analysis of a result directory.

Each imports the analysis when it runs, so that `--help` need not wait for JAX and pandas.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_group

from gaitsweep.extension import extensions


class _Analyses(TyperGroup):
    """The commands of gaitsweep, and those of extensions, which are read when a command is looked for."""

    _theirs: dict[str, Any] | None = None

    @property
    def commands(self) -> dict[str, Any]:  # pyright: ignore[reportIncompatibleVariableOverride]
        if self._theirs is None:
            self._theirs = _of_extensions()
        return self._own | self._theirs

    @commands.setter
    def commands(self, own: dict[str, Any]) -> None:
        self._own, self._theirs = own, None


app = typer.Typer(
    cls=_Analyses,
    help="Analyse the table of a result directory, and print the numbers.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Directory = Annotated[Path, typer.Argument(metavar="DIR", help="A result directory.")]
Observable = Annotated[str, typer.Option("--observable", metavar="NAME", help="A section observable.")]
Parameter = Annotated[str, typer.Option("--parameter", metavar="NAME", help="The parameter that moves.")]

Kept = Annotated[
    list[str] | None, typer.Option("--by", metavar="COLUMN", help="Kept apart; may be repeated.")
]


def result_table(directory: Path) -> Any:
    """Load the table of a result directory."""
    from gaitsweep.table import load

    return load(directory)


def print_table(found: Any, digits: int = 4, index: bool = False) -> None:
    """Print a data frame, its numbers with so many digits after the point."""
    print(found.round(digits).to_string(index=index))


@app.command()
def targets(
    directories: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="Results of searches for the same targets."),
    ],
    within: Annotated[
        float, typer.Option("--within", metavar="X", help="Misses that count as met, in reading errors.")
    ] = 1.0,
    target: Annotated[
        list[str] | None, typer.Option("--target", metavar="NAME", help="Only these; may be repeated.")
    ] = None,
) -> None:
    """Print how many sets of a search meet each pair of targets, and how near others come to the rest."""
    from gaitsweep.fitting.conflicts import conflicts

    found = conflicts([result_table(directory) for directory in directories], within, target)
    print(f"Of {found.sets} sets, those that meet the target of the row and that of the column:")
    print_table(found.together, index=True)
    print("\nThe least miss of the column's target among them, in reading errors:")
    print_table(found.nearest, 2, index=True)
    print(
        f"\nAt most {len(found.most)} targets are met by one set: {', '.join(found.most) or 'none'} "
        f"(in {found.most_sets} sets)."
    )


@app.command()
def summary(
    directory: Directory,
    by: Annotated[list[str], typer.Option("--by", metavar="COLUMN", help="Groups; may be repeated.")],
    of: Annotated[
        list[str] | None,
        typer.Option("--of", metavar="COLUMN", help="Median, least and largest; may be repeated."),
    ] = None,
) -> None:
    """Count the rows of each group, such as each gait, and print the medians and ranges of columns."""
    from gaitsweep.analysis.records import require

    table = result_table(directory)
    require(table, *by, *(of or ()))
    groups = table.groupby(by, observed=True, dropna=False)
    found = groups.size().rename("rows").to_frame()
    for name in of or ():
        found[[name, f"{name}_least", f"{name}_largest"]] = groups[name].agg(["median", "min", "max"])
    print_table(found.reset_index(), 6)


@app.command()
def attractors(directory: Directory) -> None:
    """Group the settled rows by attractor, and print how well the gaits agree with the groups."""
    from gaitsweep.analysis.attractors import attractors as analysis

    table = result_table(directory)
    found = analysis.attractors(table)
    print_table(found.summary)
    if "gait" in table.columns:
        share = analysis.agreement(table, found.column)
        print(f"{100 * share:.2f} % of the rows have the most frequent gait of their attractor.")


@app.command()
def basins(directory: Directory, by: Kept = None) -> None:
    """Print the share of each outcome, basin entropies and the uncertainty exponent of starts on a grid."""
    from gaitsweep.analysis.basins import measures

    found = measures.basins(result_table(directory), by=by or ())
    for records in (found.fractions, found.panels, found.uncertainty):
        print_table(records)
        print()


@app.command()
def wada(directory: Directory, by: Kept = None) -> None:
    """Print two tests of the Wada property of basins on a grid: boundaries after merging, basins in boxes."""
    from gaitsweep.analysis.basins import wada as tests

    found = tests.wada(result_table(directory), by=by or ())
    for records in (found.merging, found.boxes):
        print_table(records)
        print()


@app.command()
def hysteresis(directory: Directory, observable: Observable, parameter: Parameter) -> None:
    """Print where a ramp or staircase jumps between branches, and the areas of its hysteresis loops."""
    from gaitsweep.analysis.transitions.transition_points import loop_area, transition_points

    table = result_table(directory)
    print_table(transition_points(table, observable, parameter))
    print_table(loop_area(table, observable, parameter))


@app.command()
def gait_transitions(
    directory: Directory,
    parameter: Parameter,
    start: Annotated[str, typer.Option("--start", metavar="NAME", help="The start that selects the branch.")],
) -> None:
    """Print where each gait is lost, from settled rows at many values of a parameter."""
    from gaitsweep.analysis.transitions.transition_points import transition_points_by_gait

    print_table(transition_points_by_gait(result_table(directory), parameter, start))


def _of_extensions() -> dict[str, Any]:
    """The commands that extensions bring, by name.

    Raises:
        ExtensionError: an extension cannot be used.
    """
    theirs = typer.Typer(rich_markup_mode=None)
    for extension in extensions().values():
        for name in extension.analyses:
            theirs.registered_commands.extend(importlib.import_module(name).app.registered_commands)
    return dict(get_group(theirs).commands)
