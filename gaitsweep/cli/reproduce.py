"""The command `reproduce`: the claims of a paper compared with results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from gaitsweep.cli.options import Open, print_links, print_message
from gaitsweep.errors import EXIT_FAILURE, EXIT_STRICT

if TYPE_CHECKING:
    from gaitsweep.claims.reproduce import Reproduction


def reproduce(
    paper: Annotated[str, Argument(metavar="PAPER", help="Name of a paper, or file of a table of claims.")],
    quick: Annotated[
        bool,
        Option(
            "--quick",
            help="Use fewer rows, wider tolerances and no self-check: minutes instead of up to an hour.",
        ),
    ] = False,
    claims: Annotated[
        str | None,
        Option("--claims", metavar="ID,ID,...", help="Check only these claims, and run only their jobs."),
    ] = None,
    out: Annotated[
        Path | None,
        Option("--out", metavar="DIR", help="Output directory; by default results/reproduce_PAPER."),
    ] = None,
    strict: Annotated[
        bool, Option("--strict", help=f"Exit with code {EXIT_STRICT} if a claim is not reproduced.")
    ] = False,
    open_it: Open = False,
) -> None:
    """Run a paper's jobs, and compare its claims with them.

    Only jobs without results run.
    """
    from gaitsweep.claims.claims_and_verdicts import ClaimVerdict, read_paper

    table_of_claims = read_paper(paper)
    if claims is not None:
        names = [name for part in claims.split(",") if (name := part.strip())]
        if not names:
            raise typer.BadParameter("names no claim.", param_hint="--claims")
        table_of_claims = table_of_claims.only(names)
    from gaitsweep.claims.reproduce import reproduce as run_and_judge
    from gaitsweep.cli.progress import stoppable_progress

    with stoppable_progress() as on_progress:
        judged = run_and_judge(
            table_of_claims, out, quick=quick, on_progress=on_progress, on_message=print_message
        )
    _print_verdicts(judged)
    print_links([judged.page], open_them=open_it)
    if judged.failed:
        raise typer.Exit(EXIT_FAILURE)
    if strict and judged.counts[ClaimVerdict.not_reproduced.value]:
        raise typer.Exit(EXIT_STRICT)


def _print_verdicts(judged: Reproduction) -> None:
    """Print the number of claims with each verdict, and those that are not reproduced."""
    from gaitsweep.claims.claims_and_verdicts import ClaimVerdict

    counts = judged.counts
    total = len(judged.table)
    texts = [f"{counts[ClaimVerdict.reproduced.value]} of {total} claim{'s' * (total != 1)} reproduced"]
    for verdict in ClaimVerdict:
        if verdict is not ClaimVerdict.reproduced and counts[verdict.value]:
            texts.append(f"{counts[verdict.value]} {verdict.words}")
    print(f"{', '.join(texts)}.")
    if len(judged.by_constants) > 1:
        sets = ", ".join(f"{number} with {constants}" for constants, number in judged.by_constants.items())
        print(f"Claims reproduced by simulation: {sets}.")
    for missed in (ClaimVerdict.not_reproduced, ClaimVerdict.open_constants):
        for claim in judged.table.loc[judged.table["verdict"] == missed.value].to_dict(orient="records"):
            unit = "" if claim["unit"] in ("", "1") else f" {claim['unit']}"
            text = claim["why"]
            if claim["ours"]:
                why = f"; {claim['why']}" if claim["why"] else ""
                text = f"{claim['ours']}{unit}; paper: {claim['paper']}{why}"
            print(f"{claim['id']} ({missed.words}): {text}")
    print(f"Page: {judged.page}")
