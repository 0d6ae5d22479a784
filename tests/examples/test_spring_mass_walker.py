"""The spring-mass walker against its equations in SciPy, and the walking of Geyer et al. 2006."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gaitsweep as gs
from gaitsweep.examples.slip_runner import SlipRunner
from gaitsweep.examples.spring_mass_walker import SpringMassWalker

ALPHA, K, M, L0, G, ENERGY = np.deg2rad(69.0), 14e3, 80.0, 1.0, 9.81, 816.0


def next_apex(x: float, z: float) -> tuple[float, float]:
    """Return the next apex (x, z) of a walking step, from one in single support."""
    stored = 0.5 * K * (L0 - np.hypot(x, z)) ** 2
    state = np.array([x, z, np.sqrt(2.0 * (ENERGY - M * G * z - stored) / M), 0.0])
    reach = None

    def flow(t: float, s: np.ndarray) -> list[float]:
        force = np.array([0.0, -M * G])
        for foot in [0.0] if reach is None else [0.0, reach]:
            leg = np.array([s[0] - foot, s[1]])
            force += K * (L0 - np.hypot(*leg)) * leg / np.hypot(*leg)
        return [s[2], s[3], *(force / M)]

    def until(event: Any, direction: float) -> np.ndarray:
        event.terminal, event.direction = True, direction
        run = solve_ivp(flow, (0.0, 2.0), state, "DOP853", events=event, rtol=1e-12, atol=1e-13)
        return run.y_events[0][0]

    state = until(lambda t, s: s[1] - L0 * np.sin(ALPHA), -1.0)
    reach = state[0] + L0 * np.cos(ALPHA)
    state = until(lambda t, s: np.hypot(s[0], s[1]) - L0, 1.0)
    state, reach = state - np.array([reach, 0.0, 0.0, 0.0]), None
    state = until(lambda t, s: s[3], -1.0)
    return state[0], state[1]


@pytest.mark.slow
def test_a_step_is_that_of_scipy() -> None:
    step = gs.return_map(SpringMassWalker(), numerics={"rtol": 1e-12, "atol": 1e-13})
    starts = np.array([[0.0, 0.96], [0.0, 0.975], [0.03, 0.97], [-0.05, 0.972]])
    points = step.settled({"x_0": starts[:, 0], "z_0": starts[:, 1]}, 0)
    images = step(points).at[:, :2]
    np.testing.assert_allclose(images, [next_apex(x, z) for x, z in starts], atol=1e-9)


@pytest.mark.slow
def test_walking_at_1_1_m_s_is_stable_and_symmetric() -> None:
    """Geyer et al. 2006: at 816 J, 69 degrees and 14 kN/m the mass walks steadily, at about 1.1 m/s."""
    step = gs.return_map(SpringMassWalker())
    walk = step.fixed_points(step.settled({"z_0": 0.97}, 50))
    assert walk.converged[0]
    assert abs(walk.points.at[0, 0]) < 1e-7  # the apex is above the foot
    assert abs(step.multipliers(walk)[0, 0]) < 1.0
    length = walk.images.points.at[0]
    assert next_apex(*walk.points.at[0, :2]) == pytest.approx(tuple(length[:2]), abs=1e-7)
    assert walk.images.observed["v_x"][0] == pytest.approx(1.1, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "low"),
    [(SpringMassWalker(), {"E": 700.0, "z_0": 0.97}), (SlipRunner(), {"speed": 0.5, "z_0": 1.1})],
)
def test_a_start_with_too_little_energy_is_no_fall(model: gs.DeclaredModel, low: dict[str, float]) -> None:
    @jax.jit
    def begun(values: Any, starts: Any) -> tuple[Any, ...]:
        params = model.params(values)
        state = model.init(params, starts)
        return state.v_x, model.without_start(params, state), model.failed(params, state)

    for changed, begins in (({}, True), (low, False)):
        groups = (model.parameters, model.initial_conditions)
        speed, without, failed = begun(*({q.name: changed.get(q.name, q.default) for q in g} for g in groups))
        assert [bool(mask) for mask in without.values()] == [not begins]
        assert bool(np.isfinite(speed)) == begins
        assert not failed


@pytest.mark.slow
def test_walking_ends_where_a_flight_begins() -> None:
    """The symmetric walk ends where the leg above the foot is not loaded; beyond, the events differ."""
    walks = gs.atlas(
        SpringMassWalker(), parameter="E", path=(780.0, 900.0), at=816.0, periods=1, depth=0, budget=128,
        ranges={"x_0": (-0.15, 0.15), "z_0": (0.93, 1.0)}, verify=0,
    )  # fmt: skip
    branches = walks.branches
    number, place = branches["number"].to_numpy(int), branches["x_n"].to_numpy(float)
    symmetric = next(k for k in np.unique(number) if np.abs(place[number == k]).max() < 1e-3)
    energies = branches["E"].to_numpy(float)
    last = {k: np.argmax(np.where(number == k, energies, -np.inf)) for k in np.unique(number).tolist()}
    ends = {k: branches.iloc[int(place)] for k, place in last.items()}
    end = ends.pop(symmetric)
    assert end["end"] == "lost"
    assert end["z_n"] == pytest.approx(L0, abs=1e-4)
    assert end["change"]
    assert walks.points["special"].tolist() == ["neimark_sacker"]
    assert [other["change"] for other in ends.values()] == ["with rear foot lifts off"]
