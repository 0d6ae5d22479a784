"""The papers' quadrupeds on uneven ground: slopes, a loop in MuJoCo C, equality of engines, and refusals."""

from __future__ import annotations

import dataclasses
import functools
import math
import types
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.waist_quadruped_located import landings

import gaitsweep as gs
from gaitsweep.dynamics.random_numbers import fraction
from gaitsweep.engine.kernel import cuda_lanes
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.job import JobError
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from gaitsweep.papers.aoi2011.waist_quadruped.mechanics import WaistMechanics
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import LIMBS, mjcf
from gaitsweep.papers.fukuoka2015.planar_quadruped import PlanarQuadruped
from gaitsweep.status import Status
from tests.support.host_card import HostCard, compiler
from tests.support.sweeping import complete, run_rows, scalars

QUICK = {"T_grow": 0.4, "T_hold": 0.7}  # D and h full after one cycle
SLIPPING = {"swing": "ellipse", "slip": "coulomb", "damping": "rate_error", "heights": "given"}
ANGLE = math.radians(4.0)
COSINE, SINE = math.cos(ANGLE), math.sin(ANGLE)
# From the axes of the even world to those along the slope.
TURN = np.array([[COSINE, 0.0, -SINE], [0.0, 1.0, 0.0], [SINE, 0.0, COSINE]])
PLACE = np.array([3.0, 0.0, 3.0 * SINE / COSINE])  # m, of the even world's origin on the slope
STEPS = Numerics(dt=2e-4, method="semi_implicit")


def on_slope(state: Any) -> Any:
    """A waist quadruped's state on even ground, carried to the slope."""
    w, x, y, z = np.asarray(state.q[3:7])
    a, b = math.cos(0.5 * ANGLE), -math.sin(0.5 * ANGLE)  # about y, nose up
    turned = [a * w - b * y, a * x + b * z, a * y + b * w, a * z - b * x]
    q = jnp.asarray([*(PLACE + TURN @ state.q[:3]), *turned, *state.q[7:]])
    v = jnp.asarray([*(TURN @ state.v[:3]), *state.v[3:]])
    anchor = state.anchor.at[:, 0].set(PLACE[0] + COSINE * state.anchor[:, 0])
    return dataclasses.replace(state, q=q, v=v, anchor=anchor)


def turned_gravity(self: WaistMechanics) -> jax.Array:
    return jnp.stack([-SINE * self.g, 0.0 * self.g, -COSINE * self.g])


@pytest.mark.slow
@pytest.mark.parametrize("structure", [{}, SLIPPING], ids=["held", "slipping"])
def test_a_slope_is_even_ground_with_turned_gravity(structure: dict[str, str]) -> None:
    """Rates, guards and 60 ms of steps: a foot's depth is rounded to 1e-16 m, its stiffness is 4e4 N/m."""
    values = {"mu": 0.05} if structure else {}  # so that feet slip
    even, slope = WaistQuadruped(**structure), WaistQuadruped(**structure, ground="slope")
    flat, steep = scalars(even, **values), scalars(slope, **values, ground_slope=4.0)

    def after(model: WaistQuadruped, params: Any, state: Any) -> Any:
        steps = model.fixed_step_scheme()
        one = lambda s, _: (steps.step(params, s, jnp.asarray(2e-4)), None)  # noqa: E731
        return jax.jit(lambda s: jax.lax.scan(one, s, None, length=300)[0])(state)

    start = even.init(flat, {"delta_13": jnp.asarray(2.9)})
    start = dataclasses.replace(start, v=start.v.at[0].set(0.1))
    climbed = after(slope, steep, on_slope(start))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(WaistMechanics, "gravity", turned_gravity)
        walked = after(even, flat, start)
        rates, guards = jax.jit(lambda s: (even.flow(flat, s), even.guards(flat, s)))(walked)
    expected = on_slope(walked)
    np.testing.assert_array_equal(climbed.contact, expected.contact)
    for name in ("q", "anchor", "phi", "height"):
        np.testing.assert_allclose(getattr(climbed, name), getattr(expected, name), atol=1e-10, err_msg=name)
    np.testing.assert_allclose(climbed.v, expected.v, atol=1e-8)
    uphill, heights = jax.jit(lambda s: (slope.flow(steep, s), slope.guards(steep, s)))(expected)
    np.testing.assert_allclose(heights, guards, atol=1e-15)
    np.testing.assert_allclose(uphill["v"][:3], TURN @ rates["v"][:3], atol=1e-7)
    np.testing.assert_allclose(uphill["v"][3:], rates["v"][3:], atol=1e-7)
    if structure:
        assert np.abs(rates["anchor"]).max() > 0.01
        np.testing.assert_allclose(uphill["anchor"], rates["anchor"] * np.array([[COSINE, 1.0]]), atol=1e-10)


