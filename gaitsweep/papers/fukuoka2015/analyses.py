"""The commands `gaitsweep analyse` of the planar quadruped."""

from __future__ import annotations

import math
from typing import Annotated

import typer

import gaitsweep as gs
from gaitsweep.cli import Directory, GroupColumns, print_table

app = typer.Typer()
Window = Annotated[
    tuple[float, float],
    typer.Option(
        "--window", metavar="S S", help="Beginning and end of the analysed time, s; by default all."
    ),
]


@app.command()
def gaits(
    directory: Directory,
    window: Window = (-math.inf, math.inf),
    threshold: Annotated[
        float | None,
        typer.Option(
            "--threshold", metavar="X", help="Largest shift of a pair that counts as in phase, cycles."
        ),
    ] = None,
) -> None:
    """Count the rows with each gait.

    From swing onsets of four legs, as Fukuoka et al. 2015; in a table of another model by its own gaits.
    """
    from gaitsweep.papers.fukuoka2015.analysis.gait_tables import gaits_counted, gaits_in, own_gaits_in
    from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import THRESHOLD

    thresholds = (THRESHOLD,) if threshold is None else (THRESHOLD, threshold)
    table = gs.load(directory)
    without_options = threshold is None and not any(map(math.isfinite, window))
    own = own_gaits_in(table) if without_options else None
    gaits = gaits_in(table, window=window, thresholds=thresholds) if own is None else own
    if threshold is not None:
        # the first threshold is that of the model where a table has the model's own gaits
        gaits["gait"] = gaits[f"gait_at_{threshold:g}"]
    print_table(gaits_counted(gaits))


@app.command()
def gait_bouts(
    directory: Directory,
    by: Annotated[
        str, typer.Option("--by", metavar="NAME", help="Column of the bouts: family, gait or gait_at_0.05.")
    ] = "family",
    cycles: Annotated[
        int, typer.Option("--cycles", min=1, help="Number of strides for one reading of the gait.")
    ] = 3,
    least: Annotated[
        int,
        typer.Option(
            "--least", min=1, help="Smallest number of readings in a bout; shorter bouts are dropped."
        ),
    ] = 3,
) -> None:
    """List the successive gaits of each row.

    Each has the speeds at which it begins and ends.
    """
    from gaitsweep.papers.fukuoka2015.analysis import gait_bouts as bouts

    table = bouts.gait_bouts(bouts.gaits_along(gs.load(directory), cycles=cycles), by, least)
    for row, bouts_of_row in table.groupby("row"):
        texts = []
        for bout in bouts_of_row.to_dict("records"):
            text = f"{bout[by]} {bout['speed_begin']:.2f} to {bout['speed_end']:.2f}"
            # how few readings a short bout rests on
            texts.append(f"{text} ({bout['windows']})" if bout["windows"] < 3 else text)
        print(f"row {row}, m/s: {', '.join(texts)}")


@app.command()
def loading_rule(
    directory: Directory,
    split: Annotated[
        str | None,
        typer.Option("--split", metavar="COLUMN", help="Column whose values are analysed separately."),
    ] = None,
    predict: Annotated[
        bool,
        typer.Option(
            "--predict",
            help="Compare loads of trots without feedback with shifts of walks with feedback, for each k2 "
            "(or column of --split).",
        ),
    ] = False,
    pairs: Annotated[bool, typer.Option("--pairs", help="List the pairs of legs instead.")] = False,
) -> None:
    """Measure how well rows follow the rule of leg loading.

    It compares the leg loads and the pitch of the planar quadruped with its phase shifts.
    """
    from gaitsweep.papers.fukuoka2015.analysis import loading_rule as rule

    if pairs and (predict or split is not None):
        raise gs.ArgumentError("--pairs lists the pairs of all rows: leave out --split and --predict.")
    table = gs.load(directory)
    if pairs:
        judged = rule.pairs_in(table)
    elif predict:
        judged = rule.loading_rule(rule.load_prediction(table), split=split or "k2")
    else:
        judged = rule.loading_rule(table, split=split)
    print_table(judged, 3)


@app.command()
def gait_thresholds(directory: Directory, window: Window = (-math.inf, math.inf)) -> None:
    """Count the rows of each gait for several thresholds.

    It also counts the shifts by size, and the rows whose gait by touchdowns is the same.
    """
    from gaitsweep.papers.fukuoka2015.analysis.gait_tables import gaits_by_threshold, gaits_in, shift_sizes

    table = gs.load(directory)
    print_table(gaits_by_threshold(table, window=window))
    gaits = gaits_in(table, window=window)
    print("\nSizes of the shifts of both pairs, cycles, and which the threshold reads as in phase:")
    print_table(shift_sizes(gaits), 2)
    if "gait_by_touchdowns" in gaits:
        same = gaits["gait"].astype(str) == gaits["gait_by_touchdowns"].astype(str)
        share = f"{same.sum()} of {len(same)} rows ({100 * same.mean():.1f} %)"
        print(f"\n{share} have the same gait by touchdowns.")


@app.command()
def gait_measures(
    directory: Directory,
    by: Annotated[
        list[str] | None,
        typer.Option("--by", metavar="COLUMN", help="Column to group by besides the gait; may be repeated."),
    ] = None,
) -> None:
    """Print speed, period, flight and cost of each gait.

    It also prints pitch and the power of the joints.
    """
    from gaitsweep.papers.fukuoka2015.analysis import gait_tables

    print_table(gait_tables.gait_measures(gs.load(directory), by or None))


@app.command()
def speed_transitions(directory: Directory, by: GroupColumns = None) -> None:
    """Print the speeds at which gaits change.

    They are given for rising and for falling speed, with the hysteresis between.
    """
    from gaitsweep.papers.fukuoka2015.analysis import gait_bouts as bouts

    print_table(bouts.speed_transitions(gs.load(directory), by or ()), 3)


@app.command()
def body_oscillation(
    directory: Directory,
    along: Annotated[
        bool, typer.Option("--along", help="Analyse each gait bout of rows whose speed changes.")
    ] = False,
) -> None:
    """Print the amplitude of pitch by family of gaits.

    It is given at once and at twice the gait frequency.
    """
    from gaitsweep.papers.fukuoka2015.analysis.gait_bouts import family_oscillation, oscillation_along

    if along:
        print_table(oscillation_along(gs.load(directory)))
    else:
        print_table(family_oscillation(gs.load(directory)).reset_index())


@app.command()
def repertoire(
    directory: Directory,
    sets: Annotated[
        list[str],
        typer.Option(
            "--set", metavar="COLUMN", help="Column that identifies a parameter set; may be repeated."
        ),
    ],
) -> None:
    """Print the gaits of each parameter set.

    The sets are of the planar quadruped; each gait has its median speed.
    """
    from gaitsweep.papers.fukuoka2015.analysis import gait_tables

    print_table(gait_tables.repertoire(gs.load(directory), sets))
