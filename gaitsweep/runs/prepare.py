"""The context of a run: engine, devices and lanes of a job, and the hash of its directory."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import inspect
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from gaitsweep.contract import Model, Params
from gaitsweep.design import Design
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.devices import local_devices
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.sweep.blocks_of_rows import rows_of_a_block
from gaitsweep.engine.sweep.engine_choice import EngineError, choose, default_lanes
from gaitsweep.engine.sweep.lane import Values
from gaitsweep.engine.sweep.sweep_spec import EngineName, SweepSpec
from gaitsweep.errors import UserError
from gaitsweep.expression import functions_of, resolve
from gaitsweep.job import Job
from gaitsweep.job.step_lengths import RowSteps, refuse_long_steps, row_steps
from gaitsweep.kinds.columns import quantities_of
from gaitsweep.kinds.run_kind import RunKind, Schedule
from gaitsweep.models.traced_program import traced_program
from gaitsweep.own_modules import modules_beside
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.table import WriteError, reason
from gaitsweep.table.manifest import Layout

_ROWS_OF_PERIOD = 4  # of which the nominal period is computed


class RunError(UserError):
    """A job cannot run here; the message says why and what to do."""


@dataclasses.dataclass(frozen=True)
class RunContext:
    """A job on this machine.

    Args:
        job: the job.
        design: its rows.
        spec: the specification of their sweep.
        note: the reason why the engine is not the preferred one; None if it is.
        job_hash: the hash of its directory.
        steps: the lengths of the rows' steps.
        rows_in: gives, as `rows_in(first, stop)`, the rows (stop - first,) of the job where only some are
            simulated, numbered anew from 0.
    """

    job: Job
    design: Design
    spec: SweepSpec
    note: str | None
    job_hash: str
    steps: RowSteps
    rows_in: Callable[[int, int], Int[np.ndarray, " rows"]] | None = None

    @property
    def model(self) -> Model:
        return self.design.model

    def table(self, block: RowOutcome) -> pd.DataFrame:
        """Return the records of a block of rows."""
        rows = block.row
        if self.rows_in is not None:
            rows = self.rows_in(int(rows[0]), int(rows[-1]) + 1)
        return self.job.run.table(self.model, self.design.at(rows, self.design.names), block)

    @property
    def layout(self) -> Layout:
        """The layout of the job's table."""
        return Layout(self.job_hash, self.spec.n_rows, self.spec.block)

    @property
    def quantities(self) -> dict[str, dict[str, Any]]:
        """Unit, meaning and symbol of the columns of the job's table."""
        return quantities_of(self.model, self.job.run.all_columns(self.model))

    @property
    def program(self) -> Mapping[str, str]:
        """Digests of the functions and quantities of a user's model, by name; empty for gaitsweep's own."""
        return traced_program(self.model.original).digests

    @property
    def engine(self) -> EngineName:
        return self.spec.engine

    @property
    def device(self) -> str:
        first = self.spec.devices[0]
        return f"{len(self.spec.devices)} x {first.platform} ({first.device_kind})"


def prepare(job: Job) -> RunContext:
    """Choose engine, devices and lanes for a job.

    Raises:
        RunError: a device or an engine that the job asks for is not available.
    """
    try:
        devices = local_devices(job.engine.devices)
    except ValueError as error:
        raise RunError(str(error)) from error
    rows = job.design
    numerics = job.integration
    recorder = job.run.recorder(rows.model)
    moved = job.run.moved
    schedule = job.run.schedule()
    drive = None if schedule is None or moved is None else Drive(rows, moved, schedule)
    try:
        engine, obstacle = choose(job.engine.name, devices[0], rows.model, recorder, numerics, drive)
    except EngineError as error:
        raise RunError(str(error)) from error
    note = None if obstacle is None else f"engine: xla, because {obstacle}."
    lanes = job.engine.lanes or default_lanes(engine, rows.n_rows, devices[0].platform)
    lanes = _useful(lanes, rows.n_rows)
    steps = row_steps(rows, job.run, numerics)
    spec = SweepSpec(
        model=rows.model,
        recorder=recorder,
        numerics=numerics,
        n_rows=rows.n_rows,
        block=job.block,
        lanes=lanes,
        devices=devices,
        values=row_values(rows, job.run, numerics, steps),
        drive=drive,
        engine=engine,
    )
    step_digest = steps.digest if numerics.dt is None else None
    job_hash = job.hash(device=devices[0].platform, engine=engine, lanes=lanes, steps=step_digest)
    for own_class in (type(rows.model.original), type(job.run)):  # a user's own: edited, it is another job
        job_hash = _with_source(job_hash, own_class)
    if data_digest := rows.model.data_digest:
        job_hash = hashlib.sha256((job_hash + data_digest).encode()).hexdigest()
    return RunContext(job, rows, spec, note, job_hash, steps)


