"""Pushed rows against closed forms, and against the adjoint solution of the linearised return map."""

from __future__ import annotations

import inspect
import shutil
import types
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.contract import HybridModel
from gaitsweep.dynamics.ground import heights_of_model
from gaitsweep.engine.kernel import cuda_lanes
from gaitsweep.engine.pushed_model import PushedModel
from gaitsweep.engine.recorders.perturb import PerturbRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.examples.compass_walker import CompassWalker
from gaitsweep.examples.hopper import Hopper
from gaitsweep.job import Job, JobError
from gaitsweep.job.load import load_job
from gaitsweep.kinds import Settle
from gaitsweep.kinds.perturb import Perturb
from tests.support.host_card import HostCard, compiler
from tests.support.sweeping import run_rows, same

FINE = {"rtol": 1e-12, "atol": 1e-13}
SPREAD = 0.3  # half the angle between spokes, rad
SLOPE = 0.08
GAIT = 2.0 / np.tan(2.0 * SPREAD) * np.sqrt(np.sin(SPREAD) * np.sin(SLOPE))  # rate just after an impact


class Wheel(gs.DeclaredModel):
    """A rimless wheel; time in sqrt(l / g)."""

    slope = gs.parameter("rad", "slope of the ground, downwards", SLOPE, low=0.0, high=0.25)
    angle = gs.variable("rad", "angle of the spoke on the ground from the vertical")
    rate = gs.variable("1", "rate of the angle", 0.5)

    def complete(self, p: Any, s: Any) -> Any:
        return s.replace(angle=p.slope - SPREAD)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"angle": s.rate, "rate": jnp.sin(s.angle)}

    @gs.event("spoke lands", section=True)
    def landing(self, p: Any, s: Any) -> Any:
        return s.angle - p.slope - SPREAD

    @landing.jump
    def impact(self, p: Any, s: Any) -> Any:
        return s.replace(angle=p.slope - SPREAD, rate=jnp.cos(2.0 * SPREAD) * s.rate)

    def failed(self, p: Any, s: Any) -> Any:
        """The wheel rocks back."""
        return s.rate < 0.0

    def period(self, p: Any) -> Any:
        return 2.0


class Clock(gs.DeclaredModel):
    """A radial isochron clock: its phase is the angle, wherever it is (Winfree 2001, ch. 6)."""

    omega = gs.parameter("rad/s", "angular frequency", 6.0, low=0.0)
    x = gs.variable("1", "first coordinate", 0.9, scale=1.0)
    y = gs.variable("1", "second coordinate", scale=1.0)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        pull = 1.0 - s.x**2 - s.y**2
        return {"x": pull * s.x - p.omega * s.y, "y": pull * s.y + p.omega * s.x}

    @gs.event("turn ends", section=True)
    def turn(self, p: Any, s: Any) -> Any:
        return s.y

    def period(self, p: Any) -> Any:
        return 2.0 * jnp.pi / p.omega


def wrapped(share: Any) -> np.ndarray:
    return (np.asarray(share) + 0.5) % 1.0 - 0.5


def pushed(model: Any, push: list[str], run: dict[str, Any] | None = None, **keywords: Any) -> Any:
    return gs.perturb(model, push, run=run, verify=0, **keywords).table


