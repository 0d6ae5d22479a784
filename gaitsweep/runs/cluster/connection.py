"""How a cluster is reached: workers of this command, a scheduler's address, its file, or a user's client."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitsweep import near_miss
from gaitsweep.engine.sweep.xla import usable_cores
from gaitsweep.errors import ArgumentError
from gaitsweep.runs.prepare import RunError

if TYPE_CHECKING:
    from distributed import Client, SpecCluster  # pyright: ignore[reportMissingImports]

MOST_LOCAL = 1024  # workers
_CONNECT = 5.0  # s for one try
_HOW = "write local:N, tcp://HOST:PORT (or tls://HOST:PORT), or the file of a scheduler, FILE.json"
_LOOPBACK = "127.0.0.1"
# A scheduler gives a task up after this many workers were lost with it, also by tasks beside it: gaitsweep
# counts itself, for each block.
_NEVER = 10**9

# Dask's settings for workers of this command.
_SETTINGS = {
    # a worker that was killed is started again, however long that takes
    "distributed.deploy.lost-worker-timeout": "1 day",
    # what Dask measures of itself takes time of the cores that compute
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.limit": "60s",
    "distributed.admin.system-monitor.interval": "10s",
}


class Connection:
    """A connection to a scheduler, which may be lost and come back."""

    def __init__(self, where: str) -> None:
        """Describe it: `where` is what the user wrote."""
        self.where = where
        self._client: Client | None = None

    @property
    def client(self) -> Client:
        """The client, once there is one."""
        if self._client is None:
            raise RuntimeError("There is no connection yet.")
        return self._client

    @property
    def alive(self) -> bool:
        return self._client is not None and self._client.status == "running"

    def try_to_connect(self) -> bool:
        """Connect, or connect again; False if the scheduler does not answer.

        Raises:
            RunError: it cannot be reached, whatever is tried again.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Leave the scheduler."""
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(Exception):  # it may be gone
                client.close(timeout=2)


class RemoteScheduler(Connection):
    """A scheduler at an address, or one that has written its address into a file."""

    def try_to_connect(self) -> bool:
        from distributed import Client

        self.close()
        try:
            self._client = Client(self._address(), timeout=_CONNECT, set_as_default=False, name="gaitsweep")
        except (OSError, TimeoutError):
            return False
        except ValueError as error:
            raise RunError(f"--cluster {self.where} is no address of a scheduler: {error}.") from error
        except ImportError as error:  # the versions of Dask do not fit together
            raise RunError(f"The scheduler {self.where} refuses this client: {error}.") from error
        return True

    def _address(self) -> str:
        if "://" in self.where:
            return self.where
        try:
            return str(json.loads(Path(self.where).read_text())["address"])
        except (KeyError, TypeError, ValueError) as error:
            raise OSError(f"{self.where} is being written") from error


class GivenClient(Connection):
    """A client of the user's, which stays open."""

    def __init__(self, client: Client) -> None:
        """Take a client.

        Raises:
            ArgumentError: it is something else.
        """
        _require_distributed()
        from distributed import Client

        if not isinstance(client, Client):
            raise ArgumentError(f"client is {client!r}, but takes a distributed.Client.")
        super().__init__(str(getattr(client.scheduler, "address", "the client")))
        self._client = client

    def try_to_connect(self) -> bool:
        if self.client.status in ("closed", "closing"):
            raise RunError(f"The client of {self.where} is closed: make a new one, and run the job again.")
        return self.alive  # it connects again by itself

    def close(self) -> None:
        pass


class LocalWorkers(Connection):
    """Workers on this machine, children of this process, with a scheduler that no other machine reaches."""

    def __init__(self, count: int) -> None:
        super().__init__(f"local:{count}")
        self._count = count
        self._cluster: SpecCluster | None = None
        self._scratch: tempfile.TemporaryDirectory[str] | None = None

    def try_to_connect(self) -> bool:
        import dask.config
        from distributed import Client, Nanny, Scheduler, SpecCluster

        self._scratch = tempfile.TemporaryDirectory(prefix="gaitsweep-workers-")
        options: dict[str, Any] = {
            "host": _LOOPBACK,
            "nthreads": max(1, usable_cores() // self._count),
            "memory_limit": 0,
            "dashboard_address": f"{_LOOPBACK}:0",
            "local_directory": self._scratch.name,
            "silence_logs": logging.ERROR,
            "resources": _resources(),
        }
        cards = _cards()
        workers: dict[str, Any] = {}
        for number in range(self._count):
            card = {"CUDA_VISIBLE_DEVICES": cards[number % len(cards)]} if cards else {}
            workers[f"gaitsweep-{number}"] = {
                "cls": Nanny,
                "options": {**options, "env": {**_environment(), **card}},
            }
        scheduler = {"host": _LOOPBACK, "port": 0, "dashboard_address": f"{_LOOPBACK}:0"}
        dask.config.set(_SETTINGS)
        quiet: Any = logging.CRITICAL
        self._cluster = SpecCluster(
            workers=workers,
            scheduler={"cls": Scheduler, "options": {**scheduler, "allowed_failures": _NEVER}},
            silence_logs=quiet,
            name="gaitsweep",
        )
        self._client = Client(self._cluster, set_as_default=False, name="gaitsweep")
        return True

    def close(self) -> None:
        super().close()
        cluster, self._cluster = self._cluster, None
        if cluster is not None:
            with contextlib.suppress(Exception):
                cluster.close(timeout=10)
        if self._scratch is not None:
            with contextlib.suppress(OSError):
                self._scratch.cleanup()


def connection_to(where: str) -> Connection:
    """The connection that `--cluster` asks for; what is lost is told in sentences, not by Dask's log.

    Raises:
        RunError: it cannot be read, or Dask is not installed.
    """
    _require_distributed()
    if (local := re.fullmatch(r"local:(\d{1,9})", where)) is not None:
        count = int(local[1])
        if not 1 <= count <= MOST_LOCAL:
            raise RunError(f"--cluster {where} asks for {count} workers: from 1 to {MOST_LOCAL} are allowed.")
        return LocalWorkers(count)
    if re.fullmatch(r"[a-z]+://[^/\s]+", where) or where.endswith(".json"):
        return RemoteScheduler(where)
    scheme, colon, rest = where.partition(":")
    near = near_miss.suggestion(scheme, ("local", "tcp", "tls")) if colon and rest else "."
    raise RunError(f"--cluster {where} is not read: {_HOW}{near}")


def _require_distributed() -> None:
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise RunError(
            "--cluster needs Dask's package distributed, which is not installed: "
            "pip install 'gaitsweep[cluster]'."
        ) from error
    for name in ("distributed", "distributed.client"):  # whose levels Dask sets itself
        logging.getLogger(name).setLevel(logging.CRITICAL)


def _environment() -> dict[str, str]:
    """The environment in which a worker computes as this process does."""
    import jax

    environment = {"PYTHONPATH": os.environ.get("PYTHONPATH", "")}
    platform = jax.default_backend()
    if platform == "cpu":
        environment["JAX_PLATFORMS"] = "cpu"
    else:
        environment["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"  # this process uses the cards too
    return environment


def _resources() -> dict[str, float]:
    import jax

    return {"GPU": 1} if jax.default_backend() == "gpu" else {}


def _cards() -> list[str]:
    """The cards of this machine, for one worker each; none where the job runs on cores."""
    import jax

    if jax.default_backend() != "gpu":
        return []
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    return visible.split(",") if visible else [str(number) for number in range(jax.local_device_count())]
