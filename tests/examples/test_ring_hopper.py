"""The ring of oscillators with a hopper: its twisted states, their multipliers, and those of the hopper."""

from __future__ import annotations

import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.examples.ring_hopper import RingHopper

N, OMEGA, G, PUSH, E = 8, 12.0, 9.81, 2.6, 0.7


@pytest.mark.slow
@pytest.mark.parametrize("q", [0, 1, 3])
def test_multipliers_of_twisted_states(q: int) -> None:
    """Wiley, Strogatz and Girvan 2006: rates -4 K cos(2 pi q/N) sin^2(pi m/N), so stable for |q| < N/4.

    All phases together and the launch have the two multipliers of the hopper's map alone.
    """
    mapping = gs.return_map(RingHopper(N=N))
    launch = np.pi * G / OMEGA  # one turn a hop
    phase = np.arccos(2.0 * (1.0 - E) * launch / PUSH - 1.0)
    start = {f"phi_{i + 1}_0": [phase + 2.0 * np.pi * q * i / N] for i in range(N)}
    result = mapping.multipliers(mapping.settled({**start, "launch_0": [launch]}, cycles=0))[0]
    rates = -4.0 * np.cos(2.0 * np.pi * q / N) * np.sin(np.pi * np.arange(1, N) / N) ** 2
    slope = PUSH / 2.0 * np.sin(phase)
    hopper = np.linalg.eigvals([[1.0, 2.0 * OMEGA / G], [-slope, E - slope * 2.0 * OMEGA / G]])
    expected = np.concatenate([np.exp(rates * 2.0 * launch / G), hopper])
    np.testing.assert_allclose(np.poly(result), np.poly(expected), rtol=1e-6, atol=1e-6)
    assert (np.abs(result).max() < 1.0) == (abs(q) < N / 4)


@pytest.mark.slow
def test_only_stable_twisted_states_are_reached() -> None:
    sample = {"n": 200, "seed": 1, "of": {f"phi_{i + 1}_0": [0, "2*pi"] for i in range(N)}}
    rows = gs.sweep(RingHopper(N=N), sample=sample, run=gs.Settle(max_cycles=400, tolerance=1e-6)).table
    counts = rows["gait"].value_counts().to_dict()
    assert counts["q = 2"] == counts["q = -2"] == counts["none"] == 0
    assert counts["q = 0"] > counts["q = 1"] > 0
    # mirrored states are equally likely: 4 standard deviations of their difference
    assert abs(counts["q = 1"] - counts["q = -1"]) < 4.0 * np.sqrt(counts["q = 1"] + counts["q = -1"])