@pytest.mark.slow
def test_the_phase_shift_of_a_clock_is_that_of_its_angle() -> None:
    """Isochrons are the rays of the plane, for pushes of any size; settling has an error below 1e-9."""
    keywords: dict[str, Any] = {
        "numerics": FINE,
        "push_x": [-0.6, 0.3, 2.0],
        "push_phase": np.arange(8) / 8.0 + 0.03,
    }
    table = pushed(Clock(), ["x", "y"], {"tolerance": 1e-10}, push_y=0.1, **keywords)
    before = 2.0 * np.pi * table["push_phase"].to_numpy()
    pushed_x = np.cos(before) + table["push_x"].to_numpy()
    after = np.arctan2(np.sin(before) + 0.1, pushed_x)
    assert (table["recovery"] == "recovered").all()
    shift = wrapped((after - before) / (2.0 * np.pi))
    assert np.abs(wrapped(table["phase_shift"] - shift)).max() < 1e-9
    # the radius follows 1 / r^2 - 1 = (1 / r0^2 - 1) exp(-2 t), and a row is back where it is close to 1
    radius = np.hypot(np.sin(before) + 0.1, pushed_x)[:, None]
    times = ((-after[:, None]) % (2.0 * np.pi) + 2.0 * np.pi * np.arange(20)) / 6.0
    far = np.abs((1.0 + (radius**-2.0 - 1.0) * np.exp(-2.0 * times)) ** -0.5 - 1.0) > 0.01
    cycles = np.where(far.any(axis=1), 20 - np.argmax(far[:, ::-1], axis=1), 0)
    np.testing.assert_array_equal(table["cycles_back"], np.where(cycles > 0, cycles + 1, 0))
    back = np.where(cycles > 0, times[np.arange(len(times)), cycles], 0.0)
    np.testing.assert_allclose(table["time_back"], back, atol=1e-8)
    np.testing.assert_allclose(
        table["t_push"] * 6.0 / (2.0 * np.pi) % 1.0, table["push_phase"] % 1.0, atol=1e-9
    )


@pytest.mark.slow
def test_a_wheel_recovers_if_its_energy_is_above_the_barrier() -> None:
    """Just after an impact it passes the vertical if rate^2 / 2 + cos(angle) > 1."""
    least = 2.0 * np.sin((SPREAD - SLOPE) / 2.0) - GAIT
    table = pushed(Wheel(), ["rate"], push_rate=[least - 1e-5, least + 1e-5, 0.0, 0.3])
    assert table["recovery"].tolist() == ["fell", "recovered", "recovered", "recovered"]
    assert table["status"].tolist() == ["fell", "settled", "settled", "settled"]
    np.testing.assert_allclose(table["rate_end"][1:], GAIT, atol=1e-6)
    # the first crossing after the push, by the conservation of energy and the loss of an impact
    rate = np.cos(2.0 * SPREAD) * np.sqrt((GAIT + 0.3) ** 2 + 4.0 * np.sin(SPREAD) * np.sin(SLOPE))
    assert table["excursion"][3] == pytest.approx((rate - GAIT) / (0.1 + GAIT), abs=1e-6)
    shift = table["phase_shift"]
    assert shift[2] == pytest.approx(0.0, abs=1e-6)
    assert np.isnan(shift[0])
    for row, push in zip((1, 3), (least + 1e-5, 0.3), strict=True):
        rates = [GAIT + push]
        while len(rates) < 40:
            rates.append(
                np.cos(2.0 * SPREAD) * np.sqrt(rates[-1] ** 2 + 4.0 * np.sin(SPREAD) * np.sin(SLOPE))
            )
        far = np.flatnonzero(np.abs(np.array(rates[1:]) - GAIT) > 0.01 * (0.1 + GAIT))
        assert table["cycles_back"][row] == far[-1] + 2  # the crossing after the last one that is far
    assert table["cycles_back"][2] == 0.0


@pytest.mark.slow
def test_a_step_of_a_parameter_lasts_for_its_cycles() -> None:
    """Rates after each impact by energy: (cos 2a)^2 (rate^2 + 2 (cos of first angle - cos of last))."""
    run = {"step": "slope", "at": "spoke lands"}
    table = pushed(Wheel(), [], run, push_slope=[-0.05, 0.1], push_cycles=[1, 3])
    assert (table["recovery"] == "recovered").all()
    for row in table.itertuples():
        rate, farthest, angle, changed = GAIT, 0.0, SLOPE - SPREAD, SLOPE + row.push_slope
        for crossing in range(40):
            slope = changed if crossing < row.push_cycles else SLOPE
            gain = 2.0 * (np.cos(angle) - np.cos(slope + SPREAD))
            rate, angle = np.cos(2.0 * SPREAD) * np.sqrt(rate**2 + gain), slope - SPREAD
            farthest = max(farthest, abs(rate - GAIT) / (0.1 + GAIT))
        # the section's other observable is the angle there, which the slope decides
        away = max(farthest, abs(row.push_slope))
        assert row.excursion == pytest.approx(away, abs=1e-6)


