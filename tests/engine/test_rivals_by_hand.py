"""The hand-written rivals of the benchmarks simulate the same model: their crossings against solve_ivp's."""

from __future__ import annotations

import importlib
import math
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.rivals import c_simd, cuda_by_hand, numba_by_hand
from benchmarks.rivals.by_hand import Found, Runner, Starts
from benchmarks.rivals.starts import Parameters, errors, reference_crossings
from benchmarks.rivals_tasks import pendulum, simplest_walker, walkers
from benchmarks.rivals_tasks.measured import Options

STARTS, CROSSINGS = 12, 3
# Attempts of a cycle with steps of 4 ms, short ones after events and location included.
ATTEMPTS = (4000, 4300)


@pytest.fixture(scope="module")
def by_numba() -> Found:
    return found(numba_by_hand.run)


@pytest.fixture(scope="module")
def by_c() -> Found:
    if c_simd.compiler() is None:
        pytest.skip("no C compiler")
    return found(c_simd.run)


@pytest.mark.parametrize("task", ["simplest_walker", "pendulum", "branches", "walkers", "basin"])
def test_a_rival_that_is_not_installed_is_skipped(monkeypatch: pytest.MonkeyPatch, task: str) -> None:
    module = importlib.import_module(f"benchmarks.rivals_tasks.{task}")
    monkeypatch.setattr(module, "installed", lambda *names: None)
    for name in ("reference", "scipy_ends"):
        monkeypatch.setattr(module, name, lambda at, *options: np.zeros_like(at), raising=False)
    first = next(module.lines(Options([9], "cpu", 1)))
    assert "not installed: pip install" in first.note
    assert np.isnan(first.cpu_s)


@pytest.mark.slow
def test_tasks_of_rivals_against_scipy() -> None:
    """What the tasks run here, at their tolerances; errors of events add up over the walker's 20 steps."""
    angles = simplest_walker.starts(3)
    ends = simplest_walker.walk("taylor", 1e-13, angles)
    assert simplest_walker.error_of(ends, simplest_walker.reference(angles)) < 1e-13
    rates = np.array([2.0, 3.0, 4.0])
    right = np.array([walkers.reference(rate) for rate in rates])
    np.testing.assert_allclose(walkers.our_wheel(rates, "taylor"), right, rtol=0, atol=1e-9)
    begin = np.array([[0.5, 0.0], [2.7, 0.0]])  # one rests and one turns
    turned = pendulum.our_ends(begin, "taylor")
    np.testing.assert_allclose(turned, pendulum.scipy_ends(begin, "DOP853", 1e-12, 1e-14), rtol=0, atol=1e-3)
    assert (np.abs(turned) > pendulum.TURNS).tolist() == [False, True]


def found(run: Runner) -> Found:
    true = reference_crossings()[:STARTS]
    return run(Starts.of(Parameters(), true[:, 0]), CROSSINGS, 4e-3)


@pytest.mark.slow("by_numba")
@pytest.mark.parametrize("rival", ["by_numba", "by_c"])
def test_crossings_agree_with_solve_ivp(rival: str, request: pytest.FixtureRequest) -> None:
    """1e-7 rad: RK4 with steps of 4 ms and located events comes to 1e-8; an event missed or late, to 1e-3."""
    result = request.getfixturevalue(rival)
    true = reference_crossings()[:STARTS, 1 : CROSSINGS + 1]
    assert errors(result.crossings[:, :, 1:], true).max() < 1e-7
    # a cycle of the settled gait takes 15.36 s, and those of a transient no more than a quarter less or more
    assert np.all(np.abs(np.diff(result.crossings[:, :, 0]) / 15.36 - 1.0) < 0.25)
    assert np.all((result.attempts > ATTEMPTS[0] * CROSSINGS) & (result.attempts < ATTEMPTS[1] * CROSSINGS))


@pytest.mark.slow
def test_both_make_the_same_attempts(by_numba: Found, by_c: Found) -> None:
    """One algorithm, twice: rounding may cost an attempt here and there, one in a thousand at most."""
    assert np.all(np.abs(by_numba.attempts / by_c.attempts - 1.0) < 1e-3)


def test_more_starts_than_lanes(by_c: Found) -> None:
    """A start's result does not depend on the lane that runs it, nor on its neighbours there."""
    true = reference_crossings()[:STARTS]
    starts = Starts.of(Parameters(), true[:, 0])
    order = np.arange(5 * STARTS)[::-1] % STARTS
    result = c_simd.run(Starts(starts.z[order], starts.modes[order]), CROSSINGS, 4e-3)
    np.testing.assert_array_equal(result.crossings, by_c.crossings[order])
    np.testing.assert_array_equal(result.attempts, by_c.attempts[order])


def test_rows_that_cannot_be_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    monkeypatch.setattr(cuda_by_hand, "driver", lambda: None)
    for row, note in ((c_simd.measure(), "no compiler"), (cuda_by_hand.measure(), "no CUDA device")):
        assert note in row["note"]
        assert math.isnan(row["steps_per_second"])
        assert math.isnan(row["error_rad"])
