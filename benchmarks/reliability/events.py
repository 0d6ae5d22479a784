"""Are events and derivatives right in random hybrid models? `python -m benchmarks.reliability.events`.

Each family is a class of models with closed solutions, or with ones that NumPy and SciPy work out without
gaitsweep: bodies that bounce, wheels, cells that fire each other, stick and slip, clocks that meet, and so on
(`--list`). Compared are the status, the times of the crossings relative to the model's period, the state
there, and the return map's Jacobian with central differences of the exact solution. A model is

- `agree`: all of these are right, times and states to 1e-6, Jacobians to 1e-6 of their largest element;
- `lost`: gaitsweep refused it, or its status says that the row came to no result;
- `marked`: a number is wrong, but a run of this model alone warns;
- `silent`: a number or a status is wrong, and nothing says so.

Exit code 1 where a model is silent.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
import sys
import time
import warnings
import zlib
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

# one thread for each process: the matrices are small
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd

import gaitsweep as gs
from gaitsweep.api.keywords import job_of
from gaitsweep.api.return_map import PoincareMap
from gaitsweep.engine.solver.methods import METHODS
from gaitsweep.errors import UserError

from .random_events import FAMILIES
from .random_events.family import TOLERANCE, Case, Family, Solution, differences

MODELS = 300
AGREE, LOST, MARKED, SILENT = "agree", "lost", "marked", "silent"
# Statuses that claim no result; all others are an answer.
NO_RESULT = frozenset({"event_stall", "step_limit", "not_a_number"})


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Result of one model: the outcome, the errors, and gaitsweep's message."""

    family: str
    case: Case
    outcome: str
    message: str
    error: float = np.nan
    jacobian_error: float = np.nan


def numbers(solution: Solution, row: pd.DataFrame) -> tuple[str, float]:
    """The status of a row, and its largest error."""
    status = str(row["status"].iloc[-1])
    if not solution.statuses:
        return status, np.inf
    if status not in solution.statuses:
        return status, np.inf
    error = 0.0
    if "crossing" in row:
        row = row.loc[row["crossing"] > 0]
    for name, right in solution.columns.items():
        if name not in row:
            continue
        result = row[name].to_numpy(float)
        right = np.atleast_1d(np.asarray(right, float))
        if result.shape != right.shape:
            return status, np.inf
        scale = solution.period if name in ("t", "t_end") else solution.scales.get(name, 1.0)
        worst = np.max(np.abs(result - right), initial=0.0) / scale
        error = max(error, np.inf if np.isnan(worst) else float(worst))
    return status, error


def run_together(family: Family, cases: list[Case], options: dict[str, Any]) -> tuple[pd.DataFrame, str]:
    """The table of cases of one run, and the warnings of the run, with its self-check.

    `options` are those of the job: its `engine` and its `numerics`.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = gs.sweep(
            family.model(),
            run=cases[0].run,
            zip=zipped(cases),
            **options,
        )
        table = result.table
    messages = [str(warning.message) for warning in caught if warning.category is UserWarning]
    check = table.attrs["manifest"].get("self_check") or {}
    if check.get("verdict") == "warned":
        messages.append(f"self-check: {check}")
    return table, "; ".join(messages)


def zipped(cases: list[Case]) -> dict[str, Any]:
    """The parameters and starts of cases, side by side."""
    return {name: {"values": [case.values[name] for case in cases]} for name in cases[0].values}


def jacobians(
    family: Family, cases: list[Case], options: dict[str, Any]
) -> tuple[list[str], np.ndarray, str]:
    """The coordinates, the return map's Jacobians (n, size, size), and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = family.model()
        job = job_of(model, {"zip": zipped(cases)}, run=gs.ReturnMap(crossings=1), verify=0, **options)
        mapping = PoincareMap(job, 1, ())
        result = mapping.jacobian(mapping.settled({}, 0))
    messages = [str(warning.message) for warning in caught if warning.category is UserWarning]
    return mapping.coordinates, result, "; ".join(messages)


def off(family: Family, case: Case, coordinates: list[str], computed: np.ndarray) -> float:
    """The error of a Jacobian, in units of its largest element or 1."""
    scales = family.exact(case).scales
    right = differences(family, case, coordinates, scales)
    widths = np.array([scales.get(name, 1.0) for name in coordinates])
    computed = computed * widths / widths[:, None]
    return float(np.max(np.abs(computed - right)) / max(1.0, np.abs(right).max()))


