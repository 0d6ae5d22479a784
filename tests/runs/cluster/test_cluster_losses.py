"""Workers, schedulers and clients that die: the table stays that of one process, to the bit.

The scheduler and the workers are processes of this machine; each block takes a chosen time at least, so that
a signal finds it under way.
"""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import psutil
import pytest
import yaml

import gaitsweep as gs
from gaitsweep.runs.cluster.connection import LocalWorkers
from gaitsweep.table import Snapshot
from tests.support.cluster_processes import DaskProcesses, environment, until

pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

BLOCK = 8  # rows


def job_of(blocks: int, **params: Any) -> dict[str, Any]:
    """Rows of settling masses; `params` with a list act in the blocks of those values only."""
    fixed = {name: value for name, value in params.items() if not isinstance(value, list)}
    varied = {name: value for name, value in params.items() if isinstance(value, list)}
    rows = [0.2 + 2.8 * row / (blocks * BLOCK) for row in range(blocks * BLOCK)]
    zipped = {"launch_1": {"values": rows}, **{name: {"values": each} for name, each in varied.items()}}
    return {
        "name": "fragile",
        "model": "fragile_model:Fragile",
        "params": fixed,
        "vary": {"zip": zipped} if varied else zipped,
        "run": {"kind": "settle", "max_cycles": 60},
        "numerics": {"method": "rk4", "dt": 2e-3},
        "engine": {"block": BLOCK, "lanes": 8},
        "verify": 2,
    }


@pytest.fixture
def dask(tmp_path: Path) -> Iterator[DaskProcesses]:
    processes = DaskProcesses(tmp_path)
    yield processes
    processes.close()


class Run:
    """A run of the command line in a process of its own."""

    def __init__(self, folder: Path, job: dict[str, Any], *options: str, **variables: str) -> None:
        self.out = folder / "out"
        file = folder / "job.yaml"
        file.write_text(yaml.safe_dump(job, sort_keys=False))
        self.process = subprocess.Popen(
            [sys.executable, "-m", "gaitsweep", "run", str(file), "--out", str(self.out), *options],
            env=environment(**variables),
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # a group of processes, as a terminal's
        )

    @property
    def parts(self) -> int:
        assert self.process.poll() is None or self.process.returncode == 0, self.process.communicate()
        return len(list((self.out / "table").glob("part-*")))

    def ended(self, code: int = 0, seconds: float = 300.0) -> str:
        _, errors = self.process.communicate(timeout=seconds)
        assert self.process.returncode == code, errors
        assert "Traceback" not in errors
        return errors


def check(out: Path, folder: Path, job: dict[str, Any]) -> None:
    """The directory holds what one process makes, and nothing else."""
    quick = {**job, "params": {**job["params"], "pause": 0.0}}
    whole = gs.run(gs.Job(**quick), folder / "whole").table
    table = gs.load(out)
    assert table.attrs["complete"]
    pd.testing.assert_frame_equal(table, whole, check_exact=True)
    assert {file.name for file in out.iterdir()} <= {
        *(".lock", "manifest.json", "job.yaml", "SHA256SUMS", "table", "figures")
    }
    assert not [file for file in (out / "table").iterdir() if not file.name.startswith("part-")]


