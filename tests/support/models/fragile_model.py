"""A model whose blocks take a chosen time, or end or stop the worker that computes them."""

from __future__ import annotations

import dataclasses
import os
import resource
import signal
import time
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from gaitsweep.contract import Quantity
from toy_model import Toy


@dataclasses.dataclass(frozen=True)
class Fragile(Toy):
    """The bouncing masses; in a task of Dask's, the first rows of a block act as their parameters say."""

    name: ClassVar[str] = "fragile"

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return (
            *super().parameters,
            Quantity("pause", "s", "time that a block takes at least", 0.0, low=0.0),
            Quantity("deadly", "1", "1: the worker of this row's block is killed", 0.0, low=0.0),
            Quantity("hanging", "1", "1: the first worker of this row's block stops", 0.0, low=0.0),
        )

    def on_host(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        if _in_a_block():
            if os.environ.get("FRAGILE_DISK"):  # files of this process are at most so long (bytes)
                resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))
            time.sleep(float(np.max(values["pause"])))
            if np.any(values["deadly"] == 1.0):
                os.kill(os.getpid(), signal.SIGKILL)
            flag = os.environ.get("FRAGILE_HANG")
            if flag and np.any(values["hanging"] == 1.0) and not os.path.exists(flag):
                open(flag, "w").close()
                os.kill(os.getpid(), signal.SIGSTOP)
        return super().on_host(values)


def _in_a_block() -> bool:
    try:
        from distributed import get_worker

        return isinstance(get_worker().get_current_task(), tuple)
    except (ImportError, ValueError):
        return False
