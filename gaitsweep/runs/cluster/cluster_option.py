"""The option `--cluster`: workers on this machine, a scheduler's address, or a scheduler's file."""

from __future__ import annotations

import logging
import re

from gaitsweep import near_miss
from gaitsweep.runs.cluster.connection import SCHEMES, Connection, RemoteScheduler, require_distributed
from gaitsweep.runs.cluster.local_workers import MOST_LOCAL, LocalWorkers
from gaitsweep.runs.prepare import RunError

_FORMS = "write local:N, tcp://HOST:PORT (or tls://HOST:PORT), or the file of a scheduler, FILE.json"


def connection_to(where: str) -> Connection:
    """Return the connection that `--cluster` names; losses are reported in messages, not by Dask's log.

    Raises:
        RunError: the text is not valid, or Dask is not installed.
    """
    require_distributed()
    for name in ("distributed", "distributed.client"):  # whose levels Dask sets itself
        logging.getLogger(name).setLevel(logging.CRITICAL)
    scheme, colon, place = where.partition(":")
    if scheme == "local" and colon:
        if not re.fullmatch(r"\d{1,9}", place) or not 1 <= int(place) <= MOST_LOCAL:
            raise RunError(
                f"--cluster {where} asks for {place or 'no number of'} workers: from 1 to {MOST_LOCAL} are "
                "allowed."
            )
        return LocalWorkers(int(place))
    if "://" in where or where.endswith(".json"):
        return RemoteScheduler(where)
    schemes = ("local", *SCHEMES)
    if re.fullmatch(r"\d{1,5}", place) and near_miss.nearest(scheme, schemes) is None:
        near = f"; did you mean tcp://{where}?"
    else:
        near = near_miss.suggestion(scheme, schemes) if colon and place else "."
    raise RunError(f"--cluster {where or 'WHERE'} is not valid: {_FORMS}{near}")
