"""The quadruped's tree and its body in MJX against a loop in MuJoCo C that has a controller of its own."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from reference.waist_quadruped_mujoco import Landing, landings

from gaitsweep.engine.advance import advance
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.solver.methods import refusal
from gaitsweep.engine.sweep.engine_choice import EngineError, choose
from gaitsweep.job import Job, JobError, load_job
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from gaitsweep.papers.aoi2011.waist_quadruped.kinematics import STANCE
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import mjcf
from gaitsweep.status import Status
from tests.support.sweeping import complete, run_rows

DT = 2e-4
# A quick start: D and h full after one cycle, the gait let go of before the third.
START = {"T_grow": 0.4, "T_hold": 0.7}
DELTA_13 = 2.9  # at pi it would be rounding that decides whether limb 2 starts in stance
DURATION = 4.45  # s, in which each limb lands ten times and more


def params_of(model: WaistQuadruped, **values: float) -> Any:
    columns = model.on_host(complete(model, values, 1))
    return model.params({name: jnp.asarray(column[0]) for name, column in columns.items()})


def landings_of(body: str) -> list[Landing]:
    """All landings of the model, read from its states as the reference gives them."""
    model = WaistQuadruped(body)
    steps, params = model.fixed_step_scheme(), params_of(model, **START)

    @jax.jit
    def run(params: Any, start: Any) -> Any:
        def step(state: Any, _: Any) -> Any:
            after = steps.step(params, state, jnp.asarray(DT))
            return after, (after.phi - after.gain, after.segment, state.clock)

        state = model.init(params, {"delta_13": start})
        return jax.lax.scan(step, state, length=round(DURATION / DT))[1]

    phases, segment, clock = (np.asarray(a) for a in run(params, DELTA_13))
    standing = segment == STANCE
    step, limb = np.nonzero(standing[1:] & ~standing[:-1])
    over = phases[step + 1, limb] - float(params.phi_AEP)
    times = clock[step + 1] - over / float(params.omega)
    return [Landing(int(i), t, phases[k + 1]) for i, t, k in zip(limb, times, step, strict=True)]


@cache
def expected() -> list[Landing]:
    model = mujoco.MjModel.from_xml_string(mjcf())
    return landings(model, DURATION, delta_13=DELTA_13, **START)


def check(found: list[Landing]) -> None:
    """The first ten landings of each limb: times and all phases within 1e-9 rad.

    The bodies agree to 1e-13 there, while a landing read wrongly inside its step shows at 1e-5.
    """
    omega = 5.0 * math.pi
    for limb in range(4):
        mine, theirs = ([one for one in many if one.limb == limb][:10] for many in (found, expected()))
        assert len(mine) == len(theirs) == 10
        near([one.time * omega for one in mine], [one.time * omega for one in theirs])
        near([one.phases for one in mine], [one.phases for one in theirs])


def near(mine: Any, theirs: Any) -> None:
    np.testing.assert_allclose(mine, theirs, rtol=0.0, atol=1e-9)


@pytest.mark.slow
def test_the_tree_lands_as_in_mujoco() -> None:
    check(landings_of("tree"))


@pytest.mark.slow
def test_mjx_lands_as_in_mujoco() -> None:
    check(landings_of("mjx"))


@pytest.mark.slow
def test_masses_that_vary_from_row_to_row() -> None:
    """Through the engine, in blocks of two rows and as few lanes, which are therefore filled again."""

    values = {"body_mass": np.array([0.95, 1.0, 1.05, 1.1, 0.9]), "link_length": np.linspace(0.079, 0.083, 5)}

    def found(body: str) -> Any:
        model = WaistQuadruped(body)
        return run_rows(
            model,
            CrossingRecorder(model, crossings=3),
            {"delta_13": np.full(5, DELTA_13)},
            params={**START, **values},
            numerics=Numerics(dt=DT, method="semi_implicit"),
            lanes=2,
            block=2,
            engine="xla" if body == "mjx" else "kernel",
        )

    tree, mjx = found("tree"), found("mjx")
    assert tree.status.tolist() == mjx.status.tolist() == [Status.complete] * 5
    near(mjx.samples, tree.samples)
    assert np.ptp(tree.last[:, 0]) > 1e-3  # the rows do differ


@pytest.mark.slow
def test_a_mass_that_moves_while_a_row_runs_becomes_nan_instead_of_stale() -> None:
    model = WaistQuadruped("mjx")
    columns = model.on_host(complete(model, {}, 1))
    values = {name: jnp.asarray(column[0]) for name, column in columns.items()}
    assert all(bool(jnp.isfinite(field).all()) for field in model.params(values).mechanics.numbers.values())
    moved = model.params({**values, "front_mass": jnp.asarray(1.001)}).mechanics.numbers
    assert all(bool(jnp.isnan(field).all()) for field in moved.values())
    # enough for the period, not for a step
    bare = model.params({name: values[name] for name in complete(model, {}, 1)})
    assert float(model.period(bare)) == pytest.approx(0.4)
    with pytest.raises(ValueError, match="on_host"):
        model.fixed_step_scheme().step(
            bare, model.init(bare, {"delta_13": jnp.asarray(3.0)}), jnp.asarray(DT)
        )


def test_mjx_has_steps_alone() -> None:
    model = WaistQuadruped("mjx")
    assert refusal("semi_implicit", model, "float64") is None
    assert refusal("rk4", WaistQuadruped(), "float64") is None
    assert refusal("rk4", model, "float64") == (
        "is rk4, which needs a flow, but waist_quadruped has only steps with body mjx. "
        "Allowed: semi_implicit."
    )
    with pytest.raises(ValueError, match=r"method is rk4, which needs a flow"):
        advance(model, Numerics(method="rk4").resolve(model))


def test_mjx_is_left_to_xla() -> None:
    model, device = WaistQuadruped("mjx"), jax.local_devices()[0]
    numerics = Numerics(dt=DT, method="semi_implicit").resolve(model)
    how = model, CrossingRecorder(model, 3), numerics, None
    engine, note = choose("auto", device, *how)
    assert engine == "xla"
    assert note is not None
    assert "computes on the host with front_mass, " in note
    with pytest.raises(EngineError, match="Allowed here: auto, xla"):
        choose("kernel", device, *how)


def job(**changed: Any) -> Job:
    fields = {
        "name": "mjx",
        "model": "waist_quadruped",
        "structure": {"body": "mjx"},
        "run": {"kind": "settle"},
        "numerics": {"method": "semi_implicit", "dt": DT},
    }
    return Job(**(fields | changed))


def test_bodies_in_jobs() -> None:
    assert job().design.model == WaistQuadruped("mjx")
    assert job(structure={}).design.model == WaistQuadruped("tree")
    assert job().hash() != job(structure={}).hash()
    with pytest.raises(JobError, match=r"numerics\.method is rk4, .* body mjx\. Allowed: semi_implicit"):
        job(numerics={"method": "rk4"})
    with pytest.raises(JobError, match=r'structure\.body is "mjy"; did you mean mjx\? Allowed: tree, mjx'):
        job(structure={"body": "mjy"})
    with pytest.raises(ValueError, match=r"body is 'tre'; did you mean tree\? Allowed: tree, mjx"):
        WaistQuadruped("tre")


def test_constants_of_a_compiled_body_cannot_vary(tmp_path: Path) -> None:
    job = tmp_path / "job.yaml"
    job.write_text(
        "name: r\nmodel: waist_quadruped\nstructure: {body: mjx}\nvary: {delta_13: [2.2]}\n"
        "run: {kind: ramp, parameter: body_mass, path: [1.0, 1.1], rate: 0.01}\n"
        "numerics: {method: semi_implicit, dt: 2.0e-4}\n"
    )
    with pytest.raises(JobError, match=r"is body_mass, with which front_mass moves: .* cannot move"):
        load_job(job)