@pytest.mark.slow
def test_an_event_is_phase_0_and_a_short_force_an_impulse() -> None:
    amounts = [-0.1, 0.2]
    by_phase = pushed(Wheel(), ["rate"], {"tolerance": 1e-9}, numerics=FINE, push_rate=amounts)
    by_event = pushed(
        Wheel(), ["rate"], {"at": "spoke lands", "tolerance": 1e-9}, numerics=FINE, push_rate=amounts
    )
    for name in ("phase_shift", "excursion", "time_back", "cycles_back", "rate_end"):
        np.testing.assert_allclose(by_event[name], by_phase[name], atol=1e-7)
    durations = [0.02, 0.01, 0.005]
    run = {"force": True, "tolerance": 1e-9}
    forced = pushed(Wheel(), ["rate"], run, numerics=FINE, push_rate=0.2, push_duration=durations)
    errors = np.abs(forced["phase_shift"] - by_phase["phase_shift"][1])
    # the difference from an impulse is of first order in the duration
    np.testing.assert_allclose(errors[:2].to_numpy() / errors[1:].to_numpy(), 2.0, atol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "variables", "method"),
    [
        ("multilegged_reduced", ["phi_1", "phi_3"], {"method": "propagator"}),
        ("multilegged", ["phi_1", "v_1", "x_3"], {}),
    ],
)
def test_pushes_of_the_chain_agree_with_the_adjoint(
    model: str, variables: list[str], method: dict[str, str]
) -> None:
    """Differences of pushes of 1e-4 both ways have errors of 1e-8; settling adds some 1e-7."""
    start, phases = {"psi_1": 1.0, "psi_2": 2.0, "psi_3": 3.0}, [0.1, 0.35, 0.6, 0.85]
    cycles = gs.return_map(model, numerics=method, beta=0.6)
    exact = cycles.phase_response(cycles.settled(start, cycles=300), variables, phases)
    assert exact["response_phi_1"].between(0.16, 0.17).all()  # leg 1 leads: about 1 / (2 pi)
    for variable in variables:
        amounts = {f"push_{variable}": [-1e-4, 1e-4], "push_phase": phases}
        run = {"tolerance": 1e-10, "max_cycles": 600}
        table = pushed(model, [variable], run, numerics=method, beta=0.6, **start, **amounts)
        back, forth = table["phase_shift"].to_numpy().reshape(2, -1)
        np.testing.assert_allclose((forth - back) / 2e-4, exact[f"response_{variable}"], atol=1e-6)


@pytest.mark.slow
def test_the_adjoint_of_a_clock_and_of_gaits_of_two_steps() -> None:
    turns = gs.return_map(Clock(), numerics=FINE)
    gait = turns.fixed_points(turns.settled(cycles=20))
    table = turns.phase_response(gait, ["x", "y"], 12)
    angle = 2.0 * np.pi * table["push_phase"]
    np.testing.assert_allclose(table["response_x"], -np.sin(angle) / (2.0 * np.pi), atol=1e-10)
    np.testing.assert_allclose(table["response_y"], np.cos(angle) / (2.0 * np.pi), atol=1e-10)
    # over two turns a phase is half as large
    twice = gs.return_map(Clock(), numerics=FINE, period=2)
    both = twice.phase_response(twice.fixed_points(twice.settled(cycles=20)), ["x"], 24)
    np.testing.assert_allclose(both["response_x"], np.tile(table["response_x"], 2) / 2.0, atol=1e-10)


@pytest.mark.slow
def test_a_gait_of_two_steps_agrees_with_its_adjoint() -> None:
    slope, phase = 4.6, [0.2, 0.7]
    walk = gs.return_map(CompassWalker(), slope=slope, period=2)
    table = pushed(
        CompassWalker(),
        ["stance_rate"],
        {"tolerance": 1e-8, "max_cycles": 900},
        slope=slope,
        push_stance_rate=[-1e-4, 1e-4],
        push_phase=phase,
    )
    assert (table["attractor_period"] == 2).all()
    assert (table["recovery"] == "recovered").all()
    # the table's phases count from the crossing at which the row had settled: one of two
    back, forth = table["phase_shift"].to_numpy().reshape(2, -1)
    measured = (forth - back) / 2e-4
    gait = walk.fixed_points(walk.settled(cycles=100))
    one, other = (
        walk.phase_response(walk._points(at)[0], ["stance_rate"], phase)["response_stance_rate"].to_numpy()
        for at in (gait, walk.orbit(gait)[:, 1])
    )
    errors = [np.abs(measured - response).max() for response in (one, other)]
    assert min(errors) < 1e-3 * np.abs(measured).max()


