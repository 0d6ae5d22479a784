"""`gs.search`: constants of a model that meet targets."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from gaitsweep.api.fits import given_job, in_directory, in_memory
from gaitsweep.api.keywords import AnyModel, fields_without_axes, is_job, refuse_beside_a_job
from gaitsweep.api.result import refuse_of_session
from gaitsweep.errors import ArgumentError
from gaitsweep.fitting.search import SearchResult, run_search
from gaitsweep.fitting.search_job import load_search, read_search
from gaitsweep.kinds import Settle
from gaitsweep.runs.progress import Progress, progress_lines
from gaitsweep.schema.strict_model import plain

if TYPE_CHECKING:
    from distributed import Client


def search(
    model: AnyModel | Path | Mapping[str, Any],
    out: str | Path | None = None,
    *,
    free: Mapping[str, Any] | None = None,
    targets: Mapping[str, Mapping[str, Any]] | None = None,
    method: str | None = None,
    budget: int | None = None,
    population: int | None = None,
    side_by_side: int | None = None,
    first: Sequence[str] | None = None,
    first_within: float | None = None,
    known: Sequence[Mapping[str, Any] | str] | None = None,
    known_best: int | None = None,
    width: float | None = None,
    seed: int | None = None,
    finalists: int | None = None,
    robust: Mapping[str, Any] | None = None,
    run: BaseModel | Mapping[str, Any] | None = None,
    params: Mapping[str, Any] | None = None,
    start: Mapping[str, Any] | int | None = None,
    numerics: Mapping[str, Any] | None = None,
    engine: str | Mapping[str, Any] | None = None,
    overrides: Sequence[str] = (),
    on_progress: Progress | None = None,
    client: Client | None = None,
    **values: Any,
) -> SearchResult:
    """Search constants that meet targets, or continue a search that was stopped.

    Args:
        model: an instance, a class, a registered name, or "package.module:attribute". Or a job with
            `search`, as the path of its file, which ends in .yaml, as "builtin:NAME" or as a mapping of its
            fields: then only `out`, `overrides`, `on_progress` and `client` are allowed beside it.
        out: the result directory, in which a stopped search continues. Without it the result is in memory,
            but that of a job is in `results/NAME`.
        free: the free constants by name, a range [low, high], {low, high, log, whole}, or {choices}.
        targets: by name, a measure with its target value, such as {"lag": {"kind": "value", "of": "psi_1",
            "at": {"psi_1": 1.0}, "wanted": 0.9, "error": 0.01}}.
        method: cma, the default, sobol or nsga3.
        budget: number of sets that are measured.
        population: sets that are measured together.
        side_by_side: batches that run at a time.
        first, first_within: targets that are measured first, and how many reading errors a set may miss
            them by to be measured further.
        known: sets that are measured before all others: their constants, a config, or the result directory
            of an earlier search, of which the `known_best` best are taken (64 by default).
        width: standard deviation with which cma begins, a share of the ranges, 0.2 by default.
        seed: seed of all random numbers, 0 by default.
        finalists: the best sets, which are measured again at half the step; 8 by default.
        robust: the share of a set's random neighbours that should keep targets, such as {"within": 0.02,
            "targets": ["lag"], "wanted": [0.9, 1], "error": 0.1}.
        run: the run kind, `Settle()` by default, or `FixedTime`, or their fields.
        params, numerics, engine: as for `gaitsweep.sweep`.
        start: start values by name, as for `gaitsweep.sweep`; a whole number is the `search.start` of a job,
            the Sobol points with which cma begins.
        overrides: settings for a job file, such as "search.budget=64".
        on_progress: progress callback: sets done, sets in all, sets a second, the share done, a remark; by
            default it prints a line on standard error every half minute.
        client: a `distributed.Client`, whose workers compute the rows; with a directory they share it.
        values: parameters and start values by name, numbers or formulas. Names that are arguments here go
            into `params` or `start`.

    Returns:
        The table of all sets, the near-best sets, and the identifiability of each constant.

    Raises:
        ArgumentError: a name that the model does not have, an array, a package that is not installed, or
            `out` for a model whose class belongs to this session.
        JobError: all other errors of the search.
        RunError, TableError: the search cannot run here, or the directory cannot be used.
    """
    on_progress = progress_lines("sets") if on_progress is None else on_progress
    begin = None if isinstance(start, Mapping) else start
    asked = {"free": free, "targets": targets, "method": method, "budget": budget, "population": population}
    asked |= {"side_by_side": side_by_side, "start": begin, "first": first, "first_within": first_within}
    asked |= {"known": known, "known_best": known_best, "width": width, "seed": seed}
    asked |= {"finalists": finalists, "robust": robust}
    fields = {"run": run, "params": params, "numerics": numerics}
    if is_job(model):
        refuse_beside_a_job(model, {**asked, **fields, "start": start, "engine": engine, **values})
        job = given_job(model, overrides, load_search, read_search)
        return in_directory(run_search, job, out, on_progress, client)
    if overrides:
        raise ArgumentError("overrides are for a job file: give the values as keywords.")
    assert not isinstance(model, Path | Mapping)  # it was read
    fields |= {"run": Settle() if run is None else run, "start": start if begin is None else None}
    fields["engine"] = {"name": engine} if isinstance(engine, str) else engine
    written = fields_without_axes(model, values, "free", **fields)
    search_field = {name: value for name, value in asked.items() if value is not None}
    job = read_search({**written, "search": plain(search_field)}, Path.cwd())
    if out is not None:
        refuse_of_session(written["model"])
        return in_directory(run_search, job, out, on_progress, client)
    result = in_memory(run_search, job, on_progress, client)
    return dataclasses.replace(result, path=None, figures=())
