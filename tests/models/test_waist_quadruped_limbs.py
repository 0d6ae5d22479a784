"""Couplings between all limbs, different fore and hind bodies, and signals of the feet in a cycle."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from reference.waist_quadruped_body import varied
from reference.waist_quadruped_located import landings

from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder, TraceRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import body, mjcf
from gaitsweep.papers.aoi2011.waist_quadruped.rhythm import phase_rates
from gaitsweep.status import Status
from tests.support.sweeping import complete, run_rows, scalars

MODEL = WaistQuadruped()
QUICK = {"T_grow": 0.4, "T_hold": 0.7}  # D and h full after one cycle
PAIRS = [(i, j) for i in range(1, 5) for j in range(1, 5) if i != j]
BODIES = {
    "front_mass": 1.2, "rear_mass": 0.8, "front_length": 0.11, "rear_length": 0.09,
    "front_width": 0.09, "rear_width": 0.105,
}  # fmt: skip


def observed(params: dict[str, float], count: int, numerics: Numerics) -> dict[str, np.ndarray]:
    """The observables (count,) at the first landings of limb 3."""
    recorder = CrossingRecorder(MODEL, crossings=count)
    result = run_rows(
        MODEL, recorder, {"delta_13": np.array([2.9])}, params=params, numerics=numerics, engine="kernel"
    )
    table = result.samples.reshape(count + 1, -1)[1:, 2:]
    return dict(zip((q.name for q in MODEL.observables), table.T, strict=True))


def test_phase_differences_follow_from_three() -> None:
    """Delta*_14 and so on are sums of Delta*_12, Delta*_13 and Delta*_34 unless they are given."""
    p = scalars(MODEL, delta_star_12=3.0, delta_star_13=1.0, delta_star_34=2.5)
    results = [float(p.delta_star[name]) for name in ("14", "23", "24")]
    np.testing.assert_allclose(results, [3.5, -2.0, 0.5], atol=1e-15)
    assert float(scalars(MODEL, delta_star_24=0.3).delta_star["24"]) == 0.3


def test_couplings_of_all_limbs_pull_them_to_the_desired_gait() -> None:
    """The rate of phi_i is omega - sum_j K_ij sin(phi_i - phi_j - Delta*_ij)."""
    rng = np.random.default_rng(0)
    gains = {f"K_{i}{j}": rng.uniform(2.0, 20.0) for i, j in PAIRS}
    p = scalars(MODEL, **gains, delta_star_12=3.0, delta_star_34=2.0, delta_star_13=0.5)
    desired = np.array([0.0, -3.0, -0.5, -2.5])  # of each limb, limb 1's taken off
    phi = rng.uniform(0.0, 6.0, 4)
    wanted = np.full(4, float(p.omega))
    for i, j in PAIRS:
        lead = phi[i - 1] - phi[j - 1] - (desired[i - 1] - desired[j - 1])
        wanted[i - 1] -= gains[f"K_{i}{j}"] * math.sin(lead)
    state: Any = SimpleNamespace(phi=jnp.asarray(phi), held_lead=jnp.asarray(1.5))
    result = phase_rates(p, state, jnp.zeros(()))
    np.testing.assert_allclose(result, wanted, atol=1e-12)


def test_fore_and_hind_bodies_have_masses_and_sizes_of_their_own() -> None:
    values = {name: float(value[0]) for name, value in complete(MODEL, BODIES, 1).items()}
    model = varied(mjcf(), values)
    tree, _ = body()
    result = scalars(MODEL, **BODIES).mechanics.geometry()
    for name in ("front", "rear", "upper_1", "upper_3", "lower_4"):
        i, number = tree.index(name), mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
        assert float(result.mass[i]) == pytest.approx(model.body_mass[number], abs=1e-15)
        np.testing.assert_allclose(np.diag(result.inertia[i]), model.body_inertia[number], atol=1e-15)
        np.testing.assert_allclose(result.com[i], model.body_ipos[number], atol=1e-15)
        if name != "front":
            np.testing.assert_allclose(result.position[i], model.body_pos[number], atol=1e-15)


def test_both_bodies_follow_one_value_unless_they_are_given() -> None:
    of_both = scalars(MODEL, body_mass=1.3, rear_mass=0.9).mechanics
    assert (float(of_both.front_mass), float(of_both.rear_mass)) == (1.3, 0.9)


@pytest.mark.slow
def test_landings_and_feet_are_those_of_a_loop_in_mujoco() -> None:
    """Four cycles with couplings between all limbs and two different bodies: phases, strides, duty factors.

    The loop is written from the model's page alone; touchdowns and lift-offs are located in both.
    """
    gains = {f"K_{i}{j}": 0.1 * (i + 2 * j) for i, j in PAIRS}
    params = {**QUICK, **BODIES, **gains, "delta_star_13": 2.6, "delta_star_34": 3.3}
    result = observed(params, 4, Numerics(dt=1e-4, method="rk4"))
    values = {name: float(value[0]) for name, value in complete(MODEL, params, 1).items()}
    expected = landings(mjcf(), values, 2.9, 4, rtol=1e-9)
    phases = np.array([one.phases for one in expected])
    at = np.array([0.0, *(one.x for one in expected)])
    for name, (i, j) in {"delta_13": (0, 2), "delta_12": (0, 1), "delta_34": (2, 3)}.items():
        np.testing.assert_allclose(
            result[name], np.mod(phases[:, i] - phases[:, j], 2.0 * math.pi), atol=1e-6
        )
    np.testing.assert_allclose(result["stride"], np.diff(at), atol=1e-7)
    for i in range(4):
        np.testing.assert_allclose(result[f"duty_{i + 1}"], [one.duty[i] for one in expected], atol=1e-5)
        assert result[f"touchdowns_{i + 1}"].tolist() == [one.touchdowns[i] for one in expected]


@pytest.mark.slow
@pytest.mark.parametrize(("method", "dt", "near"), [("rk4", 3e-4, 1e-3), ("semi_implicit", 2e-4, 2e-3)])
def test_feet_are_those_of_a_trace(method: str, dt: float, near: float) -> None:
    """Duty factors and touchdowns, summed over 20 cycles, beside the contacts sampled every 0.2 ms."""
    numerics, every, count = Numerics(dt=dt, method=method), 2e-4, 20
    table = observed(QUICK, count, numerics)
    total = float(np.sum(table["period"]))
    recorder = TraceRecorder(MODEL, total, every)
    rows = run_rows(
        MODEL, recorder, {"delta_13": np.array([2.9])}, params=QUICK, numerics=numerics, engine="kernel"
    )
    names = recorder.names
    for i in range(1, 5):
        down = rows.samples[:, names.index(f"contact_{i}")] > 0.5
        stood = float(np.sum(table[f"duty_{i}"] * table["period"]))
        assert abs(stood - np.count_nonzero(down) * every) < near * total
        assert abs(np.sum(table[f"touchdowns_{i}"]) - np.count_nonzero(~down[:-1] & down[1:])) <= 1


@pytest.mark.slow
def test_feet_do_not_decide_whether_a_row_settles() -> None:
    """A walk settles though its feet touch down once in one cycle and twice in the next."""
    recorder = SettleRecorder(MODEL, max_cycles=200, tolerance=1e-3)
    rows = run_rows(
        MODEL, recorder, {"delta_13": np.array([2.33])}, params={"f": 3.2},
        numerics=Numerics(dt=2e-4, method="semi_implicit"), engine="kernel",
    )  # fmt: skip
    np.testing.assert_array_equal(rows.status, Status.settled)
    assert rows.numbers["period"].tolist() == [1]