@pytest.mark.slow
def test_rows_do_not_depend_on_lanes_and_name_the_other_gait() -> None:
    """The hopper's gaits 1:1 and 2:1 have launches of pi g / omega and twice that."""
    keywords: dict[str, Any] = {"launch_0": 2.5, "phase_0": 2.0, "push_launch": [0.0, 0.2, 2.57]}
    table = pushed(Hopper(), ["launch"], **keywords)
    assert table["gait_before"].tolist() == ["1:1"] * 3
    assert table["recovery"][:2].tolist() == ["recovered", "recovered"]
    assert table["recovery"][2] == "elsewhere"
    assert table["gait"].tolist() == ["1:1", "1:1", "2:1"]
    again = pushed(Hopper(), ["launch"], engine={"block": 2, "lanes": 8}, **keywords)
    np.testing.assert_array_equal(table["phase_shift"], again["phase_shift"])
    np.testing.assert_array_equal(table["t_end"], again["t_end"])


def job(**run: Any) -> Job:
    vary = run.pop("vary", {})
    return Job(name="x", model=run.pop("model", "toy_model:Toy"), vary=vary, run={"kind": "perturb", **run})


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"push": ["hight"]}, r"run\.push\[0\] is hight.*did you mean height"),
        ({}, r"run\.push is missing"),
        ({"push": ["speed_1"], "at": "lands"}, r"run\.at is lands, which is not an event"),
        ({"push": ["speed_1", "speed_1"]}, r"run\.push\[1\] is speed_1, which is named twice"),
        ({"step": "mass"}, r"kick = .*follows it"),
        ({"step": "restitution", "vary": {"push_restitution": [0.1, 0.6]}}, r"restitution 1.1 in row 1"),
        (
            {"force": True, "step": "restitution", "vary": {"push_duration": [1.0]}},
            r"run\.force has no effect without run\.push",
        ),
        ({"push": ["speed_1"], "force": True}, r"push_duration is missing"),
        ({"push": ["speed_1"], "vary": {"push_sped_1": [1.0]}}, r"did you mean push_speed_1"),
        (
            {"push": ["speed_1"], "model": "gaitsweep.examples.mujoco_hopper:MujocoHopper"},
            r"moves in steps",
        ),
        (
            {"push": ["x"], "model": "tests.dynamics.test_noise:Relaxation"},
            r"run\.kind is perturb.* in steps",
        ),
    ],
)
def test_what_cannot_be_pushed_is_refused(fields: dict[str, Any], says: str) -> None:
    with pytest.raises(JobError, match=says):
        job(**fields)


def test_a_variable_whose_push_has_the_name_of_another_quantity_is_named_once() -> None:
    with pytest.raises(JobError, match=r"two quantities push_phase, .* for phase of hopper") as refused:
        job(model="gaitsweep.examples.hopper:Hopper", push=["phase"])
    assert str(refused.value).count("push_phase") == 1


@pytest.mark.slow
def test_pushes_are_named_once_and_one_name_is_no_list_of_letters() -> None:
    def pushes(push: Any, run: Any = None) -> Any:
        return (
            gs.perturb(Hopper(), push, run=run, push_launch=0.01, verify=0)
            .table["recovery"]
            .astype(str)
            .tolist()
        )

    recovery = pushes(["launch"], {"within": 0.02})
    assert pushes("launch", gs.Perturb(within=0.02)) == recovery
    assert pushes((), gs.Perturb(push=["launch"], within=0.02)) == recovery
    assert pushes((), {"push": ["launch"], "within": 0.02}) == recovery
    for run in ({"push": ["launch"]}, gs.Perturb(push=["launch"])):
        with pytest.raises(gs.ArgumentError, match="push is given twice, once in run"):
            pushes("launch", run)
    with pytest.raises(gs.ArgumentError, match="run is a Settle, but must be a Perturb"):
        pushes("launch", gs.Settle())
    with pytest.raises(gs.ArgumentError, match=r"forse is not a field .* did you mean force"):
        pushes("launch", {"forse": True})


