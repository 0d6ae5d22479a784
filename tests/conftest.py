"""Every test runs in float64, with rank promotion an error, and without a display."""

from __future__ import annotations

import ctypes
import functools
import gc
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("MPLBACKEND", "Agg")
# JAX_PLATFORMS=cuda runs the suite, and the tests marked gpu, on a card
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import hypothesis
import pytest

from gaitsweep.cli.main import keep_compiled_programs

# XLA's programs come from the cache that the command has, as the kernels do; JAX reads its folder at import
keep_compiled_programs()

import jax  # noqa: E402

from tests.support import UNOPTIMISED  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 2)  # so that sweeps over several devices are tested anywhere
jax.config.update("jax_numpy_rank_promotion", "raise")

# Compilation makes an example's first run slow, so no deadline; the same examples are tried each time.
hypothesis.settings.register_profile("suite", deadline=None, derandomize=True, print_blob=True)
hypothesis.settings.load_profile("suite")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--shapes",
        action="store_true",
        help="check arrays against the axes in annotations (tests.support.shapes)",
    )


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--shapes"):
        from tests.support.shapes import check_shapes

        check_shapes()
    from gaitsweep.engine import stored_traces  # after the hook that checks shapes
    from gaitsweep.engine.kernel import cpu_program, row_kernel
    from gaitsweep.engine.poincare import map_derivatives

    # tests replace parts of the engine, and the programs of one would be given to another
    stored_traces.cache_folder = lambda _: None
    # tests compile more than a thousand kernels, most of them for a few rows
    row_kernel.loaded_once = _compiled_quickly(cpu_program.loaded_once)
    # optimised ones take longer to compile, and half as long for the many rows of slow tests
    if config.option.markexpr != "slow":
        cpu_program.loaded_once = row_kernel.loaded_once
    # and hundreds of maps, whose programs are little beside the kernels in them
    map_derivatives.over_points = _unoptimised_over_points


def _compiled_quickly(loaded_once: Callable[..., Any]) -> Callable[..., Any]:
    """`cpu_program.loaded_once` without optimisation; a test of optimised kernels takes its `__wrapped__`."""

    @functools.wraps(loaded_once)
    def quickly(*args: Any, quick: bool = True) -> Callable[..., None]:
        del quick
        return loaded_once(*args, quick=True)

    return quickly


def _unoptimised_over_points(function: Callable[..., Any]) -> Callable[..., Any]:
    """`map_derivatives.over_points` in a fifth of the compile time; results differ by rounding."""
    on_cpu = jax.default_backend() == "cpu"
    return jax.jit(jax.vmap(function), compiler_options=UNOPTIMISED if on_cpu else None)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the mark `slow` of the cases that it names, and skip tests marked `gpu` without a CUDA device.

    `@pytest.mark.slow` marks a test, `@pytest.mark.slow("id", ...)` its cases that have these ids.

    Raises:
        pytest.UsageError: a mark names a case that its test lacks, while all cases were collected.
    """
    _check_ids_of_slow_cases(config, items)
    for item in items:
        named = [mark for mark in item.own_markers if mark.name == "slow" and mark.args]
        callspec = getattr(item, "callspec", None)
        for mark in named:
            if callspec is not None and callspec.id not in mark.args:
                item.own_markers.remove(mark)
    if any(item.get_closest_marker("gpu") for item in items) and jax.default_backend() != "gpu":
        for item in items:
            if item.get_closest_marker("gpu"):
                item.add_marker(pytest.mark.skip(reason="no CUDA device"))


def _check_ids_of_slow_cases(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Refuse a mark `slow` with the id of no case, which would leave a long test in the default suite."""
    cases: dict[tuple[str, ...], set[str]] = {}
    for item in items:
        for mark in item.own_markers:
            if mark.name == "slow" and mark.args:
                test = (item.nodeid.partition("[")[0], *mark.args)
                callspec = getattr(item, "callspec", None)
                cases.setdefault(test, set()).add("" if callspec is None else callspec.id)
    if any("[" in str(argument) for argument in config.args):
        return  # single cases were asked for
    for (test, *ids), collected in cases.items():
        if unknown := sorted(set(ids) - collected):
            raise pytest.UsageError(
                f"{test}: mark slow names {unknown}, and its cases are {sorted(collected)}."
            )


def pytest_collection_finish() -> None:
    """Leave what was imported out of garbage collection: each pass over it takes a quarter of a second.

    Passes are also rarer than Python's, since traces of JAX make many objects that live on.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


# Memory of a process (bytes) above which compiled programs of earlier files are dropped.
MOST_MEMORY = 2 << 30


def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Drop what JAX has compiled at the end of a file, where the process has grown large.

    The slow suite compiles more programs than two processes of a machine with 24 GB can keep.
    """
    if sys.platform == "linux" and (nextitem is None or nextitem.path != item.path):
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        if pages * os.sysconf("SC_PAGE_SIZE") > MOST_MEMORY:
            jax.clear_caches()
            gc.collect()
            ctypes.CDLL(None).malloc_trim(0)