def in_groups(cases: Iterable[Case]) -> list[list[int]]:
    """The indices of cases that one job can run: of one run."""
    groups: dict[str, list[int]] = {}
    for i, case in enumerate(cases):
        groups.setdefault(repr(case.run), []).append(i)
    return list(groups.values())


def verdicts_on(family: Family, cases: list[Case], options: dict[str, Any]) -> list[Verdict]:
    """The verdicts on cases of one family."""
    solutions = [family.exact(case) for case in cases]
    verdicts: list[Verdict | None] = [None] * len(cases)
    for group in in_groups(cases):
        try:
            table, spoken = run_together(family, [cases[i] for i in group], options)
            rows: dict[Hashable, pd.DataFrame] = dict(iter(table.groupby("row")))
        except UserError:
            spoken, rows = "", {}  # each is asked alone
        for place, i in enumerate(group):
            error = numbers(solutions[i], rows[place])[1] if place in rows else np.inf
            outcome, message = AGREE, spoken
            if not error <= TOLERANCE:
                outcome, message, error = asked_alone(family, cases[i], solutions[i], options)
            verdicts[i] = Verdict(family.name, cases[i], outcome, message, error)
    results = [verdict for verdict in verdicts if verdict is not None]
    return with_jacobians(family, results, options) if family.jacobian else results


def asked_alone(
    family: Family, case: Case, right: Solution, options: dict[str, Any]
) -> tuple[str, str, float]:
    """The outcome of a case that runs alone with its self-check, its warnings, and the error."""
    try:
        table, message = run_together(family, [case], options)
    except UserError as refusal:
        return LOST, f"refused: {refusal}", np.nan
    status, error = numbers(right, table)
    if error <= TOLERANCE:
        return AGREE, message, error
    if status in NO_RESULT and status not in right.statuses:
        return LOST, status, np.nan
    return (MARKED if message else SILENT), f"{status} {message}".strip(), error


def with_jacobians(family: Family, verdicts: list[Verdict], options: dict[str, Any]) -> list[Verdict]:
    """The verdicts, where models whose Jacobian is wrong no longer agree."""
    result = list(verdicts)
    chosen = [i for i, verdict in enumerate(verdicts) if verdict.case.differentiable]
    if not chosen:
        return result
    try:
        coordinates, matrices, spoken = jacobians(family, [verdicts[i].case for i in chosen], options)
    except UserError as refusal:
        for i in chosen:
            result[i] = worse(verdicts[i], LOST, f"refused: {refusal}", np.nan)
        return result
    for place, i in enumerate(chosen):
        error = off(family, verdicts[i].case, coordinates, matrices[place])
        if error <= TOLERANCE:
            result[i] = dataclasses.replace(verdicts[i], jacobian_error=error)
        elif not np.isfinite(matrices[place]).all():
            result[i] = worse(verdicts[i], LOST, "the Jacobian is NaN", np.nan)
        else:
            # a warning of many maps may be about another one
            message = spoken and jacobians(family, [verdicts[i].case], options)[2]
            outcome = MARKED if message else SILENT
            result[i] = worse(verdicts[i], outcome, f"Jacobian off by {error:.1e} {message}".strip(), error)
    return result


def worse(verdict: Verdict, outcome: str, message: str, error: float) -> Verdict:
    """The verdict with what was found of its Jacobian, if that is worse."""
    order = (AGREE, LOST, MARKED, SILENT)
    outcome = max(verdict.outcome, outcome, key=order.index)
    return dataclasses.replace(
        verdict,
        outcome=outcome,
        message="; ".join(filter(None, (verdict.message, message))),
        jacobian_error=error,
    )


def drawn(family: Family, models: int, seed: int) -> list[Case]:
    """Random cases of a family; they depend on its name and the seed, not on the other families."""
    random = np.random.default_rng([seed, zlib.crc32(family.name.encode())])
    return [family.draw(random) for _ in range(models)]


def shares(families: list[Family], models: int) -> list[int]:
    """Number of models of each family, by their shares of a total."""
    whole = sum(family.share for family in families)
    ends = np.round(np.cumsum([family.share for family in families]) * models / whole).astype(int)
    return np.diff(ends, prepend=0).tolist()


def judged(work: tuple[str, int, int, dict[str, Any]]) -> tuple[list[Verdict], float]:
    """The verdicts on so many models of the family with a name, and the seconds that they took."""
    name, models, seed, options = work
    begun = time.monotonic()
    family = next(candidate for candidate in FAMILIES if candidate.name == name)
    verdicts = verdicts_on(family, drawn(family, models, seed), options)
    return verdicts, time.monotonic() - begun


