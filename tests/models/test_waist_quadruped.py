"""The quadruped with a waist joint against its paper and its model's page, and its parts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from gaitsweep.papers.aoi2011.waist_quadruped.kinematics import (
    BEYOND,
    EARLY,
    LATE,
    STANCE,
    WAIST,
    FootPath,
    has_fallen,
    joint_angles,
    tilt,
)
from gaitsweep.papers.aoi2011.waist_quadruped.mechanics import anchored_force
from gaitsweep.status import Status
from tests.support.multilegged_crossings import wrapped
from tests.support.sweeping import run_rows

MODEL = WaistQuadruped()
STEPS = Numerics(dt=2e-4, method="semi_implicit")
LOCATED = Numerics(dt=3e-4, method="rk4")


def crossings(
    starts: Sequence[float] | np.ndarray,
    count: int = 100,
    *,
    params: Mapping[str, Any] | None = None,
    numerics: Numerics = STEPS,
    engine: str = "kernel",
) -> np.ndarray:
    """The observables at `count` landings of limb 3, (rows, count + 1, observables)."""
    recorder = CrossingRecorder(MODEL, crossings=count)
    result = run_rows(
        MODEL, recorder, {"delta_13": starts}, params=params or {}, numerics=numerics, lanes=16, engine=engine
    )
    np.testing.assert_array_equal(result.status, Status.complete)
    return result.samples.reshape(len(starts), count + 1, -1)[:, :, 2:]


@pytest.fixture(scope="module")
def gaits() -> dict[tuple[float, float], np.ndarray]:
    """Observables at the last landing from a walk and a trot start, by stiffness and start."""
    pairs = [(f, start) for f in (2.0, 2.6, 3.2) for start in (2.2, 3.0)]
    f, starts = (np.array(column) for column in zip(*pairs, strict=True))
    return dict(zip(pairs, crossings(starts, params={"f": f})[:, -1], strict=True))


@pytest.mark.slow("2.0-2.2-2.87")
@pytest.mark.parametrize(
    ("f", "start", "delta_13"),
    [
        (2.0, 2.2, 2.87),
        (2.0, 3.0, 2.87),
        (2.6, 2.2, 2.37),
        (2.6, 3.0, 2.81),
        (3.2, 2.2, 2.33),
        (3.2, 3.0, 2.33),
    ],
)
def test_both_branches_are_where_the_page_has_them(gaits, f: float, start: float, delta_13: float) -> None:
    """Within 0.02: trot alone at 2.0, both at 2.6, walk alone at 3.2."""
    assert abs(gaits[f, start][0] - delta_13) < 0.02


def test_the_walking_speed_is_the_papers(gaits) -> None:
    """Eq. (3) gives 0.187 m/s for feet without slip and lag; the lag of the PD control reduces it."""
    last = np.array(list(gaits.values()))
    assert np.all(np.abs(last[:, 1:3] - math.pi) < 0.02), "left and right limbs are half a turn apart"
    assert np.all((last[:, 3] > 0.172) & (last[:, 3] < 0.184))
    np.testing.assert_allclose(last[:, 4], 0.4, atol=0.002)


@pytest.mark.slow
def test_gaits_are_labelled_and_rows_settle() -> None:
    recorder = SettleRecorder(MODEL, max_cycles=200, tolerance=1e-3)
    starts = {"delta_13": np.array([2.2, 3.0])}
    result = run_rows(MODEL, recorder, starts, numerics=STEPS, lanes=16, engine="kernel")
    assert [MODEL.gaits[g] for g in result.labels["gait"]] == ["walk", "trot"]
    np.testing.assert_array_equal(result.status, Status.settled)


@pytest.mark.slow
def test_no_row_settles_before_T_hold() -> None:
    """At beta = 0.6 a start at 2.0 is constant until T_hold, and then leaves for a pace."""
    recorder = SettleRecorder(MODEL, max_cycles=200, tolerance=1e-3)
    result = run_rows(
        MODEL, recorder, {"delta_13": np.array([2.0])}, params={"beta": 0.6}, numerics=STEPS, engine="kernel"
    )
    assert result.t_end[0] > 7.0 + 10 * 0.25
    assert wrapped(result.last[0, 0] - 2.0) > 1.0


@pytest.mark.slow
def test_without_phase_resetting_delta_13_is_neutral() -> None:
    """Nothing then couples fore and hind limbs: each start keeps the phase difference that it was held at."""
    seen = crossings(np.array([1.8, 2.4, 3.0]), 60, params={"resetting": 0.0})
    drift = wrapped(seen[:, -1, 0] - seen[:, 25, 0])
    assert drift.max() < 1e-9
    assert wrapped(seen[:, -1, 0] - [1.8, 2.4, 3.0]).max() < 1e-3


@pytest.mark.slow
def test_only_the_waists_stiffness_and_damping_know_of_kappa_0_and_f() -> None:
    """kappa_0 f^2 and zeta_0 kappa_0 f alike, eq. (8): the same motion to rounding."""
    scale = np.array([1.0, 1.7])
    params = {"f": 2.6 / np.sqrt(scale), "kappa_0": 0.042 * scale, "zeta_0": 1.0 / np.sqrt(scale)}
    seen = crossings(np.array([2.2, 2.2]), 12, params=params)
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-8)


@pytest.mark.slow
def test_fixed_steps_agree_on_both_engines() -> None:
    starts = np.array([2.2, 3.0])
    params = {"T_grow": 0.2, "T_hold": 0.3}
    kernel = crossings(starts, 2, params=params)
    xla = crossings(starts, 2, params=params, engine="xla")
    np.testing.assert_allclose(kernel, xla, atol=1e-9)


@pytest.mark.slow
def test_located_events_and_small_steps_agree() -> None:
    """RK4 with located events against itself at a third of the step, and against semi-implicit Euler."""
    starts = np.array([2.2, 3.0])
    exact = crossings(starts, 60, numerics=Numerics(dt=1e-4, method="rk4"))
    located = crossings(starts, 60, numerics=LOCATED)
    assert wrapped(located[..., 0] - exact[..., 0])[:, :10].max() < 1e-5
    assert wrapped(located[..., 0] - exact[..., 0])[:, -1].max() < 1e-5
    errors = [
        wrapped(crossings(starts, 40, numerics=Numerics(dt=dt, method="semi_implicit"))[:, 2:12, 0]
                - exact[:, 2:12, 0]).mean()
        for dt in (2e-4, 5e-5)
    ]  # fmt: skip
    assert errors[1] < 0.4 * errors[0], "first order"
    assert errors[0] < 0.005


@pytest.mark.slow
def test_where_trot_and_walk_are_lost() -> None:
    """By holds of 120 s with located events: intervals of 0.02 that hold the edges, 2.345 and 2.85."""
    f = np.array([2.335, 2.355, 2.84, 2.86])
    starts = np.array([2.37, 2.37, 2.83, 2.83])
    last = crossings(starts, 318, params={"f": f}, numerics=LOCATED)[:, -1, 0]
    assert last[0] > 2.8, "walk lost"
    assert last[1] < 2.5, "walk kept"
    assert 2.7 < last[2] < 2.8, "trot kept"
    assert last[3] < 2.4, "trot lost"


def test_tilt_and_falls_are_those_of_the_front_bodys_axes() -> None:
    """Roll and pitch against SciPy's rotations (intrinsic z, y, x); height, tilt or twist make it fall."""
    quaternions = np.random.default_rng(3).normal(size=(40, 4))  # not of length 1, as after many steps
    for w, x, y, z in quaternions:
        q = jnp.zeros(16).at[3:7].set(jnp.array([w, x, y, z]))
        _, pitch, roll = Rotation.from_quat([x, y, z, w]).as_euler("ZYX")
        np.testing.assert_allclose(tilt(q), [roll, pitch], atol=1e-12)
        over = abs(roll) > 1.2 or abs(pitch) > 1.2
        assert bool(has_fallen(q.at[2].set(0.13), jnp.asarray(0.133))) == over
    upright = jnp.zeros(16).at[2].set(0.13).at[3].set(1.0)
    assert not has_fallen(upright, jnp.asarray(0.133))
    assert has_fallen(upright.at[2].set(0.05), jnp.asarray(0.133))
    assert has_fallen(upright.at[WAIST].set(-1.6), jnp.asarray(0.133))