@pytest.mark.slow
def test_the_ground_pushes_across_the_plane_at_the_touchdown_point() -> None:
    """Without dampers the force is the slope of the springs' energy, and no load acts along the ground."""
    values = {"D_TL": 0.0, "D_N": 0.0, "ground_roughness": 0.01, "ground_seed": 4.0, "ground_width": 0.1}
    m = scalars(WaistQuadruped(ground="rough"), **values).mechanics
    anchor = jnp.array([[0.13, 0.0], [0.21, 0.1], [0.34, -0.1], [-0.2, 0.0]])
    ground = m.ground
    assert ground is not None
    x, span = anchor[:, 0], 1e-6
    rise = (ground(x + span) - ground(x - span)) / (2.0 * span)
    assert np.abs(rise[:3]).min() > 0.02
    point = jnp.stack([x, anchor[:, 1], ground(x)], axis=1)
    at = point + jnp.array([[3e-4, -2e-4, -5e-4]])
    forces = m.ground_forces(at, jnp.zeros((4, 3)), anchor, jnp.ones(4, bool))
    for i in LIMBS:
        along = np.array([1.0, 0.0, rise[i]]) / np.hypot(1.0, rise[i])
        across = np.array([-rise[i], 0.0, 1.0]) / np.hypot(1.0, rise[i])
        sunk = np.asarray(at[i] - point[i])
        expected = -float(m.K_TL) * (along @ sunk * along + [0.0, sunk[1], 0.0])
        expected -= float(m.K_N) * (across @ sunk) * across
        np.testing.assert_allclose(forces[i].force, expected, atol=1e-8)
    np.testing.assert_allclose(m.heights(point), 0.0, atol=1e-17)
    pressed = m.ground_forces(point - 1e-3 * ground.normal(x), jnp.zeros((4, 3)), anchor, jnp.ones(4, bool))
    np.testing.assert_allclose([one.force for one in pressed], 1e-3 * m.K_N * ground.normal(x), atol=1e-9)


# ---- against a loop in MuJoCo C ---------------------------------------------------------------------------


def observed(
    model: WaistQuadruped, params: dict[str, float], count: int, numerics: Numerics
) -> dict[str, np.ndarray]:
    """The observables (count,) at the first landings of limb 3."""
    recorder = CrossingRecorder(model, crossings=count)
    result = run_rows(model, recorder, {"delta_13": np.array([2.9])}, params=params, numerics=numerics)
    np.testing.assert_array_equal(result.status, Status.complete)
    table = result.samples.reshape(count + 1, -1)[1:, 2:]
    return dict(zip((q.name for q in model.observables), table.T, strict=True))


@functools.cache
def drawn_height(seed: float, number: int) -> float:
    """The normal number at a multiple of the width, in NumPy."""
    u, v = (float(fraction(seed, float(number), 0.0, half)) for half in (0, 1))
    return math.sqrt(-2.0 * math.log(u)) * math.cos(2.0 * math.pi * v) if number > 0 else 0.0


def rough(x: float, seed: float, roughness: float, width: float) -> float:
    """The height of `rough` ground in NumPy."""
    index, share = math.floor(x / width), x / width - math.floor(x / width)
    behind, ahead = drawn_height(seed, index), drawn_height(seed, index + 1)
    return roughness * (behind + (ahead - behind) * share**2 * (3.0 - 2.0 * share))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["slope", "rough and slip"])
