"""The command `explore`: writes a page that animates the walking model from a start on a click."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer


def explore(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Result directory.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Output file; by default DIR/explore.html.")
    ] = None,
    x: Annotated[
        str | None,
        typer.Option("--x", metavar="COLUMN", help="Column on the horizontal axis; by default the figure's."),
    ] = None,
    y: Annotated[
        str | None,
        typer.Option("--y", metavar="COLUMN", help="Column on the vertical axis; by default the figure's."),
    ] = None,
    replays: Annotated[
        int | None,
        typer.Option(
            "--walks", metavar="N", help="Largest number of starts that are simulated again; 400 by default."
        ),
    ] = None,
    max_size: Annotated[
        float | None,
        typer.Option("--max-size", metavar="MB", help="Largest size of the page; 10 MB by default."),
    ] = None,
    trust: Annotated[
        bool,
        typer.Option(
            "--trust",
            help="Allow running the code of your own model from DIR, or from the folder named in DIR.",
        ),
    ] = False,
) -> None:
    """Write explore.html into a result directory: a click on a start shows the model walking from it."""
    from gaitsweep.cli.progress import shown_progress
    from gaitsweep.view.explorer.explorer import write_explorer

    with shown_progress("starts") as shown:

        def on_progress(done: int, total: int, rate: float, fraction: float, note: str) -> None:
            shown(done, total, rate, fraction, note)

        path = write_explorer(
            directory,
            out,
            x=x,
            y=y,
            replays=replays,
            max_size=max_size,
            trust=trust,
            on_progress=on_progress,
            on_message=lambda sentence: print(sentence, file=sys.stderr),
        )
    print(path)
