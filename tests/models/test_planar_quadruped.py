"""The planar quadruped: its body and steps against MuJoCo C, its starts, and measurements of a walk."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pandas as pd
import pytest
from reference.planar_quadruped_mujoco import COLUMNS, OnCompliantFeet, begun, followed
from reference.planar_quadruped_mujoco import PlanarQuadruped as InMujoco

from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder, TraceRecorder
from gaitsweep.expression import evaluate
from gaitsweep.job import Job, JobError
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import gait_of, onsets_in, onsets_of_crossings
from gaitsweep.papers.fukuoka2015.planar_quadruped import PlanarQuadruped
from gaitsweep.papers.fukuoka2015.planar_quadruped.bodies import default_body, edit
from gaitsweep.papers.fukuoka2015.planar_quadruped.mechanics import HIP, KNEE, joint_powers, mjcf
from gaitsweep.papers.fukuoka2015.planar_quadruped.model import perturbation
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS
from gaitsweep.status import Status
from tests.support.sweeping import complete, run_rows

DT = 1e-3
SPEED = ("s", "Tr", "theta_st", "Kp_hip_st", "Kp_knee_st", "l_sw", "Kp_knee_sw")
# A gallop and a walk from two starts.
STARTS = {"seed": np.array([3.0, 8.0]), "pair": np.array([1.0, 0.0])}
SIGMA = np.array([1.0, 0.2])


def params_of(model: PlanarQuadruped, **values: float) -> Any:
    columns = model.on_host(complete(model, values, 1))
    return model.params({name: jnp.asarray(column[0]) for name, column in columns.items()})


def started(model: PlanarQuadruped, params: Any, seed: float, pair: float, scatter: float = 0.1) -> Any:
    return model.init(
        params, {"seed": jnp.asarray(seed), "pair": jnp.asarray(pair), "scatter": jnp.asarray(scatter)}
    )


def in_mujoco(kind: type[InMujoco], sigma: float, start: Any) -> InMujoco:
    """The reference at a start of the model's."""
    reference = kind(mujoco.MjModel.from_xml_string(mjcf()), sigma, np.array(start.u))
    reference.data.qpos[:] = np.array(start.q)
    reference.f_e, reference.f_f = np.array(start.f).tolist()
    return reference


@pytest.fixture(scope="module")
def traces() -> list[pd.DataFrame]:
    """All steps of three seconds of two rows, by the kernel."""
    model = PlanarQuadruped()
    recorder = TraceRecorder(model, duration=3.0, every=DT)
    block = run_rows(
        model, recorder, STARTS, params={"sigma": SIGMA}, numerics=Numerics(dt=DT), engine="kernel"
    )
    names = ["t", *(quantity.name for quantity in model.signals)]
    return [pd.DataFrame(block.samples[block.owner == row], columns=names) for row in (0, 1)]


@pytest.fixture(scope="module")
def crossings() -> pd.DataFrame:
    """All crossings in the same three seconds."""
    model = PlanarQuadruped()
    recorder = CrossingRecorder(model, duration=3.0)
    block = run_rows(
        model, recorder, STARTS, params={"sigma": SIGMA}, numerics=Numerics(dt=DT), engine="kernel"
    )
    names = ["crossing", "t", *(f"{quantity.name}_n" for quantity in model.observables)]
    return pd.DataFrame(block.samples, columns=names).assign(row=block.owner)


def test_sigma_sets_the_speed_parameters_and_each_can_be_set_alone() -> None:
    model = PlanarQuadruped()
    result = complete(model, {"sigma": np.array([0.0, 0.25, 0.5, 0.8, 1.0])}, 5)
    for name, column in zip(SPEED, COLUMNS.T, strict=True):
        wanted = np.interp([0.0, 0.25, 0.5, 0.8, 1.0], [0.0, 0.5, 1.0], column)
        np.testing.assert_allclose(result[name], wanted, rtol=1e-12, err_msg=name)
    alone = complete(model, {"sigma": 0.25, "Tr": 0.03}, 1)
    assert alone["Tr"][0] == 0.03
    assert alone["s"][0] == pytest.approx(0.5 * (1.18 + 1.71))


