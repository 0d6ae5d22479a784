"""The two independent references agree with each other, with their data files, and with the model's page."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import multilegged_exact, multilegged_scipy
from reference.make_reference import CROSSING_SETS, random_starts
from reference.multilegged_page import LANDING, TURN, Parameters, leg_lengths, obstacle, start

FOLDER = Path(__file__).parents[1] / "reference"
PERIOD = 15.3609  # s, the page's


def rows(name: str) -> list[dict[str, str]]:
    with (FOLDER / name).open() as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def angles(row: dict[str, str], count: int, suffix: str = "") -> np.ndarray:
    return np.array([float(row[f"psi_{i + 1}{suffix}"]) for i in range(count)])


@pytest.mark.slow("{'clamp': True}")
@pytest.mark.parametrize("changes", [{}, {"clamp": True}, {"N": 4, "m_end": 0.8}], ids=str)
def test_solve_ivp_and_the_exact_propagator_agree(changes: dict[str, Any]) -> None:
    p = Parameters(**changes)
    psi = np.random.default_rng(3).uniform(0.0, TURN, p.N)
    one = multilegged_scipy.run(p, psi, 1, times=[0.5, 3.0])
    other = multilegged_exact.run(p, psi, 1, times=[0.5, 3.0])
    assert one.events == other.events
    # Both hold 1e-11; a mode missed or taken late costs 1e-6 and more.
    np.testing.assert_allclose(one.crossings[1].psi, other.crossings[1].psi, rtol=0.0, atol=1e-9)
    assert one.crossings[1].t == pytest.approx(other.crossings[1].t, abs=1e-9)
    for left, right in zip(one.samples, other.samples, strict=True):
        np.testing.assert_allclose(left.x, right.x, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(left.v, right.v, rtol=0.0, atol=1e-8)


@pytest.mark.slow("a: direct", "b: retrograde")
@pytest.mark.parametrize(
    ("psi", "expected"),
    [
        ([1.13, 0.98, 1.50], [1.1301, 0.9842, 1.4960]),
        ([3.97, 5.29, 5.29], [3.959, 5.300, 5.291]),
        ([1.13, 1.10, 5.28], [1.130, 1.102, 5.282]),
    ],
    ids=["a: direct", "b: retrograde", "c: source"],
)
def test_points_of_the_page(psi: list[float], expected: list[float]) -> None:
    crossings = multilegged_exact.run(Parameters(), psi, 30).crossings
    # The neutral drift leaves 1e-3 open; a wrong kick or load moves these points by m_B b = 0.14.
    np.testing.assert_allclose(crossings[-1].psi, expected, rtol=0.0, atol=1.5e-3)
    assert crossings[-1].t - crossings[-2].t == pytest.approx(PERIOD, abs=1e-4)
    assert crossings[-1].phi_1 == pytest.approx(6.14435, abs=5e-5)


@given(
    phases=st.lists(st.floats(0.0, 6.283), min_size=4, max_size=6),
    m_1=st.floats(0.6, 0.99),
)
def test_obstacle_problem_is_solved(phases: list[float], m_1: float) -> None:
    p = Parameters(N=len(phases) - 1, m_1=m_1)
    phi = np.array(phases)
    segment = (phi > p.corners[0]).astype(np.int64) + (phi > p.corners[1])
    lengths = leg_lengths(p, phi, segment)
    x, load = obstacle(p, lengths)
    assert (x >= lengths - 1e-9).all()
    assert (load >= -1e-7).all()
    np.testing.assert_allclose(load * (x - lengths), 0.0, atol=1e-12)
    np.testing.assert_allclose(p.kappa * p.neighbours @ x + p.mass * p.g, load, atol=1e-10)


def test_start_is_leg_1_just_touching() -> None:
    p = Parameters()
    state = start(p, [2.0, 1.0, 1.0])
    assert state.contact[0]
    assert state.segment[0] == LANDING
    assert state.phi[0] == pytest.approx(TURN - 0.9 * p.b, abs=1e-15)
    assert state.y[0] == pytest.approx(0.9 * p.b / p.tau, abs=1e-14)
    assert not state.y[1:].any()
    assert not state.v.any()


def test_clamped_ground_never_pulls() -> None:
    # Leg 4 rebounds at 1.6 s, the literal ground then pulls with 230 N.
    psi, times = [3.0, 1.7, 1.0], np.arange(1.59, 1.61, 2e-4)
    pulls = []
    for clamp in (False, True):
        p = Parameters(clamp=clamp)
        pull = 0.0
        for state in multilegged_exact.run(p, psi, 0, times=times.tolist()).samples:
            gap = leg_lengths(p, state.phi, state.segment) - state.x
            rate = p.slopes[state.segment] * (p.omega + state.y)
            force = p.K * gap + p.ground_damper * (rate - state.v)
            pull = min(pull, float(np.where(state.contact & ~state.slack, force, 0.0).min()))
        pulls.append(pull)
    assert pulls[0] < -150.0
    assert pulls[1] >= -1e-6


@pytest.mark.slow
def test_the_file_of_crossings_is_complete_and_reproducible() -> None:
    table = rows("multilegged_crossings.csv")
    for chosen in CROSSING_SETS:
        mine = [row for row in table if row["set"] == chosen.name]
        assert len(mine) == chosen.starts * (chosen.crossings + 1)
        assert json.loads(header_of(chosen.name)) == chosen.changes
        first = [row for row in mine if row["start"] == "0"]
        found = multilegged_exact.run(chosen.parameters, random_starts(chosen.name)[0], 2).crossings
        for row, crossing in zip(first[:3], found, strict=True):
            gap = angles(row, chosen.parameters.N) - crossing.psi
            assert np.abs((gap + np.pi) % TURN - np.pi).max() < 1e-9
            assert float(row["t"]) == pytest.approx(crossing.t, abs=1e-9)
    assert any(row["landed"] == "0" for row in table if row["set"] == "wraps")
    agreed = [float(row["difference"]) for row in table if row["graze"] == "0"]
    assert min(agreed) >= 0.0  # all were compared
    assert max(agreed) < 1e-6
    assert len(agreed) >= 0.95 * len(table)


def header_of(name: str) -> str:
    lines = (FOLDER / "multilegged_crossings.csv").read_text().splitlines()
    (line,) = [line for line in lines if line.startswith(f"# set {name}:")]
    return line.split(", ", 1)[1]


def test_settled_rows_have_settled() -> None:
    table = rows("multilegged_settled.csv")
    assert len(table) == 200
    steps = np.array([float(row["step"]) for row in table])
    assert (steps < 1e-3).mean() >= 0.99


def test_traces_file_has_every_sample() -> None:
    table = rows("multilegged_traces.csv")
    assert len(table) == 150
    p = Parameters()
    mine = [row for row in table if row["start"] == "1"][:10]
    found = multilegged_exact.run(p, angles(mine[0], 3), 0, times=[float(row["t"]) for row in mine]).samples
    for row, state in zip(mine, found, strict=True):
        for name, values in (("x", state.x + p.L), ("v", state.v), ("phi", state.phi), ("y", state.y)):
            listed = [float(row[f"{name}_{i}"]) for i in range(1, 5)]
            np.testing.assert_allclose(listed, values, rtol=0.0, atol=1e-8)
        assert [row[f"contact_{i}"] == "1" for i in range(1, 5)] == state.contact.tolist()