def test_landings_are_those_of_a_loop_in_mujoco(kind: str) -> None:
    """Two cycles, events located in both; tolerances are those of even ground."""
    drawn = {"ground_seed": 3.0, "ground_roughness": 0.002, "ground_width": 0.04}
    extra = {"ground_slope": 2.0} if kind == "slope" else drawn
    structure = {"swing": "ellipse", "slip": "coulomb"} if "slip" in kind else {}
    model = WaistQuadruped(ground=kind.split(" ", 1)[0], **structure)
    params = {**QUICK, **extra, **({"mu": 0.3, "T_slip": 5e-4} if structure else {})}
    result = observed(model, params, 2, Numerics(dt=1e-4, method="rk4"))

    def ground(x: float) -> float:
        if kind == "slope":
            return math.tan(math.radians(2.0)) * max(x, 0.0)
        return rough(x, *drawn.values())

    values = {name: float(value[0]) for name, value in complete(model, params, 1).items()}
    expected = landings(mjcf(), values, 2.9, 2, rtol=1e-9, swing=model.swing, slip=model.slip, ground=ground)
    near = 1e-5 if structure else 1e-6
    phases = np.array([one.phases for one in expected])
    for name, (i, j) in {"delta_13": (0, 2), "delta_12": (0, 1), "delta_34": (2, 3)}.items():
        np.testing.assert_allclose(
            result[name], np.mod(phases[:, i] - phases[:, j], 2.0 * math.pi), atol=near
        )
    np.testing.assert_allclose(result["period"], np.diff([0.0, *(one.time for one in expected)]), atol=near)
    np.testing.assert_allclose(result["stride"][1:], np.diff([one.x for one in expected]), atol=near)
    even = observed(WaistQuadruped(**structure), params, 2, STEPS)
    assert np.abs(result["delta_13"] - even["delta_13"]).max() > 1e-3  # the ground is felt


# ---- even parts of uneven ground --------------------------------------------------------------------------

MODELS = {"waist": WaistQuadruped, "planar": PlanarQuadruped}
STARTS = {"waist": {"delta_13": np.array([2.9])}, "planar": {"seed": np.array([3.0])}}
FEW = {"waist": QUICK, "planar": {}}
STEP_AHEAD = "profile 0.0 0.0 1.5 0.0 1.52 0.02"  # 2 cm, 1.5 m ahead


def crossed(
    name: str, ground: str, count: int, *, engine: str = "kernel", lanes: int = 8, **params: Any
) -> np.ndarray:
    """Time and observables at the first section crossings of rows, (rows, count, 1 + observables)."""
    model = MODELS[name](ground=ground)
    rows = max(np.size(value) for value in (0.0, *params.values()))
    result = run_rows(
        model,
        CrossingRecorder(model, crossings=count),
        {key: np.repeat(value, rows) for key, value in STARTS[name].items()},
        params={**FEW[name], **params},
        numerics=STEPS if name == "waist" else Numerics(),
        engine=engine,
        lanes=lanes,
    )
    return result.samples[:, 1:].reshape(rows, count + 1, -1)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), [("waist", 4), ("planar", 4)])
def test_even_parts_of_uneven_ground_are_even_ground(name: str, count: int) -> None:
    """Roughness 0, and ground before a step far ahead, to rounding that has grown over some landings."""
    even = crossed(name, "even", count)
    for ground, values in (("rough", {}), ("steps", {}), (STEP_AHEAD, {})):
        np.testing.assert_allclose(crossed(name, ground, count, **values), even, atol=1e-7, err_msg=ground)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["waist", "planar"])