@pytest.mark.slow
def test_the_unstable_have_no_phase_response() -> None:
    hops = gs.return_map(Hopper(), omega=3.7)
    unstable = hops.fixed_points([5.9, 8.3])
    with pytest.raises(gs.ArgumentError, match="outside the unit circle"):
        hops.phase_response(unstable, ["launch"], [0.5])
    with pytest.raises(gs.ArgumentError, match="did you mean launch"):
        hops.phase_response(unstable, "lanch")
    # a period of 1 for a gait of two steps would be such a point too
    with pytest.raises(
        gs.ArgumentError, match=r"is of no gait: after a crossing a coordinate differs by 0\."
    ):
        hops.phase_response([0.5, 8.0], ["launch"], [0.5])
    with pytest.raises(gs.ArgumentError, match="no crossing after phase 0: fell"):
        gs.return_map(CompassWalker()).phase_response([0.6, 3.0, -5.0], ["stance_rate"], [0.5])
    for call in (hops.fixed_points, hops.multipliers, hops):
        with pytest.raises(gs.ArgumentError, match="x has no points"):
            call(np.zeros((0, 2)))
    for within in ((3.7,), (3.7, 3.7), "ab"):
        with pytest.raises(gs.ArgumentError, match="must be two different finite numbers"):
            hops.continue_([0.4, 8.3], "omega", within)  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
