"""Pinned memory of cards, by the host's own memory in place of CUDA's."""

from __future__ import annotations

import ctypes
import gc
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from gaitsweep.engine.kernel import cuda_device
from gaitsweep.engine.kernel.cuda_device import CudaDevice


class Memory:
    """Memory of the host, with what a buffer of cuda-core has."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._bytes = ctypes.create_string_buffer(size)
        self.handle = ctypes.addressof(self._bytes)


class Card(CudaDevice):
    """A card whose pinned memory is `Memory`."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._pinned = self

    def allocate(self, size: int) -> Any:
        return Memory(size)

    def use(self) -> Any:
        return self

    def sync(self) -> None:
        pass


@pytest.fixture(autouse=True)
def unused(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    memories: list[Any] = []
    monkeypatch.setattr(cuda_device, "_UNUSED", memories)
    return memories


def test_a_card_uses_only_its_own_memory_again() -> None:
    """An interrupted copy of another card may still write to that card's memory."""
    handles = []
    for number in (0, 1, 0):
        memory, array = Card(number).pinned(100)
        handles.append(memory.handle)
        del memory, array
    assert handles[0] == handles[2] != handles[1]


def test_memory_that_the_collector_drops_meanwhile_is_used(
    unused: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """While memory is chosen, the collector may put back more than may be kept, and drop the chosen one."""
    monkeypatch.setattr(cuda_device, "_MOST_UNUSED", 1000)
    card = Card(0)
    first, array = card.pinned(100)
    del array

    class Collected(list[Any]):
        def remove(self, memory: Any) -> None:
            gc.collect()
            super().remove(memory)

    monkeypatch.setattr(cuda_device, "_UNUSED", Collected(unused))
    _, other = card.pinned(300)
    cycle: list[Any] = [other]
    cycle.append(cycle)
    gc.disable()
    del cycle, other
    try:
        again, _ = card.pinned(90)
    finally:
        gc.enable()
    assert again is first


@pytest.mark.slow
def test_memory_of_a_live_array_is_not_put_back_at_exit() -> None:
    """A thread may still use it."""
    code = (
        "import atexit\n"
        "atexit.register(lambda: print(len(cuda_device._UNUSED), array.sum()))\n"
        "from gaitsweep.engine.kernel import cuda_device\n"
        "from tests.engine.test_pinned_memory import Card\n"
        "memory, array = Card(0).pinned(4)\n"
        "array[:] = 1.0\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0", str(np.ones(4).sum())]
