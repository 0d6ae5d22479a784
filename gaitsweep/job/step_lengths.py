"""Step lengths of a job's rows, and the check of `numerics.dt`."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from gaitsweep.contract import HybridModel, Model
from gaitsweep.design.design import Design
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.devices import see_all_cores
from gaitsweep.engine.flow_spectrum import slowest_limit
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.engine.numerics import (
    MIN_STEPS_PER_PERIOD,
    ResolvedNumerics,
    longest_step,
    recommended_step,
    unknown_step,
)
from gaitsweep.engine.solver.methods import METHODS
from gaitsweep.engine.stored_traces import dependences, stored
from gaitsweep.errors import JobError
from gaitsweep.kinds import RunKind
from gaitsweep.schema.diagnostics import Diagnostic

Rows = Int[np.ndarray, " rows"]  # numbers of rows
PerRow = Float[np.ndarray, " rows"]  # a number for each row
# Largest number of sets of parameters whose steps are checked before a job runs. Of a job with more sets this
# many, evenly spaced, are checked, and the step of each row is when its block begins.
MAX_SETS = 1_000_000
# Number of sets for the range of the steps that a model recommends, which need no check.
MAX_RECOMMENDED = 65_536
# Number of sets if each needs a simulator's compiler, or eigenvalues.
MAX_COSTLY_SETS = 64
_CHUNK = 65_536  # rows that are evaluated at a time
_DIGEST_ROWS = 1024  # of which the steps are in a digest
# A step may be longer by rounding.
_ROUNDING = 1.0 + 1e-9


class _StepsAndLimits(NamedTuple):
    """The steps of rows, and their longest accurate steps (s); NaN if unknown."""

    dt: PerRow
    longest: PerRow


@dataclasses.dataclass(frozen=True)
class RowSteps:
    """Steps of a job's rows, evaluated for each distinct set of the parameters on which they depend.

    `rows` (n,) has one row of each set, `rows_per_set` is the number of rows of a set, `dt` (n,) is their
    step (s), and `longest` (n,) the longest accurate step (s), NaN if unknown. If `sampled`, only some sets
    were evaluated.
    """

    rows: Rows
    rows_per_set: float
    dt: PerRow
    longest: PerRow
    sampled: bool

    @property
    def digest(self) -> str:
        """Digest of the steps to six digits, which reveals a changed recommendation later."""
        rows = np.linspace(0, self.dt.size - 1, _DIGEST_ROWS).astype(int)
        distinct, inverse = np.unique(self.dt[rows], return_inverse=True)
        written = [f"{dt:.5e}" for dt in distinct]  # each once, since formatting takes time
        text = ",".join(written[index] for index in inverse)
        return hashlib.sha256(text.encode()).hexdigest()


def row_steps(design: Design, run: RunKind, numerics: ResolvedNumerics) -> RowSteps:
    """Return the steps of all rows.

    Args:
        design: the job's rows.
        run: their run kind; for a moving parameter, the steps of its whole path count.
        numerics: the resolved numerics of this model.
    """
    model = design.model
    all_names = [quantity.name for quantity in model.parameters]
    names = all_names if model.host_parameters else _deciding_names(model, numerics)
    most = MAX_RECOMMENDED if numerics.dt is None else MAX_SETS
    if model.host_parameters:
        most = MAX_COSTLY_SETS
    rows, count = design.combinations(names, most)
    dt, longest = _steps(design, run, numerics, rows)
    return RowSteps(rows, design.n_rows / count, dt, longest, count > most)


def check_steps(design: Design, run: RunKind, numerics: ResolvedNumerics) -> list[Diagnostic]:
    """Return errors about a step that is too long or too short, or that neither job nor model gives.

    Args:
        design, run, numerics: as for `row_steps`.
    """
    if numerics.dt is None:
        first = _steps(design, run, numerics, np.zeros(1, np.int64)).dt
        if numerics.adaptive or not np.isnan(first).any():
            return []
        if not np.isnan(row_steps(design, run, numerics).dt).all():  # a row without a step is not_a_number
            return []
        return [Diagnostic(("numerics", "dt"), f"is missing: {unknown_step(design.model, numerics.method)}")]
    steps = row_steps(design, run, numerics)
    longest = steps.longest
    if (unknown := np.flatnonzero(np.isnan(longest))).size:
        longest = longest.copy()
        longest[unknown] = _from_spectrum(design, run, numerics, steps.rows[unknown])
    # of rows with almost no rate, the period is as long as that of rows without
    shortest = np.fmin.reduce(longest, initial=np.inf)
    if shortest < np.inf and np.any(steps.dt < np.finfo(float).eps * shortest):
        text = f"is {numerics.dt:g} s, below the rounding of the time, which would not advance: remove it."
        return [Diagnostic(("numerics", "dt"), text)]
    wrong = np.flatnonzero(steps.dt > longest * _ROUNDING)
    if not wrong.size:
        return []
    worst = int(wrong[np.argmin(longest[wrong])])
    worst_row = design.at(steps.rows[[worst]], design.names)
    varying = [name for name in design.names if _varies(design, name, steps)]
    point = ", ".join(f"{name} = {worst_row[name][0]:.6g}" for name in varying)
    rows = "some" if steps.sampled else round(wrong.size * steps.rows_per_set)
    limit = f"{_rounded_down(float(longest[worst])):g} s"
    if point:
        limit += f" (at {point})"
    text = (
        f"is {numerics.dt:g} s, too long for {rows} of {design.n_rows} rows: the longest accurate step of "
        f"{numerics.method} for all of them is {limit}. Remove it to let each row take an accurate step."
    )
    return [Diagnostic(("numerics", "dt"), text)]


def too_long_steps(design: Design, run: RunKind, numerics: ResolvedNumerics) -> Bool[np.ndarray, " rows"]:
    """Return a mask of the rows (n_rows,) whose step is known to be too long for their parameters.

    Args:
        design, run, numerics: as for `row_steps`.
    """
    if numerics.dt is None:
        return np.zeros(design.n_rows, bool)
    dt, longest = _steps(design, run, numerics, np.arange(design.n_rows))
    return dt > longest * _ROUNDING


def refuse_long_steps(design: Design, run: RunKind, numerics: ResolvedNumerics, rows: Rows) -> None:
    """Refuse rows whose step is too long for their parameters.

    Args:
        design, run, numerics: as for `row_steps`.
        rows: the rows (n,).

    Raises:
        JobError: there is such a row.
    """
    dt, longest = _steps(design, run, numerics, rows)
    wrong = np.flatnonzero(dt > longest * _ROUNDING)
    if wrong.size:
        row = int(rows[wrong[0]])
        limit = _rounded_down(float(longest[wrong[0]]))
        text = f"is {numerics.dt:g} s, too long for row {row}: use at most {limit:g} s, or remove it."
        raise JobError([Diagnostic(("numerics", "dt"), text)])


def _varies(design: Design, name: str, steps: RowSteps) -> bool:
    """Return whether the values of an axis differ between the evaluated sets."""
    values = design.at(steps.rows[:: max(1, steps.rows.size // 1000)], [name])[name]
    return bool(np.ptp(values) > 0.0)


def _rounded_down(value: float) -> float:
    """Round a number above 0 down to four digits; return others, as of a wrong model, unchanged."""
    if value <= 0.0:
        return value
    digits = 10.0 ** (math.floor(math.log10(value)) - 3)
    return math.floor(value / digits) * digits


def _steps(design: Design, run: RunKind, numerics: ResolvedNumerics, rows: Rows) -> _StepsAndLimits:
    """Return the steps of rows (n,), for a moving parameter the shortest of its path."""
    if rows.size > _CHUNK:
        chunks = [rows[first : first + _CHUNK] for first in range(0, rows.size, _CHUNK)]
        parts = [_steps(design, run, numerics, chunk) for chunk in chunks]
        return _StepsAndLimits(*map(np.concatenate, zip(*parts, strict=True)))
    # the first computation of most runs, which must not leave JAX with one core
    see_all_cores()
    model = design.model
    values = design.at(rows, [quantity.name for quantity in model.parameters])
    of_parameters = _compiled_steps(model, numerics)
    steps_by_place: list[PerRow] = []
    limits_by_place: list[PerRow] = []
    n = rows.size
    # few sizes are compiled: that of a small set of rows, and full chunks
    size = n if n <= MAX_COSTLY_SETS else _CHUNK
    for place in run.places():
        row_values = design.with_moved(values, place)
        padded = {
            name: np.resize(np.broadcast_to(column, rows.shape).astype(float), size)
            for name, column in row_values.items()
        }
        dt, longest = of_parameters(model.on_host(padded))
        steps_by_place.append(np.asarray(dt)[:n])
        limits_by_place.append(np.asarray(longest)[:n])
    return _StepsAndLimits(np.min(steps_by_place, axis=0), np.min(limits_by_place, axis=0))


@cached_by_content(maxsize=16)
def _compiled_steps(model: Model, numerics: ResolvedNumerics) -> Callable[[Any], tuple[jax.Array, jax.Array]]:
    """Return the compiled function from parameters of many rows to their steps and longest steps."""

    def step_and_limit(values: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
        params = model.params(values)
        nan = jnp.full_like(model.period(params), jnp.nan)
        dt = recommended_step(model, numerics, params)
        longest = longest_step(model, numerics.method, params)
        return nan if dt is None else dt, nan if longest is None else longest

    return over_rows(step_and_limit, "steps", model, numerics)


@cached_by_content(maxsize=16)
def _deciding_names(model: Model, numerics: ResolvedNumerics) -> list[str]:
    """Find the parameters on which the length of steps depends, from the traced functions of a model."""
    names = [quantity.name for quantity in model.parameters]

    def lengths(values: dict[str, jax.Array]) -> list[jax.Array]:
        params = model.params(values)
        steps = [recommended_step(model, numerics, params), longest_step(model, numerics.method, params)]
        return [step for step in steps if step is not None]

    def deciding() -> list[str]:
        number = jax.ShapeDtypeStruct((), jnp.float64)
        return sorted(frozenset[str]().union(*dependences(lengths, dict.fromkeys(names, number))))

    return stored("deciding", model, (numerics,), deciding)


def _from_spectrum(design: Design, run: RunKind, numerics: ResolvedNumerics, rows: Rows) -> PerRow:
    """Compute the longest steps of rows (n,) for which the model gives none.

    They follow from the flow's matrix where it is linear, and are a share of the nominal period elsewhere;
    of a moving parameter the least, the middle and the largest value count. Rows that are not examined have
    no limit.
    """
    model = design.model
    places = run.extreme_places()
    count = max(1, MAX_COSTLY_SETS // len(places))
    examined = np.unique(np.linspace(0, rows.size - 1, count).astype(int))
    longest = np.full(rows.size, np.inf)
    # a map may take one step a period
    min_steps = MIN_STEPS_PER_PERIOD if isinstance(model, HybridModel) else 1.0
    for number, place in itertools.product(examined, places):
        values, starts = design.values_in(rows[[number]])
        params = model.params(_only_row(model.on_host(design.with_moved(values, place))))
        limit = float(model.period(params)) / min_steps
        if isinstance(model, HybridModel) and model.linear and METHODS[numerics.method].limits:
            state = model.init(params, _only_row(starts))
            limit = min(limit, slowest_limit(model, params, state, numerics.method))
        longest[number] = np.fmin(longest[number], limit)
    return longest


def _only_row(columns: Mapping[str, Any]) -> dict[str, jax.Array]:
    """Return the values of the only row of columns (1,)."""
    return {name: jnp.asarray(column[0]) for name, column in columns.items()}
