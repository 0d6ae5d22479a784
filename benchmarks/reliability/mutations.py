"""Whether every damaged job gets an answer: no traceback, none after 5 s, and less than 1 GB of memory.

python -m benchmarks.reliability.mutations --jobs 3000 --cli 100

Jobs of `sweeps/` are damaged (`mutated_jobs`) and checked in one process; some of them by the command line,
`check`, `run --dry-run` and `run`. Where more processes run than there are processors, an answer waits for
its turn: then the processor's time counts, and the table says so. Exit code 1 where the guarantee fails.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import FrameType

from benchmarks.reliability.mutated_jobs import ROOT, Mutant, Workshop

LATEST = 5.0  # s
MOST_MEMORY = 1000.0  # MB
AT_A_TIME = 4  # commands; of 90 that began 16 at a time on 16 processors, 32 took 5 to 7 s
HANGS = 60  # s after which a check is stopped, and counts as one that never answers
RUN_HANGS = 900  # s, of a command that runs rows
SPARE = 6 * 2**30  # bytes of address space that a check may take more: a machine is not brought down


@dataclasses.dataclass(frozen=True)
class Answer:
    """Result of a damaged job: `fault` is a traceback, or empty; times in s, memory in MB."""

    kind: str
    good: bool
    fault: str
    wall: float
    processor: float
    memory: float
    path: str

    def late(self, crowded: bool) -> bool:
        """Whether it came after its time; where others hold the processor, that time is the processor's."""
        return (self.processor if crowded else self.wall) > LATEST


class Hangs(BaseException):
    """No answer within the time that is waited for one."""


def check_all(count: int, seed: int, folder: Path) -> list[Answer]:
    """Check damaged jobs one after the other in this process."""
    from gaitsweep.job import load_job

    shop = Workshop(folder, seed)
    load_job(ROOT / "sweeps" / "quick_basins.yaml")  # what is imported once is no job's time or memory
    with _address_space(SPARE):
        return [check_one(shop.make(number)) for number in range(count)]


def check_one(mutant: Mutant) -> Answer:
    """Check one damaged job: the answer is a job, or a UserError whose sentence can be printed."""
    from gaitsweep.errors import UserError
    from gaitsweep.job import load_job

    good, fault = False, ""
    _forget_peak()
    began, spent = time.perf_counter(), time.process_time()
    try:
        with _alarm(HANGS):
            job = load_job(mutant.path)
            job.design.values(0, min(job.design.n_rows, 3))
            job.hash()
            good = True
    except UserError as error:
        fault = _fault_of_sentence(error.sentence)
    except (Exception, Hangs):
        fault = traceback.format_exc()
    wall, processor = time.perf_counter() - began, time.process_time() - spent
    return Answer(mutant.kind, good, fault, wall, processor, _peak(), str(mutant.path))


def _fault_of_sentence(text: str) -> str:
    """Fault of a text for users; empty without one."""
    if not text.strip():
        return "no sentence"
    if "Traceback" in text or len(text) > 20_000:
        return f"no sentence: {text[:200]}"
    return (
        ""
        if all(letter.isprintable() or letter == "\n" for letter in text)
        else f"unprintable: {text[:200]!r}"
    )


