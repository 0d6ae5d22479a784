"""The command `explore`: writes a page that animates the walking model from a start on a click."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gaitsweep.cli.options import Directory, Trust, print_message


def explore(
    directory: Directory,
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
    trust: Trust = False,
) -> None:
    """Write explore.html into a result directory: a click on a start shows the model walking from it."""
    from gaitsweep.cli.progress import shown_progress
    from gaitsweep.view.explorer.explorer import write_explorer

    with shown_progress("starts") as on_progress:
        path = write_explorer(
            directory,
            out,
            x=x,
            y=y,
            replays=replays,
            max_size=max_size,
            trust=trust,
            on_progress=on_progress,
            on_message=print_message,
        )
    print(path)
