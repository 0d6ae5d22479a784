"""The command `animate`: one row of a trace as a movie, or as a strip of poses."""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path
from typing import Annotated

import typer


def animate(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="The result directory of a trace.")],
    row: Annotated[int, typer.Option("--row", metavar="N", help="Which row.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", help="A .gif or .mp4 (.png of --still); in DIR/figures by default."
        ),
    ] = None,
    start: Annotated[
        float | None, typer.Option("--start", metavar="S", help="From when, s of the trace.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="S", help="How much of the trace; all by default.")
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option("--speed", metavar="X", help="1: real time; by default a cycle takes about 1.6 s."),
    ] = None,
    fps: Annotated[
        float | None, typer.Option("--fps", metavar="N", help="Pictures a second; 25 by default.")
    ] = None,
    size: Annotated[
        str | None, typer.Option("--size", metavar="WxH", help="Pixels; 960x540, or 1600x560 of --still.")
    ] = None,
    renderer: Annotated[
        str,
        typer.Option("--renderer", metavar="NAME", help="mujoco, matplotlib, or auto: mujoco where it can."),
    ] = "auto",
    still: Annotated[
        float | None,
        typer.Option("--still", metavar="T", help="A PNG of six poses over the cycle from T, s."),
    ] = None,
    trust: Annotated[
        bool,
        typer.Option(
            "--trust", help="Run the code of a model of one's own that lies in DIR, or where DIR says."
        ),
    ] = False,
) -> None:
    """Show one row of a trace walking: a movie, or a strip of poses."""
    from gaitsweep.cli.progress import shown_progress
    from gaitsweep.plot import PlotError
    from gaitsweep.view.movie import row_movie as movie

    if still is not None:
        moving = {"--start": start, "--seconds": seconds, "--speed": speed, "--fps": fps}
        given = [name for name, value in moving.items() if value is not None]
        if given:
            raise PlotError(
                f"--still makes one picture, of which {given[0]} says nothing: leave one of them out."
            )
        pixels = movie.STILL_SIZE if size is None else _size(size)
        print(
            movie.write_still(
                directory,
                out,
                row=row,
                at=still,
                size=pixels,
                renderer=renderer,
                trust=trust,
                on_message=_print_message,
            )
        )
        return
    began = time.monotonic()
    with shown_progress("pictures") as shown:

        def on_progress(done: int, total: int) -> None:
            shown(done, total, done / max(time.monotonic() - began, 1e-9), done / total, "")

        path = movie.write_movie(
            directory,
            out,
            row=row,
            start=start or 0.0,
            seconds=seconds,
            speed=speed,
            fps=25.0 if fps is None else fps,
            size=movie.SIZE if size is None else _size(size),
            renderer=renderer,
            trust=trust,
            on_progress=on_progress,
            on_message=_print_message,
        )
    print(path)


def _print_message(sentence: str) -> None:
    print(sentence, file=sys.stderr)


def _size(text: str) -> tuple[int, int]:
    from gaitsweep.plot import PlotError

    match = re.fullmatch(r"\s*(\d{1,6})\s*[xX×]\s*(\d{1,6})\s*", text)
    if match is None:
        raise PlotError(f"--size is {text}, but is written as width x height in pixels, such as 960x540.")
    return int(match[1]), int(match[2])
