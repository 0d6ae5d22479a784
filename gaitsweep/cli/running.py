"""Running of jobs by commands: progress, workers, Ctrl-C, and the outcome that is printed."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from gaitsweep.cli.options import print_links, print_message

if TYPE_CHECKING:
    from gaitsweep.runs.cluster.dispatch import Cluster
    from gaitsweep.runs.progress import Progress

STOPPED = 130  # by Ctrl-C


@contextlib.contextmanager
def running(
    name: str,
    out: Path | None,
    unit: str = "rows",
    *,
    cluster: str | None,
    collect: bool = False,
    limit: float | None = None,
    on_message: Callable[[str], None] = print_message,
) -> Iterator[tuple[Progress, Cluster | None]]:
    """The progress callback and the workers of a run; a run that was stopped ends with a sentence."""
    from gaitsweep.cli.progress import stoppable_progress

    try:
        with stoppable_progress(unit) as on_progress, contextlib.ExitStack() as stack:
            workers = None
            if cluster is not None:
                from gaitsweep.runs.cluster.connection import connection_to
                from gaitsweep.runs.cluster.dispatch import Cluster

                connection = connection_to(cluster)
                workers = stack.enter_context(
                    Cluster(connection, collect=collect, limit=limit, on_message=on_message)
                )
            yield on_progress, workers
    except KeyboardInterrupt as error:
        print_message(_stopped(name, out))
        raise typer.Exit(getattr(error, "exit_code", STOPPED)) from None  # SIGTERM brings its own


def _stopped(name: str, out: Path | None) -> str:
    """The sentence at the end of a run that was stopped."""
    from gaitsweep.runs.execute import RESULTS
    from gaitsweep.table import Snapshot, TableError

    path = out or RESULTS / name
    try:
        snapshot = Snapshot.of(path)
    except TableError:
        return "Stopped before anything was written. Run the same command to start again."
    safe = f"{snapshot.rows_safe} of {snapshot.manifest['rows']} rows are safe in {path}"
    return f"Stopped: {safe}. Run the same command to continue."


def print_outcome(outcome: str, open_them: bool) -> None:
    """Print the outcome of a run, and links to the figures that it names; open these if asked to."""
    print(outcome)
    named = (line.partition("Figure: ") for line in outcome.splitlines())
    print_links([file for before, sign, file in named if sign and not before], open_them)
