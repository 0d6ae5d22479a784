"""Time of a kernel between two returns to the host, on a clock of the test's own."""

from __future__ import annotations

import math

import pytest

from gaitsweep.engine.recorders.recorder import POLL_INTERVAL
from gaitsweep.engine.sweep import lane_group as module
from gaitsweep.engine.sweep.lane_group import MAX_CHUNK, NEARLY_FULL, ChunkSizer

POLL, HOST = 2e-4, 3e-3  # s


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


def run(sizer: ChunkSizer, clock: Clock, chunks: int, row_polls: float, fullest: int = 0) -> None:
    """Chunks of polls of POLL s, between which the host works for HOST s."""
    for _ in range(chunks):
        polls, began = sizer.polls, sizer.record_start()
        clock.now += polls * POLL
        sizer.record_end(began, polls)
        clock.now += HOST
        sizer.choose(row_polls * POLL_INTERVAL, fullest)


def test_a_chunk_weighs_the_host_against_rows_that_wait(clock: Clock) -> None:
    """A chunk lasts sqrt(2 x host x row): the least sum of half a chunk per row and the host's work."""
    sizer, row_polls = ChunkSizer(4), 5_000
    run(sizer, clock, 60, row_polls)
    assert sizer.polls * POLL == pytest.approx(math.sqrt(2.0 * HOST * row_polls * POLL), rel=0.01)


def test_no_chunk_keeps_the_user_waiting(clock: Clock) -> None:
    sizer = ChunkSizer(4)
    run(sizer, clock, 60, 1e9)
    assert sizer.polls * POLL == pytest.approx(MAX_CHUNK, rel=0.01)


def test_short_rows_have_the_shortest_chunks(clock: Clock) -> None:
    sizer = ChunkSizer(16)
    run(sizer, clock, 20, 1.0)
    assert sizer.polls == 16


def test_chunks_shrink_where_buffers_fill(clock: Clock) -> None:
    """A row whose buffer is full waits for the host."""
    sizer = ChunkSizer(4)
    run(sizer, clock, 60, 1e9)
    long = sizer.polls
    run(sizer, clock, 1, 1e9, fullest=math.ceil(NEARLY_FULL) + 1)
    assert sizer.polls == long // 2
