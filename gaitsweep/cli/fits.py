"""The commands `search` and `sensitivity`, whose jobs vary a model's constants."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument

from gaitsweep.cli.options import ClusterAsForRun, DryRun, Open, Out, Settings, print_message
from gaitsweep.cli.run import print_outcome, running
from gaitsweep.shipped import job_file as shipped_or_own


def search(
    job_file: Annotated[
        Path,
        Argument(
            metavar="JOB.yaml", parser=shipped_or_own, help="Job file with `search:` in place of `vary:`."
        ),
    ],
    out: Out = None,
    settings: Settings = None,
    cluster: ClusterAsForRun = None,
    dry_run: DryRun = False,
    open_it: Open = False,
) -> None:
    """Search constants of a model that meet targets.

    A search that was stopped continues; the ranges of the constants are reported.
    """
    from gaitsweep.cli import show_fits
    from gaitsweep.fitting.search_job import load_search

    job = load_search(job_file, list(settings or ()))
    if dry_run:
        from gaitsweep.fitting.search_cost import estimate_search

        print(show_fits.search_estimate(estimate_search(job)))
        return
    from gaitsweep.fitting.search import run_search

    with running(job.name, out, "sets", cluster=cluster) as (on_progress, workers):
        result = run_search(job, out, on_progress=on_progress, on_message=print_message, cluster=workers)
    print_outcome(show_fits.search_outcome(result), open_them=open_it)


def sensitivity(
    job_file: Annotated[
        Path,
        Argument(
            metavar="JOB.yaml",
            parser=shipped_or_own,
            help="Job file with `sensitivity:` in place of `vary:`.",
        ),
    ],
    out: Out = None,
    settings: Settings = None,
    cluster: ClusterAsForRun = None,
    open_it: Open = False,
) -> None:
    """Measure how much results depend on each constant.

    Write a table, the indices and their figure.
    """
    from gaitsweep.cli import show_fits
    from gaitsweep.fitting.sensitivity_job import load_sensitivity

    job = load_sensitivity(job_file, list(settings or ()))
    from gaitsweep.fitting.sensitivity import run_sensitivity

    with running(job.name, out, "sets", cluster=cluster) as (on_progress, workers):
        result = run_sensitivity(job, out, on_progress=on_progress, on_message=print_message, cluster=workers)
    print_outcome(show_fits.sensitivity_outcome(result), open_them=open_it)
