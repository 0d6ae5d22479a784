"""The cache of kernels: a module of it is whole for each thread that asks for it."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from gaitsweep.engine.kernel.cache import module_of

SLOW = """
import time
time.sleep(0.3)  # as long as threads need to ask for this module too
def run():
    return 7
"""


def test_threads_that_ask_at_once_get_the_whole_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path))
    with ThreadPoolExecutor(4) as threads:
        modules = list(threads.map(module_of, 4 * [SLOW]))
    assert [module.run() for module in modules] == 4 * [7]
    assert len({id(module) for module in modules}) == 1


def test_a_module_that_fails_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path))
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            module_of("run = 1 / 0")
