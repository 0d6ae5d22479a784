"""The task of a worker: one block of a table, computed with the engine of one process of known identity."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import importlib
import inspect
import json
import logging
import platform
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from gaitsweep.errors import EXIT_FAILURE, UserError
from gaitsweep.job import Job
from gaitsweep.own_modules import installed
from gaitsweep.runs.executor import compute_blocks
from gaitsweep.runs.prepare import RunContext, prepare
from gaitsweep.runs.provenance import versions
from gaitsweep.runs.refinement import some_rows
from gaitsweep.table import TableError
from gaitsweep.table.atomic_files import reason
from gaitsweep.table.directory import SharedWriter
from gaitsweep.table.locks import BLOCK_LOCKS, BlockLocks, this_process
from gaitsweep.table.manifest import Layout

Identity = Mapping[str, str]
_HASH = "the job's hash"
MODEL_FILE = ""  # in place of a module's name, where a model is a file and not a module


class WorkerUnfit(UserError):
    """A worker cannot compute this job's blocks; the message is the reason, without the worker's name.

    `address` is the worker's address, once known.
    """

    def __init__(self, why: str, address: str = "") -> None:
        self.address = address
        super().__init__(why)

    def __reduce__(self) -> tuple[type[WorkerUnfit], tuple[str, str]]:
        return WorkerUnfit, (str(self), self.address)


def identity_of(context: RunContext) -> Identity:
    """Return the identity of this process for a job."""
    return {
        **versions(),
        "gaitsweep's source": _source_digest()[:12],
        "the processor": _processor(),
        "the platform": context.spec.devices[0].platform,
        "the engine": context.engine,
        "the lanes": str(context.spec.lanes),
        "the model's program": hashlib.sha256(json.dumps(dict(context.program)).encode()).hexdigest()[:12],
        _HASH: context.job_hash[:12],
    }


def difference(worker: Identity, client: Identity) -> str | None:
    """Describe how a worker differs from the client; return None if it does not."""
    differences = {
        name: f"{name} is {worker.get(name, 'unknown')} there and {value} here"
        for name, value in client.items()
        if worker.get(name) != value
    }
    of_hash = differences.pop(_HASH, None)  # it follows from the others
    if of_hash and not differences:
        return f"{of_hash} (the files of its model differ)"
    return "; ".join(differences.values()) or None


def own_modules(context: RunContext) -> tuple[tuple[str, str], ...]:
    """Return the user's modules that a job needs, with the folders from which they are imported.

    A model file has the name `MODEL_FILE`, and the folder from which its path in the job begins.
    """
    folders: dict[str, str] = {}
    for own_class in (type(context.model.original), type(context.job.run)):
        model_file = getattr(own_class, "model_file", None)
        if model_file is not None:
            bases = (path for path in model_file.parents if (path / context.job.model).is_file())
            folders[MODEL_FILE] = str(next(bases, model_file.parent))
            continue
        module = inspect.getmodule(own_class)
        file = getattr(module, "__file__", None)
        if module is None or file is None or module.__name__.startswith("gaitsweep.") or installed(module):
            continue
        levels = len(module.__name__.split(".")) - (0 if Path(file).name == "__init__.py" else 1)
        folders[module.__name__] = str(Path(file).resolve().parents[levels])
    return tuple(folders.items())


@functools.cache
def _source_digest() -> str:
    """The sha256, in hex, of gaitsweep's source files."""
    root = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        digest.update(f"{file.relative_to(root)}\n".encode() + file.read_bytes())
    return digest.hexdigest()


def _processor() -> str:
    """The kind of processor, as far as it decides how numbers are rounded."""
    import llvmlite.binding as llvm

    features = llvm.get_host_cpu_features()
    # a fused product and sum rounds once
    return f"{platform.machine()} {'with' if features.get('fma') else 'without'} fused multiply-add"


MOST_DEATHS = 3  # of workers that began a block, after which it is given up
_POLL = 0.2  # s between two checks whether the task is still wanted
# A worker computes one block at a time with all of its cores, however many tasks Dask starts in it.
_ONE_BLOCK = threading.Lock()
_log = logging.getLogger("distributed.worker.gaitsweep")