@pytest.mark.skipif(compiler() is None, reason="no C++ compiler")
def test_the_program_for_a_card_pushes_alike(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A processor stands in for the card; its compiler fuses no products, so numbers agree to rounding."""

    class CudaDevice(HostCard):
        folder = tmp_path

    model = PushedModel(Wheel(), ("rate",))
    recorder = PerturbRecorder(model, SettleRecorder(model, tolerance=1e-6), 0.01)
    amounts = {"push_rate": np.array([-0.3, -0.1, 0.0, 0.2]), "push_phase": np.array([0.0, 0.3, 0.5, 0.7])}
    rows = partial(run_rows, model, recorder, {"rate_0": np.full(4, 0.5)}, params=amounts, engine="kernel")
    expected = rows()
    monkeypatch.setattr(cuda_lanes, "CudaDevice", CudaDevice)
    device = types.SimpleNamespace(platform="gpu")
    monkeypatch.setattr("tests.support.sweeping.devices_on", lambda platform, engine: [device])
    outcome = rows(lanes=3)
    np.testing.assert_array_equal(outcome.status, expected.status)
    for name in ("t_push", "cycles_back", "time_back", "excursion", "phase_shift", "recovered"):
        np.testing.assert_allclose(outcome.numbers[name], expected.numbers[name], atol=1e-6, err_msg=name)
    same(outcome, rows(lanes=2, block=3))


def test_a_recovery_map_shows_rows_that_have_not_settled_again() -> None:
    table = pd.DataFrame(
        {
            "push_phase": [0.25, 0.75] * 2,
            "push_x": [-1.0, -1.0, 1.0, 1.0],
            "recovery": pd.Categorical(["recovered", "not settled", "recovered", "fell"]),
            "status": ["settled", "cycle_limit", "settled", "fell"],
        }
    )
    figure = gs.plot.recovery(table, x="push_phase", y="push_x")
    (legend,) = figure.legends
    names = [text.get_text().rsplit("  ", 1) for text in legend.get_texts()]
    assert sorted(names) == [["fell", "25 %"], ["not settled", "25 %"], ["recovered", "50 %"]]


def test_the_least_fatal_push_is_found_around_the_cycle_and_marked() -> None:
    """Pushes beyond a circle are fatal, whose radius is 0.5 at phase 0 and 1 at phase 0.5."""
    amounts = np.linspace(-1.2, 1.2, 25)
    x, y, phase = (each.ravel() for each in np.meshgrid(amounts, amounts, [0.0, 0.5], indexing="ij"))
    fell = np.hypot(x - 0.1, y) > 0.5 + phase
    recovery = np.where(fell, "fell", np.where(x > 0.45, "not settled", "recovered"))
    columns = {"push_x": x, "push_y": y, "push_phase": phase, "recovery": pd.Categorical(recovery)}
    table = pd.DataFrame({"row": np.arange(x.size), **columns, "status": "settled"})
    unit = {"unit": "rad/s", "circular": False, "symbol": ""}
    table.attrs["quantities"] = dict.fromkeys(("push_x", "push_y"), unit)
    least = gs.analyses.least_fatal_push(table, ["push_x", "push_y"], "push_phase")
    # the centre is at 0.1, so the nearest border is at 0.4 and 0.9 on the other side, within a cell of 0.1
    assert (least["push_x"].to_numpy() < 0.0).all()
    beyond = least["size"].to_numpy() - [0.4, 0.9]
    assert ((beyond > -1e-12) & (beyond < 0.1 * np.sqrt(2.0))).all()
    np.testing.assert_allclose(least["size"], np.hypot(least["push_x"], least["push_y"]), atol=1e-12)
    assert least["recovery"].tolist() == ["fell", "fell"]
    figure = gs.plot.recovery(table, x="push_x", y="push_y", panels="push_phase")
    stars = [
        np.asarray(line.get_xydata())[0]
        for axes in figure.axes
        for line in axes.lines
        if line.get_marker() == "*"
    ]
    np.testing.assert_allclose(stars, least[["push_x", "push_y"]])
    (panel,) = gs.plot.recovery(table.head(0), x="push_x", y="push_y").axes
    assert [text.get_text() for text in panel.texts] == ["no rows yet"]
    table.attrs["quantities"]["push_y"] = {**unit, "unit": "m/s"}
    with pytest.raises(gs.analyses.AnalysisError, match="one unit"):
        gs.analyses.least_fatal_push(table, ["push_x", "push_y"], "push_phase")
    with pytest.raises(gs.analyses.AnalysisError, match=r"scales\.push is not one of the columns"):
        gs.analyses.least_fatal_push(table, "push_x", scales={"push": 2.0})
    halved = gs.analyses.least_fatal_push(table, "push_x", "push_phase", scales={"push_x": 2.0})
    np.testing.assert_allclose(halved["size"], np.abs(halved["push_x"]) / 2.0)
    with pytest.raises(gs.analyses.AnalysisError, match="has no rows"):
        gs.analyses.least_fatal_push(table.iloc[:0], "push_x")


@pytest.mark.slow
def test_settled_rows_of_a_table_are_pushed_as_rows_that_settle_anew(tmp_path: Path) -> None:
    """The hopper's gaits 1:1 and 2:1 at one frequency; its multipliers near 1 bound the phase shifts."""
    omega = {"omega": [11.9, 12.0]}
    starts = {"launch_0": [2.5, 5.0], "phase_0": 2.0}
    settled = gs.sweep(
        Hopper(),
        run=Settle(states=True, tolerance=1e-9),
        verify=0,
        out=tmp_path / "settled",
        **omega,
        **starts,
    )
    pushes: dict[str, Any] = {"push_launch": [0.0, 0.2, -0.2], "push_phase": [0.1, 0.4]}
    run = {"tolerance": 1e-7}
    anew = pushed(Hopper(), ["launch"], run, **omega, **starts, **pushes)
    again = pushed(Hopper(), ["launch"], run, after=settled, **pushes)
    assert again["gait_before"].tolist() == (["1:1"] * 6 + ["2:1"] * 6) * 2
    for name in ("omega", "gait_before", "gait", "recovery", "cycles_back"):
        assert again[name].tolist() == anew[name].tolist()
    # launches are pi g / omega and twice that
    np.testing.assert_allclose(again["launch_end"], anew["launch_end"], rtol=1e-6)
    np.testing.assert_allclose(
        again["state_launch"][[0, 6]], np.array([1.0, 2.0]) * np.pi * 9.81 / 11.9, rtol=1e-7
    )
    np.testing.assert_allclose(again["excursion"], anew["excursion"], atol=2e-5)
    np.testing.assert_allclose(again["phase_shift"], anew["phase_shift"], atol=2e-5)
    assert (again["t_push"] < 0.2 * anew["t_push"]).all()  # after the crossings of the first test
    # from its directory alone, and from some records of a table in memory
    by_path = pushed(Hopper(), ["launch"], run, after=tmp_path / "settled", **pushes)
    np.testing.assert_array_equal(by_path["phase_shift"], again["phase_shift"])
    table = settled.table
    in_memory = pushed(Hopper(), ["launch"], run, after=table[table["gait"] == "2:1"], **pushes)
    np.testing.assert_array_equal(
        in_memory["phase_shift"], again["phase_shift"][again["gait_before"] == "2:1"]
    )


def test_rows_of_a_joined_table_are_not_pushed() -> None:
    """Its jobs may vary different parameters."""
    table = pd.DataFrame({"row": [0]})
    table.attrs = {"joined": [], "job": {"model": "hopper", "run": {"kind": "settle", "states": True}}}
    pushed_model = PushedModel(Hopper(), ("launch",), resumes=True)
    run = {"kind": "perturb", "push": ["launch"], "after": table}
    _, wrong = Perturb.filled({"model": "hopper", "run": run}, pushed_model, Path())
    assert "run.after is a table in memory: it is joined of several results" in str(wrong[0])


@pytest.mark.slow
def test_rows_that_a_refined_run_infers_have_no_state() -> None:
    starts: dict[str, Any] = {"launch_0": {"linspace": [1, 9, 24]}, "phase_0": {"linspace": [0, 6, 24]}}
    whole = gs.sweep(Hopper(), run=Settle(states=True), verify=0, **starts).table
    refined = gs.sweep(
        Hopper(), run=Settle(states=True, refine="boundary", coarse=4), verify=0, **starts
    ).table
    simulated = np.isfinite(refined["t_end"].to_numpy())
    assert 0 < simulated.sum() < len(refined)
    settled = (whole["status"] == "settled").to_numpy()
    np.testing.assert_array_equal(np.isfinite(refined["state_launch"]), simulated & settled)
    both = simulated & settled
    np.testing.assert_array_equal(refined["state_launch"][both], whole["state_launch"][both])
    # at the section the state of the hopper is what is observed there; of a longer orbit a crossing is chosen
    fixed = settled & (whole["attractor_period"] == 1)
    np.testing.assert_array_equal(whole["state_launch"][fixed], whole["launch_end"][fixed])


@pytest.mark.slow
def test_modes_of_a_settled_row_are_kept() -> None:
    """A chain without a push is on its gait at each crossing, if the stance of each leg is that of before."""
    start: dict[str, Any] = {"psi_1": 1.0, "psi_2": 2.0, "psi_3": 3.0}
    run: dict[str, Any] = {"tolerance": 1e-10, "max_cycles": 600}
    settled = gs.sweep("multilegged", beta=0.6, run=Settle(states=True, **run), verify=0, **start)
    pushes: dict[str, Any] = {"push_v_1": [0.0, 0.05], "push_phase": 0.3}
    again = pushed("multilegged", ["v_1"], run, after=settled, **pushes)
    anew = pushed("multilegged", ["v_1"], run, beta=0.6, **start, **pushes)
    assert again["recovery"].tolist() == ["recovered"] * 2
    assert again["excursion"][0] < 1e-8
    assert (again["t_push"] < 0.2 * anew["t_push"]).all()
    for name in ("excursion", "phase_shift", "time_back"):
        np.testing.assert_allclose(again[name], anew[name], atol=1e-7)


def earlier(folder: Path, **fields: Any) -> Path:
    """A result directory with one row of the hopper, which has settled."""
    run = {"run": Settle(states=True), **fields}
    gs.sweep(Hopper(), verify=0, out=folder, launch_0=[2.5], phase_0=2.0, **run)
    return folder


def test_a_job_holds_the_rows_of_its_earlier_table(tmp_path: Path) -> None:
    """Its hash depends on their numbers, not on their folder, which may be gone later."""

    def job_after(name: str) -> Job:
        run = {"kind": "perturb", "push": ["launch"], "after": str(tmp_path / name)}
        return Job(name="x", model="gaitsweep.examples.hopper:Hopper", vary={"push_launch": [0.1]}, run=run)

    earlier(tmp_path / "a", omega=[12.0])
    (tmp_path / "a").rename(tmp_path / "b")
    earlier(tmp_path / "a", omega=[12.0])
    earlier(tmp_path / "c", omega=[11.0])
    first, second, other = (job_after(name) for name in "abc")
    assert first.hash() == second.hash() != other.hash()
    shutil.rmtree(tmp_path / "a")
    again = Job.model_validate(first.resolved())
    assert again.hash() == first.hash()
    np.testing.assert_array_equal(again.design.row(0)["state_launch"], first.design.row(0)["state_launch"])


def test_the_directory_of_an_earlier_table_is_relative_to_the_jobs_folder(tmp_path: Path) -> None:
    earlier(tmp_path / "results" / "gaits", omega=[12.0])
    (tmp_path / "jobs").mkdir()
    file = tmp_path / "jobs" / "pushed.yaml"
    file.write_text(
        "name: x\nmodel: gaitsweep.examples.hopper:Hopper\nvary: {push_launch: [0.1]}\n"
        "run: {kind: perturb, push: [launch], after: ../results/gaits}\n"
    )
    assert load_job(file).resolved()["run"]["after"] == "../results/gaits"
    with pytest.raises(JobError, match=r"run\.after is results/gaits: .*jobs/results/gaits"):
        load_job(file, ["run.after=results/gaits"])


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        (
            {"model": "gaitsweep.examples.compass_walker:CompassWalker"},
            r"its model is .*Hopper, but that of this",
        ),
        ({"params": {"omega": 11.0}}, r"params\.omega is 11\.0, but .*settled has its values"),
        ({"params": {"restitution": 0.5}}, r"params\.restitution is 0\.5, but .*settled has its values"),
        ({"vary": {"omega": [11.0]}}, r"vary varies omega, but .*settled has its values"),
        ({"start": {"launch_0": 2.0}}, r"launch_0 is not a start value"),
        ({"run": {"after": "nowhere"}}, r"run\.after is .*nowhere"),
        ({"damage": True}, r"run\.after is .*settled: .*damaged"),
        ({"states": False}, r"it has no states of its rows: run its job as"),
    ],
)
def test_tables_whose_rows_cannot_be_pushed_are_refused(
    tmp_path: Path, fields: dict[str, Any], says: str
) -> None:
    folder = earlier(tmp_path / "settled", run=Settle(states=fields.get("states", True)))
    if fields.get("damage"):
        part = next(iter(sorted((folder / "table").iterdir())))
        part.write_bytes(part.read_bytes()[:-9])
    run = {"kind": "perturb", "push": [fields.get("push", "launch")], "after": str(folder)}
    if "run" in fields:
        run["after"] = str(tmp_path / fields["run"]["after"])
    job_fields = {name: fields[name] for name in ("model", "params", "vary", "start") if name in fields}
    with pytest.raises(JobError, match=says):
        Job(name="x", **{"model": "gaitsweep.examples.hopper:Hopper", **job_fields}, run=run)