def test_engines_meet_the_same_ground(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel of a CPU, XLA, and a card's program in C for this processor: rounding, grown by landings."""
    rows = {"ground_seed": np.arange(3.0), "ground_roughness": 0.02, "ground_width": 0.2}
    here = crossed(name, "rough", 4, **rows)
    assert np.ptp(here[:, -1], axis=0).max() > 1e-3  # the rows differ
    np.testing.assert_array_equal(crossed(name, "rough", 4, lanes=2, **rows), here)
    np.testing.assert_allclose(crossed(name, "rough", 4, engine="xla", **rows), here, rtol=1e-6, atol=1e-6)
    if compiler() is None:
        return

    class CudaDevice(HostCard):
        folder = tmp_path

    monkeypatch.setattr(cuda_lanes, "CudaDevice", CudaDevice)
    device = types.SimpleNamespace(platform="gpu")
    monkeypatch.setattr("tests.support.sweeping.devices_on", lambda platform, engine: [device])
    np.testing.assert_allclose(crossed(name, "rough", 4, **rows), here, rtol=1e-6, atol=1e-6)


# ---- falls and refusals -----------------------------------------------------------------------------------


def test_a_planar_quadruped_has_fallen_where_its_hips_are_on_the_ground() -> None:
    model = PlanarQuadruped(ground="slope")
    p = scalars(model, ground_slope=20.0)
    even = scalars(PlanarQuadruped())
    standing = float(p.mechanics.l_0 + p.motors.l_st)
    start = model.init(p, {"seed": jnp.asarray(0.0), "scatter": jnp.asarray(0.0), "pair": jnp.asarray(0.0)})
    assert not model.failed(p, start)

    def fallen(x: float, clearance: float, pitch: float) -> tuple[bool, bool]:
        """Whether it has fallen on the slope and on even ground."""
        height = math.tan(math.radians(20.0)) * max(x, 0.0)
        on_uneven = dataclasses.replace(
            start, q=start.q.at[:3].set(jnp.array([x, height + clearance, pitch]))
        )
        on_even = dataclasses.replace(start, q=on_uneven.q.at[1].set(clearance))
        return bool(model.failed(p, on_uneven)), bool(PlanarQuadruped().failed(even, on_even))

    assert fallen(3.0, 0.9 * standing, math.radians(-20.0)) == (False, False)
    assert fallen(3.0, 0.4 * standing, math.radians(-20.0)) == (True, True)
    # nose down on ground that rises: the fore hips are on it
    assert fallen(3.0, 0.6 * standing, math.radians(20.0)) == (True, False)


@pytest.mark.parametrize("model", ["waist_quadruped", "planar_quadruped"])
def test_ground_in_jobs(model: str) -> None:
    job = {"name": "g", "model": model, "run": {"kind": "fixed_time", "duration": 1.0}}
    even = gs.Job.model_validate(job)
    assert gs.Job.model_validate({**job, "ground": "even"}).hash() == even.hash()
    assert "ground" not in even.resolved().get("structure", {})
    with pytest.raises(JobError, match="ground_seed"):
        gs.Job.model_validate({**job, "vary": {"ground_seed": [1.0]}})
    drawn = gs.Job.model_validate({**job, "ground": "rough", "vary": {"ground_seed": [1.0, 2.0]}})
    assert drawn.hash() != even.hash()
    with pytest.raises(JobError, match=r"ground_seed.* is 0\.5 .*a whole number"):
        gs.Job.model_validate({**job, "ground": "rough", "vary": {"ground_seed": {"linspace": [0, 2, 5]}}})
    with pytest.raises(JobError, match=r"stps.*did you mean steps"):
        gs.Job.model_validate({**job, "ground": "stps"})


def test_no_fixed_point_of_the_waist_quadruped_is_sought_on_rough_ground() -> None:
    run = {"kind": "continuation", "parameter": "f", "path": [2.0, 3.0]}
    with pytest.raises(JobError, match="no step repeats another"):
        gs.Job.model_validate({"name": "g", "model": "waist_quadruped", "ground": "rough", "run": run})
    with pytest.raises(gs.ArgumentError, match="no step repeats another"):
        gs.return_map(WaistQuadruped(ground="steps")).fixed_points([0.0] * 46)