def test_a_start_is_the_pages_with_a_small_perturbation_of_its_own() -> None:
    model = PlanarQuadruped()
    params = params_of(model)
    plain, mirrored = (started(model, params, 0.0, pair, 0.0) for pair in (0.0, 1.0))
    np.testing.assert_allclose(plain.u, [[1.0, -0.5, -0.5, 1.0], [-0.5, 1.0, 1.0, -0.5]])
    np.testing.assert_allclose(plain.f, [[0.1, 0.0, 0.0, 0.1], [0.0, 0.1, 0.1, 0.0]])
    np.testing.assert_allclose(plain.q[HIP], [0.2, -0.2, -0.2, 0.2])
    np.testing.assert_allclose(plain.q[KNEE], 0.13)
    swap = [LEGS.index(leg) for leg in ("RF", "RH", "LF", "LH")]
    np.testing.assert_array_equal(mirrored.u, plain.u[:, jnp.array(swap)])
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(mjcf()))
    data.qpos[:] = np.array(plain.q)
    mujoco.mj_kinematics(data.model, data)
    soles = [data.geom(f"foot_{leg}").xpos[2] - 0.025 for leg in LEGS]
    np.testing.assert_allclose(soles, 0.005, atol=1e-12)

    numbers = np.stack([perturbation(jnp.asarray(float(seed))) for seed in range(200)]).reshape(200, 8)
    assert np.abs(numbers).max() < 1.0
    assert np.abs(numbers.mean(axis=0)).max() < 0.05, "evenly on both sides; at random 0.04 is one deviation"
    assert np.unique(numbers.round(9), axis=0).shape == (200, 8)
    assert np.abs(np.corrcoef(numbers.T) - np.eye(8)).max() < 0.2
    moved = started(model, params, 5.0, 0.0)
    np.testing.assert_allclose(moved.u - plain.u, 0.1 * perturbation(jnp.asarray(5.0)))


def test_the_tree_is_the_mjcfs_body_for_any_masses_and_lengths() -> None:
    model = PlanarQuadruped()
    random = np.random.default_rng(7)
    for scale in (0.0, 0.3):
        values = {name: v * (1.0 + scale * random.uniform(-1, 1)) for name, v in default_body().items()}
        values["com_z"] = 0.1 * scale  # 0 on the page
        spec = mujoco.MjSpec.from_string(mjcf())
        edit(spec, values)
        compiled = spec.compile()
        if scale == 0.0:
            as_written = mujoco.MjModel.from_xml_string(mjcf())
            for field in ("body_mass", "body_ipos", "body_inertia", "body_pos", "geom_size", "geom_pos"):
                written = getattr(as_written, field)
                np.testing.assert_allclose(getattr(compiled, field), written, atol=1e-12, err_msg=field)
        geometry = params_of(model, **values).mechanics.geometry(np.zeros(4, bool), 0.0)
        # the tree's first two links are the massless slides of the torso
        np.testing.assert_allclose(geometry.mass[2:], compiled.body_mass[1:], rtol=1e-12)
        np.testing.assert_allclose(geometry.com[2:], compiled.body_ipos[1:], atol=1e-12)
        np.testing.assert_allclose(geometry.inertia[2:, 1, 1], compiled.body_inertia[1:, 1], rtol=1e-10)
        across = [0, 2]
        np.testing.assert_allclose(
            np.array(geometry.position)[2:, across], compiled.body_pos[1:, across], atol=1e-12
        )
        np.testing.assert_allclose(geometry.damping, compiled.dof_damping)
        mass = np.array(geometry.mass).sum()
        assert mass == pytest.approx(7.0 if scale == 0.0 else compiled.body_mass.sum(), rel=1e-12)


def test_knees_have_dampings_of_their_own_in_swing_and_stance() -> None:
    mechanics = params_of(PlanarQuadruped(), Kv_knee_sw=30.0, Kv_knee_st=5.0).mechanics
    swings = np.array([True, False, False, True])
    np.testing.assert_array_equal(mechanics.damping(swings), [0, 0, 0, 1, 30, 1, 5, 1, 5, 1, 30])
    np.testing.assert_array_equal(mechanics.geometry(swings, 0.5).armature, 0.5 * mechanics.damping(swings))
    one = params_of(PlanarQuadruped(), Kv_knee=20.0).mechanics.damping(swings)
    np.testing.assert_array_equal(one, [0, 0, 0, 1, 20, 1, 20, 1, 20, 1, 20])