def compared(
    models: int = MODELS,
    seed: int = 0,
    names: Iterable[str] = (),
    engine: str = "auto",
    method: str = "auto",
    workers: int = 1,
    on_progress: Callable[[list[Verdict], float], None] | None = None,
) -> list[Verdict]:
    """The verdicts on random models of the families with these names, or of all."""
    chosen = [family for family in FAMILIES if not names or family.name in names]
    counts = shares(chosen, models)
    options = {"engine": {"name": engine}, "numerics": {"method": method}}
    work = [(family.name, n, seed, options) for family, n in zip(chosen, counts, strict=True) if n]
    all_verdicts: list[Verdict] = []
    with contextlib.ExitStack() as stack:
        if workers == 1:
            results = map(judged, work)
        else:
            pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
            results = stack.enter_context(pool).map(judged, work)
        for verdicts, seconds in results:
            if on_progress is not None:
                on_progress(verdicts, seconds)
            all_verdicts += verdicts
    return all_verdicts


HEADER = (
    f"{'family':24s}{'models':>7s}{'agree':>7s}{'lost':>6s}{'marked':>8s}{'silent':>8s}  largest error of"
)
HEADER = f"{HEADER}\n{'':60s}  time, state  Jacobian    time"


def line(name: str, verdicts: list[Verdict], seconds: float) -> str:
    """A line of the table; errors are those of models that agree or are silent."""
    counts = [
        sum(verdict.outcome == outcome for verdict in verdicts) for outcome in (AGREE, LOST, MARKED, SILENT)
    ]
    judged = [verdict for verdict in verdicts if verdict.outcome in (AGREE, SILENT)]

    def largest(errors: list[float]) -> str:
        known = [error for error in errors if not np.isnan(error)]
        return f"{max(known):.1e}" if known else "-"

    error = largest([judgement.error for judgement in judged])
    jacobian = largest([judgement.jacobian_error for judgement in judged])
    columns = "".join(f"{count:{width}d}" for count, width in zip(counts, (7, 6, 8, 8), strict=True))
    return f"{name:24s}{len(verdicts):7d}{columns}  {error:>11s}  {jacobian:>8s}{seconds:6.0f} s"


def listed(verdicts: list[Verdict], most: int) -> str:
    """Messages about models, with their values: so many of each family and outcome, and one that agrees."""
    lines: list[str] = []
    seen: dict[tuple[str, str], int] = {}
    for verdict in verdicts:
        place = (verdict.family, verdict.outcome)
        if verdict.outcome == AGREE and not verdict.message:
            continue
        seen[place] = seen.get(place, 0) + 1
        if seen[place] > (1 if verdict.outcome == AGREE else most):
            continue
        values = ", ".join(f"{name}={value!r}" for name, value in verdict.case.values.items())
        lines.append(
            f"{verdict.family}, {verdict.outcome}: {verdict.message}; error {verdict.error:.1e}, Jacobian "
            f"{verdict.jacobian_error:.1e}; {verdict.case.run.model_dump(exclude_defaults=True)}; {values}"
        )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.reliability.events",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--models", type=int, default=MODELS, help="in all families together")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument(
        "--family", action="append", choices=[family.name for family in FAMILIES], default=[]
    )
    options.add_argument("--engine", default="auto", choices=["auto", "kernel", "xla"])
    options.add_argument("--method", default="auto", choices=("auto", *METHODS))
    options.add_argument("--workers", type=int, default=2, help="processes, a family each at a time")
    options.add_argument("--most", type=int, default=2, help="models listed of each family and outcome")
    options.add_argument("--list", action="store_true", help="say what the families are, and stop")
    chosen = options.parse_args(arguments)
    if chosen.list:
        for family in FAMILIES:
            print(f"{family.name:24s}{family.about}")
        return 0

    numerics = f"engine {chosen.engine}, method {chosen.method}"
    print(f"{chosen.models} models, seed {chosen.seed}, {numerics}\n{HEADER}", flush=True)
    begun = time.monotonic()

    def on_progress(verdicts: list[Verdict], seconds: float) -> None:
        if verdicts:
            print(line(verdicts[0].family, verdicts, seconds), flush=True)

    verdicts = compared(
        chosen.models, chosen.seed, chosen.family, chosen.engine, chosen.method, chosen.workers, on_progress
    )
    print(line("all", verdicts, time.monotonic() - begun))
    if text := listed(verdicts, chosen.most):
        print(text)
    return 1 if any(verdict.outcome == SILENT for verdict in verdicts) else 0


if __name__ == "__main__":
    sys.exit(main())
