"""Dispatch of a table's blocks to the workers of a cluster, some of which die.

The parts on disk are the truth. A block whose task is lost, with a worker or with the scheduler, is submitted
again, and a worker that finds its part writes nothing. Few tasks are in flight: a scheduler does not queue
tasks that ask for resources, and keeps all tasks in memory.
"""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import itertools
import json
import secrets
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from jaxtyping import Int

from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.errors import EXIT_FAILURE, UserError
from gaitsweep.runs.cluster.connection import Connection
from gaitsweep.runs.cluster.task import (
    MOST_DEATHS,
    Assignment,
    BlockGivenUp,
    JobTicket,
    Unwanted,
    WorkerUnfit,
    identity_of,
    own_modules,
    run_block,
)
from gaitsweep.runs.cluster.worker_pool import WorkerPool
from gaitsweep.runs.executor import Executor, MissingBlocks
from gaitsweep.runs.prepare import RunContext
from gaitsweep.table import ResultDirectory, replace_file, writing
from gaitsweep.table.locks import BLOCK_LOCKS

# Tasks in flight: two for each worker, so that no worker waits for the client, or as many as end in
# `_AHEAD` s.
_AHEAD = 1.0
_MOST_IN_FLIGHT = 4096
_MOST_GATHERED = 16  # parts that come back through the scheduler at the same time
# Each poll of the tasks takes time of a core on which a worker may run: they are polled every `_POLL` s, and
# every `_POLL_OFTEN` s if more than `_MANY` end in a second.
_POLL = 0.05
_POLL_OFTEN = 0.01
_MANY = 10.0
_REPORT = 0.1  # s between two reports of progress
_MOST_FAILURES = 3  # of a block by an error
# The time limit of a block, after which its worker counts as hanging: this multiple of the longest time of a
# block so far, and at least this time (s).
_TIMES_LONGEST = 10.0
_LEAST_LIMIT = 120.0
# A worker waits so long (s) for another process that holds its block, and at most half the limit.
_LOCK_PATIENCE = 60.0
_BETWEEN_LIMIT_CHECKS = 10.0  # s between two polls of the tasks that each worker holds
_PROBE = ".probe-"  # a file of the client that workers look for
_LAG = 60.0  # s after which a file that another machine has written is seen


class BlocksFailed(UserError):
    """Some blocks could not be computed; all others were."""

    exit_code = EXIT_FAILURE


@dataclasses.dataclass
class _InFlight:
    """A submitted task, the time (s) of its submission, and the workers that may run it; None: all may."""

    future: Any
    since: float
    only: list[str] | None


class _TasksOfWorker(NamedTuple):
    """The keys of the tasks that a worker holds, and since when (s) none of its tasks has ended."""

    keys: set[Any]
    since: float


