"""The cache of kernels: damaged or missing entries are compiled again, and no other program is loaded."""

from __future__ import annotations

import functools
import os
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaitsweep.cache_folder import cache_folder, compiled_once, load_cached, store_cached
from gaitsweep.engine.kernel import cpu_program, llvm_code, row_kernel
from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.lanes import kernel_of
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recorder import BUFFER
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from toy_model import Toy


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def chunk() -> Chunk:
    model = Toy()
    return kernel_of(
        model, CrossingRecorder(model, crossings=3), Numerics(dt=1e-2).resolve(model), None
    ).chunk


def compiled(chunk: Chunk) -> tuple[Callable[..., None], int]:
    """The function that runs a chunk, and the slots of a lane."""
    return cpu_program.compiled(
        lambda: chunk, lambda _, compute, *others: compute(), contraction=True, quick=False
    )


@pytest.fixture
def compilations(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The instants at which a kernel is compiled; each takes as long as threads need to ask for it too."""
    instants: list[float] = []
    compile_ = llvm_code.machine_code

    def slow(module: Any, *, quick: bool = False) -> bytes:
        instants.append(time.perf_counter())
        time.sleep(0.3)
        return compile_(module, quick=quick)

    monkeypatch.setattr(llvm_code, "machine_code", slow)
    monkeypatch.setattr(cpu_program, "_LOADED", {})
    return instants


def test_threads_that_ask_at_once_compile_a_kernel_once(
    cache: Path, chunk: Chunk, compilations: list[float]
) -> None:
    with ThreadPoolExecutor(4) as threads:
        list(threads.map(compiled, 4 * [chunk]))
    assert len(compilations) == 1


def test_few_rows_run_on_a_kernel_that_was_optimised_before(
    cache: Path, monkeypatch: pytest.MonkeyPatch, compilations: list[float]
) -> None:
    loaded_once = row_kernel.loaded_once.__wrapped__  # type: ignore[attr-defined]

    def kernel(number: float) -> row_kernel.RowKernel:
        return row_kernel.RowKernel(f"def of_tile(s):\n    s[0] = {number}\n", [], 1)

    for number, orders in ((1.0, [True, False, True]), (2.0, [False, True, True])):
        for count, quick in enumerate(orders, start=1):
            monkeypatch.setattr(cpu_program, "_LOADED", {})  # as in another process
            monkeypatch.setattr(row_kernel, "loaded_once", functools.partial(loaded_once, quick=quick))
            numbers = np.zeros((3, 1))
            row_kernel.running(kernel(number))([], numbers)
            np.testing.assert_array_equal(numbers, number)
            # the quick one is followed by the optimised one, which is never followed by a quick one
            assert len(compilations) == min(count, 1 + orders[0])
        compilations.clear()


def test_a_failed_compilation_leaves_no_file(
    cache: Path, chunk: Chunk, monkeypatch: pytest.MonkeyPatch, compilations: list[float]
) -> None:
    with monkeypatch.context() as failing:
        failing.setattr(llvm_code, "machine_code", lambda _, *, quick: bytes(1 // 0))
        for _ in range(2):
            with pytest.raises(ZeroDivisionError):
                compiled(chunk)
    compiled(chunk)
    assert len(compilations) == 1


def _flipped(data: bytes) -> bytes:
    return data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 1]) + data[len(data) // 2 + 1 :]


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda _: b"",
    "cut": lambda data: data[:-100],
    "digest alone": lambda data: data[:32],
    "flipped bit": _flipped,
    "flipped bit of the digest": lambda data: bytes([data[0] ^ 1]) + data[1:],
}


def _opened(chunk: Chunk) -> np.ndarray:
    """The slots of a tile after a chunk of the kernel, which is asked for as another process would."""
    cpu_program._LOADED.clear()
    run, slots = compiled(chunk)
    tile = np.ones((1, slots * cpu_program.TILE))
    run(tile, np.zeros((cpu_program.TILE, BUFFER, chunk.width)), 1)
    return tile


@pytest.mark.slow
def test_damaged_code_is_compiled_again(cache: Path, chunk: Chunk, compilations: list[float]) -> None:
    right = _opened(chunk)
    (file,) = (cache / "kernels").iterdir()
    sound = file.read_bytes()
    for count, damage in enumerate(DAMAGE.values(), start=1):
        np.testing.assert_array_equal(_opened(chunk), right)
        assert len(compilations) == count
        file.write_bytes(damage(sound))
        np.testing.assert_array_equal(_opened(chunk), right)
        assert len(compilations) == count + 1


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
            assert compiled_once("cubin", ("source",), compile_) == bytes(range(200))
        assert len(compiled) == n + 1


def _full(*_: Any) -> None:
    raise OSError(28, "No space left on device")


def test_a_full_disk_costs_a_compilation(
    cache: Path, chunk: Chunk, monkeypatch: pytest.MonkeyPatch, compilations: list[float]
) -> None:
    monkeypatch.setattr(os, "replace", _full)
    for count in (1, 2):
        _opened(chunk)
        assert len(compilations) == count
    assert compiled_once("cubin", ("source",), lambda: b"code") == b"code"
    assert list((cache / "kernels").iterdir()) == []  # no drafts


@pytest.mark.parametrize("mode", [0o702, 0o777])
def test_a_folder_that_others_may_write_to_is_not_used(cache: Path, mode: int) -> None:
    assert cache_folder("kernels") == cache / "kernels"
    for folder in (cache, cache / "kernels"):
        folder.chmod(mode)
        with pytest.warns(UserWarning, match=f"{folder} is not used.*chmod go-w"):
            assert cache_folder("kernels") is None
        folder.chmod(0o700)


def test_the_sticky_bit_excuses_the_cache_but_not_its_folder_of_code(cache: Path) -> None:
    assert cache_folder("kernels") == cache / "kernels"
    cache.chmod(0o1777)
    assert cache_folder("kernels") == cache / "kernels"
    (cache / "kernels").chmod(0o1777)
    with pytest.warns(UserWarning, match=f"{cache / 'kernels'} is not used.*chmod go-w"):
        assert cache_folder("kernels") is None


def test_an_empty_setting_of_the_cache_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAITSWEEP_CACHE", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder("kernels") == tmp_path / "gaitsweep" / "kernels"


def test_an_interrupt_ends_a_store_even_if_its_draft_cannot_be_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    monkeypatch.setattr(os, "unlink", _full)
    with pytest.raises(KeyboardInterrupt):
        store_cached(tmp_path / "file", b"content")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files to others")
def test_a_folder_of_another_user_is_not_used(cache: Path) -> None:
    cache.mkdir()
    os.chown(cache, 12345, -1)
    with pytest.warns(UserWarning, match="belongs to user 12345"):
        assert cache_folder("kernels") is None
    with warnings.catch_warnings(action="error"):  # said once in a process
        assert compiled_once("cubin", ("source",), lambda: b"code") == b"code"


def test_without_a_home_there_is_no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    for name in ("GAITSWEEP_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    assert cache_folder("kernels") is None
    assert compiled_once("cubin", ("source",), lambda: b"code") == b"code"


def test_cached_code_is_read_unchanged(tmp_path: Path) -> None:
    store_cached(tmp_path / "file", b"content")
    assert load_cached(tmp_path / "file") == b"content"
    assert load_cached(tmp_path / "none") is None