@pytest.mark.parametrize("sigma", [0.0, 0.3, 0.5, 0.8, 1.0])
def test_the_ends_of_the_path_determine_the_points_between(sigma: float) -> None:
    slow, fast = {"Tr_slow": 0.1, "theta_st_slow": -0.3}, {"Tr_fast": 0.03, "theta_st_fast": -0.7}
    result = complete(PlanarQuadruped(), {"sigma": sigma, **slow, **fast}, 1)
    at = [0.0, 0.5, 1.0]
    assert result["Tr"] == pytest.approx(np.interp(sigma, at, [0.1, 0.0473, 0.03]), rel=1e-12)
    assert result["theta_st"] == pytest.approx(np.interp(sigma, at, [-0.3, -0.438, -0.7]), rel=1e-12)
    assert result["s"] == pytest.approx(np.interp(sigma, at, [1.18, 1.71, 1.40]), rel=1e-12)


@pytest.mark.slow("0")
@pytest.mark.parametrize("row", [0, 1])
def test_the_tree_follows_mujoco_c_under_the_same_forces(traces: list[pd.DataFrame], row: int) -> None:
    """Network, motors, body and feet in the kernel, against dense linear algebra on MuJoCo's matrices."""
    model = PlanarQuadruped()
    params = params_of(model, sigma=float(SIGMA[row]))
    start = started(model, params, float(STARTS["seed"][row]), float(STARTS["pair"][row]))
    wanted = followed(in_mujoco(OnCompliantFeet, float(SIGMA[row]), start), 1.0)
    trace = traces[row].iloc[1:1001]
    q = trace[[f"q_{i}" for i in range(11)]].to_numpy()
    # rounding alone, which each touchdown multiplies; another order of the updates shows at 1e-3
    np.testing.assert_allclose(q, wanted["q"], atol=1e-9)
    np.testing.assert_allclose(trace[[f"u_f_{leg}" for leg in LEGS]], wanted["u"][:, 1], atol=1e-8)
    np.testing.assert_allclose(trace[[f"F_{leg}" for leg in LEGS]], wanted["load"], atol=1e-5)
    assert wanted["load"].max() > 50.0


@pytest.mark.slow
@pytest.mark.parametrize("row", [0, 1])
def test_crossings_agree_with_a_trace(traces: list[pd.DataFrame], crossings: pd.DataFrame, row: int) -> None:
    trace = traces[row].assign(row=row)
    seen = onsets_in(trace, {leg: f"u_f_{leg}" for leg in LEGS})
    message = onsets_of_crossings(crossings.loc[crossings["row"] == row])
    for leg in LEGS:
        at = seen.loc[seen["leg"] == leg, "t"].to_numpy()
        known = message.loc[message["leg"] == leg, "t"].to_numpy()
        at = at[at <= known[-1] + 1e-6]
        np.testing.assert_allclose(known, at[-known.size :], atol=1e-9, err_msg=leg)
    last = crossings.loc[crossings["row"] == row].iloc[-1]
    window = (0.5, last["t"])
    by_trace, by_crossings = (gait_of(each, window=window).iloc[0] for each in (seen, message))
    assert by_crossings["gait"] == by_trace["gait"]
    assert by_crossings["delta_1"] == pytest.approx(by_trace["delta_1"], abs=1e-9)

    end = last["t"] - last["since_LF_n"]
    begin = end - last["period_n"]
    times = {leg: seen.loc[seen["leg"] == leg, "t"].to_numpy() for leg in LEGS}
    assert np.abs(times["LF"] - begin).min() < 1e-9
    before = {leg: at[at <= end + 1e-9] for leg, at in times.items()}
    for name, hind, fore in (("delta_1_n", "LH", "RF"), ("delta_2_n", "RH", "LF")):
        shift = (before[hind][-1] - before[fore][-1]) / last["period_n"]
        assert last[name] == pytest.approx((shift + 0.5) % 1.0 - 0.5, abs=1e-9)
    _check_means(trace, before, last.to_dict(), (begin, end))
    shifts, lengths = _by_touchdowns(trace, times)
    np.testing.assert_allclose(last[["delta_1_touchdown_n", "delta_2_touchdown_n"]], shifts[:2], atol=1e-9)
    assert last["length_touchdown_n"] == pytest.approx(lengths.min(), abs=1e-9)


