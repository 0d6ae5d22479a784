"""The command `explore`: a page on which a click on a start makes it walk."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer


def explore(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="A result directory.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="The page; DIR/explore.html by default.")
    ] = None,
    x: Annotated[
        str | None, typer.Option("--x", metavar="COLUMN", help="Along the horizontal axis; the figure's.")
    ] = None,
    y: Annotated[
        str | None, typer.Option("--y", metavar="COLUMN", help="Along the vertical axis; the figure's.")
    ] = None,
    replays: Annotated[
        int | None,
        typer.Option("--walks", metavar="N", help="Starts that are simulated again at most; 400 by default."),
    ] = None,
    max_size: Annotated[
        float | None, typer.Option("--max-size", metavar="MB", help="Largest size; 10 MB by default.")
    ] = None,
    trust: Annotated[
        bool,
        typer.Option(
            "--trust", help="Run the code of a model of one's own that lies in DIR, or where DIR says."
        ),
    ] = False,
) -> None:
    """Write explore.html into a result directory: click a start, and it walks."""
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
