"""A row's numbers depend on the row alone: not on blocks, refilling, neighbours or the number of devices."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitsweep.engine.kernel import cpu_program, row_kernel
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.engine.sweep.blocks_of_rows import as_slice
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.row_outcome import RowOutcome
from tests.support.sweeping import run_rows, same
from toy_model import Toy

LAUNCH = np.linspace(0.1, 4.0, 23)
NUMERICS = Numerics(dt=1e-2)


@pytest.fixture(scope="module")
def whole() -> RowOutcome:
    return run_rows(Toy(), SettleRecorder(Toy()), {"launch_1": LAUNCH}, numerics=NUMERICS, lanes=4)


@given(places=st.lists(st.integers(0, 9), max_size=4))
def test_a_slice_has_the_places_that_it_replaces(places: list[int]) -> None:
    assert np.arange(10)[as_slice(np.array(places, int))].tolist() == places


@pytest.mark.slow
@settings(max_examples=8)
@given(block=st.integers(1, 30), devices=st.integers(1, 2))
def test_blocks_refilling_and_devices(whole, block: int, devices: int) -> None:
    """Four lanes for 23 rows: every lane is filled again and again, in another order with each block size."""
    assert len(jax.local_devices()) == 2, "tests/conftest.py gives two CPU devices"
    other = run_rows(
        Toy(),
        SettleRecorder(Toy()),
        {"launch_1": LAUNCH},
        numerics=NUMERICS,
        lanes=4,
        block=block,
        devices=devices,
    )
    same(whole, other)


def test_order_of_rows(whole) -> None:
    order = np.random.default_rng(0).permutation(LAUNCH.size)
    other = run_rows(Toy(), SettleRecorder(Toy()), {"launch_1": LAUNCH[order]}, numerics=NUMERICS, lanes=4)
    np.testing.assert_array_equal(whole.t_end[order], other.t_end)
    np.testing.assert_array_equal(whole.last[order], other.last)


def test_a_quickly_compiled_kernel_gives_the_same_bits(whole, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests compile quickly; `quick=True` asks for a kernel of its own, which is optimised here."""
    optimised = row_kernel.loaded_once.__wrapped__  # type: ignore[attr-defined]
    asked = []

    def loaded_once(*args: Any, quick: bool) -> Any:
        asked.append(quick)
        return optimised(*args, quick=False)

    monkeypatch.setattr(cpu_program, "loaded_once", loaded_once)
    rows = {"launch_1": LAUNCH}
    same(whole, run_rows(Toy(), SettleRecorder(Toy()), rows, numerics=NUMERICS, lanes=4, quick=True))
    assert asked == [True]


@pytest.mark.slow
def test_multilegged_rows_over_blocks_and_devices() -> None:
    random = np.random.default_rng(5)
    starts = {f"psi_{i}": random.uniform(0, 2 * np.pi, 11) for i in (1, 2, 3)}
    model = Multilegged()
    one = run_rows(model, CrossingRecorder(model, crossings=2), starts, lanes=4)
    two = run_rows(model, CrossingRecorder(model, crossings=2), starts, lanes=4, block=3, devices=2)
    same(one, two)