class BlockGivenUp(UserError):
    """A block that ended the workers which computed it."""

    exit_code = EXIT_FAILURE


class Unwanted(Exception):
    """The client has cancelled the task, or is gone."""


@dataclasses.dataclass(frozen=True)
class JobTicket:
    """A job as sent to workers.

    Args:
        job: the resolved job, as JSON.
        modules: the user's modules that it needs, each with its folder.
        identity: identity of the client.
        probe: a file of the client in the result directory, and the text in it; None where the parts come
            back through the scheduler.
    """

    job: str
    modules: tuple[tuple[str, str], ...]
    identity: tuple[tuple[str, str], ...]
    probe: tuple[str, str] | None


@dataclasses.dataclass(frozen=True)
class Assignment:
    """Shared description of the tasks of one table.

    Args:
        ticket: the job.
        path: the result directory; of a refined run, that of the round.
        layout: that of the table.
        patience: how long (s) a worker waits for another process that holds its block, before it computes the
            block itself; both write the same part.
    """

    ticket: JobTicket
    path: str
    layout: Layout
    patience: float


def examine(ticket: JobTicket) -> str | None:
    """Prepare a job here; return the reason if this worker cannot compute its blocks, else None."""
    try:
        _context_of(ticket)
    except WorkerUnfit as error:
        return str(error)
    return None


def run_block(number: int, rows: Int[np.ndarray, " rows"] | None, assignment: Assignment) -> int | bytes:
    """Compute a block and write its part, unless the part exists.

    Args:
        number: the block.
        rows: the rows of the job (n,) that are its own, where a refined run chooses them.
        assignment: description of the table.

    Returns:
        The block's number; where the parts come back through the scheduler, the part.

    Raises:
        WorkerUnfit: this worker cannot compute the job's blocks, or cannot write.
        BlockGivenUp: the block has ended too many workers.
        Unwanted: the task was cancelled.
    """
    from distributed import get_worker

    try:
        with _ONE_BLOCK:
            return _run_block(number, rows, assignment)
    except WorkerUnfit as error:
        raise WorkerUnfit(str(error).rstrip("."), get_worker().address) from None


def _run_block(number: int, rows: Int[np.ndarray, " rows"] | None, assignment: Assignment) -> int | bytes:
    """Compute a block in the only thread that does, as `run_block`."""
    ticket = assignment.ticket
    writer = SharedWriter(Path(assignment.path), assignment.layout)
    name = f"block {assignment.layout.words(number)} of {assignment.path}"
    began = time.perf_counter()
    _log.info("begins %s", name)
    if ticket.probe is None:
        data = _compute(assignment, writer, number, rows)
        _log.info("has computed %s in %.1f s", name, time.perf_counter() - began)
        return data
    _check_probe(*ticket.probe)
    # held during the preparation too, so that a worker which dies in it counts
    with _block_lock(writer, number, assignment.patience) as missing:
        if missing:
            data = _compute(assignment, writer, number, rows)
            try:
                writer.write(number, data)
            except TableError as error:
                raise WorkerUnfit(error.sentence) from error
    _log.info("has written %s after %.1f s", name, time.perf_counter() - began)
    return number


@contextlib.contextmanager
def _block_lock(writer: SharedWriter, number: int, patience: float) -> Iterator[bool]:
    """A context that holds a block; its value says whether the part is missing."""
    if writer.has(number):
        yield False
        return
    try:
        locks = BlockLocks(writer.path)
    except OSError as error:
        raise WorkerUnfit(f"{error.filename} cannot be opened: {reason(error)}") from error
    with locks:
        deadline = time.monotonic() + patience
        deaths, last = locks.unfinished_starts(number)
        try:
            while not (taken := locks.take(number, _name())) and time.monotonic() < deadline:
                _stop_if_unwanted()
                time.sleep(_POLL)
                deaths, last = locks.unfinished_starts(number)
            missing = not writer.has(number)
            if missing:
                deaths -= not taken  # the last start is that of the process which holds the block
                if deaths >= MOST_DEATHS:
                    raise BlockGivenUp(f"it ended {deaths} workers that began it, the last of them {last}")
                locks.begin(number)
        except OSError as error:
            raise WorkerUnfit(f"{writer.path / BLOCK_LOCKS} cannot be written: {reason(error)}") from error
        try:
            yield missing
        finally:  # after an exception too; a worker that died leaves its start without an end
            if missing:
                with contextlib.suppress(OSError):
                    locks.end(number)


