"""A sweep that is stopped by an exception raises it, stores its ended rows, and ends its threads."""

from __future__ import annotations

import functools
import threading
from typing import Any

import numpy as np
import pytest

from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.sweep import sweep as module
from gaitsweep.row_outcome import RowOutcome
from tests.support import sweeping
from toy_model import Toy

BLOCK = 100


def run(devices: int = 1) -> None:
    sweeping.run_rows(
        Toy(),
        CrossingRecorder(Toy(), crossings=2),
        {"launch_1": np.linspace(0.1, 4.0, 20 * BLOCK)},
        numerics=Numerics(dt=1e-2),
        block=BLOCK,
        devices=devices,
    )


class Storage:
    """Has no rows of an earlier run, and collects those of this one."""

    def __init__(self) -> None:
        self.kept: set[int] = set()

    def restored(self, number: int) -> RowOutcome | None:
        return None

    def keep(self, rows: RowOutcome) -> None:
        self.kept.update(rows.row.tolist())


def test_the_first_of_several_failures_is_raised_and_rows_are_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    both_begun = threading.Barrier(2)
    storage = Storage()

    def encode(number: int, rows: RowOutcome) -> Any:
        if number < 2:
            both_begun.wait(60.0)
        raise RuntimeError(f"block {number} failed")

    failing = functools.partial(module.sweep, encode=encode, open_rows=storage)
    monkeypatch.setattr(sweeping, "sweep", failing)
    with pytest.raises(RuntimeError, match="block 0 failed"):
        run()
    assert set(range(2 * BLOCK)) <= storage.kept


def test_threads_end_when_compiling_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise RuntimeError("no label")

    monkeypatch.setattr(module, "labelled", fail)
    before = set(threading.enumerate())
    with pytest.raises(RuntimeError, match="no label") as raised:
        run(devices=2)
    left = [thread.name for thread in set(threading.enumerate()) - before if thread.name.startswith("Thread")]
    assert left == [], raised
