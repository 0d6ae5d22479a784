"""Job of a search: free constants, targets, and options of the optimiser."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import Field

from gaitsweep import near_miss
from gaitsweep.engine.sweep.engine_choice import default_lanes
from gaitsweep.errors import ArgumentError, JobError
from gaitsweep.fitting.fit_fields import (
    by_name,
    name_errors,
    read_file,
    read_free,
    read_measure,
    read_settings,
)
from gaitsweep.fitting.free_parameters import FreeParameter
from gaitsweep.fitting.optimisers import RULE_OF_RESTARTS, Method, missing_package
from gaitsweep.fitting.robustness import ROBUST, Robust, ShareKept, check_robust, own_constants
from gaitsweep.fitting.search_and_sensitivity_job import FitJob, read_fit_job
from gaitsweep.fitting.targets import MISS, Target, TargetValue
from gaitsweep.runs.prepare import RunContext
from gaitsweep.schema.diagnostics import Diagnostic, quoted, refuse
from gaitsweep.schema.numbers import Count, CountOrZero, Positive, Seed, Text, Word
from gaitsweep.schema.strict_model import StrictModel, plain, read_model
from gaitsweep.status import SetStatus
from gaitsweep.table import TableError, load

# Columns of the table of a search beside constants and targets.
_COLUMNS = ("row", "generation", "score", "status", "why")
# Sets that are measured together by default.
_SETS_TOGETHER = 64
# Sets that NSGA-III takes at a time, at most: its own time grows with their square, about a second for these.
_MOST_OF_A_FRONT = 2048
# Batches that a GPU runs at a time by default.
_SIDE_BY_SIDE = 4
_MAX_LANES = 2**20  # rows that a GPU is filled for


class SearchOptions(StrictModel):
    """Settings by which a search chooses its sets."""

    method: Annotated[Method, Word()] = Field(
        default="cma",
        description="sobol: points that fill the ranges; cma: evolution strategies with restarts (BIPOP), "
        "for one score; nsga3: a front, where targets conflict",
    )
    budget: Count = Field(description="sets that are measured in all")
    population: Count | None = Field(
        default=None,
        description="sets that are measured together; by default 64 on a CPU, and what fills a GPU",
    )
    side_by_side: Count | None = Field(
        default=None,
        description="batches that run at a time: a batch is chosen before those beside it are known; by "
        "default 1 on a CPU and 4 on a GPU, which one batch fills only until its first rows end",
    )
    start: CountOrZero | None = Field(
        default=None,
        description="sets of a Sobol sequence with which cma begins; by default a tenth of the budget",
    )
    first: list[Text] = Field(
        default=[],
        description="targets that are measured first: a set without a value for one of them is not measured "
        "further, which saves the time of sets that fall or never settle",
    )
    first_within: Positive | None = Field(
        default=None,
        description="reading errors by which the targets of `first` may be missed for a set to be measured "
        "further; by default any value will do",
    )
    robust: Robust | None = Field(
        default=None,
        description="the share of random neighbours of a set that should keep some targets: a target itself, "
        "measured of sets that keep them",
    )
    known: list[dict[str, Any] | Text] = Field(
        default=[],
        description="sets that are measured before all others: constants by name, a config that has them, or "
        "the result directory of an earlier search, of which the best are taken; a constant that they do not "
        "name has the job's own value, or the model's default",
    )
    known_best: Count = Field(
        default=64, description="sets that are taken of each earlier search in `known`, the best first"
    )
    width: Positive | None = Field(
        default=None,
        description="standard deviation with which the strategies of cma begin, a share of the ranges, 0.2 "
        "by default; a small one stays near `known` sets",
    )
    seed: Seed = Field(default=0, description="seed of all that is drawn")
    finalists: CountOrZero = Field(
        default=8,
        description="the best sets, which are measured again at half the step when the rest is done",
    )


@dataclasses.dataclass(frozen=True)
class Search:
    """Field `search` of a job: free constants, targets and options.

    With `options.robust` the last target is the share of a set's neighbours that keep its targets.
    """

    free: dict[str, FreeParameter]
    targets: dict[str, Target]
    options: SearchOptions

    @property
    def counted(self) -> list[str]:
        """Names of the targets that count."""
        return [name for name, target in self.targets.items() if not target.value.held_back]


@dataclasses.dataclass(frozen=True)
class SearchJob(Search):
    """Search of a job file: `fit` has the job, `written` its fields, which the result directory stores.

    `known` are the sets that are measured first, values of each constant by name;
    `changing` those of the job's constants that differ between a set and its neighbours.
    """

    fit: FitJob
    written: dict[str, Any]
    known: tuple[dict[str, Any], ...] = ()
    changing: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the job."""
        return self.fit.name

    @property
    def start(self) -> int:
        """Sets of the Sobol sequence with which `cma` begins."""
        return self.options.budget // 10 if self.options.start is None else self.options.start

    def known_points(self) -> Float[np.ndarray, "sets constants"]:
        """Return the points (m, constants) of the unit cube of the sets that are measured first."""
        points = np.empty((len(self.known), len(self.free)))
        for number, (name, parameter) in enumerate(self.free.items()):
            points[:, number] = parameter.share([values[name] for values in self.known])
        return points

    def sets_together(self, context: RunContext, rows_of_a_set: int) -> int:
        """Return the number of sets that are measured together.

        Args:
            context: context of the job of a set.
            rows_of_a_set: number of rows of each set.
        """
        sets = self.options.population
        if sets is None:
            sets = self._default_population(context, rows_of_a_set)
        return min(sets, self.options.budget)

    def _default_population(self, context: RunContext, rows_of_a_set: int) -> int:
        """Return the number of sets that are measured together by default, such that they fill a GPU."""
        sets = _SETS_TOGETHER
        platform = context.spec.devices[0].platform
        if platform != "cpu" and rows_of_a_set:
            lanes = default_lanes(context.engine, _MAX_LANES, platform) * len(context.spec.devices)
            sets = max(sets, math.ceil(lanes / rows_of_a_set))
        return min(sets, _MOST_OF_A_FRONT) if self.options.method == "nsga3" else sets

    def batches_side_by_side(self, context: RunContext) -> int:
        """Return the number of batches that run at a time."""
        if self.options.side_by_side is not None:
            return self.options.side_by_side
        return 1 if context.spec.devices[0].platform == "cpu" else _SIDE_BY_SIDE

    def hash(
        self, *, device: str, engine: str, population: int, side_by_side: int, versions: Mapping[str, str]
    ) -> str:
        """Return the sha256, in hex, of all that determines the sets and their measures.

        Args:
            device: class of the device, such as "cpu" or "gpu".
            engine: the engine that runs.
            population: number of sets that are measured together.
            side_by_side: number of batches that run at a time.
            versions: versions by package, since optimisers of other versions draw other numbers.
        """
        jobs = [self.fit.job_of(structure) for structure in self.fit.structures]
        deciding = {
            "job": [job.hash(device=device, engine=engine) for job in jobs],
            "search": {**self.written["search"], "population": population, "side_by_side": side_by_side},
            "versions": dict(versions),
            **self.fit.deciding_rules(),
        }
        if self.options.method == "cma":  # other methods choose their points as in older versions
            deciding["restarts"] = RULE_OF_RESTARTS
        return hashlib.sha256(json.dumps(deciding, sort_keys=True).encode()).hexdigest()