def test_inverse_kinematics_of_a_limb() -> None:
    x, z = np.random.default_rng(0).uniform(-0.05, 0.05, 50), -np.random.default_rng(1).uniform(0.1, 0.15, 50)
    for bend in (1.0, -1.0):
        hip, knee = joint_angles(jnp.array(x), jnp.array(z), 0.08, bend)
        assert np.all(np.sign(knee) == bend)
        np.testing.assert_allclose(-0.08 * (np.sin(hip) + np.sin(hip + knee)), x, atol=1e-15)
        np.testing.assert_allclose(-0.08 * (np.cos(hip) + np.cos(hip + knee)), z, atol=1e-15)


def test_a_foot_out_of_reach_is_aimed_at() -> None:
    hip, knee = joint_angles(jnp.asarray(0.0), jnp.asarray(-0.2), 0.08, 1.0)
    assert float(hip) == pytest.approx(0.0)
    assert float(knee) == 0.0
    # aimed lower and farther ahead the limb stays straight, and turns
    _, (turn, bend) = jax.jvp(lambda x: joint_angles(x, jnp.asarray(-0.2), 0.08, 1.0), (0.0,), (1.0,))
    assert (float(turn), float(bend)) == (pytest.approx(-5.0), 0.0)


def test_the_ground_is_a_spring_and_a_damper() -> None:
    at, speed, anchor = jnp.array([0.1, 0.2, -1e-4]), jnp.array([0.0, 0.1, 0.3]), jnp.array([0.099, 0.2])
    ground = jnp.full(3, 3.6e4), jnp.full(3, 175.0)
    free = anchored_force(at, speed, anchor, jnp.asarray(True), *ground)
    np.testing.assert_allclose(free, [-36.0, -17.5, 3.6 - 52.5], rtol=1e-12)
    clamped = anchored_force(at, speed, anchor, jnp.asarray(True), *ground, clamp=1.0)
    np.testing.assert_allclose(clamped, [-36.0, -17.5, 0.0], rtol=1e-12)
    assert not np.any(anchored_force(at, speed, anchor, jnp.asarray(False), *ground))


