"""The commands `gaitsweep analyse` of the multi-legged chain."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import gaitsweep as gs
from gaitsweep.cli import Directory, print_table

if TYPE_CHECKING:
    from gaitsweep.papers.ambe2021.theory.chain import Chain

app = typer.Typer()


@app.command()
def waves(directory: Directory) -> None:
    """Compare waves of the chain with the theory.

    Wavelength and speed of waves in traces of the multi-legged chain, and eqs. (27), (28).
    """
    from gaitsweep.papers.ambe2021.analysis.travelling_wave import waves as measured

    print_table(measured(gs.load(directory)), 6)


@app.command()
def gait_shares(directory: Directory) -> None:
    """Count parameter sets of the chain by gait.

    For the multi-legged chain, by the conditions of the theory.
    """
    from gaitsweep.papers.ambe2021.analysis.gait_shares import sets_by_conditions

    print_table(sets_by_conditions(gs.load(directory)))


@app.command()
def source_place(directory: Directory) -> None:
    """Print the shares of starts by the leg of the source.

    Where the waves of the multi-legged chain settle to a source.
    """
    from gaitsweep.papers.ambe2021.analysis.source_place import source_place as places

    shares = places(gs.load(directory))
    print_table(shares.loc[(shares["source"] > 0) | (shares["meeting"] > 0) | (shares["leg"] == 1)])


@app.command()
def source_drift(directory: Directory) -> None:
    """Compare the drift of the chain's source with its law.

    The drift of E, and so of the source of the multi-legged chain's waves.
    """
    from gaitsweep.papers.ambe2021.analysis.source_place import source_drift as drifts

    print_table(drifts(gs.load(directory)), 8)


@app.command()
def multilegged_theory(
    springs: Annotated[int, typer.Option("--N", help="Number of springs; the chain has N + 1 legs.")] = 3,
    omega: Annotated[float, typer.Option("--omega", help="Basic frequency, rad/s.")] = 0.4,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Set a parameter of the chain; may be repeated."),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option("--figures", metavar="DIR", help="Folder in which to draw Figs. 8 to 11 of Ambe 2021."),
    ] = None,
    k: Annotated[
        int | None, typer.Option("--k", help="Boundary leg of the source wave in these figures.")
    ] = None,
) -> None:
    """Print the analytic solutions of a chain of legs.

    It needs no result directory.
    """
    import jax

    from gaitsweep.papers.ambe2021.analysis.theory_summary import theory_summary

    jax.config.update("jax_enable_x64", True)
    chain = _chain_of_settings(settings or ())
    print(theory_summary(springs, omega, chain))
    if figures is not None:
        from gaitsweep.papers.ambe2021.figures.chain_theory import SHOWN, theory_figure

        figures.mkdir(parents=True, exist_ok=True)
        for show in SHOWN:
            file = figures / f"{show}.png"
            theory_figure(springs, chain, show=show, k=k).savefig(file)
            print(f"Figure: {file}")


def _chain_of_settings(settings: Iterable[str]) -> Chain:
    """The chain of Table 1 with the parameters that the options `--set NAME=VALUE` give."""
    from gaitsweep import ArgumentError, near_miss
    from gaitsweep.expression import evaluate
    from gaitsweep.papers.ambe2021.theory.chain import Chain

    values = {}
    for setting in settings:
        name, _, value = setting.partition("=")
        if name not in Chain._fields:
            near = near_miss.suggestion(name, Chain._fields)
            raise ArgumentError(f"{name} is not a parameter of the chain{near}")
        values[name] = evaluate(value, {})
    return Chain(**values)