def load_search(path: str | Path, overrides: Sequence[str] = ()) -> SearchJob:
    """Load a search from a YAML file.

    Args:
        path: the file.
        overrides: "key=value" each, laid over it as `gaitsweep.load_job` does.

    Raises:
        JobError: all errors, with file and line of each.
        ArgumentError: the package of the method is not installed.
    """
    return read_file(path, overrides, read_search)


def read_search(data: Mapping[str, Any], folder: Path) -> SearchJob:
    """Read a search from its mapping.

    Args:
        data: the mapping.
        folder: folder to which its paths are relative.

    Raises:
        JobError: all errors.
        ArgumentError: the package of the method is not installed.
    """
    data = plain(data)
    wrong: list[Diagnostic] = []
    search = read_search_field(data, wrong)
    robust = search.options.robust
    measures = {name: target.measure for name, target in search.targets.items() if target.value is not robust}
    fit = read_fit_job("search", data, folder, search.free, measures, wrong)
    if (package := missing_package(search.options.method)) is not None:
        raise ArgumentError(
            f"search.method {search.options.method} needs the package {package}: "
            "pip install 'gaitsweep[search]'."
        )
    changing = {} if robust is None else own_constants(robust, fit)
    known = _known(search, fit)
    written = {key: value for key, value in data.items() if value is not None}
    if known:  # the values and not a config that names them: with a changed config the search is another
        written["search"] = {**written["search"], "known": [dict(values) for values in known]}
    return SearchJob(search.free, search.targets, search.options, fit, written, known, changing)