class Cluster(Executor):
    """The executor whose blocks the workers of a cluster compute; a context manager, which disconnects.

    Args:
        connection: connection to the cluster.
        collect: let the parts come back through the scheduler, where no directory is shared.
        limit: time (s) after which a block is taken from a worker that hangs; by default ten times that of
            the longest block so far, and at least 120 s.
        on_message: called with a sentence for each worker that is refused.
    """

    task: ClassVar[Callable[..., int | bytes]] = staticmethod(run_block)

    def __init__(
        self,
        connection: Connection,
        *,
        collect: bool = False,
        limit: float | None = None,
        on_message: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.workers = WorkerPool(connection, on_message)
        self.collect = collect
        self._limit = limit
        self._ticket: JobTicket | None = None
        self._group = f"gaitsweep-{secrets.token_hex(4)}"
        self._submitted = itertools.count()
        self._free_keys: collections.deque[Any] = collections.deque()

    @property
    def note(self) -> str:
        return self.workers.note

    @property
    def manifest(self) -> dict[str, Any]:
        return {"cluster": {"workers": self.workers.most}}

    @contextlib.contextmanager
    def serve(
        self, context: RunContext, directory: ResultDirectory, on_wait: Callable[[], None]
    ) -> Iterator[None]:
        token = secrets.token_hex(8)
        probe = directory.path / f"{_PROBE}{token}"
        for old_probe in directory.path.glob(f"{_PROBE}*"):  # of clients that were killed
            old_probe.unlink(missing_ok=True)
        if not self.collect:
            with writing(f"{directory.path} cannot be written"):
                replace_file(probe, lambda file: file.write(token.encode()))
        self.workers.on_card = context.spec.devices[0].platform == "gpu"
        self._ticket = JobTicket(
            json.dumps(directory.manifest["job"]),
            own_modules(context),
            tuple(identity_of(context).items()),
            None if self.collect else (str(probe.absolute()), token),
        )
        try:
            self.workers.connect(on_wait)
            while not self.workers.examine(self._ticket, on_wait):
                self.workers.connect(on_wait)
            yield
        finally:
            for own_probe in directory.path.glob(f"{probe.name}*"):  # also of workers that were killed
                own_probe.unlink(missing_ok=True)

    def close(self) -> None:
        """Disconnect from the cluster; workers of this command end."""
        self.workers.connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def run_blocks(self, missing: MissingBlocks) -> None:
        if self._ticket is None:
            raise RuntimeError("run_blocks is called inside `serve`.")
        path = missing.directory.path
        patience = min(_LOCK_PATIENCE, self.limit(None) / 2)
        assignment = Assignment(self._ticket, str(path.absolute()), missing.directory.layout, patience)
        # deaths that an earlier run has counted are forgotten
        (path / BLOCK_LOCKS).unlink(missing_ok=True)
        Dispatch(self, missing, assignment).run()

    def submit(
        self, tasks: Sequence[tuple[int, Int[np.ndarray, " rows"] | None]], assignment: Assignment
    ) -> list[Any]:
        """Submit blocks to the scheduler; return a task in flight for each.

        Args:
            tasks: the numbers of the blocks, each with the rows (n,) of the job that a refined run chooses.
            assignment: the description that all tasks share.
        """
        only = self.workers.chosen
        now = time.monotonic()
        futures = self.workers.client.map(
            self.task,
            [number for number, _ in tasks],
            [rows for _, rows in tasks],
            assignment=assignment,
            key=[self._key() for _ in tasks],
            pure=False,
            retries=0,
            workers=only,
            resources=self.workers.resources,
        )
        return [_InFlight(future, now, only) for future in futures]

    def _key(self) -> Any:
        """Name of a task.

        A scheduler keeps a record of each group of tasks, so there is one group; and the names of the last
        100 000 tasks, so names are reused long after their tasks have ended.
        """
        if len(self._free_keys) > 2 * _MOST_IN_FLIGHT:
            return self._free_keys.popleft()
        return self._group, next(self._submitted)

    def free_key(self, key: Any) -> None:
        """Make the name of a task that ended well available again."""
        self._free_keys.append(key)

    def limit(self, longest: float | None) -> float:
        """Return the time (s) that a task may take, where the longest so far took `longest`."""
        if self._limit is not None:
            return self._limit
        return float("inf") if longest is None else max(_TIMES_LONGEST * longest, _LEAST_LIMIT)


class Dispatch:
    """The dispatch of the blocks of one table.

    Args:
        cluster: the cluster.
        missing: the blocks.
        assignment: the description that all tasks share.
    """

    def __init__(self, cluster: Cluster, missing: MissingBlocks, assignment: Assignment) -> None:
        self.cluster = cluster
        self.workers = cluster.workers
        self.missing = missing
        self.directory = missing.directory
        self.assignment = assignment
        self.waiting = collections.deque(missing.numbers)
        self.flight: dict[int, _InFlight] = {}
        self.ended: list[int] = []
        self.failures: collections.Counter[int] = collections.Counter()
        self.failed: dict[int, str] = {}
        self.rows = self.directory.layout.rows_in(missing.numbers)
        self.done = 0  # rows
        self._reported = -_REPORT
        self._began = time.monotonic()
        self._longest: float | None = None  # s, of the tasks that have ended
        self._ends = 0  # blocks that ended since `_counted` (s)
        self._counted = self._began
        self._rate = 0.0  # blocks that ended in a second before that
        self._checked_at = self._began
        self._tasks_of_workers: dict[str, _TasksOfWorker] = {}  # by the worker's address

    def run(self) -> None:
        """Have all blocks computed, and return when their parts exist.

        Raises:
            BlocksFailed: some blocks could not be computed.
        """
        try:
            while self.waiting or self.flight:
                self._step()
                if not self.waiting and not self.flight:
                    self._settle()
        except BaseException:
            self._cancel()
            with contextlib.suppress(UserError):
                self._take_parts()
            raise
        if self.failed:
            raise BlocksFailed(self._sentence())

    def _step(self) -> None:
        """Submit waiting blocks, process ended tasks, and report."""
        try:
            if not self.workers.connection.alive:
                # tasks in flight are submitted again, to another scheduler
                self._give_back(list(self.flight))
                self.workers.connect(self._report)
            self.workers.update()
            self._refill()
            ends = self._take_ended()
            self._free_stranded()
            self._end_hanging_workers()
        except (OSError, TimeoutError):  # the scheduler is lost while it was asked
            if self.workers.connection.alive:
                raise
            ends = 0
        self._report()
        if not ends:
            time.sleep(_POLL_OFTEN if self._rate > _MANY else _POLL)

    def _give_back(self, numbers: Sequence[int]) -> None:
        """Let blocks in flight wait again."""
        for number in numbers:
            self.flight.pop(number).future.release()
            self.waiting.appendleft(number)

    def _refill(self) -> None:
        """Submit as many blocks as workers can take."""
        slots = self.workers.slots
        now = time.monotonic()
        if now - self._counted >= 0.5 * _AHEAD:
            self._rate = self._ends / (now - self._counted)
            self._ends = 0
            self._counted = now
        wanted = min(max(2 * slots, int(self._rate * _AHEAD)), _MOST_IN_FLIGHT) if slots else 0
        free = min(wanted - len(self.flight), len(self.waiting))
        if free <= 0 or free < min(wanted // 8, len(self.waiting)):  # many at once are cheaper
            return
        numbers = [self.waiting.popleft() for _ in range(free)]
        try:
            tasks = self.cluster.submit([(n, self._rows(n)) for n in numbers], self.assignment)
        except BaseException:
            self.waiting.extendleft(reversed(numbers))
            raise
        self.flight.update(zip(numbers, tasks, strict=True))

    def _rows(self, number: int) -> Int[np.ndarray, " rows"] | None:
        """The job's rows of a block where a round of a refined run chooses them, else None."""
        rows_in = self.missing.context.rows_in
        return None if rows_in is None else rows_in(*self.directory.layout.rows_of(number))

    def _take_ended(self) -> int:
        """Process the tasks that have ended, well or not; return their number."""
        # read once: it changes while the scheduler is lost
        status = {number: task.future.status for number, task in self.flight.items() if task.future.done()}
        errors = {
            number: self.flight[number].future.exception(timeout=30)
            for number, state in status.items()
            if state == "error"
        }
        if self.cluster.collect:
            finished = [number for number, state in status.items() if state == "finished"]
            for number in finished[_MOST_GATHERED:]:  # these are taken in the next call
                del status[number]
            if not self._gather(finished[:_MOST_GATHERED]):
                return 0
        now = time.monotonic()
        for number in status:
            task = self.flight.pop(number)
            if number in errors:
                self._fail(number, errors[number])
            elif status[number] == "finished":
                self.done += self.directory.layout.rows_in([number])
                self.ended.append(number)
                self._longest = max(self._longest or 0.0, now - task.since)
                self._ends += 1
                self.cluster.free_key(task.future.key)
            else:  # cancelled: the scheduler was lost, or the cluster restarted
                self.waiting.appendleft(number)
            task.future.release()
        return len(status)

    def _gather(self, numbers: Sequence[int]) -> bool:
        """Write the parts of finished blocks, which the scheduler sends; return False if it is lost."""
        if not numbers:
            return True
        try:
            parts = self.workers.client.gather([self.flight[number].future for number in numbers])
        except CancelledError:  # the scheduler is lost, and the parts that it had with it
            return False
        for number, data in zip(numbers, parts, strict=True):
            self.directory.write_part_bytes(number, data)
        return True

    def _fail(self, number: int, error: BaseException) -> None:
        """Submit a block again, or give it up."""
        from distributed import KilledWorker
        from distributed.scheduler import NoValidWorkerError

        if isinstance(error, WorkerUnfit):
            self.workers.refuse(error.address, str(error))
            self.waiting.appendleft(number)
            return
        # the block's own record counts deaths; a scheduler also counts those of blocks that waited on a
        # worker
        counted_there = isinstance(error, KilledWorker) and not self.cluster.collect
        if counted_there or isinstance(error, NoValidWorkerError | Unwanted):
            self.waiting.append(number)
            return
        self.failures[number] += 1
        if isinstance(error, BlockGivenUp | KilledWorker) or self.failures[number] >= _MOST_FAILURES:
            why = str(error) if isinstance(error, UserError) else repr(error)
            if isinstance(error, KilledWorker):
                why = f"it ended {MOST_DEATHS} workers or more that began it"
            self.failed[number] = why.rstrip(".")
        else:
            self.waiting.append(number)

    def _free_stranded(self) -> None:
        """Submit tasks again that only lost workers may run."""
        present = set(self.workers.names)
        only = {n: task.only for n, task in self.flight.items() if task.only is not None}
        stranded = [n for n, addresses in only.items() if present.isdisjoint(addresses)]
        if stranded:
            self.workers.client.cancel([self.flight[number].future for number in stranded], force=True)
            self._give_back(stranded)

    def _end_hanging_workers(self) -> None:
        """End workers of which no task has ended for too long; a task may wait behind another."""
        now = time.monotonic()
        if not self.workers.slots:  # nobody runs
            self._tasks_of_workers = {}
            for task in self.flight.values():
                task.since = now
            return
        limit = self.cluster.limit(self._longest)
        if limit == float("inf") or now - self._checked_at < min(_BETWEEN_LIMIT_CHECKS, limit / 4):
            return
        self._checked_at = now
        ours = {task.future.key: number for number, task in self.flight.items()}
        before = self._tasks_of_workers
        self._tasks_of_workers = {}
        for address, keys in self.workers.client.processing().items():
            keys_of_worker = {key for key in keys if key in ours}
            if not keys_of_worker:
                continue
            known = before.get(address)
            since = now if known is None or known.keys - keys_of_worker else known.since
            if now - since <= limit:
                self._tasks_of_workers[address] = _TasksOfWorker(keys_of_worker, since)
                continue
            block = self.directory.layout.words(min(ours[key] for key in keys_of_worker))
            name = self.workers.names.get(address, address)
            self.workers.on_message(
                f"The worker {name} is ended, and its blocks go elsewhere: block {block} took longer than "
                f"{limit:.0f} s there."
            )
            self.workers.restart(address)
            for key in keys_of_worker:
                self.flight[ours[key]].since = time.monotonic()

    def _settle(self) -> None:
        """Check that all parts exist; missing ones are submitted again."""
        deadline = time.monotonic() + _LAG
        while (lost := self._take_parts()) and time.monotonic() < deadline:
            self._report()
            time.sleep(0.1)  # a network file system shows a file of another machine some time later
        for number in lost:
            self.done -= self.directory.layout.rows_in([number])
            self._fail(number, RuntimeError("its part is not there, or is damaged, after it was written"))
        self.ended = []

    def _take_parts(self) -> list[int]:
        """Read the parts that workers have written; return the blocks whose part is missing."""
        if self.cluster.collect:
            return []
        self.ended = self.directory.take_parts(self.ended)
        return self.ended

    def _cancel(self) -> None:
        """Cancel the tasks of this job."""
        with contextlib.suppress(Exception):
            futures = [task.future for task in self.flight.values()]
            if futures and self.workers.connection.alive:
                self.workers.client.cancel(futures, force=True)
        self.flight = {}

    def _report(self) -> None:
        """Report progress, at most every `_REPORT` s."""
        now = time.monotonic()
        if now - self._reported < _REPORT:
            return
        self._reported = now
        seconds = now - self._began
        self.missing.timings.run_s = seconds
        share = self.done / self.rows
        self.missing.on_progress(SweepProgress(self.done, self.rows, share, 0, seconds, self.cluster.note))

    def _sentence(self) -> str:
        """The sentences about the blocks that failed."""
        sentences = [
            f"Block {self.directory.layout.words(number)} was not computed: {why}."
            for number, why in sorted(self.failed.items())
        ]
        safe = f"All other rows are safe in {self.directory.path}; the same command tries these again."
        return "\n".join([*sentences, safe])
