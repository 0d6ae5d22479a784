"""Connections to a cluster, `--cluster`: a scheduler's address or file, a client, or workers started here."""

from __future__ import annotations

import abc
import asyncio
import contextlib
import json
import logging
import os
import re
import signal
import tempfile
import time
from collections.abc import Mapping
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitsweep import near_miss
from gaitsweep.engine.devices import usable_cores
from gaitsweep.errors import ArgumentError
from gaitsweep.runs.prepare import RunError
from gaitsweep.table.atomic_files import reason

if TYPE_CHECKING:
    from distributed import Client, Security, SpecCluster
    from distributed.utils import LoopRunner


_CONNECT = 5.0  # s for one try
_BEING_WRITTEN = 10.0  # s during which a scheduler's file may be incomplete
SCHEMES = ("tcp", "tls")
_LAST_PORT = 65535


class Connection(abc.ABC):
    """A connection to a scheduler, which may be lost and come back.

    Args:
        target: the user's words for the scheduler.
    """

    def __init__(self, target: str) -> None:
        self.target = target
        self.last_error = ""  # of the last try to connect
        self._client: Client | None = None
        self._closing = contextlib.ExitStack()  # what `close` closes, the last first

    @property
    def client(self) -> Client:
        """The client, once connected."""
        if self._client is None:
            raise RuntimeError("There is no connection yet.")
        return self._client

    @property
    def alive(self) -> bool:
        return self._client is not None and self._client.status == "running"

    @abc.abstractmethod
    def try_to_connect(self) -> bool:
        """Connect, or connect again; return False if the scheduler does not answer.

        Raises:
            RunError: the scheduler cannot be reached by another try either.
        """

    def close(self) -> None:
        """Close the connection, but not a client of the user's."""
        self._closing.close()

    def _disconnect(self) -> None:
        """Close the client, if there is one."""
        client = self._client
        self._client = None
        if client is not None:
            with contextlib.suppress(Exception):  # it may be gone
                client.close(timeout=2)


class RemoteScheduler(Connection):
    """A scheduler at an address, or one that has written its address into a file.

    Args:
        target: the address, or the path of the file.

    Raises:
        RunError: it is not the address of a scheduler.
    """

    def __init__(self, target: str) -> None:
        super().__init__(target)
        self._loop: LoopRunner | None = None
        if "://" in target:
            _check_address(target, f"--cluster {target}")
        with contextlib.suppress(OSError):  # the file may come later
            self._address()

    def try_to_connect(self) -> bool:
        from distributed import Client
        from distributed.utils import LoopRunner, sync

        self._disconnect()
        if self._loop is None:  # one for all tries: a client that does not connect leaves its own behind
            self._loop = LoopRunner()
            self._loop.start()
            self._closing.callback(self._loop.stop)
            self._closing.callback(self._disconnect)
        loop: Any = self._loop.loop
        unreachable = f"The scheduler {self.target} cannot be reached"
        try:
            address = self._address()
            sync(loop, _greet, address, _certificates())
            options: Any = {"timeout": _CONNECT, "loop": loop, "set_as_default": False}
            self._client = Client(address, name="gaitsweep", **options)
        except (OSError, TimeoutError) as error:
            self.last_error = _innermost(error)
            if "certificate" in self.last_error:  # it does not become another one
                raise RunError(f"{unreachable}: {self.last_error}.") from error
            return False
        except (RuntimeError, TypeError, ValueError) as error:  # such as missing settings of TLS
            raise RunError(f"{unreachable}: {str(error).rstrip('.')}.") from error
        except ImportError as error:  # the versions of Dask do not fit together
            raise RunError(f"The scheduler {self.target} refuses this client: {error}.") from error
        return True

    def _address(self) -> str:
        """The scheduler's address, as given or read from its file.

        Raises:
            OSError: the file is not there, or is being written.
            RunError: the file is not a scheduler's, or its address is not valid.
        """
        if "://" in self.target:
            return self.target
        file = Path(self.target)
        text = file.read_text(errors="replace")
        age = time.time() - file.stat().st_mtime  # s
        try:
            address = str(json.loads(text)["address"])
        except (KeyError, TypeError, ValueError) as error:
            if age < _BEING_WRITTEN:
                raise OSError("its file is being written") from error
            raise RunError(
                f"--cluster {file} is not a scheduler's file: dask scheduler --scheduler-file {file} writes "
                'JSON with the field "address".'
            ) from error
        _check_address(address, f"The address {address} of {file}")
        return address


def _certificates() -> dict[str, Any]:
    """Return Dask's settings for a connection.

    Raises:
        RunError: a file that the settings name cannot be read.
    """
    from distributed import Security

    try:
        return Security().get_connection_args("client")
    except OSError as error:
        raise RunError(f"A certificate that Dask's settings name cannot be read: {reason(error)}.") from error


