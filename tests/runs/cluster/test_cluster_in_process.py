"""A job's blocks computed by Dask workers in threads of this process, without losses of processes."""

from __future__ import annotations

import os
import re
import socket
import threading
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest

import gaitsweep as gs
import toy_model
from gaitsweep.runs.cluster import connection, dispatch, task, worker_pool
from gaitsweep.runs.cluster.connection import UserClient, connection_to
from gaitsweep.runs.cluster.dispatch import BlocksFailed, Cluster
from gaitsweep.runs.cluster.task import MOST_DEATHS, BlockGivenUp, WorkerUnfit, difference
from gaitsweep.runs.cluster.worker_pool import WorkerPool
from gaitsweep.runs.execute import run_job
from gaitsweep.runs.prepare import RunError
from gaitsweep.table import Snapshot, TableError, WriteError
from gaitsweep.table.directory import SharedWriter
from gaitsweep.table.locks import BlockLocks, Lock
from gaitsweep.table.manifest import Layout

distributed = pytest.importorskip("distributed")

JOB = {
    "name": "hops",
    "model": "toy_model:Toy",
    "vary": {"launch_1": {"linspace": [0.2, 3.0, 60]}},
    "run": {"kind": "settle", "max_cycles": 60},
    "numerics": {"method": "rk4", "dt": 2e-3},
    "engine": {"block": 8, "lanes": 8},
    "verify": 2,
}


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with (
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=False,
            dashboard_address=None,
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> gs.Result:
    return gs.run(gs.Job(**JOB), tmp_path_factory.mktemp("whole") / "table")


def test_the_table_is_that_of_one_process(client: Any, whole: gs.Result, tmp_path: Path) -> None:
    run = gs.run(gs.Job(**JOB), tmp_path / "out", client=client)
    pd.testing.assert_frame_equal(run.table, whole.table, check_exact=True)
    for name in ("complete", "counts", "gaits", "quantities", "self_check", "job_hash"):
        assert run.manifest[name] == whole.manifest[name]
    for part in (whole.path / "table").iterdir():
        assert (run.path / "table" / part.name).read_bytes() == part.read_bytes()
    left = {path.name for path in run.path.iterdir()} - {path.name for path in whole.path.iterdir()}
    assert not left


def test_sound_parts_are_not_computed_again(client: Any, tmp_path: Path) -> None:
    run = gs.run(gs.Job(**JOB), tmp_path / "out", client=client)
    parts = sorted((run.path / "table").iterdir())
    stamps = {part: part.stat().st_mtime_ns for part in parts}
    parts[2].unlink()
    parts[5].write_bytes(parts[5].read_bytes()[:-20])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gs.run(gs.Job(**JOB), tmp_path / "out", client=client)
    assert [part for part in parts if part.stat().st_mtime_ns != stamps[part]] == [parts[2], parts[5]]


def test_parts_return_through_the_scheduler(client: Any, whole: gs.Result, tmp_path: Path) -> None:
    cluster = Cluster(UserClient(client), collect=True)
    run_job(gs.Job(**JOB), tmp_path / "out", cluster=cluster)
    pd.testing.assert_frame_equal(gs.load(tmp_path / "out"), whole.table, check_exact=True)


def test_workers_that_do_not_share_the_directory_are_named(
    client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = task._check_probe
    monkeypatch.setattr(task, "_check_probe", lambda file, token: seen(f"{file}-gone", token))
    task._context_of.cache_clear()
    with pytest.raises(RunError) as refusal:
        gs.run(gs.Job(**JOB), tmp_path / "out", client=client)
    message = str(refusal.value)
    assert "2 of the 2 workers" in message
    assert "which is not started" in message
    assert f"does not see the result directory {tmp_path / 'out'}" in message
    assert "--collect" in message
    assert not list((tmp_path / "out" / "table").iterdir())
    assert not list((tmp_path / "out").glob(".probe*"))
    _until_no_task(client)  # though the exception is still known here


def test_a_worker_that_differs_is_refused_by_its_name_and_what_differs(
    client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    identity = dispatch.identity_of
    monkeypatch.setattr(dispatch, "identity_of", lambda context: {**identity(context), "jax": "0.1"})
    with pytest.raises(RunError, match=r"0: jax is \d.* there and 0.1 here"):
        gs.run(gs.Job(**JOB), tmp_path / "out", client=client)


def test_differences_between_workers_are_named() -> None:
    here = {"jax": "1", "the engine": "kernel", "the job's hash": "ab"}
    assert difference(here, here) is None
    assert difference({**here, "jax": "2", "the job's hash": "cd"}, here) == "jax is 2 there and 1 here"
    assert "the files of its model differ" in str(difference({**here, "the job's hash": "cd"}, here))


def test_a_worker_that_cannot_write_is_refused_and_the_others_go_on(
    client: Any, whole: gs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one whose disk is full: its blocks are written by another."""
    write = SharedWriter.write

    def full(self: SharedWriter, number: int, data: bytes) -> None:
        if distributed.get_worker().name == 1:
            raise WriteError(f"Part {number} could not be written: the disk is full.")
        write(self, number, data)

    monkeypatch.setattr(SharedWriter, "write", full)
    with pytest.warns(UserWarning, match="The worker 1 is refused: Part .* the disk is full"):
        run = gs.run(gs.Job(**JOB), tmp_path / "out", client=client)
    pd.testing.assert_frame_equal(run.table, whole.table, check_exact=True)


def test_all_workers_that_cannot_write_end_the_run(
    client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: SharedWriter, number: int, data: bytes) -> None:
        raise WriteError("The disk is full.")

    with monkeypatch.context() as patched, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        patched.setattr(SharedWriter, "write", full)
        with pytest.raises(RunError, match=r"No worker of .* can compute this job\. 0: The disk is full\."):
            gs.run(gs.Job(**JOB), tmp_path / "out", client=client)
    assert gs.run(gs.Job(**JOB), tmp_path / "out", client=client).manifest["complete"]


def test_a_block_that_fails_is_named_and_the_others_go_on(
    client: Any, whole: gs.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed = task.compute_blocks

    def failing(context: Any, blocks: list[int], *others: Any) -> None:
        if blocks == [3]:
            raise ZeroDivisionError("a fault")
        computed(context, blocks, *others)

    with monkeypatch.context() as patched:
        patched.setattr(task, "compute_blocks", failing)
        with pytest.raises(BlocksFailed) as failure:
            gs.run(gs.Job(**JOB), tmp_path / "out", client=client)
    assert failure.value.exit_code == 1
    assert "Block 3 (rows 24 to 31) was not computed: ZeroDivisionError('a fault')." in str(failure.value)
    assert Snapshot.of(tmp_path / "out").rows_done == 52
    assert Snapshot.of(tmp_path / "out").manifest["counts"] == {"settled": 52}
    run = gs.run(gs.Job(**JOB), tmp_path / "out", client=client)
    pd.testing.assert_frame_equal(run.table, whole.table, check_exact=True)


def _tasks(dask_scheduler: Any) -> list[str]:
    return [f"{task.key}: {task.state}, wanted by {task.who_wants}" for task in dask_scheduler.tasks.values()]


def _until_no_task(client: Any) -> None:
    deadline = time.monotonic() + 10.0
    while left := client.run_on_scheduler(_tasks):
        assert time.monotonic() < deadline, left
        time.sleep(0.05)


@pytest.mark.slow
def test_ctrl_c_leaves_no_task_behind(client: Any, tmp_path: Path) -> None:
    job = gs.Job(**{**JOB, "vary": {"launch_1": {"linspace": [0.2, 3.0, 480]}}})  # longer than a look
    whole = gs.run(job, tmp_path / "whole").table

    def stop(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        if done:
            assert note == "2 workers"
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        gs.run(job, tmp_path / "out", on_progress=stop, client=client)
    assert Snapshot.of(tmp_path / "out").rows_done > 0
    assert not list((tmp_path / "out").glob(".probe*"))
    _until_no_task(client)
    run = gs.run(job, tmp_path / "out", client=client)
    pd.testing.assert_frame_equal(run.table, whole, check_exact=True)


def test_ctrl_c_stops_running_blocks(client: Any, tmp_path: Path) -> None:
    """They would take minutes; workers are free within seconds."""
    job = gs.Job(**{**JOB, "run": {"kind": "fixed_time", "duration": 2000.0}, "numerics": {"dt": 2e-5}})
    began = time.monotonic()

    def stop(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        if all(client.run(lambda dask_worker: dask_worker.state.executing_count).values()):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        gs.run(job, tmp_path / "out", on_progress=stop, client=client)
    deadline = time.monotonic() + 20.0
    while any(client.run(lambda dask_worker: dask_worker.state.executing_count).values()):
        assert time.monotonic() < deadline, "a worker goes on"
        time.sleep(0.1)
    assert not list((tmp_path / "out" / "table").iterdir())
    assert time.monotonic() - began < 60.0


def test_a_second_client_is_refused_by_the_name_of_the_first(client: Any, tmp_path: Path) -> None:
    gs.run(gs.Job(**{**JOB, "vary": {"launch_1": [1.0, 2.0]}}), tmp_path / "out", client=client)
    lock = Lock(tmp_path / "out")
    with pytest.raises(TableError, match=r"Another run \(process \d+ on .*\) is writing"):
        gs.run(gs.Job(**{**JOB, "vary": {"launch_1": [1.0, 2.0]}}), tmp_path / "out", client=client)
    lock.release()


@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("loacl:2", "did you mean local?"),
        ("local:0", "from 1 to 1024 are allowed"),
        ("local:-1", "asks for -1 workers"),
        ("node07", "write local:N, tcp://HOST:PORT"),
        ("10.0.0.7:8786", "did you mean tcp://10.0.0.7:8786?"),
        ("http://node07:8786", "begins with http, .* did you mean tcp://node07:8786?"),
        ("tcp://node07", "with a port from 1 to 65535, such as tcp://node07:8786"),
        ("tcp://node07:87860", "with a port from 1 to 65535"),
    ],
)
def test_other_addresses_are_refused(where: str, said: str) -> None:
    with pytest.raises(RunError, match=re.escape(said).replace(re.escape(".*"), ".*")):
        connection_to(where)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("no JSON", 'writes JSON with the field "address"'),
        ('{"id": 1}', 'writes JSON with the field "address"'),
        ('{"address": 5}', "The address 5 of "),
    ],
)
def test_a_file_that_is_none_of_a_scheduler_is_refused(text: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "scheduler.json"
    connection_to(str(file))  # it may come later
    file.write_text(text)
    os.utime(file, (0, 0))
    with pytest.raises(RunError) as refusal:
        connection_to(str(file))
    assert said in str(refusal.value)
    file.write_text("")  # the scheduler begins to write it
    connection_to(str(file))


@pytest.mark.slow
def test_a_silent_scheduler_is_reported_and_leaves_no_threads(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(connection, "_CONNECT", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as nothing:  # which takes connections, and says nothing
        where = f"tcp://127.0.0.1:{nothing.getsockname()[1]}"
        mute = connection_to(where)
        assert not mute.try_to_connect()
        assert mute.last_error == "something answers there, but not as a scheduler of Dask"
        before = threading.active_count()
        for _ in range(3):
            assert not mute.try_to_connect()
        assert threading.active_count() <= before
        mute.close()
    messages: list[str] = []
    workers = WorkerPool(connection_to(where), messages.append)
    tries: list[None] = []

    def stop() -> None:
        tries.append(None)
        if len(tries) > 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        workers.connect(stop)
    workers.connection.close()
    assert messages  # refused at once, or after a time
    assert all(
        re.fullmatch(rf"The scheduler {where} does not answer \(.*\): waiting for it\.", t) for t in messages
    )


def test_a_worker_that_cannot_answer_ends_the_wait_for_busy_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_pool, "_EXAMINATION", 0.0)
    cluster: Any = SimpleNamespace(alive=True)
    workers = WorkerPool(cluster, lambda sentence: None)
    monkeypatch.setattr(workers, "update", lambda: None)
    workers.names = {"a": "left", "b": "right"}
    fails = SimpleNamespace(done=lambda: True, status="error", exception=lambda: OSError("no such module"))
    busy = SimpleNamespace(done=lambda: False, status="pending")
    polls = iter(range(3))

    def on_wait() -> None:
        next(polls)  # ends a wait that is too long

    assert workers._reasons({"a": fails, "b": busy}, on_wait) == {"a": "no such module"}


def test_a_worker_hangs_that_ends_no_block_and_not_one_whose_blocks_wait(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each of two workers holds two blocks of 7 s, of which the second waits; the limit is 10 s."""
    now, messages, ended = 0.0, [], []
    held = {"a": [0, 2], "b": [1, 3]}
    monkeypatch.setattr(dispatch, "time", SimpleNamespace(monotonic=lambda: now))
    workers = SimpleNamespace(
        slots=2,
        names={"a": "left", "b": "right"},
        on_message=messages.append,
        restart=lambda address: ended.append((address, now)),
        client=SimpleNamespace(processing=lambda: held),
    )
    cluster: Any = SimpleNamespace(workers=workers, limit=lambda longest: 10.0)
    directory: Any = SimpleNamespace(layout=Layout("", 800, 8))
    missing: Any = SimpleNamespace(directory=directory, numbers=range(4))
    assignment: Any = None
    blocks = dispatch.Dispatch(cluster, missing, assignment)
    blocks.flight = {n: dispatch._InFlight(SimpleNamespace(key=n), 0.0, None) for n in range(4)}
    for second in range(17):
        now = float(second)
        held["a"] = [0, 2] if second < 7 else [2, 4] if second < 14 else [4]
        blocks._end_hanging_workers()
    assert [address for address, _ in ended] == ["b"]
    assert 10.0 < ended[0][1] <= 15.0
    where = "block 1 (rows 8 to 15) took longer than 10 s there"
    assert messages == [f"The worker right is ended, and its blocks go elsewhere: {where}."]


@pytest.mark.slow
def test_names_of_tasks_are_used_again(client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that a scheduler does not remember more of them with each block."""
    monkeypatch.setattr(dispatch, "_MOST_IN_FLIGHT", 4)
    keys: list[Any] = []
    key = Cluster._key
    monkeypatch.setattr(Cluster, "_key", lambda self: keys.append(key(self)) or keys[-1])
    job = gs.Job(**{**JOB, "vary": {"launch_1": {"linspace": [0.2, 3.0, 240]}}})
    whole = gs.run(job, tmp_path / "whole").table
    run = gs.run(job, tmp_path / "out", client=client)
    pd.testing.assert_frame_equal(run.table, whole, check_exact=True)
    assert len(keys) == 30
    assert len(set(keys)) <= 13


def test_a_reason_and_its_worker_travel_as_a_pickle() -> None:
    import pickle

    result = pickle.loads(pickle.dumps(WorkerUnfit("the disk is full", "tcp://127.0.0.1:1")))
    assert (str(result), result.address) == ("the disk is full", "tcp://127.0.0.1:1")


def test_a_living_process_is_no_death_of_its_block(tmp_path: Path) -> None:
    """After the patience the block is computed here, too, unless three others have died with it."""
    writer: Any = SimpleNamespace(path=tmp_path, has=lambda number: False)
    with BlockLocks(tmp_path) as theirs:
        assert theirs.take(0, "slow")
        for _ in range(MOST_DEATHS):  # of which the last is alive
            theirs.begin(0)
        with task._block_lock(writer, 0, 0.0) as missing:
            assert missing
        for _ in range(MOST_DEATHS + 1):
            theirs.begin(0)
        with pytest.raises(BlockGivenUp, match="ended 3 workers"), task._block_lock(writer, 0, 0.0):
            pass


def test_a_sweep_of_keywords_on_a_cluster(client: Any, tmp_path: Path) -> None:
    from toy_model import Toy

    fields: dict[str, Any] = {"launch_1": [0.5, 1.0, 2.0], "numerics": {"dt": 2e-3}, "verify": 0}
    alone = gs.sweep(Toy(N=1), **fields)
    memory, disk = (
        gs.sweep(Toy(N=1), client=client, **fields),
        gs.sweep(Toy(N=1), client=client, out=tmp_path / "out", **fields),
    )
    pd.testing.assert_frame_equal(memory.table, alone.table, check_exact=True)
    pd.testing.assert_frame_equal(disk.table, alone.table, check_exact=True)


def test_a_client_is_one_of_dasks() -> None:
    with pytest.raises(gs.ArgumentError, match=r"client is 1, but takes a distributed\.Client\."):
        gs.sweep(toy_model.Toy(), launch_1=[1.0], client=1)  # pyright: ignore[reportArgumentType]


def test_a_client_that_is_closed_is_refused_before_anything_is_written(client: Any, tmp_path: Path) -> None:
    closed = distributed.Client(client.cluster, set_as_default=False)
    closed.close()
    with pytest.raises(gs.ArgumentError, match="client is closed: make a new one"):
        gs.run(gs.Job(**JOB), tmp_path / "out", client=closed)
    assert not (tmp_path / "out").exists()
