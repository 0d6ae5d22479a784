"""A model from an MJCF against MuJoCo's simulation in C, and its refusals."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.examples.mujoco_hopper import MujocoHopper
from gaitsweep.runs.prepare import prepare

DT, OMEGA, SIGMA, STROKE = 1e-3, 15.0, 0.1, 0.03
TEXT = (Path(gs.__file__).parent / "examples" / "mujoco_hopper.xml").read_text()


def in_c(height: float, steps: int) -> np.ndarray:
    """phi, qpos and qvel after each step of MuJoCo C: the oscillator by Euler, feedback of the last load."""
    model = mujoco.MjModel.from_xml_string(TEXT)
    data = mujoco.MjData(model)
    data.qpos[0], phi, load, found = height, 1.0, 0.0, []
    for _ in range(steps):
        data.ctrl[0] = -STROKE * np.sin(phi)
        phi += DT * (OMEGA - SIGMA * load * np.cos(phi))
        mujoco.mj_step(model, data)
        load = data.sensordata[0]  # of the step's beginning, as in MJX
        phi -= 2.0 * np.pi * (phi >= 2.0 * np.pi)
        found.append([phi, *data.qpos, *data.qvel])
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(("dynamics", "within"), [("mujoco", 1e-10), ("mjx", 1e-5)])
def test_steps_are_mujocos_in_c(dynamics: str, within: float) -> None:
    """Through landings: MJX's solver of contacts ends at 1e-8, and each landing enlarges what differs."""
    trace = gs.simulate(
        MujocoHopper(dynamics=dynamics), height_0=0.05, duration=0.6, every=DT, numerics={"dt": DT}
    )
    true = in_c(0.05, 600)
    landed = np.diff(true[:, 3]) > 0.02
    assert landed.any()
    result = trace[["phi", "q_0", "q_1"]].to_numpy()[1:]
    before = int(np.flatnonzero(landed)[0])
    np.testing.assert_allclose(result[:before], true[:before, :3], rtol=0, atol=1e-10)
    np.testing.assert_allclose(result, true[:, :3], rtol=0, atol=within)


@pytest.mark.slow
def test_a_slope_between_landings_at_two_steps_is_not_the_maps() -> None:
    """Why MjcfModel has no derivative: the one of its steps is wrong in sign, and shorter steps do not help.

    Speed by height at the section: a straight line over 2 cm, where a landing moves by tens of steps, does
    not depend on the step. Each of the 60 images is off by up to what the landing moves in a step.
    """
    maps = [gs.return_map(MujocoHopper(), numerics={"dt": dt}) for dt in (DT, 0.5 * DT)]
    x = maps[0].settled({"height_0": 0.1}, 30).at[0]
    lines, pieces = [], []
    for hop in maps:
        at, to = (hop.coordinates.index(name) for name in ("body_q_1", "body_v_1"))
        moved = np.concatenate([np.linspace(-0.01, 0.01, 60), [-1e-7, 1e-7]])
        speed = hop(x + np.outer(moved, np.eye(x.size)[at]))[:, to]
        lines.append(np.polyfit(moved[:-2], speed[:-2], 1)[0])
        pieces.append((speed[-1] - speed[-2]) / 2e-7)
    np.testing.assert_allclose(lines, 2.1, rtol=0.1)  # 1/s; 2.05 at a quarter of the step
    np.testing.assert_allclose(pieces, -7.7, rtol=0.05)
    with pytest.raises(gs.ArgumentError, match=r"no derivative: .* fit a straight line through the images"):
        maps[1].jacobian(x)


@pytest.mark.slow
def test_a_turn_is_a_cycle_and_starts_are_the_joints() -> None:
    model = MujocoHopper()
    starts = ["phi_0", "height_0", "height_rate_0", "leg_0", "leg_rate_0"]
    assert [q.name for q in model.initial_conditions] == starts
    rows = gs.sweep(model, height_0=[0.0, 0.1], run=gs.ReturnMap(crossings=3), sigma=0.0).table
    t = rows["t"].to_numpy().reshape(2, 4)[:, 1:]
    # turns of constant frequency, detected at the end of a step
    turns = (2.0 * np.pi * np.arange(1, 4) - 1.0) / OMEGA
    assert ((t - turns > -1e-9) & (t - turns < 2.0 * DT)).all()


EDITED = """\
import gaitsweep as gs
import jax.numpy as jnp


class Edited(gs.MjcfModel):
    body_file = "body.xml"
    omega = gs.parameter("rad/s", "frequency", 1.0)
    phi = gs.variable("rad", "phase", 0.0)

    def control(self, p, s):
        return jnp.zeros(1)

    def period(self, p):
        return 1.0 + 0.0 * p.omega
"""


def made(xml: str, **members: object) -> type[gs.MjcfModel]:
    functions = {
        "control": lambda self, p, s: jnp.zeros(1),
        "period": lambda self, p: jnp.asarray(1.0),
    }
    declared = {"omega": gs.parameter("rad/s", "frequency", 1.0), "phi": gs.variable("rad", "phase", 0.0)}
    return type("Body", (gs.MjcfModel,), {"body_file": xml, **functions, **declared, **members})


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('name="foot" type="sphere"', 'type="spear"', "spear"),
        (
            '<option timestep="0.001"/>',
            '<option noslip_iterations="3"/>',
            "noslip_iterations is set",
        ),
        ('<touch name="load" site="foot"/>', '<magnetometer name="load" site="feet"/>', "feet"),
        (
            "</actuator>",
            '<adhesion body="leg" ctrlrange="0 1" gain="2"/></actuator>',
            "adhesion, which MJX does not have",
        ),
    ],
)
def test_unsupported_features_are_refused(old: str, new: str, sentence: str) -> None:
    assert old in TEXT
    with pytest.raises(gs.ArgumentError, match=f"is not accepted by session:Body.*: .*{sentence}"):
        gs.simulate(made(TEXT.replace(old, new))(dynamics="mjx"), duration=0.1)


def test_wrong_names_are_refused() -> None:
    with pytest.raises(gs.ArgumentError, match=r"The MJCF .*hoper\.xml does not exist"):
        gs.simulate(made("hoper.xml"), duration=0.1)
    control = {"control": lambda self, p, s: self.sensor(s, "laod")[None]}
    with pytest.raises(gs.ArgumentError, match="no sensor 'laod'; did you mean load"):
        gs.simulate(made(TEXT, **control), duration=0.1)
    with pytest.raises(TypeError, match="declares body, a name that every model has"):
        made(TEXT, body=gs.variable("1", "phase"))


@pytest.mark.slow
def test_an_edited_body_is_another_job(tmp_path: Path) -> None:
    (tmp_path / "edited_body.py").write_text(EDITED)
    (tmp_path / "job.yaml").write_text(
        "name: a\nmodel: edited_body:Edited\nrun: {kind: trace, duration: 0.1, every: 0.1}\n"
    )
    hashes = []
    for mass in ("2", "3", "2"):
        (tmp_path / "body.xml").write_text(TEXT.replace('mass="2"', f'mass="{mass}"'))
        hashes.append(prepare(gs.load_job(tmp_path / "job.yaml")).job_hash)
    assert hashes[0] == hashes[2] != hashes[1]
