"""Overhead of a cluster: `python -m benchmarks.cluster rate | memory | overhead`.

rate: stub blocks a second, given out as the blocks of a table are, beside `client.map` of an empty function
over the same scheduler and workers, alternated.
memory: of the process that holds client and scheduler, while stub blocks go by.
overhead: a job on `--cluster local:N` beside the same job in one process: seconds of the wall clock, and of
all processors together, which other load on the machine changes less.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, ClassVar

import psutil
import yaml

from gaitsweep.runs.cluster.connection import LocalWorkers
from gaitsweep.runs.cluster.dispatch import Cluster, Dispatch
from gaitsweep.runs.cluster.task import Assignment, JobTicket
from gaitsweep.runs.executor import MissingBlocks
from gaitsweep.table.manifest import Layout

ROOT = Path(__file__).resolve().parents[1]
BLOCK = 16_384  # rows of a stub block

# A slice of the chain's basins, long enough for two minutes on two cores.
JOB: dict[str, Any] = {
    "name": "overhead",
    "model": "multilegged",
    "params": {"beta": 0.8, "kappa": 100},
    "run": {"kind": "settle", "max_cycles": 150},
    "verify": 0,
}


def empty(number: int) -> int:
    """The task that `client.map` is measured with."""
    return number


def stub(number: int, rows: None, assignment: Assignment) -> int:
    """A block that takes no time."""
    return number


class StubCluster(Cluster):
    """A cluster whose tasks compute nothing."""

    task: ClassVar[Callable[..., int]] = staticmethod(stub)


class StubDirectory:
    """A table of which all parts are said to be there."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout

    @staticmethod
    def take_parts(numbers: Iterable[int]) -> list[int]:
        return []


def give_out(cluster: StubCluster, count: int, on_progress: Callable[[Any], None] = lambda _: None) -> float:
    """Give out stub blocks with an assignment as large as a real one; the seconds that it takes."""
    text = yaml.safe_dump(JOB) * 8  # a resolved job has 2 to 4 kB
    ticket = JobTicket(text, (), (), ("/results/overhead/.probe-0123456789abcdef", "0123456789abcdef"))
    layout = Layout("0" * 64, count * BLOCK, BLOCK)
    assignment = Assignment(ticket, "/results/overhead", layout, 60.0)
    began = time.perf_counter()
    directory: Any = StubDirectory(layout)
    unused: Any = None
    missing = MissingBlocks(unused, directory, range(count), on_progress, unused, unused)
    Dispatch(cluster, missing, assignment).run()
    return time.perf_counter() - began


def mapped(cluster: Cluster, count: int) -> float:
    """`client.map` of an empty function, and the wait for its results; the seconds that it takes."""
    from distributed import wait

    began = time.perf_counter()
    futures = cluster.workers.client.map(empty, range(count), pure=False)
    with cluster.workers.client.as_current():
        wait(futures)
    return time.perf_counter() - began


def rate(count: int, workers: int, repeats: int) -> None:
    with StubCluster(LocalWorkers(workers)) as cluster:
        cluster.workers.connect(lambda: None)
        mapped(cluster, 100)
        give_out(cluster, 100)
        seconds = [(mapped(cluster, count), give_out(cluster, count)) for _ in range(repeats)]
    ratios = [plain / ours for plain, ours in seconds]
    for plain, ours in seconds:
        print(f"client.map {count / plain:7.0f}/s   blocks {count / ours:7.0f}/s   ratio {plain / ours:.2f}")
    print(f"median ratio {statistics.median(ratios):.2f} over {repeats} pairs of {count}")


def memory(count: int, workers: int) -> None:
    with StubCluster(LocalWorkers(workers)) as cluster:
        cluster.workers.connect(lambda: None)
        give_out(cluster, 1000)
        process, last = psutil.Process(), 0

        def on_progress(now: Any) -> None:
            nonlocal last
            done = now.done // BLOCK
            if done >= last + count // 10:
                last = done
                print(f"{done:8d} blocks  {process.memory_info().rss / 2**20:7.1f} MiB", flush=True)

        spent = give_out(cluster, count, on_progress)
        print(f"{count:8d} blocks  {process.memory_info().rss / 2**20:7.1f} MiB, {spent:.0f} s in all")


def overhead(points: int, block: int, workers: int, repeats: int) -> None:
    axis = {"linspace": [0, "2*pi", points], "at": "centre"}
    job = {**JOB, "vary": dict.fromkeys(("psi_1", "psi_2", "psi_3"), axis), "engine": {"block": block}}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "job.yaml"
        file.write_text(yaml.safe_dump(job, sort_keys=False))
        results: dict[str, list[tuple[float, float]]] = {"one process": [], f"local:{workers}": []}
        for repeat in range(repeats):
            for name, measured in results.items():
                options = [] if name == "one process" else ["--cluster", name]
                out = Path(folder) / f"{name.replace(' ', '_')}-{repeat}"
                began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
                subprocess.run(
                    [sys.executable, "-m", "gaitsweep", "run", str(file), "--out", str(out), *options],
                    check=True,
                    cwd=ROOT,
                    env={**os.environ, "JAX_PLATFORMS": "cpu"},
                    stdout=subprocess.DEVNULL,
                )
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
                measured.append((time.perf_counter() - began, spent))
                print(f"{name:12s} {measured[-1][0]:7.1f} s wall, {spent:7.1f} s of processors", flush=True)
    one, many = ([statistics.median(times) for times in zip(*rows, strict=True)] for rows in results.values())
    print(
        f"overhead of local:{workers}: {100 * (many[0] / one[0] - 1):+.1f} % of the wall clock, "
        f"{100 * (many[1] / one[1] - 1):+.1f} % of processors ({points**3} rows in blocks of {block})"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("rate", "memory", "overhead"))
    parser.add_argument("--blocks", type=int, default=None, help="20 000 for rate, 100 000 for memory")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--points", type=int, default=60, help="of each of three axes (overhead)")
    parser.add_argument("--block", type=int, default=4096, help="rows of a block (overhead)")
    options = parser.parse_args()
    if options.what == "rate":
        rate(options.blocks or 20_000, options.workers, options.repeats)
    elif options.what == "memory":
        memory(options.blocks or 100_000, options.workers)
    else:
        overhead(options.points, options.block, options.workers, options.repeats)
    return 0


if __name__ == "__main__":
    sys.exit(main())
