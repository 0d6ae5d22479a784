"""The commands `gaitsweep analyse NAME`: each prints one analysis of a result directory.

Each imports the analysis when it runs, so that `--help` need not wait for JAX and pandas.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(
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


def _table(directory: Path) -> Any:
    from gaitsweep.table import load

    return load(directory)


def _print(found: Any, digits: int = 4, index: bool = False) -> None:
    print(found.round(digits).to_string(index=index))


@app.command()
def gaits(
    directory: Directory,
    window: Annotated[
        tuple[float, float], typer.Option("--window", metavar="S S", help="Begin and end, s; all by default.")
    ] = (-math.inf, math.inf),
    threshold: Annotated[
        float | None,
        typer.Option("--threshold", metavar="X", help="Largest shift of a pair in phase, cycles."),
    ] = None,
) -> None:
    """Count the rows of a four-legged model with each gait."""
    from gaitsweep.analysis.gaits.gait_tables import gaits_counted, gaits_in
    from gaitsweep.models.planar_quadruped.nine_gaits import THRESHOLD

    thresholds = (THRESHOLD if threshold is None else threshold,)
    _print(gaits_counted(gaits_in(_table(directory), window=window, thresholds=thresholds)))


@app.command()
def gait_bouts(
    directory: Directory,
    by: Annotated[str, typer.Option("--by", metavar="NAME", help="family, gait or gait_at_0.05.")] = "family",
    cycles: Annotated[int, typer.Option("--cycles", min=1, help="Strides that a gait is read from.")] = 3,
    least: Annotated[int, typer.Option("--least", min=1, help="Readings in a bout; shorter ones go.")] = 3,
) -> None:
    """List the gaits that follow each other along each row, with the speeds at which they begin and end."""
    from gaitsweep.analysis.transitions import gait_bouts as bouts

    found = bouts.gait_bouts(bouts.gaits_along(_table(directory), cycles=cycles), by, least)
    for row, mine in found.groupby("row"):
        each = [
            f"{s[by]} {s['speed_begin']:.2f} to {s['speed_end']:.2f}"
            + f" ({s['windows']})" * (s["windows"] < 3)
            for s in mine.to_dict("records")
        ]
        print(f"row {row}, m/s: {', '.join(each)}")


@app.command()
def loading_rule(
    directory: Directory,
    split: Annotated[
        str | None, typer.Option("--split", metavar="COLUMN", help="Analyse each of its values separately.")
    ] = None,
    predict: Annotated[
        bool, typer.Option("--predict", help="Loads of trots without feedback, shifts of the walks with it.")
    ] = False,
    pairs: Annotated[bool, typer.Option("--pairs", help="List each pair of legs instead.")] = False,
) -> None:
    """Measure how well leg loads and pitch of the planar quadruped agree with the rule of leg loading."""
    from gaitsweep.analysis.gaits import loading_rule as rule

    table = _table(directory)
    if pairs:
        found = rule.pairs_in(table)
    elif predict:
        found = rule.loading_rule(rule.load_prediction(table), split=split or "k2", repeats=())
    else:
        found = rule.loading_rule(table, split=split)
    _print(found, 3)


@app.command()
def gait_thresholds(
    directory: Directory,
    window: Annotated[
        tuple[float, float], typer.Option("--window", metavar="S S", help="Begin and end, s; all by default.")
    ] = (-math.inf, math.inf),
) -> None:
    """Count the rows with each gait for several thresholds, the shifts by size, and gaits by touchdowns."""
    from gaitsweep.analysis.gaits.gait_tables import gaits_in
    from gaitsweep.analysis.gaits.threshold_effect import gaits_by_threshold, shift_sizes

    table = _table(directory)
    _print(gaits_by_threshold(table, window=window))
    found = gaits_in(table, window=window)
    print("\nSizes of the shifts of both pairs, cycles, and which the threshold reads as in phase:")
    _print(shift_sizes(found), 2)
    if "gait_by_touchdowns" in found:
        same = found["gait"].astype(str) == found["gait_by_touchdowns"].astype(str)
        share = f"{same.sum()} of {len(same)} rows ({100 * same.mean():.1f} %)"
        print(f"\n{share} have the same gait by touchdowns.")


@app.command()
def gait_measures(
    directory: Directory,
    by: Annotated[
        list[str] | None,
        typer.Option("--by", metavar="COLUMN", help="Kept apart besides the gait; may be repeated."),
    ] = None,
) -> None:
    """Print speed, period, flight, pitch, power of the joints and cost of transport of each gait."""
    from gaitsweep.analysis.gaits import gait_measures as measures

    _print(measures.gait_measures(_table(directory), by or None))


@app.command()
def speed_transitions(directory: Directory, by: Kept = None) -> None:
    """Print the speeds at which gaits change as the speed rises and falls, and the hysteresis between."""
    from gaitsweep.analysis.transitions import speed_transitions as transitions

    _print(transitions.speed_transitions(_table(directory), by or ()), 3)


@app.command()
def body_oscillation(
    directory: Directory,
    along: Annotated[
        bool, typer.Option("--along", help="Of each gait bout along a row whose speed changes.")
    ] = False,
) -> None:
    """Print how far the body pitches at once and twice the gait frequency, for each family of gaits."""
    from gaitsweep.analysis.gaits.body_oscillation import family_oscillation
    from gaitsweep.analysis.transitions.oscillation_along import oscillation_along

    if along:
        _print(oscillation_along(_table(directory)))
    else:
        _print(family_oscillation(_table(directory)).reset_index())


@app.command()
def repertoire(
    directory: Directory,
    sets: Annotated[
        list[str], typer.Option("--set", metavar="COLUMN", help="Names a parameter set; may be repeated.")
    ],
) -> None:
    """Print the gaits of each parameter set of the planar quadruped, with their median speeds."""
    from gaitsweep.analysis.gaits import repertoire as analysis

    _print(analysis.repertoire(_table(directory), sets))


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

    found = conflicts([_table(directory) for directory in directories], within, target)
    print(f"Of {found.sets} sets, those that meet the target of the row and that of the column:")
    _print(found.together, index=True)
    print("\nThe least miss of the column's target among them, in reading errors:")
    _print(found.nearest, 2, index=True)
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

    table = _table(directory)
    require(table, *by, *(of or ()))
    groups = table.groupby(by, observed=True, dropna=False)
    found = groups.size().rename("rows").to_frame()
    for name in of or ():
        found[[name, f"{name}_least", f"{name}_largest"]] = groups[name].agg(["median", "min", "max"])
    _print(found.reset_index(), 6)


@app.command()
def attractors(directory: Directory) -> None:
    """Group the settled rows by attractor, and print how well the gaits agree with the groups."""
    from gaitsweep.analysis.attractors import attractors as analysis

    table = _table(directory)
    found = analysis.attractors(table)
    _print(found.summary)
    if "gait" in table.columns:
        share = analysis.agreement(table, found.column)
        print(f"{100 * share:.2f} % of the rows have the most frequent gait of their attractor.")


@app.command()
def basins(directory: Directory, by: Kept = None) -> None:
    """Print the share of each outcome, basin entropies and the uncertainty exponent of starts on a grid."""
    from gaitsweep.analysis.basins import measures

    found = measures.basins(_table(directory), by=by or ())
    for records in (found.fractions, found.panels, found.uncertainty):
        _print(records)
        print()


@app.command()
def wada(directory: Directory, by: Kept = None) -> None:
    """Print two tests of the Wada property of basins on a grid: boundaries after merging, basins in boxes."""
    from gaitsweep.analysis.basins import wada as tests

    found = tests.wada(_table(directory), by=by or ())
    for records in (found.merging, found.boxes):
        _print(records)
        print()


@app.command()
def hysteresis(directory: Directory, observable: Observable, parameter: Parameter) -> None:
    """Print where a ramp or staircase jumps between branches, and the areas of its hysteresis loops."""
    from gaitsweep.analysis.transitions.transition_points import loop_area, transition_points

    table = _table(directory)
    _print(transition_points(table, observable, parameter))
    _print(loop_area(table, observable, parameter))


@app.command()
def gait_transitions(
    directory: Directory,
    parameter: Parameter,
    start: Annotated[str, typer.Option("--start", metavar="NAME", help="The start that selects the branch.")],
) -> None:
    """Print where each gait is lost, from settled rows at many values of a parameter."""
    from gaitsweep.analysis.transitions.transition_points import transition_points_by_gait

    _print(transition_points_by_gait(_table(directory), parameter, start))


@app.command()
def waves(directory: Directory) -> None:
    """Print wavelength and speed of waves in traces of the multi-legged chain, beside eqs. (27), (28)."""
    from gaitsweep.analysis.chain.travelling_wave import waves as measured

    _print(measured(_table(directory)), 6)


@app.command()
def source_place(directory: Directory) -> None:
    """Print at which leg the source of the multi-legged chain's waves settles: shares of the starts."""
    from gaitsweep.analysis.chain.source_place import source_place as places

    found = places(_table(directory))
    _print(found[(found["source"] > 0) | (found["meeting"] > 0) | (found["leg"] == 1)])