@pytest.mark.slow
def test_the_path_of_a_foot_is_continuous() -> None:
    """Segments join, and a swing begins at rest on its path."""
    aep, end = 0.5 * math.pi, 2.0 * math.pi
    phi_AEP, x_c, D, H, h, dip, ease = jnp.array([aep, -0.0008, 0.056, 0.133, 0.0393, 0.009, 1.0])
    path = FootPath(phi_AEP, x_c, D, H, h, dip, ease)
    landing = (path.PEP + path.D, -path.H)

    def foot(phi: float, segment: int) -> np.ndarray:
        return np.array(path.target(jnp.asarray(phi), jnp.asarray(segment), landing))

    np.testing.assert_allclose(foot(0.5 * aep, EARLY), foot(0.5 * aep, LATE), atol=1e-15)
    np.testing.assert_allclose(foot(aep, LATE), foot(aep, STANCE), atol=1e-15)
    np.testing.assert_allclose(foot(aep, LATE), foot(aep, BEYOND), atol=1e-15)
    np.testing.assert_allclose(foot(end, STANCE), foot(0.0, EARLY), atol=1e-15)
    np.testing.assert_allclose(foot(end, BEYOND), foot(0.0, EARLY), atol=1e-15)
    np.testing.assert_allclose(foot(0.5 * aep, EARLY)[1], -0.133 + 0.0393, atol=1e-15)
    slope = jax.jacfwd(lambda phi: jnp.stack(path.target(phi, jnp.asarray(EARLY), landing)))(0.0)
    np.testing.assert_allclose(slope, 0.0, atol=1e-12)
