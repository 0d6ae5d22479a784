"""The XLA engine on a CUDA device against the reference: `JAX_PLATFORMS=cuda pytest -m gpu`."""

from __future__ import annotations

import numpy as np
import pytest
from test_multilegged import reference, simulated, wrapped

pytestmark = pytest.mark.gpu


def test_crossings_on_a_card_agree_with_solve_ivp() -> None:
    """The same bound as on a CPU: 95 % of random starts within 1e-6 rad over ten crossings."""
    _, table = reference("base")
    exact = table[["psi_1", "psi_2", "psi_3"]].to_numpy().reshape(table["start"].nunique(), -1, 3)
    _, psi, _ = simulated({}, exact[:, 0], exact.shape[1] - 1, devices=1)
    worst = wrapped(psi - exact).max(axis=(1, 2))
    assert np.mean(worst < 1e-6) >= 0.95