def read_search_field(data: Mapping[str, Any], wrong: list[Diagnostic]) -> Search:
    """Read the field `search` of a job, without its model.

    Args:
        data: the job's mapping.
        wrong: receives all errors in the field.

    Raises:
        JobError: the field is missing or not a mapping.
    """
    search = data.get("search")
    if not isinstance(search, Mapping):
        text = "is missing" if search is None else f"is {quoted(search)}"
        raise JobError([Diagnostic(("search",), f"{text}: it has free, targets, budget, and method.")])
    free = read_free(search.get("free"), ("search", "free"), wrong)
    targets = _read_targets(search.get("targets"), free, wrong)
    options = read_settings(SearchOptions, "search", ("free", "targets"), search, wrong)
    if options is None:
        result = Search(free, targets, SearchOptions(budget=1))
    elif options.robust is None:
        result = Search(free, targets, options)
    else:
        wrong.extend(check_robust(options.robust, free, targets))
        robust = Target(ShareKept(kind="robust"), options.robust)
        result = Search(free, {**targets, ROBUST: robust}, options)
    if targets and not result.counted:
        wrong.append(Diagnostic(("search", "targets"), "are all held back: one of them has to count."))
    if options is not None:
        wrong.extend(_check_options(options, targets))
        if options.method == "nsga3":
            wrong.extend(_check_front(options, len(result.counted)))
    return result


def _check_options(options: SearchOptions, targets: Mapping[str, Target]) -> list[Diagnostic]:
    """Check options of a search that depend on others or on the targets; return the diagnostics."""
    wrong = []
    for number, name in enumerate(options.first):
        if name not in targets:
            text = f"is {name}, which is not a target{near_miss.suggestion(name, targets)}"
            wrong.append(Diagnostic(("search", "first", number), text))
    if options.first_within is not None and not options.first:
        text = "has no meaning without search.first, the targets that are measured first."
        wrong.append(Diagnostic(("search", "first_within"), text))
    of_cma = {"start": options.start, "width": options.width}
    for name, value in of_cma.items():
        if value is not None and options.method != "cma":
            text = f"has no meaning for the method {options.method}: it is cma's."
            wrong.append(Diagnostic(("search", name), text))
    if options.width is not None and options.width > 1.0:
        text = f"is {options.width:g}, but is a share of the ranges, at most 1."
        wrong.append(Diagnostic(("search", "width"), text))
    return wrong


def _check_front(options: SearchOptions, counted: int) -> list[Diagnostic]:
    """Check a search by nsga3 with this number of targets that count; return the diagnostics."""
    wrong = []
    if counted == 1:
        text = "is nsga3, which needs two targets or more that count: take cma."
        wrong.append(Diagnostic(("search", "method"), text))
    together = min(options.population or _SETS_TOGETHER, options.budget)
    if together < counted:
        field = "budget" if together == options.budget else "population"
        text = f"is {together}, but nsga3 takes as many sets at a time as targets count, {counted}."
        wrong.append(Diagnostic(("search", field), text))
    return wrong