@contextlib.contextmanager
def _alarm(seconds: int) -> Iterator[None]:
    def ring(number: int, frame: FrameType | None) -> None:
        raise Hangs(f"no answer after {seconds} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def _address_space(spare: int) -> Iterator[None]:
    """A limit on memory, so that a check that grows without end fails instead of the machine."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if Path("/proc/self/statm").exists() else 0
    if pages:
        limit = pages * resource.getpagesize() + spare
        resource.setrlimit(resource.RLIMIT_AS, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _forget_peak() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # Linux: the peak counts from here


def _peak() -> float:
    """The most memory (MB) since `_forget_peak`; since the process began where that cannot be told."""
    with contextlib.suppress(OSError):
        result = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
        if result:
            return int(result[1]) / 1000.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000.0


def by_command_line(count: int, seed: int, folder: Path) -> list[Answer]:
    """Give damaged jobs to `gaitsweep check`, and of those that are good a tenth of all to a (dry) run."""
    from gaitsweep.errors import UserError
    from gaitsweep.job import load_job

    shop = Workshop(folder, seed, tiny=True)
    checks: list[tuple[str, Mutant, list[str]]] = []
    runs: list[tuple[str, Mutant, list[str]]] = []
    number = 10**6
    while len(checks) < count - count // 10 or len(runs) < count // 10:
        mutant = shop.make(number := number + 1)
        try:
            rows = load_job(mutant.path).design.n_rows
        except UserError:
            rows = 0
        if rows and len(runs) < count // 10:
            out = ["--out", str(folder / f"out_{number}")] if rows <= 100 and len(runs) % 2 else ["--dry-run"]
            runs.append((f"run {out[0]}", mutant, ["run", str(mutant.path), *out]))
        elif len(checks) < count - count // 10:
            checks.append(("check", mutant, ["check", str(mutant.path)]))
    commands = [*checks, *runs]
    with ThreadPoolExecutor(min(os.cpu_count() or 1, AT_A_TIME)) as pool:
        return list(pool.map(lambda command: run_one(*command, folder=folder), commands))


def run_one(kind: str, mutant: Mutant, arguments: list[str], folder: Path) -> Answer:
    """The answer of one command: its exit code is 0, 1 or 2, and it prints no traceback."""
    place = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-m", "gaitsweep", *arguments]
    with tempfile.TemporaryFile(dir=folder) as output:
        began = time.perf_counter()
        process = subprocess.Popen(command, stdout=output, stderr=output, cwd=folder, env=place)
        limit, waited, status, usage = HANGS if kind == "check" else RUN_HANGS, 0, 0, None
        while waited == 0 and time.perf_counter() - began < limit:
            waited, status, usage = os.wait4(process.pid, os.WNOHANG)
            time.sleep(0.02)
        if waited == 0:
            process.kill()
            _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - began
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        text = output.read().decode(errors="replace")
    fault = ""
    if waited == 0:
        fault = f"no answer after {limit} s"
    elif process.returncode not in (0, 1, 2) or "Traceback" in text:
        fault = f"exit code {process.returncode}: {text[-3000:]}"
    assert usage is not None
    return Answer(
        kind,
        process.returncode == 0,
        fault,
        wall,
        usage.ru_utime + usage.ru_stime,
        usage.ru_maxrss / 1000.0,
        f"{mutant.kind}: {' '.join(arguments)}",
    )


def table(answers: Sequence[Answer]) -> str:
    """A line for each kind: jobs, how many were good, tracebacks, the latest answer and the most memory."""
    head = (
        f"{'':<16}{'jobs':>6}{'good':>6}{'faults':>8}{'latest, s':>11}{'processor, s':>14}{'memory, MB':>12}"
    )
    lines = [head]
    for kind in sorted({answer.kind for answer in answers}):
        of_kind = [answer for answer in answers if answer.kind == kind]
        faults, good = (
            sum(map(bool, values)) for values in zip(*((a.fault, a.good) for a in of_kind), strict=True)
        )
        worst = [max(getattr(answer, name) for answer in of_kind) for name in ("wall", "processor", "memory")]
        lines.append(f"{kind:<16}{len(of_kind):>6}{good:>6}{faults:>8}"
                     f"{worst[0]:>11.2f}{worst[1]:>14.2f}{worst[2]:>12.0f}")  # fmt: skip
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and give 1 where the guarantee fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--jobs", type=int, default=3000, help="damaged jobs checked in this process")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cli", type=int, default=100, help="damaged jobs given to the command line")
    options = parser.parse_args(arguments)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        answers = check_all(options.jobs, options.seed, _made(Path(name) / "checked"))
        commands = by_command_line(options.cli, options.seed, _made(Path(name) / "commands"))
    crowded = os.getloadavg()[0] > 1.2 * (os.cpu_count() or 1)
    print(f"{len(answers)} damaged jobs checked in one process\n{table(answers)}")
    print(f"\n{len(commands)} by the command line (its start, some 3 s, included)\n{table(commands)}\n")
    if crowded:
        print(
            f"Others hold the processors (load {os.getloadavg()[0]:.1f}): its own time counts as an answer's."
        )
    bad = [answer for answer in (*answers, *commands) if answer.fault]
    checks = [*answers, *(answer for answer in commands if answer.kind == "check")]
    late = [answer for answer in checks if answer.late(crowded)]
    large = [answer for answer in checks if answer.memory > MOST_MEMORY]
    for answer in (*bad, *late, *large)[:20]:
        print(f"\n{answer.kind}, {answer.path}: {answer.wall:.1f} s, {answer.memory:.0f} MB\n{answer.fault}")
    print(f"{len(bad)} tracebacks, {len(late)} late answers, {len(large)} above {MOST_MEMORY:g} MB")
    print(f"{time.perf_counter() - began:.0f} s in all")
    return 1 if bad or late or large else 0


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


if __name__ == "__main__":
    sys.exit(main())
