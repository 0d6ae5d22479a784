"""The commands `animate` and `explore`: the walking model as a movie, a strip of poses, or a page."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from typer import Option
from typer.core import TyperCommand

from gaitsweep.cli.options import Directory, Open, Trust, print_links, print_message

Row = Annotated[int, Option("--row", metavar="N", help="Number of the row.")]
MovieFile = Annotated[
    Path | None,
    Option(
        "--out",
        metavar="FILE",
        help="Output file, .gif or .mp4 (.png with --still); by default in DIR/figures.",
    ),
]
Start = Annotated[
    float | None, Option("--start", metavar="S", help="Time in the row at which the movie begins, s.")
]
Seconds = Annotated[
    float | None,
    Option(
        "--seconds",
        metavar="S",
        help="Length in time of the row, s; by default a whole trace, or the last cycles.",
    ),
]
Speed = Annotated[
    float | None,
    Option("--speed", metavar="X", help="Speed relative to real time; by default a cycle takes about 1.6 s."),
]
FramesPerSecond = Annotated[
    float | None, Option("--fps", metavar="N", help="Frames per second; 25 by default.")
]
Size = Annotated[
    str | None,
    Option("--size", metavar="WxH", help="Size in pixels; by default 960x540, or 1600x560 with --still."),
]
Renderer = Annotated[
    str, Option("--renderer", metavar="NAME", help="mujoco, matplotlib, or auto: mujoco if available.")
]
Lift = Annotated[
    float, Option("--lift", metavar="X", help="Draw feet X times as high over the ground as they are.")
]
_LAST = "last"


def _beginning(text: str) -> float | str:
    """The value of `--still`: a time, s, or `_LAST`."""
    return text if text == _LAST else float(text)


Still = Annotated[
    Any,
    Option(
        "--still",
        metavar="[T]",
        parser=_beginning,
        help="Draw a PNG of six poses over the cycle from T, s, or over the last cycle.",
    ),
]


class WithStill(TyperCommand):
    """A command whose option `--still` may have no value."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments, with `_LAST` as the value of an option `--still` without one."""
        completed = []
        for argument, after in zip(args, [*args[1:], "--"], strict=True):
            completed.append(argument)
            if argument == "--still" and not _is_number(after):
                completed.append(_LAST)
        return super().parse_args(ctx, completed)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text == _LAST
    return True


def animate(
    directory: Directory,
    row: Row = 0,
    out: MovieFile = None,
    start: Start = None,
    seconds: Seconds = None,
    speed: Speed = None,
    fps: FramesPerSecond = None,
    size: Size = None,
    renderer: Renderer = "auto",
    lift: Lift = 1.0,
    still: Still = None,
    trust: Trust = False,
    open_it: Open = False,
) -> None:
    """Draw the walking model of one row as a movie or strip."""
    from gaitsweep.plot import PlotError
    from gaitsweep.view import row_movie

    options: dict[str, Any] = {"row": row, "renderer": renderer, "lift": lift, "trust": trust}
    options["on_message"] = print_message
    if size is not None:
        options["size"] = _size(size)
    of_movie = {"start": start, "seconds": seconds, "speed": speed, "fps": fps}
    requested = {name: value for name, value in of_movie.items() if value is not None}
    if still is None:
        path = _movie(directory, out, {**options, **requested})
    elif requested:
        raise PlotError(
            f"--still draws a single picture, to which --{next(iter(requested))} does not apply: remove one "
            "of the two."
        )
    else:
        path = row_movie.write_still(directory, out, at=None if still == _LAST else still, **options)
    print(path)
    print_links([path], open_them=open_it)


def _movie(directory: Path, out: Path | None, options: Mapping[str, Any]) -> Path:
    """Write a movie with these options of `write_movie`, and show its progress; returns the file."""
    from gaitsweep.cli.progress import shown_progress
    from gaitsweep.view import row_movie

    began = time.monotonic()
    with shown_progress("frames") as shown:

        def on_progress(done: int, total: int) -> None:
            shown(done, total, done / max(time.monotonic() - began, 1e-9), done / total, "")

        return row_movie.write_movie(directory, out, on_progress=on_progress, **options)


def _size(text: str) -> tuple[int, int]:
    """The width and height of `--size WxH`."""
    from gaitsweep.plot import PlotError

    match = re.fullmatch(r"\s*(\d{1,6})\s*[xX×]\s*(\d{1,6})\s*", text)
    if match is None:
        raise PlotError(f"--size is {text}, but must be width x height in pixels, such as 960x540.")
    return int(match[1]), int(match[2])


def explore(
    directory: Directory,
    out: Annotated[
        Path | None, Option("--out", metavar="FILE", help="Output file; by default DIR/explore.html.")
    ] = None,
    x: Annotated[
        str | None,
        Option("--x", metavar="COLUMN", help="Column on the horizontal axis; by default the figure's."),
    ] = None,
    y: Annotated[
        str | None,
        Option("--y", metavar="COLUMN", help="Column on the vertical axis; by default the figure's."),
    ] = None,
    replays: Annotated[
        int | None,
        Option(
            "--replays",
            "--walks",
            metavar="N",
            help="Largest number of starts that are simulated again; 400 by default.",
        ),
    ] = None,
    max_size: Annotated[
        float | None, Option("--max-size", metavar="MB", help="Largest size of the page; 10 MB by default.")
    ] = None,
    trust: Trust = False,
    open_it: Open = False,
) -> None:
    """Write explore.html: click a start to see the model walk.

    The page is written into the result directory.
    """
    from gaitsweep.cli.progress import shown_progress
    from gaitsweep.table import load
    from gaitsweep.view.explorer.explorer import EXPLORE, write_explorer
    from gaitsweep.view.explorer.page_format import require_plotly

    require_plotly()  # before a large table is read
    table = load(directory)
    target = out or directory / EXPLORE
    options: dict[str, Any] = {"x": x, "y": y, "replays": replays, "max_size": max_size, "trust": trust}
    with shown_progress("starts") as on_progress:
        write_explorer(table, target, **options, on_progress=on_progress, on_message=print_message)
    print(target)
    print_links([target], open_them=open_it)