def _known(search: Search, fit: FitJob) -> tuple[dict[str, Any], ...]:
    """Read the sets that are measured first: values of every free constant.

    Raises:
        JobError: all errors of these sets.
    """
    sets: list[dict[str, Any]] = []
    wrong: list[Diagnostic] = []
    for number, entry in enumerate(search.options.known):
        path = ("search", "known", number)
        try:
            for name, known_set in _sets_of(entry, search, fit.folder):
                values = fit.own_values(known_set)
                reasons = {constant: free.outside(values[constant]) for constant, free in search.free.items()}
                outside = [
                    f"{name}has {constant} at {quoted(values[constant])}, {reason}"
                    for constant, reason in reasons.items()
                    if reason is not None
                ]
                wrong.extend(Diagnostic(path, text) for text in outside)
                sets.append(values)
                if outside and name:  # one set of an earlier search shows which range is too narrow
                    break
        except JobError as error:
            wrong.extend(Diagnostic(path, f"is refused: {diagnostic}") for diagnostic in error.diagnostics)
        except TableError as error:
            wrong.append(Diagnostic(path, f"is refused: {error}"))
    if not wrong and len(sets) > search.options.budget:
        text = f"has {len(sets)} sets, but the budget is {search.options.budget}."
        wrong.append(Diagnostic(("search", "known"), text))
    refuse(wrong)
    return tuple(sets)


def _sets_of(
    entry: Mapping[str, Any] | str, search: Search, folder: Path
) -> Iterator[tuple[str, Mapping[str, Any] | str]]:
    """Yield the sets of an entry of `known`, each with its name in an earlier search, or "" without one.

    Args:
        entry: constants by name, a config, or a result directory of a search.
        search: the search.
        folder: folder to which the directory is relative.

    Raises:
        TableError: a directory is not the result of a search, or is that of a search of other constants.
    """
    directory = folder / entry if isinstance(entry, str) else None
    if directory is None or not directory.is_dir():
        yield "", entry
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a search that was stopped has sets too
        table = load(directory)
    if not {"score", "generation", "status"} <= set(table):
        raise TableError(f"{entry} is not the result of a search: its table has no score.")
    constants = [name for name in search.free if name in table]
    if not constants:
        raise TableError(f"{entry} is a search of other constants: it has none of {', '.join(search.free)}.")
    # a set that failed has a score too
    complete = table.iloc[np.flatnonzero(table["status"].astype(str) == SetStatus.COMPLETE)]
    best = complete.sort_values("score", kind="stable").drop_duplicates(constants)
    for _, row in best.head(search.options.known_best).iterrows():
        values = {name: search.free[name].written([row[name]])[0] for name in constants}
        yield f"row {row['row']} of {entry} ", values


def _read_targets(
    value: Any, free: Mapping[str, FreeParameter], wrong: list[Diagnostic]
) -> dict[str, Target]:
    """Read the targets by name; errors are added to `wrong`."""
    path = ("search", "targets")
    targets = {}
    takes = "targets by name, each with kind, at, wanted and error"
    for name, fields in by_name(value, takes, path, wrong):
        target_path = (*path, name)
        if not isinstance(fields, Mapping):
            wrong.append(Diagnostic(target_path, f"is {quoted(fields)}, but takes fields (key: value)."))
            continue
        value_fields = {key: field for key, field in fields.items() if key in TargetValue.model_fields}
        target_value = read_model(TargetValue, value_fields, target_path, wrong)
        measure_fields = {key: field for key, field in fields.items() if key not in value_fields}
        measure = read_measure(measure_fields, target_path, wrong, beside=TargetValue)
        is_taken = name in (*_COLUMNS, *free) or name.startswith(MISS) or name.endswith("_half")
        wrong.extend(name_errors(name, is_taken, target_path))
        if target_value is not None and measure is not None:
            targets[name] = Target(measure, target_value)
    return targets