def test_a_gait_without_observed_values_is_at_no_distance_from_itself() -> None:
    """As that of a body that stands, whose lags and strides have no value."""
    model: Any = types.SimpleNamespace(observables=(gs.Quantity("lag", "rad", "lag", circular=True),))
    recorder = PerturbRecorder(model, SettleRecorder(model), within=0.05)
    gait = jnp.full((3, 1), jnp.nan)
    distances = recorder._distances(gait[0], gait, jnp.asarray(2))
    np.testing.assert_array_equal(distances, [0.0, 0.0, np.inf])


def test_the_ground_of_pushed_rows_is_that_of_their_model() -> None:
    class Hilly(Wheel):
        def own_ground(self, x: Any, y: Any) -> Any:
            return 0.1 * jnp.sin(x)

    places = np.array([0.0, 0.5])
    heights = heights_of_model(PushedModel(Hilly(), ("rate",)), {}, places)
    assert heights is not None
    np.testing.assert_allclose(heights, 0.1 * np.sin(places))


def test_a_pushed_model_answers_for_its_model() -> None:
    """Each member of a model is redefined or that of the model itself, but for four.

    Pushed rows have no chart, symmetries or fixed-step scheme; who needs the ground asks the model itself.
    """
    members = [name for name in dir(HybridModel) if not name.startswith("__")]
    defaults = {
        name
        for name in members
        if inspect.getattr_static(PushedModel, name) is inspect.getattr_static(HybridModel, name)
    }
    assert defaults - {"_abc_impl"} == {"chart", "symmetries", "fixed_step_scheme", "own_ground"}
