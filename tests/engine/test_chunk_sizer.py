"""How long a kernel runs between two returns to the host, on a clock of the test's own."""

from __future__ import annotations

import math

import pytest

from gaitsweep.engine.recorders.recorder import CADENCE
from gaitsweep.engine.sweep import chunk_sizer as module
from gaitsweep.engine.sweep.chunk_sizer import FULL, LONGEST, Pace

LOOK, HOST = 2e-4, 3e-3  # s


class Clock:
    """A clock that is moved by hand."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    return clock


def run(pace: Pace, clock: Clock, chunks: int, row_looks: float, fullest: int = 0) -> None:
    """Chunks of looks of LOOK s, between which the host works for HOST s."""
    for _ in range(chunks):
        looks, began = pace.looks, pace.begins()
        clock.now += looks * LOOK
        pace.ended(began, looks)
        clock.now += HOST
        pace.choose(row_looks * CADENCE, fullest)


def test_a_chunk_weighs_the_host_against_rows_that_wait(clock: Clock) -> None:
    """Of sqrt(2 x host x row), the least sum of half a chunk a row and the host's share of each chunk."""
    pace, row_looks = Pace(4), 5_000
    run(pace, clock, 60, row_looks)
    assert pace.looks * LOOK == pytest.approx(math.sqrt(2.0 * HOST * row_looks * LOOK), rel=0.01)


def test_no_chunk_keeps_the_user_waiting(clock: Clock) -> None:
    pace = Pace(4)
    run(pace, clock, 60, 1e9)
    assert pace.looks * LOOK == pytest.approx(LONGEST, rel=0.01)


def test_short_rows_have_the_shortest_chunks(clock: Clock) -> None:
    pace = Pace(16)
    run(pace, clock, 20, 1.0)
    assert pace.looks == 16


def test_chunks_shrink_where_buffers_fill(clock: Clock) -> None:
    """A row whose buffer is full waits for the host."""
    pace = Pace(4)
    run(pace, clock, 60, 1e9)
    long = pace.looks
    run(pace, clock, 1, 1e9, fullest=math.ceil(FULL) + 1)
    assert pace.looks == long // 2