def _compute(
    assignment: Assignment, writer: SharedWriter, number: int, rows: Int[np.ndarray, " rows"] | None
) -> bytes:
    """Compute the part of a block."""
    context = _context_of(assignment.ticket)
    quantities = context.quantities
    if rows is not None:  # a round of a refined run, whose columns have no units in one process either
        quantities = None
        offset, _ = assignment.layout.rows_of(number)
        context = some_rows(
            context, assignment.layout.rows, lambda first, stop: rows[first - offset : stop - offset]
        )
    parts: list[bytes] = []
    last = time.monotonic()

    def on_progress(_: object) -> None:
        nonlocal last
        if time.monotonic() - last > _POLL:
            _stop_if_unwanted()
            last = time.monotonic()

    encode = functools.partial(writer.encoded, quantities=quantities)
    compute_blocks(context, [number], encode, lambda _, part: parts.append(part), on_progress)
    return parts[0]


def _stop_if_unwanted() -> None:
    """Raise Unwanted if the scheduler has cancelled the task of this thread."""
    worker = _worker()
    if worker is None:
        return
    task = worker.state.tasks.get(worker.get_current_task())
    if task is None or task.state == "cancelled":
        raise Unwanted


def _worker() -> Any | None:
    """Return the worker of Dask that runs this task; None outside a task."""
    from distributed import get_worker

    try:
        return get_worker()
    except ValueError:
        return None


def _name() -> str:
    """The name of this worker and its process, for the record of a block."""
    worker = _worker()
    return this_process() if worker is None else f"{worker.name} ({this_process()})"


@functools.lru_cache(maxsize=4)
def _context_of(ticket: JobTicket) -> RunContext:
    """Return the context of the job in this process, after a comparison with the client's."""
    if ticket.probe is not None:
        _check_probe(*ticket.probe)
    for module, folder in ticket.modules:
        if module not in sys.modules and folder not in sys.path:
            sys.path.append(folder)
        if module == MODEL_FILE:
            continue
        try:
            importlib.import_module(module)
        except Exception as error:
            raise WorkerUnfit(
                f"{module} does not import there ({type(error).__name__}: {error}): put it into a folder "
                "that all workers see, or on their PYTHONPATH"
            ) from error
    try:
        fields = json.loads(ticket.job)
        context = prepare(Job.model_validate(fields | {"engine": fields["engine"] | {"devices": None}}))
    except UserError as error:
        raise WorkerUnfit(f"the job is refused there: {error.sentence}") from error
    spec = context.spec
    if spec.devices[0].platform == "cpu" and (worker := _worker()) is not None:
        # the results do not depend on the number of devices
        cores = spec.devices[: worker.state.nthreads]
        context = dataclasses.replace(context, spec=dataclasses.replace(spec, devices=cores))
    mismatch = difference(identity_of(context), dict(ticket.identity))
    if mismatch is not None:
        raise WorkerUnfit(mismatch)
    return context


@functools.lru_cache(maxsize=16)
def _check_probe(file: str, token: str) -> None:
    """Raise WorkerUnfit if this worker does not share the client's result directory."""
    probe = Path(file)
    folder = probe.parent
    file_of_worker = probe.with_name(
        f"{probe.name}-{threading.get_native_id()}-{this_process().replace(' ', '-')}"
    )
    try:
        if probe.read_text() != token:
            raise FileNotFoundError
        file_of_worker.write_text(token)
        file_of_worker.unlink()
    except FileNotFoundError:
        raise WorkerUnfit(
            f"it does not see the result directory {folder}: give a directory that all workers share with "
            "--out, or add --collect, so that the parts come back through the scheduler"
        ) from None
    except OSError as error:
        raise WorkerUnfit(f"it cannot write into {folder}: {reason(error)}") from error
