"""A real Dask scheduler and real workers, processes of this machine on the loopback address."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.support import environment

LOOPBACK = "127.0.0.1"


def until(happened: Callable[[], Any], seconds: float = 120.0) -> Any:
    """Wait until `happened` returns something true, and return it."""
    deadline = time.monotonic() + seconds
    while not (found := happened()):
        assert time.monotonic() < deadline, "it does not happen"
        time.sleep(0.05)
    return found


class DaskProcesses:
    """A scheduler that writes its address into `file`, and workers that find it there."""

    def __init__(self, folder: Path) -> None:
        self.file, self.folder = folder / "scheduler.json", folder
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: dict[str, subprocess.Popen[bytes]] = {}
        self._log = (folder / "dask.log").open("ab")

    def start_scheduler(self) -> None:
        self.file.unlink(missing_ok=True)
        self.scheduler = self._start(
            "dask_scheduler", "--host", LOOPBACK, "--port", "0", "--scheduler-file", str(self.file),
            "--dashboard-address", f"{LOOPBACK}:0",
        )  # fmt: skip
        until(lambda: self.file.exists() and self.file.read_text().rstrip().endswith("}"))

    @property
    def address(self) -> str:
        return json.loads(self.file.read_text())["address"]

    def start_worker(self, name: str, *options: str, **variables: str) -> None:
        self.workers[name] = self._start(
            "dask_worker", self.address, "--name", name, "--nthreads", "1", "--host", LOOPBACK,
            "--no-dashboard", "--memory-limit", "0", "--local-directory", str(self.folder / "scratch"),
            *options, **variables,
        )  # fmt: skip

    def _start(self, module: str, *options: str, **variables: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{module}", *options],
            env=environment(**variables),
            stdout=self._log,
            stderr=self._log,
            start_new_session=True,  # so that a nanny ends with its worker
        )

    def kill(self, process: subprocess.Popen[bytes]) -> None:
        """End a process and its children at once."""
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(30)

    def kill_worker(self, name: str) -> None:
        self.kill(self.workers.pop(name))

    def kill_scheduler(self) -> None:
        assert self.scheduler is not None
        self.kill(self.scheduler)

    @property
    def log(self) -> str:
        return (self.folder / "dask.log").read_text(errors="replace")

    def close(self) -> None:
        for process in [*self.workers.values(), *filter(None, [self.scheduler])]:
            self.kill(process)
        self._log.close()
