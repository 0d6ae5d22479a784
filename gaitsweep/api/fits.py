"""`gs.search` and `gs.sensitivity`: jobs whose rows are sets of constants, from keywords or whole jobs."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from pydantic import BaseModel

from gaitsweep.api.keywords import AnyModel, fields_without_axes, is_job, refuse_beside_a_job
from gaitsweep.api.run import cluster_of, refuse_of_session
from gaitsweep.errors import ArgumentError, warn
from gaitsweep.fitting.search import SearchResult, run_search
from gaitsweep.fitting.search_job import load_search, read_search
from gaitsweep.fitting.sensitivity import Sensitivity, run_sensitivity
from gaitsweep.fitting.sensitivity_job import load_sensitivity, read_sensitivity
from gaitsweep.kinds import Settle
from gaitsweep.runs.progress import Progress, progress_lines

if TYPE_CHECKING:
    from distributed import Client

FitT = TypeVar("FitT", SearchResult, Sensitivity)


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
            fields: then only `out`, `on_progress` and `client` are allowed beside it, and `overrides` beside
            a file.
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
        overrides: settings for a job from a file, such as "search.budget=64".
        on_progress: progress callback: sets done, sets in all, sets a second, the share done, a remark; by
            default it prints a line on standard error every half minute.
        client: a `distributed.Client`, whose workers compute the rows; with a directory they share it.
        values: parameters and start values by name, numbers or formulas. Names that are arguments here go
            into `params` or `start`.

    Returns:
        The table of all sets, the near-best sets, and the identifiability of each constant.

    Raises:
        ArgumentError: a name that the model does not have, an array, a package that is not installed, `out`
            for a model whose class belongs to this session, other keywords beside a whole job, or `overrides`
            of one that is not read from a file.
        JobError: all other errors of the search.
        RunError, TableError: the search cannot run here, or the directory cannot be used.
    """
    start_values, sobol_points = (start, None) if isinstance(start, Mapping) else (None, start)
    own_fields = {"free": free, "targets": targets, "method": method, "budget": budget}
    own_fields |= {"population": population, "side_by_side": side_by_side, "start": sobol_points}
    own_fields |= {"first": first, "first_within": first_within, "known": known, "known_best": known_best}
    own_fields |= {"width": width, "seed": seed, "finalists": finalists, "robust": robust}
    of_run = {"run": run, "params": params, "numerics": numerics, "engine": engine}
    return _SEARCH.result(
        model,
        own_fields=own_fields,
        job_fields={**of_run, "start": start_values},
        values=values,
        out=out,
        overrides=overrides,
        on_progress=on_progress,
        client=client,
    )


def sensitivity(
    model: AnyModel | Path | Mapping[str, Any],
    *,
    parameters: Mapping[str, Any] | None = None,
    outputs: Mapping[str, Mapping[str, Any]] | None = None,
    method: str | None = None,
    n: int | None = None,
    seed: int | None = None,
    run: BaseModel | Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    params: Mapping[str, Any] | None = None,
    start: Mapping[str, Any] | None = None,
    numerics: Mapping[str, Any] | None = None,
    engine: str | Mapping[str, Any] | None = None,
    verify: int | None = None,
    overrides: Sequence[str] = (),
    on_progress: Progress | None = None,
    client: Client | None = None,
    **values: Any,
) -> Sensitivity:
    """Find how much outputs of a model depend on each of some constants.

    Args:
        model: an instance, a class, a registered name, or "package.module:attribute". Or a job with
            `sensitivity`, as the path of its file, which ends in .yaml, as "builtin:NAME" or as a mapping of
            its fields: then only `out`, `on_progress` and `client` are allowed beside it, and `overrides`
            beside a file.
        parameters: by name, a range [low, high] or {low, high, log, whole}, or a share of its value: "10%".
        outputs: measures by name, such as {"lag": {"kind": "value", "of": "psi_1", "at": {"psi_1": 1.0}}}.
        method: one_at_a_time, morris or sobol, the default.
        n: trajectories of morris, or base points of sobol, a power of two.
        seed: seed of all random numbers, 0 by default.
        run: the run kind, `Settle()` by default, or `FixedTime`, or their fields.
        out: the result directory, in which a stopped analysis continues. Without it the result is in memory,
            but that of a job is in `results/NAME`.
        params, start, numerics, engine: as for `gaitsweep.sweep`.
        verify: sets that are measured again at half the step; 32 by default, 0: none.
        overrides: settings for a job from a file, such as "sensitivity.n=64".
        on_progress: progress callback: sets done, sets in all, sets a second, the share done, a remark; by
            default it prints a line on standard error every half minute.
        client: a `distributed.Client`, whose workers compute the rows; with a directory they share it.
        values: parameters and start values by name, numbers or formulas.

    Raises:
        ArgumentError: a name that the model does not have, an array, a package that is not installed, `out`
            for a model whose class belongs to this session, other keywords beside a whole job, or `overrides`
            of one that is not read from a file.
        JobError: all other errors.
        TableError, RunError: as for `gaitsweep.run`.
    """
    if method is None and not is_job(model):
        method = "sobol"
    of_run = {"run": run, "params": params, "numerics": numerics, "engine": engine}
    return _SENSITIVITY.result(
        model,
        own_fields={"parameters": parameters, "outputs": outputs, "method": method, "n": n, "seed": seed},
        job_fields={**of_run, "start": start, "verify": verify},
        values=values,
        out=out,
        overrides=overrides,
        on_progress=on_progress,
        client=client,
    )


