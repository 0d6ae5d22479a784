"""The cache of kernels: what is damaged or cannot be kept is compiled again, and is never another program."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from gaitsweep.cache_folder import cache_folder, keep, kept
from gaitsweep.engine.kernel.cache import binary_of, module_of

SLOW = """
import time
time.sleep(0.3)  # as long as threads need to ask for this module too
def run():
    return 7
"""
COMPILED = """
from gaitsweep.engine.kernel.cache import compiled

@compiled
def run(x):
    return 3.0 * x
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_threads_that_ask_at_once_get_the_whole_module(cache: Path) -> None:
    with ThreadPoolExecutor(4) as threads:
        modules = list(threads.map(module_of, 4 * [SLOW]))
    assert [module.run() for module in modules] == 4 * [7]
    assert len({id(module) for module in modules}) == 1


def test_a_module_that_fails_is_none(cache: Path) -> None:
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            module_of("run = 1 / 0")


def _loaded_anew(*, hit: bool) -> None:
    """Ask for the kernel as another process would; `hit`: its code comes from the cache."""
    module = module_of(COMPILED)
    try:
        assert module.run(2.0) == 6.0
        assert bool(module.run.stats.cache_hits) is hit
    finally:
        del sys.modules[module.__name__]


def _flipped(data: bytes) -> bytes:
    return data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 1]) + data[len(data) // 2 + 1 :]


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda _: b"",
    "cut": lambda data: data[:-100],
    "digest alone": lambda data: data[:32],
    "flipped bit": _flipped,
    "flipped bit of the digest": lambda data: bytes([data[0] ^ 1]) + data[1:],
}


def test_damaged_code_is_compiled_again(cache: Path) -> None:
    _loaded_anew(hit=False)
    (file,) = (cache / "kernels").iterdir()
    sound = file.read_bytes()
    _loaded_anew(hit=True)
    for damage in DAMAGE.values():
        file.write_bytes(damage(sound))
        _loaded_anew(hit=False)
        _loaded_anew(hit=True)  # it has been written again


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_damaged_code_of_a_card_is_compiled_again(cache: Path, damage: Callable[[bytes], bytes]) -> None:
    compiled: list[int] = []

    def compile_() -> bytes:
        compiled.append(1)
        return bytes(range(200))

    for n, change in enumerate((None, damage)):
        if change is not None:
            (file,) = (cache / "kernels").glob("*.cubin")
            file.write_bytes(change(file.read_bytes()))
        for _ in range(2):
            assert binary_of("cubin", ("source",), compile_) == bytes(range(200))
        assert len(compiled) == n + 1


def _full(*_: Any) -> None:
    raise OSError(28, "No space left on device")


def test_a_full_disk_costs_a_compilation(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "replace", _full)
    for _ in range(2):
        _loaded_anew(hit=False)
    assert binary_of("cubin", ("source",), lambda: b"code") == b"code"
    assert list((cache / "kernels").iterdir()) == []  # no drafts


@pytest.mark.parametrize("mode", [0o702, 0o777])
def test_a_folder_that_others_may_write_to_is_not_used(cache: Path, mode: int) -> None:
    assert cache_folder("kernels") == cache / "kernels"
    for folder in (cache, cache / "kernels"):
        folder.chmod(mode)
        with pytest.warns(UserWarning, match=f"{folder} is not used.*chmod go-w"):
            assert cache_folder("kernels") is None
        folder.chmod(0o700)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files to others")
def test_a_folder_of_another_user_is_not_used(cache: Path) -> None:
    cache.mkdir()
    os.chown(cache, 12345, -1)
    with pytest.warns(UserWarning, match="belongs to user 12345"):
        assert cache_folder("kernels") is None
    with warnings.catch_warnings(action="error"):  # said once in a process
        assert binary_of("cubin", ("source",), lambda: b"code") == b"code"


def test_without_a_home_nothing_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    for name in ("GAITSWEEP_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    assert cache_folder("kernels") is None
    assert binary_of("cubin", ("source",), lambda: b"code") == b"code"


def test_what_is_kept_is_read_as_it_was_written(tmp_path: Path) -> None:
    keep(tmp_path / "file", b"content")
    assert kept(tmp_path / "file") == b"content"
    assert kept(tmp_path / "none") is None
