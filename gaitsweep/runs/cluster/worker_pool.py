"""The workers of a cluster as one client sees them: present and refused ones, and their resources."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Mapping
from typing import Any

from gaitsweep.runs.cluster.connection import Connection
from gaitsweep.runs.cluster.task import JobTicket, examine
from gaitsweep.runs.prepare import RunError

_BETWEEN_UPDATES = 1.0  # s between two polls of the workers
_POLL = 0.01  # s between two polls of a task
_BETWEEN_TRIES = 0.1  # s between two tries to connect
_EMPTY = 5.0  # s without workers after which a message says so
# Workers that are busy with other work are not waited for longer (s), once one has answered.
_EXAMINATION = 30.0


class WorkerPool:
    """The workers of a cluster.

    Args:
        connection: connection to the cluster.
        on_message: called with a sentence for each worker that is refused.
    """

    def __init__(self, connection: Connection, on_message: Callable[[str], None]) -> None:
        self.connection = connection
        self.on_message = on_message
        self.names: dict[str, str] = {}  # by address
        self.most = 0  # usable ones at one time
        self.slots = 0  # blocks that they compute at the same time
        self.on_card = False
        self._refused: dict[str, str] = {}  # reasons by address
        self._messages: set[str] = set()
        self._updated = -_BETWEEN_UPDATES
        self._unreachable = False
        self._empty: float | None = None  # since when there are none

    @property
    def client(self) -> Any:  # its methods are typed for a use with `await` too
        return self.connection.client

    @property
    def usable(self) -> list[str]:
        """Addresses of the workers that are not refused."""
        return [address for address in self.names if address not in self._refused]

    @property
    def chosen(self) -> list[str] | None:
        """Addresses of the workers that may compute blocks; None if all may."""
        return self.usable if self._refused else None

    @property
    def resources(self) -> dict[str, float] | None:
        """Resources that a block needs on a worker."""
        return {"GPU": 1} if self.on_card else None

    @property
    def note(self) -> str:
        """The workers, for a line of progress."""
        if self._unreachable:
            return "the scheduler is away"
        count = len(self.usable)
        return f"{count} worker{'s' * (count != 1)}"

    def connect(self, on_wait: Callable[[], None]) -> None:
        """Connect, or connect again, for as long as it takes.

        Args:
            on_wait: called meanwhile; an exception that it raises ends the wait.
        """
        while not self.connection.alive:
            self._unreachable = not self.connection.try_to_connect()
            if self._unreachable:
                self.names = {}
                self.slots = 0
                text = f"The scheduler {self.connection.target} does not answer"
                self._message_once(f"{text} ({self.connection.last_error}): waiting for it.")
                on_wait()
                time.sleep(_BETWEEN_TRIES)
        self._unreachable = False
        self._updated = -_BETWEEN_UPDATES

    def update(self) -> None:
        """Update the list of workers, at most once a second."""
        now = time.monotonic()
        if now - self._updated < _BETWEEN_UPDATES:
            return
        self._updated = now
        workers = self.client.scheduler_info(n_workers=-1)["workers"]
        self.names = {address: str(about["name"]) for address, about in workers.items()}
        self._refused = {address: why for address, why in self._refused.items() if address in workers}
        if self.on_card:
            cards = {a: about.get("resources", {}).get("GPU", 0) for a, about in workers.items()}
            for address, count in cards.items():
                if not count:
                    self.refuse(address, "it offers no card: start it with --resources GPU=1")
            self.slots = int(sum(cards[address] for address in self.usable))
        else:
            self.slots = len(self.usable)
        self.most = max(self.most, len(self.usable))
        if workers:
            self._empty = None
        elif self._empty is None:
            self._empty = now
        elif now - self._empty > _EMPTY:
            self._message_once(f"The scheduler {self.connection.target} has no workers: waiting for them.")
        if self.names and not self.usable:
            raise RunError(
                f"No worker of {self.connection.target} can compute this job. "
                + " ".join(sorted({f"{self.names[a]}: {why}." for a, why in self._refused.items()}))
            )

    def refuse(self, address: str, why: str) -> None:
        """Exclude a worker, and report its name and the reason."""
        if address in self._refused:
            return
        self._refused[address] = why
        self._updated = -_BETWEEN_UPDATES
        self._message_once(f"The worker {self.names.get(address, address)} is refused: {why}.")

    def _message_once(self, sentence: str) -> None:
        """Report a sentence that was not reported before."""
        if sentence not in self._messages:
            self._messages.add(sentence)
            self.on_message(sentence)

    def examine(self, ticket: JobTicket, on_wait: Callable[[], None]) -> bool:
        """Ask the present workers whether they can compute a job; return False if the scheduler is lost.

        Args:
            ticket: the job.
            on_wait: called meanwhile; an exception that it raises ends the wait.

        Raises:
            RunError: some cannot, each named with the reason.
        """
        try:
            self._examine(ticket, on_wait)
        except (OSError, TimeoutError):
            if self.connection.alive:
                raise
        return self.connection.alive

    def _examine(self, ticket: JobTicket, on_wait: Callable[[], None]) -> None:
        """Ask the present workers, as `examine`."""
        self.update()
        futures = {
            address: self.client.submit(
                examine,
                ticket,
                workers=[address],
                key=f"gaitsweep-examine-{secrets.token_hex(4)}",
                resources=self.resources,
            )
            for address in self.usable
        }
        try:
            reasons = self._reasons(futures, on_wait)
        finally:  # at once, not when the last exception is collected
            for future in futures.values():
                future.release()
        if reasons:
            named = {f"{self.names.get(a, a)}: {why}." for a, why in reasons.items()}
            raise RunError(
                f"{len(reasons)} of the {max(len(self.names), len(reasons))} workers of "
                f"{self.connection.target} cannot compute this job, which is not started. "
                + " ".join(sorted(named))
            )

    def _reasons(self, futures: Mapping[str, Any], on_wait: Callable[[], None]) -> dict[str, str]:
        """The reasons of the workers that cannot compute a job, from the tasks that examine them."""
        reasons: dict[str, str] = {}
        asked = dict(futures)
        deadline = time.monotonic() + _EXAMINATION
        answers = 0
        while asked and self.connection.alive and (time.monotonic() < deadline or not answers):
            for address, future in list(asked.items()):
                if not future.done():
                    continue
                del asked[address]
                reason = None
                answers += future.status in ("finished", "error")
                if future.status == "finished":
                    reason = future.result()
                elif future.status == "error":
                    reason = future.exception()
                if reason is not None:
                    reasons[address] = str(reason)
            on_wait()
            self.update()  # lost workers are not asked again
            asked = {address: future for address, future in asked.items() if address in self.names}
            time.sleep(_POLL)
        return reasons

    def restart(self, address: str) -> None:
        """End a worker that hangs, and let its nanny start another."""
        try:
            self.client.restart_workers([address], timeout=10, raise_for_error=False)
        except ValueError:  # it has no nanny; the scheduler forgets it, and its tasks go elsewhere
            self.client.sync(
                self.client.scheduler.unregister, address=address, stimulus_id="gaitsweep-time-limit"
            )
        self._updated = -_BETWEEN_UPDATES