@app.command()
def source_drift(directory: Directory) -> None:
    """Print how fast E, and with it the source of the multi-legged chain's waves, drifts, beside the law."""
    from gaitsweep.analysis.chain.source_place import source_drift as drifts

    _print(drifts(_table(directory)), 8)


@app.command()
def multilegged_theory(
    springs: Annotated[int, typer.Option("--N", help="Springs; the chain has N + 1 legs.")] = 3,
    omega: Annotated[float, typer.Option("--omega", help="Basic frequency, rad/s.")] = 0.4,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="A parameter of the chain; may be repeated."),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option("--figures", metavar="DIR", help="Draw Figs. 8 to 11 of Ambe 2021 there.")
    ] = None,
    k: Annotated[
        int | None, typer.Option("--k", help="Boundary leg of the source wave in these figures.")
    ] = None,
) -> None:
    """Print the solutions of a chain of legs by the theory; no result directory is needed."""
    import jax

    from gaitsweep import near_miss
    from gaitsweep.analysis.chain.theory_summary import theory_summary
    from gaitsweep.errors import ArgumentError
    from gaitsweep.expression import evaluate
    from gaitsweep.models.multilegged.theory.chain import Chain

    values = {}
    for setting in settings or ():
        name, _, value = setting.partition("=")
        if name not in Chain._fields:
            raise ArgumentError(f"{name} is not a parameter of the chain"
                                f"{near_miss.suggestion(name, Chain._fields)}")  # fmt: skip
        values[name] = evaluate(value, {})
    jax.config.update("jax_enable_x64", True)
    print(theory_summary(springs, omega, Chain(**values)))
    if figures is not None:
        from gaitsweep.plot.chain.theory import SHOWN, theory_figure
        from gaitsweep.table import writing

        with writing(f"{figures} could not be written"):
            figures.mkdir(parents=True, exist_ok=True)
            for show in SHOWN:
                file = figures / f"{show}.png"
                theory_figure(springs, Chain(**values), show=show, k=k).savefig(file)
                print(f"Figure: {file}")