def _lives(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_local_workers_are_children_on_the_loopback_address(tmp_path: Path) -> None:
    job = job_of(40, pause=0.1)
    run = Run(tmp_path, job, "--cluster", "local:2")
    until(lambda: run.parts >= 2)
    family = [psutil.Process(run.process.pid), *psutil.Process(run.process.pid).children(recursive=True)]
    listening = [
        where.laddr.ip
        for each in family
        for where in each.net_connections(kind="inet")
        if where.status == psutil.CONN_LISTEN
    ]
    assert listening
    assert set(listening) == {"127.0.0.1"}
    run.ended()
    until(lambda: not any(_lives(each) for each in family))
    check(run.out, tmp_path, job)


# What another user of the machine can do: connect without a certificate, and with one of his own whose
# owner does not look at ours.
_STRANGER = """
import asyncio, ssl, sys
from distributed import Security
from distributed.core import connect

async def reached(address, given):
    try:
        comm = await asyncio.wait_for(connect(address, timeout=2, **given), 4)
        await comm.write({"op": "identity"})
        return await asyncio.wait_for(comm.read(), 3)
    except Exception as error:
        return type(error).__name__

async def tried():
    own = Security.temporary().get_connection_args("client")
    own["ssl_context"].verify_mode = ssl.CERT_NONE
    bare = ssl.create_default_context()
    bare.check_hostname, bare.verify_mode = False, ssl.CERT_NONE
    for address in sys.argv[1:]:
        print(await reached(address.replace("tls:", "tcp:"), {}))
        print(await reached(address, own))
        print(await reached(address, {**own, "ssl_context": bare}))

asyncio.run(tried())
"""


def test_no_other_user_of_the_machine_reaches_local_workers() -> None:
    pytest.importorskip("cryptography")
    workers = LocalWorkers(1)
    try:
        assert workers.try_to_connect()
        result = workers.client.scheduler_info()
        addresses = [result["address"], *result["workers"]]
        assert all(address.startswith("tls://127.0.0.1:") for address in addresses)
        line = [sys.executable, "-c", _STRANGER, *addresses]
        done = subprocess.run(line, capture_output=True, text=True, timeout=120)
        answers = done.stdout.split()
        assert len(answers) == 3 * len(addresses), done.stderr
        assert all(answer.endswith("Error") for answer in answers), answers
        assert workers.client.run(os.getpid)  # its own client does reach them
    finally:
        workers.close()


def test_ctrl_c_of_a_terminal_ends_the_command_and_its_local_workers(tmp_path: Path) -> None:
    job = job_of(40, pause=0.2)
    run = Run(tmp_path, job, "--cluster", "local:2")
    until(lambda: run.parts >= 2)
    os.killpg(run.process.pid, signal.SIGINT)
    errors = run.ended(code=130)
    assert re.fullmatch(r"Stopped: \d+ of 320 rows are safe in .*\n", errors)
    Run(tmp_path, job, "--cluster", "local:2").ended()
    check(run.out, tmp_path, job)


def test_workers_killed_one_after_another_in_one_run(tmp_path: Path, dask: DaskProcesses) -> None:
    """Each worker is killed with its nanny, at a random moment, and another comes."""
    random.seed(1)
    job = job_of(90, pause=0.25)
    dask.start_scheduler()
    dask.start_worker("w0")
    dask.start_worker("w1")
    run = Run(tmp_path, job, "--cluster", str(dask.file))
    until(lambda: run.parts >= 2)
    for kill in range(5):
        dask.start_worker(f"w{kill + 2}")
        time.sleep(random.uniform(0.2, 1.4))
        assert run.process.poll() is None, "the run has ended before the last kill"
        dask.kill_worker(f"w{kill}")
        # a block that ends three workers is given up, so it is computed before the next worker is killed
        written = run.parts
        until(lambda written=written: run.parts >= written + 3)
    run.ended()
    assert re.search(r"begins block \d+ \(rows \d+ to \d+\) of ", dask.log)
    check(run.out, tmp_path, job)


def test_all_workers_are_replaced(tmp_path: Path, dask: DaskProcesses) -> None:
    job = job_of(30, pause=0.2)
    dask.start_scheduler()
    dask.start_worker("a")
    run = Run(tmp_path, job, "--cluster", dask.address)
    until(lambda: run.parts >= 3)
    dask.kill_worker("a")
    time.sleep(3.0)
    before = run.parts
    time.sleep(1.0)
    assert run.parts == before < 30
    dask.start_worker("b")
    dask.start_worker("c", "--no-nanny")
    run.ended()
    check(run.out, tmp_path, job)


def test_a_scheduler_killed_twice(tmp_path: Path, dask: DaskProcesses) -> None:
    """Another scheduler comes at another port, with other workers; the client finds its file."""
    job = job_of(30, pause=0.2)
    dask.start_scheduler()
    dask.start_worker("w0")
    run = Run(tmp_path, job, "--cluster", str(dask.file))
    for kill in range(2):
        before = run.parts
        until(lambda before=before: run.parts >= before + 3)
        dask.kill_scheduler()
        dask.kill_worker(f"w{kill}")
        dask.start_scheduler()
        dask.start_worker(f"w{kill + 1}")
    run.ended()
    check(run.out, tmp_path, job)


def test_a_client_killed_twice_continues_when_it_is_run_again(tmp_path: Path, dask: DaskProcesses) -> None:
    job = job_of(60, pause=0.2)
    dask.start_scheduler()
    dask.start_worker("a")
    dask.start_worker("b")
    table = tmp_path / "out" / "table"
    parts: dict[Path, int] = {}
    for _ in range(2):
        run = Run(tmp_path, job, "--cluster", dask.address)
        wanted = len(parts) + 4
        until(lambda wanted=wanted: len(list(table.glob("part-*"))) >= wanted)
        run.process.kill()
        run.process.communicate()
        parts = {file: file.stat().st_mtime_ns for file in table.glob("part-*")}
    run = Run(tmp_path, job, "--cluster", dask.address)
    run.ended()
    for file, since in parts.items():
        assert file.stat().st_mtime_ns == since
    check(run.out, tmp_path, job)


def test_a_second_client_is_refused_and_ctrl_c_leaves_the_cluster_clean(
    tmp_path: Path, dask: DaskProcesses
) -> None:
    from distributed import Client

    job = job_of(60, pause=0.2)
    dask.start_scheduler()
    dask.start_worker("a")
    run = Run(tmp_path, job, "--cluster", dask.address)
    until(lambda: run.parts >= 2)
    second = Run(tmp_path, job, "--cluster", dask.address)
    assert f"Another run (process {run.process.pid} on " in second.ended(code=2)
    run.process.send_signal(signal.SIGINT)
    errors = run.ended(code=130)
    stopped = re.search(r"Stopped: (\d+) of 480 rows are safe", errors)
    assert stopped is not None
    # each worker may still write the block of 8 rows that it was sending
    assert 0 <= Snapshot.of(run.out).rows_safe - int(stopped[1]) <= 2 * 8
    with Client(dask.address) as client:
        until(lambda: not client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)), 10)
    Run(tmp_path, job, "--cluster", dask.address).ended()
    check(run.out, tmp_path, job)


