"""Tests of the model against its closed form; `pytest` runs them."""

import numpy as np
from hopper import Hopper

import gaitsweep as gs

G, OMEGA, RESTITUTION, PUSH = 9.81, 12.0, 0.7, 2.6  # the model's defaults


def test_the_model_keeps_the_contract():
    assert gs.fault(Hopper()) is None  # `gaitsweep check-model` prints the fault


def test_hops_are_those_of_the_map_in_closed_form():
    """Phase' = phase + 2 omega/g launch;  launch' = restitution launch + push (1 + cos(phase')) / 2."""
    starts = {"n": 16, "seed": 1, "of": {"phase_0": [0, "2*pi"], "launch_0": [0.5, 8.0]}}
    hops = gs.sweep(Hopper(), sample=starts, run=gs.ReturnMap(crossings=20)).table
    phase, launch = (hops[name].to_numpy().reshape(16, 21) for name in ("phase_n", "launch_n"))
    next_phase = phase[:, :-1] + 2 * OMEGA / G * launch[:, :-1]
    next_launch = RESTITUTION * launch[:, :-1] + PUSH * (1 + np.cos(next_phase)) / 2
    # an event's time is known to 1e-12 s
    np.testing.assert_allclose(np.angle(np.exp(1j * (phase[:, 1:] - next_phase))), 0.0, atol=1e-9)
    np.testing.assert_allclose(launch[:, 1:], next_launch, atol=1e-9)


def test_one_turn_a_hop_is_steady():
    launch = np.pi * G / OMEGA
    phase = np.arccos(2 * (1 - RESTITUTION) * launch / PUSH - 1)
    settled = gs.sweep(Hopper(), phase_0=[phase + 0.02], launch_0=launch, run=gs.Settle(tolerance=1e-6)).table
    assert settled["gait"].tolist() == ["1:1"]
    np.testing.assert_allclose(settled["launch_end"], launch, rtol=1e-4)