def in_memory(context: RunContext) -> RunContext:
    """Return the context of the same rows for a table in memory: longer blocks, and more lanes.

    More rows are then open at a time; an interrupt loses all rows of such a table anyway. No result depends
    on it.
    """
    engine, spec = context.job.engine, context.spec
    lanes = spec.lanes
    platform = spec.devices[0].platform
    if engine.lanes is None and spec.engine == "kernel":
        lanes = max(lanes, default_lanes(spec.engine, spec.n_rows, platform, in_memory=True))
    block = rows_of_a_block(engine.block, spec.n_rows, in_memory=True)
    return dataclasses.replace(
        context, spec=dataclasses.replace(spec, block=block, lanes=_useful(lanes, spec.n_rows))
    )


def _useful(lanes: int, n_rows: int) -> int:
    """Return the number of lanes of which none is idle from the start, but at least 8."""
    return min(lanes, max(8, n_rows))


def row_values(
    design: Design,
    run: RunKind,
    numerics: ResolvedNumerics,
    steps: RowSteps,
    rows_in: Callable[[int, int], Int[np.ndarray, " rows"]] | None = None,
) -> Callable[[int, int], tuple[Values, Values]]:
    """The function `(first, last) -> (parameters, starts)` of rows first..last-1 of a run.

    The function checks the rows' steps if only some of them were checked when the job was read.

    Args:
        design: the rows of the job.
        run: its run kind.
        numerics: its numerics.
        steps: the lengths of its rows' steps.
        rows_in: as of `RunContext`.
    """
    unchecked = numerics.dt is not None and steps.sampled and not design.model.host_parameters

    def values(first: int, last: int) -> tuple[Values, Values]:
        rows = np.arange(first, last, dtype=np.int64) if rows_in is None else rows_in(first, last)
        if unchecked:
            refuse_long_steps(design, run, numerics, rows)
        return design.values_in(rows)

    return values


def nominal_period(design: Design) -> float:
    """Return the nominal period (s) of the first sampled row that has one; NaN if none has."""
    rows = np.unique(np.linspace(0, design.n_rows - 1, _ROWS_OF_PERIOD).astype(np.int64))
    values, _ = design.values_in(rows)
    model = design.model
    seconds = _period(model)(model.on_host(values))
    sound = seconds[(seconds > 0.0) & (seconds < np.inf)]
    return float(sound[0]) if sound.size else math.nan


@cached_by_content(maxsize=16)
def _period(model: Model) -> Callable[..., Float[np.ndarray, " rows"]]:
    """The function `values -> period` of rows."""
    return over_rows(lambda values: model.period(model.params(values)), "period", model)


class Drive:
    """The parameters at a time, `(values, t) -> params`; formulas that use the moving parameter follow it.

    `times` (s) are those where its passes begin and end, and some between: steps are chosen by them.

    Args:
        design: the rows of the job.
        moved: the parameter that moves.
        schedule: its values over time.
    """

    def __init__(self, design: Design, moved: str, schedule: Schedule) -> None:
        self._model = design.model
        self._moved = moved
        self._schedule = schedule
        self._following = design.following(moved)
        self.times = schedule.times

    def __call__(self, values: Mapping[str, jax.Array], t: jax.Array) -> Params:
        values_now = {**values, self._moved: self._schedule.at(t)}
        return self._model.params(resolve(self._following, values_now, functions_of(jnp)))


@contextlib.contextmanager
def naming_the_file() -> Iterator[None]:
    """Raise errors of the operating system as a sentence that names the file."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            raise
        raise WriteError(f"{error.filename} cannot be used: {reason(error)}.") from error


def _with_source(job_hash: str, own_class: type) -> str:
    """Extend a hash by the source of the user's module that defines a class, and of the modules beside it."""
    module = inspect.getmodule(own_class)
    if module is None or module.__name__.startswith("gaitsweep."):
        return job_hash
    try:
        source = inspect.getsource(module)
    except (OSError, TypeError):
        return job_hash
    other_modules = modules_beside(module)
    other_modules.pop(module.__name__, None)
    digest = hashlib.sha256((job_hash + source).encode(errors="replace"))
    with naming_the_file():
        for name in sorted(other_modules):
            digest.update(f"\n# {name}\n".encode() + other_modules[name].read_bytes())
    return digest.hexdigest()
