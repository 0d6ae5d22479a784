"""The package as gaitsweep finds it; `pytest` runs it once the package is installed."""

import numpy as np

import gaitsweep as gs
from gaitsweep.claims.paper import read_paper
from gaitsweep.models.conformity import fault


def test_the_model_keeps_the_contract():
    assert fault(gs.models.find("goswami1998")()) is None


def test_the_claims_can_be_read():
    assert len(read_paper("goswami1998").claims) == 3


def test_one_turn_a_hop_is_steady():
    settled = gs.sweep("goswami1998", phase_0=[2.0], launch_0=2.6, run=gs.Settle(tolerance=1e-6)).table
    assert settled["gait"].tolist() == ["1:1"]
    np.testing.assert_allclose(settled["launch_end"], np.pi * 9.81 / 12.0, rtol=1e-4)
