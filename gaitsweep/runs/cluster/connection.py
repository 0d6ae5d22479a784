"""Connections to a running cluster: a scheduler's address, its file, or a user's client."""

from __future__ import annotations

import abc
import asyncio
import contextlib
import json
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitsweep.errors import ArgumentError
from gaitsweep.runs.prepare import RunError
from gaitsweep.table.atomic_files import reason

if TYPE_CHECKING:
    from distributed import Client  # pyright: ignore[reportMissingImports]
    from distributed.utils import LoopRunner  # pyright: ignore[reportMissingImports]

_CONNECT = 5.0  # s for one try
_BEING_WRITTEN = 10.0  # s during which a scheduler's file may be incomplete
SCHEMES = ("tcp", "tls")
_LAST_PORT = 65535


class Connection(abc.ABC):
    """A connection to a scheduler, which may be lost and come back.

    Args:
        where: the user's words for it.
    """

    def __init__(self, where: str) -> None:
        self.where = where
        self.why = ""  # the reason why the last try to connect failed
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
        where: the address, or the path of the file.

    Raises:
        RunError: it is not the address of a scheduler.
    """

    def __init__(self, where: str) -> None:
        super().__init__(where)
        self._loop: LoopRunner | None = None
        if "://" in where:
            _check_address(where, f"--cluster {where}")
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
        try:
            address = self._address()
            sync(loop, _greet, address, _certificates())
            self._client = Client(
                address, timeout=_CONNECT, loop=loop, set_as_default=False, name="gaitsweep"
            )
        except (OSError, TimeoutError) as error:
            self.why = _innermost(error)
            if "certificate" in self.why:  # it does not become another one
                raise RunError(f"The scheduler {self.where} cannot be reached: {self.why}.") from error
            return False
        except (RuntimeError, TypeError, ValueError) as error:  # such as missing settings of TLS
            raise RunError(
                f"The scheduler {self.where} cannot be reached: {str(error).rstrip('.')}."
            ) from error
        except ImportError as error:  # the versions of Dask do not fit together
            raise RunError(f"The scheduler {self.where} refuses this client: {error}.") from error
        return True

    def _address(self) -> str:
        """The scheduler's address, as given or read from its file.

        Raises:
            OSError: the file is not there, or is being written.
            RunError: the file is not a scheduler's, or its address is not valid.
        """
        if "://" in self.where:
            return self.where
        file = Path(self.where)
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


def _check_address(address: str, what: str) -> None:
    """Raise RunError if a text is not the address of a scheduler; `what` begins the message."""
    scheme, _, place = address.partition("://")
    if scheme not in SCHEMES:
        near = f"; did you mean tcp://{place}?" if place else "."
        raise RunError(
            f"{what} begins with {scheme}, but a scheduler's address begins with tcp:// or tls://{near}"
        )
    port = re.fullmatch(r"(?:\[[^\]\s]+\]|[^:/\s]+):(\d{1,5})", place)
    if port is None or not 1 <= int(port[1]) <= _LAST_PORT:
        raise RunError(
            f"{what} is not valid: write {scheme}://HOST:PORT with a port from 1 to {_LAST_PORT}, such as "
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
            raise RunError(f"The client of {self.where} is closed: make a new one, and run the job again.")
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
