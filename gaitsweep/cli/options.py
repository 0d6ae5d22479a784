"""Arguments and options that several commands share, and their messages."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

Directory = Annotated[Path, Argument(metavar="DIR", help="Result directory.")]
Out = Annotated[
    Path | None, Option("--out", metavar="DIR", help="Result directory; by default results/NAME.")
]
# `gaitsweep.job.load.read_with_overrides` applies these to the job.
Settings = Annotated[
    list[str] | None,
    Option("--set", metavar="KEY=VALUE", help="Override a field of the job; may be repeated."),
]
DryRun = Annotated[
    bool, Option("--dry-run", help="Print the resources that the job would need, without running it.")
]
ClusterAsForRun = Annotated[
    str | None, Option("--cluster", metavar="WHERE", help="Dask workers that compute the rows, as for `run`.")
]
NewFolder = Annotated[
    Path,
    Option(
        "--to", metavar="DIR", help="Folder that will contain the folder NAME; by default the current one."
    ),
]
Trust = Annotated[
    bool,
    Option(
        "--trust", help="Allow running the code of your own model from DIR, or from the folder named in DIR."
    ),
]

Open = Annotated[bool, Option("--open", help="Open the written page or figures in the browser.")]


def print_links(paths: Iterable[Path | str], *, open_them: bool) -> None:
    """Print links to written pages or figures on standard error, and open them if asked to.

    Args:
        paths: the files.
        open_them: whether to open them in the browser.
    """
    for path in paths:
        link = Path(path).resolve().as_uri()
        print_message(f"Link: {link}")
        if open_them:
            import webbrowser  # which most commands do not need

            if not webbrowser.open(link):
                print_message("No browser opened here: copy the link.")


def print_message(sentence: str) -> None:
    """Print a note or a warning on standard error."""
    print(sentence, file=sys.stderr)
