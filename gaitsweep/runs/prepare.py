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
from gaitsweep.engine.sweep.engines import EngineError, choose, default_lanes
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

# Number of rows of which the nominal period is computed.
_LOOKED_AT = 4


class RunError(UserError):
    """A job cannot run here; the message says why and what to do."""


@dataclasses.dataclass(frozen=True)
class RunContext:
    """A job on this machine: its rows, the specification of their sweep, and the hash of its directory.

    `steps` are the lengths of the rows' steps; `note` says why the engine is another than the one preferred,
    if it is; `rows_in(first, stop)` gives the rows (stop - first,) of the job where only some are simulated,
    numbered anew from 0.
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
        """Digests of the traced functions of a user's model, by name; empty for gaitsweep's own."""
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
    recorder, moved = job.run.recorder(rows.model), job.run.moved
    schedule = job.run.schedule()
    drive = None if schedule is None or moved is None else Drive(rows, moved, schedule)
    try:
        engine, note = choose(job.engine.name, devices[0], rows.model, recorder, numerics, drive)
    except EngineError as error:
        raise RunError(str(error)) from error
    lanes = job.engine.lanes or default_lanes(engine, rows.n_rows, devices[0].platform)
    lanes = min(lanes, max(8, rows.n_rows))  # more would be idle from the start
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
    digest = steps.digest if numerics.dt is None else None
    job_hash = job.hash(device=devices[0].platform, engine=engine, lanes=lanes, steps=digest)
    for own in (type(rows.model.original), type(job.run)):  # a user's own: edited, it is another job
        job_hash = _with_source(job_hash, own)
    if digest := rows.model.data_digest:
        job_hash = hashlib.sha256((job_hash + digest).encode()).hexdigest()
    return RunContext(job, rows, spec, note, job_hash, steps)


def row_values(
    design: Design,
    run: RunKind,
    numerics: ResolvedNumerics,
    steps: RowSteps,
    rows_in: Callable[[int, int], Int[np.ndarray, " rows"]] | None = None,
) -> Callable[[int, int], tuple[Values, Values]]:
    """Function `(first, last) -> (parameters, starts)` of rows first..last-1 of a run.

    It checks the rows' steps if only some of them were checked when the job was read. `rows_in(first, last)`
    gives the rows of the job (last - first,) if only some of them are simulated.
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
    values, _ = design.values_in(np.unique(np.linspace(0, design.n_rows - 1, _LOOKED_AT).astype(np.int64)))
    model = design.model
    seconds = _period(model)(model.on_host(values))
    sound = seconds[(seconds > 0.0) & (seconds < np.inf)]
    return float(sound[0]) if sound.size else math.nan


@cached_by_content(maxsize=16)
def _period(model: Model) -> Callable[..., Float[np.ndarray, " rows"]]:
    """`values -> period` of rows."""
    return over_rows(lambda values: model.period(model.params(values)), "period", model)


class Drive:
    """The parameters at a time, `(values, t) -> params`; formulas that use the moving parameter follow it.

    `times` (s): where its passes begin and end, and some between, by which the length of steps is chosen.
    """

    def __init__(self, rows: Design, moved: str, schedule: Schedule) -> None:
        self._rows, self._moved, self._schedule = rows, moved, schedule
        self._following = rows.following(moved)
        self.times = schedule.times

    def __call__(self, values: Mapping[str, jax.Array], t: jax.Array) -> Params:
        moved = {**values, self._moved: self._schedule.at(t)}
        return self._rows.model.params(resolve(self._following, moved, functions_of(jnp)))


@contextlib.contextmanager
def naming_the_file() -> Iterator[None]:
    """Raise errors of the operating system as a sentence that names the file."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            raise
        raise WriteError(f"{error.filename} cannot be used: {reason(error)}.") from error


def _with_source(job_hash: str, own: type) -> str:
    """Extend a hash by the source of the user's module that defines a class, and of the modules beside it."""
    module = inspect.getmodule(own)
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
