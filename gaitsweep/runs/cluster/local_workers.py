"""Workers that a command starts on this machine, with a scheduler of their own (`--cluster local:N`)."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import tempfile
from collections.abc import Mapping
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any

from gaitsweep.engine.devices import usable_cores
from gaitsweep.runs.cluster.connection import Connection
from gaitsweep.runs.prepare import RunError

if TYPE_CHECKING:
    from distributed import Security, SpecCluster  # pyright: ignore[reportMissingImports]

MOST_LOCAL = 1024  # workers
_LOOPBACK = "127.0.0.1"
# Lost workers after which a scheduler gives a task up: never, since it also counts workers that another task
# ended. gaitsweep counts them for each block.
_NEVER = 10**9


# Dask's settings for workers of this command.
_SETTINGS = {
    # a worker that was killed is started again, however long that takes
    "distributed.deploy.lost-worker-timeout": "1 day",
    # no web page of the scheduler or the workers shows other users of this machine what they do
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    # what Dask measures of itself takes time of the cores that compute
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.limit": "60s",
    "distributed.admin.system-monitor.interval": "10s",
}


class LocalWorkers(Connection):
    """Workers on this machine, children of this process, with a scheduler that no other machine reaches.

    They communicate by TLS with a certificate that is made for this run and never written to a file that
    others can read. A client without it, such as another user of this machine, is refused; otherwise it could
    run code as this user.

    Args:
        count: the number of workers.
    """

    def __init__(self, count: int) -> None:
        super().__init__(f"local:{count}")
        self._count = count

    def try_to_connect(self) -> bool:
        import dask.config
        from distributed import Client, Scheduler, Security, SpecCluster

        try:
            security = Security.temporary()
        except ImportError as error:
            raise RunError(
                f"--cluster {self.where} needs the package cryptography, which is not installed: "
                "pip install 'gaitsweep[cluster]'."
            ) from error
        scratch = tempfile.TemporaryDirectory(prefix="gaitsweep-workers-", ignore_cleanup_errors=True)
        self._closing.callback(scratch.cleanup)
        options = self._options(security, scratch.name)
        scheduler = {name: options[name] for name in ("host", "protocol", "security", "dashboard_address")}
        dask.config.set(_SETTINGS)
        quiet: Any = logging.CRITICAL
        # a terminal sends Ctrl-C to the workers too: the command obeys it, and ends them; they inherit what
        # this thread blocks, unless a thread of theirs starts the tracker, which unblocks it
        resource_tracker.ensure_running()
        signals_before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            cluster = SpecCluster(
                workers=self._workers(options),
                scheduler={"cls": Scheduler, "options": {**scheduler, "port": 0, "allowed_failures": _NEVER}},
                security=security,
                silence_logs=quiet,
                name="gaitsweep",
            )
        except RuntimeError as error:
            raise RunError(f"The workers of {self.where} do not start: {error}.") from error
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, signals_before)
        self._closing.callback(_close_quietly, cluster)
        self._client = Client(cluster, set_as_default=False, name="gaitsweep")
        self._closing.callback(self._disconnect)
        return True

    def _options(self, security: Security, scratch: str) -> dict[str, Any]:
        """Dask's options of a worker, which keeps its files in the folder `scratch`."""
        return {
            "host": _LOOPBACK,
            "protocol": "tls://",
            "security": security,
            "nthreads": max(1, usable_cores() // self._count),
            "memory_limit": 0,
            "dashboard_address": f"{_LOOPBACK}:0",
            "local_directory": scratch,
            # a heartbeat may meet the scheduler while it closes, at the end
            "silence_logs": logging.CRITICAL,
            "resources": {"GPU": 1} if _cards() else {},
        }

    def _workers(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Dask's specification of each worker, which has a card of its own where there are enough."""
        from distributed import Nanny

        workers: dict[str, Any] = {}
        cards = _cards()
        for number in range(self._count):
            card = {"CUDA_VISIBLE_DEVICES": cards[number % len(cards)]} if cards else {}
            environment = {**_environment(), **card}
            workers[f"gaitsweep-{number}"] = {"cls": Nanny, "options": {**options, "env": environment}}
        return workers


def _close_quietly(cluster: SpecCluster) -> None:
    """Close the workers, some of which may be gone."""
    with contextlib.suppress(Exception):
        cluster.close(timeout=10)


def _environment() -> dict[str, str]:
    """The environment variables with which a worker computes as this process does."""
    import jax

    environment = {"PYTHONPATH": os.environ.get("PYTHONPATH", "")}
    platform = jax.default_backend()
    if platform == "cpu":
        environment["JAX_PLATFORMS"] = "cpu"
    else:
        environment["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"  # this process uses the cards too
    return environment


def _cards() -> list[str]:
    """Return the GPUs of this machine, one for each worker; empty if the job runs on CPU cores."""
    import jax

    if jax.default_backend() != "gpu":
        return []
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    return visible.split(",") if visible else [str(number) for number in range(jax.local_device_count())]