async def _greet(address: str, certificates: dict[str, Any]) -> None:
    """Connect to a scheduler and disconnect: a client never returns if the address is no scheduler.

    Raises:
        OSError: the address does not answer as a scheduler.
    """
    from distributed.comm.core import connect

    try:
        comm = await asyncio.wait_for(connect(address, timeout=_CONNECT, **certificates), 2 * _CONNECT)
    except TimeoutError as error:
        raise OSError("something answers there, but not as a scheduler of Dask") from error
    comm.abort()


def _check_address(address: str, subject: str) -> None:
    """Raise RunError if a text is not the address of a scheduler; `subject` begins the message."""
    scheme, _, place = address.partition("://")
    if scheme not in SCHEMES:
        near = f"; did you mean tcp://{place}?" if place else "."
        raise RunError(
            f"{subject} begins with {scheme}, but a scheduler's address begins with tcp:// or tls://{near}"
        )
    port = re.fullmatch(r"(?:\[[^\]\s]+\]|[^:/\s]+):(\d{1,5})", place)
    if port is None or not 1 <= int(port[1]) <= _LAST_PORT:
        raise RunError(
            f"{subject} is not valid: write {scheme}://HOST:PORT with a port from 1 to {_LAST_PORT}, such as "
            f"{scheme}://{place.partition(':')[0] or 'node01'}:8786."
        )


def _innermost(error: BaseException) -> str:
    """Return the reason of an error: that of the operating system if it caused the error."""
    if isinstance(error, OSError) and error.strerror:
        return reason(error)
    text = str(error) or type(error).__name__
    cause = error.__cause__
    while cause is not None:
        if isinstance(cause, OSError) and cause.strerror:
            text = reason(cause)
        cause = cause.__cause__
    return text


class UserClient(Connection):
    """A client of the user's, which stays open.

    Args:
        client: the client.

    Raises:
        ArgumentError: it is not a client, or is closed.
    """

    def __init__(self, client: Client) -> None:
        require_distributed()
        from distributed import Client

        if not isinstance(client, Client):
            raise ArgumentError(f"client is {client!r}, but takes a distributed.Client.")
        if client.status in ("closed", "closing"):
            raise ArgumentError("client is closed: make a new one.")
        super().__init__(str(getattr(client.scheduler, "address", "the client")))
        self._client = client

    def try_to_connect(self) -> bool:
        if self.client.status in ("closed", "closing"):
            raise RunError(f"The client of {self.target} is closed: make a new one, and run the job again.")
        return self.alive  # it connects again by itself


def require_distributed() -> None:
    """Raise RunError if Dask is not installed."""
    try:
        import distributed  # noqa: F401 - whether it is installed
    except ImportError as error:
        raise RunError(
            "--cluster needs Dask's package distributed, which is not installed: "
            "pip install 'gaitsweep[cluster]'."
        ) from error


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
                f"--cluster {self.target} needs the package cryptography, which is not installed: "
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
            raise RunError(f"The workers of {self.target} do not start: {error}.") from error
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

    of_cpu = {"JAX_PLATFORMS": "cpu"}
    of_cards = {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}  # this process uses the cards too
    of_platform = of_cpu if jax.default_backend() == "cpu" else of_cards
    return {"PYTHONPATH": os.environ.get("PYTHONPATH", ""), **of_platform}


def _cards() -> list[str]:
    """Return the GPUs of this machine, one for each worker; empty if the job runs on CPU cores."""
    import jax

    if jax.default_backend() != "gpu":
        return []
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    return visible.split(",") if visible else [str(number) for number in range(jax.local_device_count())]


_FORMS = "write local:N, tcp://HOST:PORT (or tls://HOST:PORT), or the file of a scheduler, FILE.json"


def connection_to(target: str) -> Connection:
    """Return the connection that `--cluster` names; losses are reported in messages, not by Dask's log.

    Raises:
        RunError: the text is not valid, or Dask is not installed.
    """
    require_distributed()
    for name in ("distributed", "distributed.client"):  # whose levels Dask sets itself
        logging.getLogger(name).setLevel(logging.CRITICAL)
    scheme, colon, place = target.partition(":")
    if scheme == "local" and colon:
        if not re.fullmatch(r"[0-9]{1,9}", place) or not 1 <= int(place) <= MOST_LOCAL:
            asked = f"--cluster {target} asks for {place or 'no number of'} workers"
            raise RunError(f"{asked}: from 1 to {MOST_LOCAL} are allowed.")
        return LocalWorkers(int(place))
    if "://" in target or target.endswith(".json"):
        return RemoteScheduler(target)
    schemes = ("local", *SCHEMES)
    near = near_miss.suggestion(scheme, schemes) if colon and place else "."
    if re.fullmatch(r"[0-9]{1,5}", place) and near_miss.nearest(scheme, schemes) is None:
        near = f"; did you mean tcp://{target}?"
    raise RunError(f"--cluster {target or 'WHERE'} is not valid: {_FORMS}{near}")