@dataclasses.dataclass(frozen=True)
class _Fit(Generic[FitT]):
    """A command whose rows are sets of constants.

    Args:
        section: the field of a job with the command's own fields.
        ranges: the keyword of the constants that vary.
        load, read: functions that read a job from a file, and from a mapping of its fields.
        run: function that runs a job.
    """

    section: str
    ranges: str
    load: Callable[[str | Path, Sequence[str]], Any]
    read: Callable[[Mapping[str, Any], Path], Any]
    run: Callable[..., FitT]

    def result(
        self,
        model: AnyModel | Path | Mapping[str, Any],
        *,
        own_fields: Mapping[str, Any],
        job_fields: Mapping[str, Any],
        values: Mapping[str, Any],
        out: str | Path | None,
        overrides: Sequence[str],
        on_progress: Progress | None,
        client: Client | None,
    ) -> FitT:
        """Run a whole job, or one that is made of keywords.

        Args:
            model: a model, or a whole job.
            own_fields: the command's own fields; None: not given.
            job_fields: the other fields of a job; None: not given.
            values: parameters and start values by name.
            out: the result directory. Without it, the result of keywords is in memory, and that of a job is
                in `results/NAME`.
            overrides, on_progress, client: as for `search`.

        Raises:
            ArgumentError: keywords beside a whole job, or overrides of keywords.
        """
        if is_job(model):
            refuse_beside_a_job(model, own_fields)
            refuse_beside_a_job(model, {**job_fields, **values})
            if not isinstance(model, Mapping):
                return self._run(self.load(model, overrides), out, on_progress, client)
        if overrides:
            instead = "change the mapping instead" if is_job(model) else "give the values as keywords"
            raise ArgumentError(f"overrides are for a job file: {instead}.")
        if isinstance(model, Mapping):
            return self._run(self.read(model, Path.cwd()), out, on_progress, client)
        assert not isinstance(model, Path)  # a job
        run = Settle() if job_fields["run"] is None else job_fields["run"]
        fields = fields_without_axes(model, values, self.ranges, **{**job_fields, "run": run})
        section = {name: value for name, value in own_fields.items() if value is not None}
        if self.section == "search" and not isinstance(model, str | type):
            # an instance has a value for each name of its structure, also for those that a search frees
            freed = own_fields["free"] or {}
            fields["structure"] = {k: value for k, value in fields["structure"].items() if k not in freed}
        job = self.read({**fields, self.section: section}, Path.cwd())
        if out is not None:
            refuse_of_session(fields["model"])
            return self._run(job, out, on_progress, client)
        with tempfile.TemporaryDirectory(prefix="gaitsweep_") as folder:
            result = self._run(job, folder, on_progress, client, in_memory=True)
        del result.table.attrs["path"]
        return dataclasses.replace(result, path=None)

    def _run(
        self,
        job: Any,
        out: str | Path | None,
        on_progress: Progress | None,
        client: Client | None,
        *,
        in_memory: bool = False,
    ) -> FitT:
        """Run a job that was read."""
        on_progress = progress_lines("sets") if on_progress is None else on_progress
        cluster = None if client is None else cluster_of(client, collect=in_memory)
        return self.run(
            job, out, on_progress=on_progress, on_message=warn, figures=not in_memory, cluster=cluster
        )


_SEARCH = _Fit("search", "free", load_search, read_search, run_search)
_SENSITIVITY = _Fit("sensitivity", "parameters", load_sensitivity, read_sensitivity, run_sensitivity)