@pytest.mark.parametrize("nanny", [(), ("--no-nanny",)], ids=["nanny", "no_nanny"])
def test_a_hanging_worker_is_ended_and_its_block_is_reassigned(
    tmp_path: Path, dask: DaskProcesses, nanny: tuple[str, ...]
) -> None:
    job = job_of(20, pause=0.1, hanging=[1.0 if 40 <= row < 48 else 0.0 for row in range(160)])
    flag = str(tmp_path / "hung")
    dask.start_scheduler()
    dask.start_worker("a", *nanny, FRAGILE_HANG=flag)
    dask.start_worker("b", *nanny, FRAGILE_HANG=flag)
    run = Run(tmp_path, job, "--cluster", dask.address, "--block-limit", "10")
    errors = run.ended()
    assert os.path.exists(flag)
    assert re.search(r"The worker [ab] is ended, and its blocks go elsewhere: block \d+ \(rows \d+", errors)
    check(run.out, tmp_path, job)


def test_a_block_that_kills_its_workers_is_named_and_the_others_go_on(
    tmp_path: Path, dask: DaskProcesses
) -> None:
    """Three workers die of block 5; their nannies start others."""
    job = job_of(40, pause=0.1, deadly=[1.0 if 40 <= row < 48 else 0.0 for row in range(320)])
    dask.start_scheduler()
    dask.start_worker("a")
    dask.start_worker("b")
    run = Run(tmp_path, job, "--cluster", dask.address)
    errors = run.ended(code=1)
    assert "Block 5 (rows 40 to 47) was not computed: it ended 3 workers that began it" in errors
    assert "All other rows are safe" in errors
    assert Snapshot.of(run.out).rows_done == 39 * BLOCK
    deaths = len(re.findall(r"begins block 5 ", dask.log))
    assert deaths == 4  # the fourth time it is refused


def test_a_worker_whose_disk_is_full_is_refused_by_name(tmp_path: Path, dask: DaskProcesses) -> None:
    """The largest file that its process may write is as small as a directory's quota that is used up."""
    job = job_of(30, pause=0.1)
    dask.start_scheduler()
    dask.start_worker("good")
    dask.start_worker("full", FRAGILE_DISK="1")
    run = Run(tmp_path, job, "--cluster", dask.address)
    errors = run.ended()
    assert re.search("The worker full is refused: Part .* could not be written to .*", errors)
    check(run.out, tmp_path, job)


def test_schedulers_clients_and_workers_killed_in_one_job(tmp_path: Path, dask: DaskProcesses) -> None:
    random.seed(2)
    job = job_of(90, pause=0.2)
    dask.start_scheduler()
    dask.start_worker("w0")
    dask.start_worker("w1")
    run, made = Run(tmp_path, job, "--cluster", str(dask.file)), 2
    for kill in range(4):
        dask.start_worker(f"w{made}")
        made += 1
        before = len(list((run.out / "table").glob("part-*")))
        until(lambda b=before, run=run: len(list((run.out / "table").glob("part-*"))) >= b + 4)
        time.sleep(random.uniform(0.0, 0.5))
        assert run.process.poll() is None, "the run has ended before the last kill"
        dask.kill_worker(random.choice(list(dask.workers)))
        if kill == 1:
            dask.kill_scheduler()
            for name in list(dask.workers):
                dask.kill_worker(name)
            dask.start_scheduler()
            for _ in range(2):
                dask.start_worker(f"w{made}")
                made += 1
        elif kill == 3:
            run.process.kill()
            run.process.communicate()
            run = Run(tmp_path, job, "--cluster", str(dask.file))
    run.ended()
    check(run.out, tmp_path, job)
