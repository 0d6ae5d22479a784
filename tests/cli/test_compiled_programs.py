"""XLA's programs are kept on disk, with the same bits, and work beside rows is the CPU's."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
from gaitsweep.cli.main import keep_compiled_programs
keep_compiled_programs()
import jax, jax.numpy as jnp, numpy as np
x = jnp.linspace(0.1, 9.0, 1000)
print(np.asarray(jax.jit(lambda x: jnp.sum(jnp.sin(x) * jnp.exp(-x)) / x)(x)).tobytes().hex())
"""
# what the user set himself would be kept
SETTINGS = ("JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS")


def _run(cache: Path, **settings: str) -> str:
    """The bits that a process computes with this cache, which says nothing else."""
    clean = {name: value for name, value in os.environ.items() if name not in SETTINGS}
    environment = {**clean, "GAITSWEEP_CACHE": str(cache), **settings}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return done.stdout


def _programs(cache: Path) -> dict[Path, int]:
    """The kept programs, and when they were written (ns)."""
    return {file: file.stat().st_mtime_ns for file in (cache / "xla").glob("*-cache")}


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A cache that one process has filled, and the bits that it computed."""
    cache = tmp_path_factory.mktemp("cache")
    return cache, _run(cache)


def test_the_next_process_loads_compiled_programs(warm: tuple[Path, str]) -> None:
    cache, bits = warm
    kept = _programs(cache)
    assert any("lambda" in file.name for file in kept)
    assert _run(cache) == bits
    assert _programs(cache) == kept


@pytest.mark.slow
def test_without_a_folder_programs_are_compiled(warm: tuple[Path, str], tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("a file where the cache would be")
    assert _run(taken) == warm[1]


def test_damaged_programs_are_compiled_again(warm: tuple[Path, str], tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    for file in _programs(warm[0]):
        damaged = cache / file.relative_to(warm[0])
        damaged.parent.mkdir(parents=True, exist_ok=True)
        damaged.write_bytes(file.read_bytes()[:-20])
    assert _run(cache) == warm[1]


@pytest.mark.slow
def test_the_users_own_folder_is_used(warm: tuple[Path, str], tmp_path: Path) -> None:
    own, ours = tmp_path / "own", tmp_path / "ours"
    assert _run(ours, JAX_COMPILATION_CACHE_DIR=str(own)) == warm[1]
    assert own.exists()
    assert not _programs(ours)


@pytest.mark.parametrize(("platforms", "device"), [("", "cpu"), ("cuda,cpu", "cpu"), ("cuda", None)])
def test_the_cpu_computes_what_is_beside_rows(platforms: str, device: str | None) -> None:
    script = "import os; from gaitsweep.cli.main import keep_other_work_on_host as keep; keep(); "
    script += "print(os.environ.get('JAX_DEFAULT_DEVICE'))"
    clean = {name: value for name, value in os.environ.items() if name != "JAX_DEFAULT_DEVICE"}
    environment = {**clean, "JAX_PLATFORMS": platforms}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, check=True)
    assert done.stdout.decode().split() == [str(device)]
