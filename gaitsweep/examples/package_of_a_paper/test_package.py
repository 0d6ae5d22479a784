"""Tests of the package as gaitsweep finds it; `pytest` runs them once the package is installed."""

import numpy as np

import gaitsweep as gs


def test_the_model_keeps_the_contract():
    assert gs.fault(gs.models.find("hopper")()) is None


def test_the_claims_can_be_read():
    assert len(gs.claims.read_paper("hopper").claims) == 3


def test_one_turn_a_hop_is_steady():
    settled = gs.sweep("hopper", phase_0=[2.0], launch_0=2.6, run=gs.Settle(tolerance=1e-6)).table
    assert settled["gait"].tolist() == ["1:1"]
    np.testing.assert_allclose(settled["launch_end"], np.pi * 9.81 / 12.0, rtol=1e-4)
