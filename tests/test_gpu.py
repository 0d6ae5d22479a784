"""The engines on a CUDA device against the reference: `JAX_PLATFORMS=cuda pytest -m gpu`."""

from __future__ import annotations

import numpy as np
import pytest
from sweeping import run_rows
from test_multilegged import reference, simulated, wrapped

from gaitsweep.engine.advance import Numerics
from gaitsweep.engine.crossings import Crossings
from gaitsweep.engine.settle import Settle
from gaitsweep.models.multilegged import Multilegged

pytestmark = pytest.mark.gpu


def test_crossings_on_a_card_agree_with_solve_ivp() -> None:
    """The same bound as on a CPU: 95 % of random starts within 1e-6 rad over ten crossings."""
    _, table = reference("base")
    exact = table[["psi_1", "psi_2", "psi_3"]].to_numpy().reshape(table["start"].nunique(), -1, 3)
    _, psi, _ = simulated({}, exact[:, 0], exact.shape[1] - 1, devices=1)
    worst = wrapped(psi - exact).max(axis=(1, 2))
    assert np.mean(worst < 1e-6) >= 0.95


@pytest.mark.parametrize(("method", "dt"), [("rk4", 4e-3), ("stabilised", 32e-3)])
def test_kernels_on_a_card_agree_with_solve_ivp(method: str, dt: float) -> None:
    """One thread a trajectory, rows refilled and kept on the way: the bound of the XLA engine."""
    pytest.importorskip("numba_cuda")
    _, table = reference("base")
    exact = table[["psi_1", "psi_2", "psi_3"]].to_numpy().reshape(table["start"].nunique(), -1, 3)
    starts = {f"psi_{i + 1}": exact[:, 0, i] for i in range(3)}
    numerics = Numerics(dt=dt, method=method)
    recorder = Crossings(Multilegged(), crossings=exact.shape[1] - 1)
    result = run_rows(Multilegged(), recorder, starts, numerics=numerics, lanes=64, engine="kernel")
    psi = result.samples.reshape(len(exact), exact.shape[1], -1)[:, :, 2:5]
    assert np.mean(wrapped(psi - exact).max(axis=(1, 2)) < 1e-6) >= 0.95


def test_settling_on_a_card() -> None:
    """Gaits and cycles of settling of kernels and XLA, over rows that outnumber the lanes."""
    pytest.importorskip("numba_cuda")
    random = np.random.default_rng(8)
    starts = {f"psi_{i}": random.uniform(0, 2 * np.pi, 48) for i in (1, 2, 3)}
    numerics = Numerics(dt=32e-3, method="stabilised")
    recorder = Settle(Multilegged())
    kernel, xla = (
        run_rows(Multilegged(), recorder, starts, numerics=numerics, lanes=lanes, engine=engine)
        for engine, lanes in (("kernel", 32), ("xla", 48))
    )
    np.testing.assert_array_equal(kernel.status, xla.status)
    assert np.mean(kernel.labels["gait"] == xla.labels["gait"]) >= 0.95