def _by_touchdowns(trace: pd.DataFrame, onsets: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The mean shifts (3,) by the touchdowns in all samples of a trace, and their resultant lengths."""
    t = trace["t"].to_numpy()
    landed, irregular = {}, [-1.0]
    for number, leg in enumerate(LEGS):
        down = t[trace[f"contact_{number + 1}"].to_numpy() > 0.5]
        after = np.diff(down, prepend=-1.0) - DT >= 0.06 - 1e-9
        cycles, first = np.unique(np.searchsorted(onsets[leg], down[after]), return_index=True)
        landed[leg] = down[after][first]
        irregular += [*np.delete(down[after], first)]
        lasted = np.diff(onsets[leg], prepend=0.0)
        long = lasted > 0.5 * np.median(np.diff(onsets["LF"]))
        irregular += [end for k, end in enumerate(onsets[leg]) if k not in cycles and long[k]]
    assert len(irregular) < 4
    waves, weight = np.zeros(3, complex), 0.0
    for begin, end in zip(onsets["LF"][:-1], onsets["LF"][1:], strict=True):
        now = np.ceil(end / DT - 1e-9) * DT
        last = {leg: at[at <= now + 1e-9][-1] for leg, at in landed.items()}
        pairs = (("LH", "RF"), ("RH", "LF"), ("LF", "RF"))
        late = np.array([last[one] - last[other] for one, other in pairs])
        recent = np.array(irregular)[np.array(irregular) <= now]
        known = recent.max() < now - 1.5 * (end - begin)
        waves += 0.1 * (known * np.exp(2j * np.pi * late / (end - begin)) - waves)
        weight += 0.1 * (1.0 - weight)
    return np.angle(waves) / (2.0 * np.pi), np.abs(waves) / weight


@pytest.mark.parametrize("row", [0, 1])
def test_joint_powers_are_those_of_the_motors(
    traces: list[pd.DataFrame], crossings: pd.DataFrame, row: int
) -> None:
    """Powers from the page's gains and differences of positions, and their means over a cycle."""
    trace = traces[row]
    columns = dict(zip(SPEED, [np.interp(SIGMA[row], [0.0, 0.5, 1.0], c) for c in COLUMNS.T], strict=True))
    total = {joint: np.zeros(len(trace) - 1) for joint in ("hip", "knee")}
    for leg in LEGS:
        swings = trace[f"u_f_{leg}"].to_numpy() > 0.0
        theta, length = trace[f"theta_{leg}"].to_numpy(), trace[f"l_{leg}"].to_numpy()
        hip = np.where(swings, 7.6 * (1.312 - theta), columns["Kp_hip_st"] * (columns["theta_st"] - theta))
        knee = np.where(
            swings,
            columns["Kp_knee_sw"] * (columns["l_sw"] - length),
            columns["Kp_knee_st"] * (0.13 - length),
        )
        # semi-implicit steps: the velocity after a step is the difference of positions over it
        for joint, at, force, damping in (("hip", theta, hip, 1.0), ("knee", length, knee, 40.0)):
            rate = np.diff(at) / DT
            power = trace[f"P_{joint}_{leg}"].to_numpy()[1:]
            np.testing.assert_allclose(power, (force[1:] - damping * rate) * rate, atol=1e-6)
            # in a step the motor's spring is that at its begin, its damper that at its end
            total[joint] = total[joint] + np.maximum((force[:-1] - damping * rate) * rate, 0.0)
    last = crossings.loc[crossings["row"] == row].iloc[-1]
    end, t = last["t"] - last["since_LF_n"], trace["t"].to_numpy()[1:]
    inside = (t > end - last["period_n"]) & (t <= end + DT)
    for joint, power in total.items():
        # a step more or less at the ends of the cycle
        error = 2.0 * DT / last["period_n"] * power[inside].max()
        assert last[f"power_{joint}_n"] == pytest.approx(power[inside].mean(), abs=error)
    both = last["power_hip_n"] + last["power_knee_n"]
    assert last["cost_of_transport_n"] == pytest.approx(both / (7.0 * 9.81 * last["speed_n"]), rel=1e-12)


def test_in_the_air_the_joints_work_is_mujocos_change_of_energy() -> None:
    reference = InMujoco(mujoco.MjModel.from_xml_string(mjcf()), 0.5, begun())
    model, data = reference.model, reference.data
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    reference.dt = model.opt.timestep = 1e-5
    data.qpos[1] += 1.0
    mujoco.mj_forward(model, data)
    before, tau, v = float(data.energy.sum()), [], []
    for _ in range(3000):
        reference.step()
        tau.append(data.qfrc_applied.copy())
        v.append(data.qvel.copy())
    damping = jnp.asarray(model.dof_damping)
    powers = jax.vmap(lambda tau, v: joint_powers(tau, damping, v))(np.array(tau), np.array(v))
    work = reference.dt * float(sum(power.sum() for power in powers))
    mujoco.mj_forward(model, data)
    change = float(data.energy.sum()) - before
    assert max(reference.load) == 0.0
    assert abs(change) > 0.1
    assert work == pytest.approx(change, rel=5e-3)


def _check_means(
    trace: pd.DataFrame, before: dict[str, np.ndarray], last: Mapping[str, float], cycle: tuple[float, float]
) -> None:
    """Means of loads and pitch over the last cycle, from the samples; onsets lie between those."""
    t = trace["t"].to_numpy()
    samples = {name: trace[name].to_numpy() for name in ("pitch", *(f"F_{leg}" for leg in LEGS))}
    inside = (t > cycle[0]) & (t <= cycle[1])
    aloft = np.all([samples[f"F_{leg}"][inside] == 0.0 for leg in LEGS], axis=0).mean()
    slack = 3.0 * DT / last["period_n"]  # steps at the ends of what is averaged
    assert last["flight_n"] == pytest.approx(aloft, abs=slack)
    assert last["pitch_mean_n"] == pytest.approx(samples["pitch"][inside].mean(), abs=1e-3)
    assert last["pitch_range_n"] == pytest.approx(np.ptp(samples["pitch"][inside]), abs=1e-3)
    x = np.interp(cycle, t, trace["x"])
    assert last["speed_n"] == pytest.approx((x[1] - x[0]) / last["period_n"], rel=1e-2)
    for leg in LEGS:
        onset, previous, first = before[leg][-1], before[leg][-2], before[leg][-3]
        late = (t > previous + 0.85 * (previous - first)) & (t <= onset)
        stands = (t > previous) & (t <= onset) & (trace[f"u_f_{leg}"].to_numpy() <= 0.0)
        for name, part in (("late", late), ("stance", stands)):
            load, pitch = samples[f"F_{leg}"][part], samples["pitch"][part]
            # a step more or less at an end
            error = 2.0 * np.ptp(load) / load.size + 1e-9
            assert last[f"{name}_load_{leg}_n"] == pytest.approx(load.mean(), abs=error), (leg, name)
            assert last[f"{name}_pitch_{leg}_n"] == pytest.approx(pitch.mean(), abs=5e-3), (leg, name)


def test_falls() -> None:
    model = PlanarQuadruped()
    params = params_of(model)
    start = started(model, params, 0.0, 0.0)
    standing = 0.175 + 0.13
    for place, value, fell in ((1, 0.46 * standing, False), (1, 0.44 * standing, True), (2, -1.01, True)):
        state = jax.tree.map(lambda leaf: leaf, start)
        object.__setattr__(state, "q", start.q.at[place].set(value))
        assert bool(model.failed(params, state)) == fell
    # without the hip's feedback it falls, and the row says so
    block = run_rows(
        model,
        CrossingRecorder(model, duration=3.0),
        {"seed": np.arange(2.0)},
        params={"k1": -3.0},
        numerics=Numerics(dt=DT),
        engine="kernel",
    )
    assert list(block.status) == [Status.fell, Status.fell]


def test_labels() -> None:
    model = PlanarQuadruped()
    params = params_of(model)
    seen = {"delta_1_mean": 0.1, "delta_2_mean": -0.1, "length": 0.96, "variation": 0.04, "antiphase": 0.5}
    seen |= {"delta_1_touchdown": 0.1, "delta_2_touchdown": 0.0, "length_touchdown": 0.96}

    def label(of: str = "gait", **changed: float) -> str:
        values = {name: jnp.asarray(value) for name, value in {**seen, **changed}.items()}
        return model.gaits[int(model.label(params, values)[of])]

    def margin(**changed: float) -> float:
        values = {name: jnp.asarray(value) for name, value in {**seen, **changed}.items()}
        return float(model.label(params, values)["margin"])

    assert label() == "RT-gallop"
    assert label("gait_by_touchdowns") == "R-canter"
    assert label("gait_by_touchdowns", length=0.5) == "R-canter"
    assert label("gait_by_touchdowns", length_touchdown=0.94) == "unsteady"
    # to the threshold of 0.07 from either side, and to half a cycle, where late becomes early
    assert margin(delta_2_mean=0.06) == pytest.approx(0.01)
    assert margin(delta_1_mean=0.2, delta_2_mean=-0.09) == pytest.approx(0.02)
    assert margin(delta_1_mean=0.2, delta_2_mean=-0.495) == pytest.approx(0.005)
    assert label(delta_1_mean=0.06, delta_2_mean=0.0) == "trot"
    assert label(delta_1_mean=0.2, delta_2_mean=0.08) == "L-walk"
    assert label(length=0.94) == label(variation=0.06) == label(antiphase=0.1) == "unsteady"


def test_bodies_in_jobs(tmp_path: Path) -> None:
    def job(**changed: Any) -> Job:
        fields = {"name": "p", "model": "planar_quadruped", "run": {"kind": "settle"}, "numerics": {"dt": DT}}
        return Job(**(fields | changed))

    assert job().design.model == PlanarQuadruped("tree")
    assert job(structure={"body": "mjx"}).design.model == PlanarQuadruped("mjx")
    with pytest.raises(JobError, match=r'structure\.body is "mjy"; did you mean mjx\? Allowed: tree, mjx'):
        job(structure={"body": "mjy"})
    with pytest.raises(ValueError, match=r"body is 'tre'; did you mean tree\? Allowed: tree, mjx"):
        PlanarQuadruped("tre")
    assert PlanarQuadruped("tree").host_parameters == ()
    assert "com_x" in PlanarQuadruped("mjx").host_parameters


@pytest.mark.slow
def test_a_walk_up_a_slope_is_that_on_even_ground_with_turned_gravity() -> None:
    """200 steps of 1 ms, touchdowns of four feet among them: to rounding."""
    angle = np.deg2rad(5.0)
    cosine, sine = float(np.cos(angle)), float(np.sin(angle))
    even, uneven = PlanarQuadruped(), PlanarQuadruped(ground="slope")

    def params_of(model: PlanarQuadruped, **given: float) -> Any:
        values: dict[str, float] = {}
        for quantity in model.parameters:
            written = given.get(quantity.name, quantity.default)
            values[quantity.name] = evaluate(0.0 if written is None else written, values)
        return model.params({name: jnp.asarray(float(value)) for name, value in values.items()})

    def after(model: PlanarQuadruped, params: Any, state: Any) -> Any:
        dt = jnp.asarray(1e-3)
        step = lambda s, _: (model.step(params, s, dt), None)  # noqa: E731
        return jax.jit(lambda s: jax.lax.scan(step, s, None, length=200)[0])(state)

    def turned_gravity(self: Any) -> jax.Array:
        return jnp.stack([-sine * self.g, 0.0 * self.g, -cosine * self.g])

    on_even, on_slope = params_of(even), params_of(uneven, ground_slope=5.0)
    start = even.init(
        on_even, {"seed": jnp.asarray(0.0), "scatter": jnp.asarray(0.1), "pair": jnp.asarray(0.0)}
    )
    turn = np.array([[cosine, -sine], [sine, cosine]])
    foot_of_slope = np.array([5.0, 5.0 * sine / cosine])
    q = start.q.at[:2].set(foot_of_slope + turn @ np.asarray(start.q[:2])).at[2].add(-angle)
    climbed = after(uneven, on_slope, dataclasses.replace(start, q=q))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(on_even.mechanics), "gravity", turned_gravity)
        walked = after(even, on_even, start)
    assert (np.asarray(walked.load) > 1.0).all()
    np.testing.assert_allclose(turn.T @ (np.asarray(climbed.q[:2]) - foot_of_slope), walked.q[:2], atol=1e-12)
    np.testing.assert_allclose(climbed.q[2] + angle, walked.q[2], atol=1e-12)
    np.testing.assert_allclose(climbed.q[3:], walked.q[3:], atol=1e-12)
    np.testing.assert_allclose(climbed.load, walked.load, atol=1e-8)


def test_mjx_refuses_uneven_ground() -> None:
    with pytest.raises(ValueError, match="ground is rough, but the plane that MuJoCo compiles is even"):
        PlanarQuadruped(body="mjx", ground="rough")
    assert PlanarQuadruped(body="mjx").parameters == PlanarQuadruped(ground="even").parameters
