"""Self-checks of runs: rows repeated with the same and with finer steps, and their differences."""

from __future__ import annotations

import contextlib
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from double_well import DoubleWell
from gaitsweep.cli import main
from gaitsweep.contract import Model
from gaitsweep.engine.poincare.maps import Points
from gaitsweep.job import Job
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.plot.provenance_marks import remarks
from gaitsweep.runs import concurrent_self_check, execute, unstable_rests
from gaitsweep.runs.execute import run_job
from gaitsweep.runs.self_check import _largest_change
from gaitsweep.runs.self_check_result import SelfCheck, counted, sample_rows
from gaitsweep.runs.sentences import advice, self_check_sentence
from gaitsweep.runs.unstable_rests import followed
from gaitsweep.table import directory

HOLD = {"kind": "fixed_time", "duration": 40.0}
SETTLE = {"kind": "settle", "max_cycles": 2000, "tolerance": 1e-4}


def job(**fields: Any) -> Job:
    given: dict[str, Any] = {"name": "wells", "model": "double_well:DoubleWell", "run": HOLD, **fields}
    return Job(**given)


def checked(tmp_path: Path, *, warns: bool = False, **fields: Any) -> dict[str, Any]:
    told = pytest.warns(UserWarning, match=r"\ASelf-check") if warns else contextlib.nullcontext()
    with told:
        result = gs.run(job(**fields), tmp_path / "out")
    found = result.manifest["self_check"]
    assert result.table.attrs["manifest"]["self_check"] == found
    return found


def test_a_step_that_does_not_matter_passes(tmp_path: Path) -> None:
    result = checked(tmp_path, vary={"x_0": {"linspace": [-0.9, 0.9, 20]}})
    assert result["verdict"] == "passed"
    assert (result["rows"], result["of"], result["stored_differs"]) == (4, 20, 0)
    assert 0.0 < result["largest"]["x"] < 1e-9  # both end in the same wells, by steps of their own
    assert self_check_sentence(result).startswith(
        "Self-check: 4 of 20 rows rerun at 0.38 of the step kept their gait; x "
    )
    one = self_check_sentence({**result, "rows": 1, "of": 1, "verdict": "warned", "unstable": 1})
    assert one.startswith("Self-check: 1 row rerun at 0.38 of the step: 1 rests on an unstable gait, which")
    assert "1 row rerun at 0.38 of the step kept its gait; x " in self_check_sentence(
        {**result, "rows": 1, "of": 1}
    )
    other = {"rows": 1, "of": 1, "verdict": "warned", "status_differs": 1, "largest": {}}
    assert self_check_sentence({**result, **other}).endswith(
        "1 ended with another status; no observable was compared."
    )
    assert checked(tmp_path / "all", vary={"x_0": {"linspace": [-0.9, 0.9, 20]}}, verify=20)["rows"] == 20


def test_another_gait_with_finer_steps_is_detected(tmp_path: Path) -> None:
    """The boundary lies at -lean dt: -5e-5 m, or -1.9e-5 m with finer steps; starts between them differ."""
    starts = [-1e-4, -4e-5, -3e-5, -1e-5, 1e-4]
    result = checked(tmp_path, vary={"x_0": starts}, params={"lean": 1e-3}, verify=5, warns=True)
    assert (result["verdict"], result["gait_differs"], result["sensitive"]) == ("warned", 2, 0)
    assert "2 ended with another gait" in self_check_sentence(result)


def test_a_row_on_a_boundary_is_sensitive(tmp_path: Path) -> None:
    """A start moved by 1e-9 m also settles in another well."""
    result = checked(
        tmp_path, vary={"x_0": [-4e-10, 0.3]}, params={"lean": 1e-8}, run={**HOLD, "duration": 60}
    )
    assert (result["verdict"], result["gait_differs"], result["sensitive"]) == ("passed", 0, 1)
    assert "1 of them on a boundary" in self_check_sentence(result)


@pytest.mark.slow
def test_a_settled_row_that_moves_is_detected(tmp_path: Path) -> None:
    """The well's bottom moves by 0.62 lean dt / 2, 0.0156 m: more than ten tolerances."""
    fields: dict[str, Any] = {"vary": {"x_0": [0.5, 0.8]}, "params": {"lean": 1.0}}
    result = checked(tmp_path / "fine", run=SETTLE, warns=True, **fields)
    assert (result["verdict"], result["moved"], result["gait_differs"]) == ("warned", 2, 0)
    assert result["largest"]["x"] == pytest.approx(0.0156, rel=0.1)
    # from the well's bottom, 1 m from 0, which then moves by 7.8e-6 m: less than ten tolerances of 0.01 m
    still = checked(tmp_path / "still", run=SETTLE, vary={"x_0": [1.0]}, params={"lean": 5e-4})
    assert still["verdict"] == "passed"


def test_strict_runs_fail_where_others_warn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = job(vary={"x_0": [-4e-5]}, params={"lean": 1e-3})
    with pytest.raises(gs.SelfCheckError, match="1 ended with another gait"):
        gs.run(wrong, tmp_path / "out", strict=True)
    assert len(gs.load(tmp_path / "out")) == 1, "the table is complete"
    file = tmp_path / "job.yaml"
    file.write_text(
        "name: wells\nmodel: double_well:DoubleWell\nparams: {lean: 1.0e-3}\nvary: {x_0: [-4.0e-5]}\n"
        "run: {kind: fixed_time, duration: 40}\n"
    )
    options = ["run", str(file), "--out", str(tmp_path / "by command")]
    assert main(options) == 0
    assert "Warning: Self-check: 1 row" in capsys.readouterr().err
    assert main([*options, "--strict"]) == 3


@pytest.fixture
def beside(monkeypatch: pytest.MonkeyPatch) -> None:
    """The self-check runs beside the rows, as on a card."""
    monkeypatch.setattr(execute, "_rows_leave_the_host_idle", lambda _: True)


def test_beside_the_rows_it_finds_the_same(tmp_path: Path, beside: None) -> None:
    fields: dict[str, Any] = {"vary": {"x_0": [-1e-4, -4e-5, -3e-5, 1e-4]}, "params": {"lean": 1e-3}}
    result = checked(tmp_path / "beside", warns=True, **fields)
    table = gs.load(tmp_path / "beside/out")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(execute, "_rows_leave_the_host_idle", lambda _: False)
        assert checked(tmp_path / "after", warns=True, **fields) == result
    assert result["gait_differs"] == 2
    pd.testing.assert_frame_equal(gs.load(tmp_path / "after/out"), table, check_exact=True)


def test_its_failure_beside_the_rows_is_raised_and_the_table_is_complete(
    tmp_path: Path, beside: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any) -> dict[str, Any]:
        raise RuntimeError("no check")

    monkeypatch.setattr(concurrent_self_check, "self_check", fails)
    with pytest.raises(RuntimeError, match="no check"):
        gs.run(job(vary={"x_0": [0.5, 0.8]}), tmp_path / "out")
    assert gs.load(tmp_path / "out").attrs["complete"]
    monkeypatch.undo()
    again = gs.run(job(vary={"x_0": [0.5, 0.8]}), tmp_path / "out")
    assert again.manifest["self_check"]["verdict"] == "passed"


def test_stopped_rows_stop_it(tmp_path: Path, beside: None, monkeypatch: pytest.MonkeyPatch) -> None:
    called = threading.Event()

    def endless(_ready: Any, _count: int, on_progress: Callable[[Any], None]) -> dict[str, Any]:
        while True:
            called.set()
            on_progress(None)
            time.sleep(0.001)

    def stop(*_: Any, **__: Any) -> None:
        assert called.wait(10.0)
        raise KeyboardInterrupt

    monkeypatch.setattr(concurrent_self_check, "self_check", endless)
    with pytest.raises(KeyboardInterrupt):
        run_job(job(vary={"x_0": [0.5, 0.8]}), tmp_path / "out", on_progress=stop)


def test_it_can_be_turned_off_and_does_not_change_the_hash(tmp_path: Path) -> None:
    off = job(vary={"x_0": [-4e-5]}, params={"lean": 1e-3}, verify=0)
    assert gs.run(off, tmp_path / "out").manifest["self_check"] == {"rows": 0, "verdict": "off"}
    on = job(vary={"x_0": [-4e-5]}, params={"lean": 1e-3})
    assert on.hash() == off.hash()
    with pytest.warns(UserWarning, match=r"\ASelf-check"):
        assert gs.run(on, tmp_path / "out").manifest["self_check"]["verdict"] == "warned"


def test_rows_that_do_not_settle_are_compared_over_their_first_crossings(tmp_path: Path) -> None:
    fields: dict[str, Any] = {"vary": {"x_0": [0.5]}, "params": {"lean": 0.1}}
    result = checked(tmp_path, run={"kind": "return_map", "crossings": 12}, **fields)
    # by explicit Euler, crossing k of the coarse step is step k, not the same time: all that is told
    assert result["largest"]["x"] > 0.0
    assert result["verdict"] == "passed"


@pytest.mark.parametrize("count", [4, 8, 32, 50])
def test_a_sample_has_the_ends_of_each_axis(count: int) -> None:
    vary = {"x_0": {"linspace": [-1, 1, 40]}, "lean": {"linspace": [0, 1e-3, 25]}}
    design = job(vary=vary).design
    rows = sample_rows(design, count)
    assert rows.size == np.unique(rows).size == count
    assert rows.min() >= 0
    assert rows.max() < design.n_rows
    first, second = rows // 25, rows % 25
    assert {0, 39} <= set(first.tolist())
    assert {0, 24} <= set(second.tolist())
    if count == 32:  # and no large part of the box is left out
        for axis, length in ((first, 40), (second, 25)):
            assert np.max(np.diff(np.unique(np.sort(axis)))) <= 0.25 * length
    assert sample_rows(design, 10**6).size == design.n_rows


class Wheel(gs.DeclaredModel):
    """A wheel that turns once in 2 pi s; its teeth are counted as they pass."""

    teeth = gs.parameter("1", "teeth", 3.0)
    phi = gs.variable("rad", "angle", 0.1, observed=False)
    count = gs.variable("1", "teeth counted", 0.0)

    def flow(self, p, s):
        return {"phi": 1.0 + 0.0 * s.phi}

    @gs.event("a tooth passes")
    def tooth(self, p, s):
        return jnp.sin(p.teeth * s.phi)

    @tooth.jump
    def add(self, p, s):
        return s.replace(count=s.count + 1.0)

    @gs.event("the wheel has turned", section=True)
    def turn(self, p, s):
        return s.phi - 2.0 * jnp.pi

    @turn.jump
    def back(self, p, s):
        return s.replace(phi=s.phi - 2.0 * jnp.pi)

    def period(self, p):
        return 2.0 * jnp.pi + 0.0 * p.teeth


class Spring(gs.DeclaredModel):
    """An undamped spring; v rises through 0 once a period."""

    w = gs.parameter("rad/s", "frequency", 2.0)
    x = gs.variable("m", "place", 1.0, scale=1.0)
    v = gs.variable("m/s", "speed", 0.0)

    def flow(self, p, s):
        return {"x": s.v, "v": -(p.w**2) * s.x}

    @gs.event("v rises through 0", section=True)
    def turns(self, p, s):
        return s.v

    def period(self, p):
        return 2.0 * jnp.pi / p.w


class Rotor(gs.DeclaredModel):
    """A rotor whose period is given for w = 1 rad/s only."""

    w = gs.parameter("rad/s", "frequency", 1.0)
    phi = gs.variable("rad", "phase", 0.5, circular=True)

    def flow(self, p, s):
        return {"phi": p.w}

    @gs.event("its sine rises", section=True)
    def turns(self, p, s):
        return jnp.sin(s.phi)

    def period(self, p):
        return 2.0 * jnp.pi + 0.0 * p.w


class Pulses(gs.DeclaredModel):
    """u' = -u, and a pulse of area 1 in the middle of each 2 s that no step of the run's own meets."""

    width = gs.parameter("s", "width of the pulse", 0.01)
    clock = gs.variable("s", "clock", 0.0, observed=False)
    u = gs.variable("1", "u", 1.0)

    def flow(self, p, s):
        on = (s.clock > 1.0) & (s.clock < 1.0 + p.width)
        return {"clock": 1.0, "u": -s.u + jnp.where(on, 1.0 / p.width, 0.0)}

    @gs.event("2 s are over", section=True)
    def tick(self, p, s):
        return s.clock - 2.0

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=s.clock - 2.0)

    def period(self, p):
        return 2.0 + 0.0 * p.width


class Relaxation(gs.DeclaredModel):
    """Van der Pol's oscillator in um; v falls through 0 once a period."""

    mu = gs.parameter("1/s", "rate", 8.0)
    x = gs.variable("um", "place", 2.5e6)
    v = gs.variable("um/s", "speed", 0.0)

    def flow(self, p, s):
        return {"x": s.v, "v": p.mu * (1.0 - (s.x / 1e6) ** 2) * s.v - s.x}

    @gs.event("v falls through 0", section=True)
    def turns(self, p, s):
        return -s.v

    def period(self, p):
        return 6.6 + 0.0 * p.mu


class Latch(gs.DeclaredModel):
    """u rises by 1.5 within 0.01 s, between two steps of 1/16 s, in rows that never cross the section."""

    every = gs.parameter("s", "time between two crossings", 3.0)
    clock = gs.variable("s", "clock", 0.0, observed=False)
    u = gs.variable("1", "u", 0.5)

    def flow(self, p, s):
        on = (s.clock > 1.0) & (s.clock < 1.01) & (p.every > 10.0)
        return {"clock": 1.0, "u": jnp.where(on, 150.0, 0.0)}

    @gs.event("the time is over", section=True)
    def tick(self, p, s):
        return s.clock - p.every

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=s.clock - p.every)

    def period(self, p):
        return 3.0 + 0.0 * p.every


class Counted(gs.DeclaredModel):
    """A rotor whose rate is read from its second turn on."""

    w = gs.parameter("rad/s", "frequency", 1.0)
    phi = gs.variable("rad", "phase", 0.5, circular=True)
    turned = gs.mode(0, "turns")

    def flow(self, p, s):
        return {"phi": p.w}

    @gs.event("its sine rises", section=True)
    def turns(self, p, s):
        return jnp.sin(s.phi)

    @turns.jump
    def count(self, p, s):
        return s.replace(turned=s.turned + 1)

    @gs.observable("rad/s", "rate")
    def rate(self, p, s):
        return jnp.where(s.turned < 2, jnp.nan, p.w)

    def period(self, p):
        return 2.0 * jnp.pi / p.w


def judged(model: type, run: Any, **given: Any) -> dict[str, Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return gs.sweep(model, run=run, **given).manifest["self_check"]


@pytest.mark.slow
def test_whole_numbers_are_counts() -> None:
    """Phi is an angle, count a count as long as both runs give whole numbers."""
    model, whole = Wheel(), np.array([[3.0], [np.nan], [6.0]])
    assert counted(model, whole, whole + 1.0).tolist() == [True]
    assert counted(model, whole, whole + 1e-9).tolist() == [False]
    assert counted(Rotor(), whole).tolist() == [False]
    assert judged(Wheel, gs.ReturnMap(crossings=3), teeth=[3.0, 30.0])["verdict"] == "passed"


@pytest.mark.slow
def test_an_observable_of_any_unit_is_judged_by_its_size() -> None:
    """Steps of 0.39 s of Runge and Kutta's method lose a phase of some tenths in 200 s."""
    result = judged(Spring, gs.FixedTime(duration=200.0), numerics={"method": "rk4", "dt": 0.39})
    assert (result["verdict"], result["moved"]) == ("warned", 1)
    result = judged(Spring, gs.FixedTime(duration=20.0))
    assert (result["verdict"], result["sensitive"]) == ("passed", 0)


@pytest.mark.slow
def test_rounding_of_an_observable_that_the_section_keeps_at_0_is_no_change() -> None:
    """The speed at crossings is some 1e-6 um/s, and 1e6 um/s between them."""
    result = judged(
        Relaxation, gs.ReturnMap(crossings=10, after_cycles=10), numerics={"method": "rk4", "dt": 0.01}
    )
    assert (result["verdict"], result["sensitive"]) == ("passed", 0)
    assert result["largest"]["v"] > 1e-7


def test_the_time_of_a_crossing_is_compared() -> None:
    """A step of many periods passes over crossings; phi is 0 at all of them, so only their times tell."""
    steps = {"method": "rk4", "dt": 0.19}
    result = judged(Rotor, gs.ReturnMap(crossings=4), w=[1.0, 3000.0], numerics=steps)
    assert (result["verdict"], result["moved"], result["worst"]["name"]) == ("warned", 1, "t")
    assert judged(Rotor, gs.ReturnMap(crossings=4), w=[1.0, 5.0])["verdict"] == "passed"


@pytest.mark.slow
def test_rows_that_do_not_cross_the_section_are_compared_beside_those_that_do() -> None:
    steps = {"method": "rk4", "dt": 1.0 / 16.0}
    for every in ([1e9], [1e9, 3.0]):
        result = judged(Latch, gs.Trace(duration=4.0, every=2.0), every=every, numerics=steps)
        assert (result["verdict"], result["moved"]) == ("warned", 1)


def test_events_that_all_steps_miss_are_detected() -> None:
    """Every step of 2 s / 32, and of half of it, ends at a multiple of itself."""
    steps = {"method": "rk4", "dt": 2.0 / 32.0}
    result = judged(Pulses, gs.Settle(max_cycles=60), width=[0.01, 0.015], numerics=steps)
    assert (result["verdict"], result["moved"]) == ("warned", 2)
    assert result["largest"]["u"] > 0.1  # the run's own is 0


@pytest.mark.slow("ramp", "staircase", "trace")
@pytest.mark.parametrize(
    "run",
    [
        {"kind": "settle", "max_cycles": 2000, "tolerance": 1e-4},
        {"kind": "return_map", "crossings": 12},
        {"kind": "trace", "duration": 3.0, "every": 0.5},
        {"kind": "staircase", "parameter": "lean", "path": [0.0, 0.1], "step": 0.05, "dwell": 30.0},
        {"kind": "ramp", "parameter": "lean", "path": [0.0, 0.1], "rate": 0.01},
    ],
    ids=lambda run: run["kind"],
)
def test_stored_rows_that_are_not_reproduced_are_detected(
    tmp_path: Path, run: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    fields: dict[str, Any] = {"vary": {"x_0": [0.5, 0.8]}, "run": run}
    assert checked(tmp_path / "same", **fields)["stored_differs"] == 0

    def altered(*given: Any, **more: Any) -> pd.DataFrame:
        table = gs.load(*given, **more)
        names = [name for name in table.columns if name in ("x", "x_n", "x_end")]
        assert len(names) == 1
        table[names[0]] = table[names[0]] + np.where(table["row"] == 1, 1e-4, 0.0)
        return table

    monkeypatch.setattr(directory, "load", altered)
    result = checked(tmp_path / "other", warns=True, **fields)
    assert (result["verdict"], result["stored_differs"]) == ("warned", 1)
    assert "run the job into a new directory" in advice({"stored_differs": 1}, None)


@pytest.mark.slow
def test_an_observable_that_is_unknown_at_first_is_reproduced() -> None:
    result = judged(Counted, gs.ReturnMap(crossings=4), w=[1.0, 1.1])
    assert (result["verdict"], result["stored_differs"]) == ("passed", 0)


@pytest.mark.parametrize(
    "run", [SETTLE, {"kind": "return_map", "crossings": 12}], ids=lambda run: run["kind"]
)
def test_a_stored_value_that_is_lost_is_detected(
    tmp_path: Path, run: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def altered(*given: Any, **more: Any) -> pd.DataFrame:
        table = gs.load(*given, **more)
        (name,) = {"x_n", "x_end"} & set(table.columns)
        table[name] = table[name].where(table["row"] != 1)
        return table

    monkeypatch.setattr(directory, "load", altered)
    result = checked(tmp_path, warns=True, vary={"x_0": [0.5, 0.8]}, run=run)
    assert (result["verdict"], result["stored_differs"]) == ("warned", 1)


def test_a_value_that_one_of_two_runs_lacks_is_a_change() -> None:
    """Times and places over three crossings; after its end a row has no values."""
    once = np.array([[[0.0, 1.0], [1.0, np.nan], [np.nan, np.nan]], [[0.0, 1.0], [1.0, 2.0], [2.0, 3.0]]])
    again = np.array([[[0.0, 1.0], [1.0, 2.0], [2.0, 3.0]], [[0.0, 1.0], [1.0, 2.5], [np.nan, np.nan]]])
    assert _largest_change(DoubleWell(), once, again).tolist() == [[np.inf], [0.5]]


@pytest.mark.filterwarnings("error")
def test_observables_without_a_size_do_not_hide_changes() -> None:
    """Crossings at one instant, or a single one, have no interval; the change of x is still the worst."""
    result = SelfCheck(rows=3, of=3, finer="half the step")
    late, interval = np.array([[0.0], [0.0], [1e-9]]), np.array([[0.0], [np.nan], [np.nan]])
    result.record_changes((gs.Quantity("x", "m", "position"),), np.full((3, 1), 1e-6), np.ones(1))
    result.record_changes((gs.Quantity("t", "s", "time"),), late, interval)
    assert (result.worst["name"], result.largest) == ("x", {"x": 1e-6, "t": 1e-9})
    hidden = SelfCheck(rows=1, of=1, finer="half the step")
    size = np.array([1.0, np.nan])
    quantities = (gs.Quantity("x", "m", "position"), gs.Quantity("v", "m/s", "speed"))
    hidden.record_changes(quantities[:1], np.array([[1e-6], [2e-6]]), size[:, None])
    hidden.record_changes(quantities[1:], np.array([[1e-7]]), np.ones(1))
    assert hidden.worst["name"] == "x", "one row of unknown size hides no other"
    hidden.record_changes((gs.Quantity("t", "s", "time"),), np.array([[1e-3]]), np.zeros((1, 1)))
    assert hidden.worst["name"] == "t", "a change of what has no size is one beyond any size"


class TwoOscillators(gs.DeclaredModel):
    """Two phase oscillators, coupled: in phase they are stable if K > 0, in antiphase if K < 0.

    The section is a clock's, so that oscillators in phase stay alike to the last bit.
    """

    omega = gs.parameter("rad/s", "frequency", 2.0 * np.pi)
    K = gs.parameter("rad/s", "coupling", 1.0)
    first = gs.variable("rad", "phase of the first", 0.0, circular=True)
    second = gs.variable("rad", "phase of the second", 0.0, circular=True)
    clock = gs.variable("rad", "clock", 0.0)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        pull = p.K * jnp.sin(s.second - s.first)
        return {"first": p.omega + pull, "second": p.omega - pull, "clock": p.omega}

    @gs.event("turn", section=True)
    def turn(self, p: Any, s: Any) -> Any:
        return s.clock - 2.0 * jnp.pi

    @turn.jump
    def back(self, p: Any, s: Any) -> Any:
        return s.replace(clock=s.clock - 2.0 * jnp.pi)

    def period(self, p: Any) -> Any:
        return 2.0 * np.pi / p.omega


class MergingLegs(gs.DeclaredModel):
    """Four phases that start differently: a landing draws the others by K (sin d + sin(d)^3), d their lead.

    In phase they merge if K > 0; at K = 0 a pitchfork makes this gait unstable.
    """

    omega = gs.parameter("rad/s", "frequency", 2.0 * np.pi)
    K = gs.parameter("1", "coupling", 0.1)
    phase = gs.variable("rad", "phase of leg {}", (0.0, 0.3, 0.6, 0.9), count=4, circular=True)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"phase": p.omega + 0.0 * s.phase}

    @gs.event("leg {} lands", count=4, section="first")
    def landing(self, p: Any, s: Any) -> Any:
        return s.phase - 2.0 * jnp.pi

    @landing.jump
    def draw(self, p: Any, s: Any, leg: int) -> Any:
        lead = s.phase - s.phase[leg]
        drawn = s.phase - p.K * (jnp.sin(lead) + jnp.sin(lead) ** 3)
        return s.replace(phase=jnp.where(jnp.arange(4) == leg, s.phase - 2.0 * jnp.pi, drawn))

    def period(self, p: Any) -> Any:
        return 2.0 * np.pi / p.omega


SLOW = pytest.mark.slow
UP, DOWN = [0.5, 0.1], [0.5, -0.5]
OVER: dict[str, Any] = {"parameter": "K", "path": [0.1, -0.1], "step": 0.02, "dwell": 40.0}
WELLS: dict[str, Any] = {"max_cycles": 2000, "tolerance": 1e-6}
PUSHED = gs.Perturb(push=["first"], max_cycles=60)


@pytest.mark.slow("TwoOscillators-run0-axes0-2")
@pytest.mark.parametrize(
    ("model", "run", "axes", "unstable"),
    [
        (TwoOscillators, gs.Settle(max_cycles=60), {"K": [-0.2, 0.2], "second_0": [0.0, np.pi]}, 2),
        pytest.param(
            TwoOscillators, gs.Staircase(parameter="K", path=DOWN, step=0.25, dwell=30.0), {}, 1, marks=SLOW
        ),
        pytest.param(
            TwoOscillators, gs.Staircase(parameter="K", path=UP, step=0.2, dwell=30.0), {}, 0, marks=SLOW
        ),
        pytest.param(TwoOscillators, gs.Ramp(parameter="K", path=DOWN, rate=0.05), {}, 1, marks=SLOW),
        pytest.param(TwoOscillators, gs.Ramp(parameter="K", path=UP, rate=0.05), {}, 0, marks=SLOW),
        pytest.param(MergingLegs, gs.Staircase(**OVER), {}, 1, marks=SLOW),
        pytest.param(MergingLegs, gs.Staircase(**{**OVER, "path": [0.1, 0.05]}), {}, 0, marks=SLOW),
        pytest.param(TwoOscillators, PUSHED, {"K": [-0.2, 0.2], "push_first": [0.0]}, 1, marks=SLOW),
        pytest.param(DoubleWell, gs.Settle(**WELLS), {"x_0": [0.0, 0.5]}, 1, marks=SLOW),
    ],
)
def test_rows_that_stay_on_an_unstable_gait_are_marked(
    model: type[Model], run: RunKind, axes: Any, unstable: int
) -> None:
    """Two move apart by exp(-2 K) in a cycle in phase, by exp(2 K) in antiphase; 0 lies between the wells."""
    wrong = pytest.warns(UserWarning, match="unstable gait") if unstable else contextlib.nullcontext()
    with wrong:
        result = gs.sweep(model, run=run, verify=4, **axes)
    check = result.manifest["self_check"]
    assert check["unstable"] == unstable
    if unstable and "K" in axes:
        assert check["unstable_first"]["K"] == -0.2
        assert "on an unstable gait" in self_check_sentence(check)
        assert "(first row 0 at K = -0.2" in self_check_sentence(check)
    elif unstable and model is TwoOscillators:  # stairs and ramps from K = 0.5 down, in phase
        assert -0.3 < check["unstable_first"]["K"] <= 0.0


class Shear(gs.DeclaredModel):
    """The origin of a linear return map: x -> a x + g y, y -> a y; displacements grow g-fold, then as a^n."""

    a = gs.parameter("1", "multiplier", 0.5)
    g = gs.parameter("1", "shear", 1e4)
    x = gs.variable("1", "x", 0.0)
    y = gs.variable("1", "y", 0.0)
    clock = gs.variable("s", "clock", 0.0, observed=False)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": 0.0 * s.x, "y": 0.0 * s.y, "clock": 1.0}

    @gs.event("1 s is over", section=True)
    def tick(self, p: Any, s: Any) -> Any:
        return s.clock - 1.0

    @tick.jump
    def image(self, p: Any, s: Any) -> Any:
        return s.replace(x=p.a * s.x + p.g * s.y, y=p.a * s.y, clock=s.clock - 1.0)

    def period(self, p: Any) -> Any:
        return 1.0 + 0.0 * p.a


@pytest.mark.slow
def test_transient_growth_at_a_stable_gait_is_no_instability() -> None:
    """With a = 0.5 displacements grow ten-thousandfold before they decay; with a = 1.2 they grow for good."""
    result = judged(Shear, gs.Settle(max_cycles=60), a=[0.5, 1.2])
    assert (result["verdict"], result["unstable"]) == ("warned", 1)
    assert result["unstable_first"] == {"row": 1, "a": 1.2}


class Well(gs.DeclaredModel):
    """A point between two wells, 0.2 mm apart."""

    rate = gs.parameter("1/s", "rate", 0.5)
    x = gs.variable("m", "place", 0.0, scale=1e-4)
    clock = gs.variable("s", "clock", 0.0, observed=False)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": p.rate * (s.x - 1e8 * s.x**3), "clock": 1.0}

    @gs.event("1 s is over", section=True)
    def tick(self, p: Any, s: Any) -> Any:
        return s.clock - 1.0

    @tick.jump
    def again(self, p: Any, s: Any) -> Any:
        return s.replace(clock=s.clock - 1.0)

    def period(self, p: Any) -> Any:
        return 1.0 + 0.0 * p.rate


@pytest.mark.slow
def test_states_are_displaced_by_the_scale_of_their_coordinates() -> None:
    """Displaced by a share of 0.1 m, the state at 0 would come to the other wells within a share of it."""
    result = judged(Well, gs.Settle(max_cycles=100), x_0=[0.0, 5e-5])
    assert (result["unstable"], result["unstable_first"]) == (1, {"row": 0, "x_0": 0.0})
    assert judged(Well, gs.Settle(max_cycles=100), x_0=[0.0, 5e-5], rate=-0.5)["unstable"] == 0


@pytest.mark.parametrize(
    ("growth", "smooth", "share", "unstable"),
    [(1.5, False, 1.0, True), (0.5, False, 1.0, False), (0.5, True, unstable_rests.SMALLER, False)],
)
def test_orbits_of_other_periods_have_no_influence(
    growth: float, smooth: bool, share: float, unstable: bool
) -> None:
    """An orbit of two crossings beside a stable one of three; deviations grow by a factor, up to 0.1."""

    def follow(points: Points, values: Any, width: int) -> Any:
        x = points.at[:, 0]
        place = np.round(x)
        beyond = x - place
        after = np.where(place < 5.0, 1.0 - place, 10.0 + np.mod(place - 9.0, 3.0))
        factor = np.where(place < 5.0, growth, 0.5)
        image = after + np.clip(factor * beyond, -0.1, 0.1)
        sound = np.ones(len(x), bool)
        return unstable_rests._Images(Points(image[:, None], points.modes), sound, {"x": image})

    starts = np.array([[0.0], [10.0]])
    place = (gs.Quantity("x", "m", "place"),)
    mapping: Any = SimpleNamespace(
        model=SimpleNamespace(observables=place, original=None),
        coordinates=place,
        difference=np.subtract,
        sizes=lambda at: 0.1 + np.abs(at),
        distance=lambda a, b: np.abs(a - b).max(axis=-1),
    )
    displaced = unstable_rests._DisplacedStates(
        mapping,
        follow,
        Points(starts, ()),
        {},
        starts,
        np.zeros(0, bool),
        np.array([2, 3]),
        smooth=smooth,
        share=share,
    )
    assert displaced.follow(10**6, lambda share: None).tolist() == [unstable, False]


def test_an_unknown_period_counts_as_one() -> None:
    mapping: Any = SimpleNamespace(sizes=np.abs)
    follow: Any = None
    displaced = unstable_rests._DisplacedStates(
        mapping,
        follow,
        Points(np.ones((2, 1)), ()),
        {},
        np.ones((2, 1)),
        np.zeros(0, bool),
        np.array([0, 2]),
        smooth=False,
        share=1.0,
    )
    assert displaced._period.tolist() == [1, 2]


class Limited(gs.DeclaredModel):
    """The map x -> m x / sqrt(1 + x^2 / 5) of an angle, with an unstable fixed point at 0 where m > 1."""

    m = gs.parameter("1", "multiplier", 1.05)
    x = gs.variable("rad", "angle", 0.0, circular=True)
    clock = gs.variable("s", "clock", 0.0, observed=False)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": 0.0 * s.x, "clock": 1.0}

    @gs.event("1 s is over", section=True)
    def tick(self, p: Any, s: Any) -> Any:
        return s.clock - 1.0

    @tick.jump
    def image(self, p: Any, s: Any) -> Any:
        return s.replace(x=p.m * s.x / jnp.sqrt(1.0 + 0.2 * s.x**2), clock=s.clock - 1.0)

    def period(self, p: Any) -> Any:
        return 1.0 + 0.0 * p.m


@pytest.mark.slow
def test_a_row_beside_an_unstable_gait_is_marked() -> None:
    """The row itself leaves before its copies, which are displaced by less, are far from it."""
    assert judged(Limited, gs.Settle(max_cycles=60), m=[1.05], x_0=1e-7)["unstable"] == 1
    assert judged(Limited, gs.Settle(max_cycles=60), m=[0.95], x_0=1e-7)["unstable"] == 0


class Pair(gs.DeclaredModel):
    """An oscillator whose phase defines the section, and one that follows it: in phase if they are alike."""

    detuning = gs.parameter("rad/s", "difference of frequencies", 0.0)
    K = gs.parameter("rad/s", "coupling", 1.0)
    phi = gs.variable("rad", "phase of oscillator {}", (0.0, 0.0), count=2, circular=True)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        pull = p.detuning + p.K * jnp.sin(s.phi[0] - s.phi[1])
        return {"phi": 2.0 * jnp.pi + jnp.stack([0.0 * pull, pull])}

    @gs.event("oscillator {} turns", count=2, section="first")
    def turn(self, p: Any, s: Any) -> Any:
        return s.phi - 2.0 * jnp.pi

    @turn.jump
    def back(self, p: Any, s: Any, leg: int) -> Any:
        return s.replace(phi=s.phi.at[leg].add(-2.0 * jnp.pi))

    def period(self, p: Any) -> Any:
        return 1.0 + 0.0 * p.K


@pytest.mark.slow
def test_the_phase_of_the_section_is_no_sign_of_symmetry(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first phase is 0 at each crossing of every row; the second is, too, on the symmetric gait alone."""
    settle = gs.Settle(max_cycles=60)
    result = judged(Pair, settle, K=[-0.2, 0.2])
    assert (result["unstable"], result["unstable_first"]) == (1, {"row": 0, "K": -0.2})
    result = judged(
        Pair, settle, K=[30.0, 25.0, -0.2]
    )  # the first two attract their displaced starts at once
    assert (result["unstable"], result["unstable_first"]) == (1, {"row": 2, "K": -0.2})

    def follows(*_: Any) -> Any:
        raise AssertionError("no row rests on a symmetric gait")

    monkeypatch.setattr(unstable_rests, "followed", follows)
    assert judged(Pair, settle, K=[1.0, 2.0], detuning=[0.5])["verdict"] == "passed"


class Ledge(gs.DeclaredModel):
    """A point that stays on a narrow ledge, around x = 0.13 m, or falls at once."""

    rate = gs.parameter("1/s", "rate of settling", 2.0)
    x = gs.variable("m", "place", 0.0)
    clock = gs.variable("s", "clock", 0.0, observed=False)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": -p.rate * (s.x - 0.13), "clock": 1.0}

    @gs.event("1 s is over", section=True)
    def tick(self, p: Any, s: Any) -> Any:
        return s.clock - 1.0

    @tick.jump
    def again(self, p: Any, s: Any) -> Any:
        return s.replace(clock=s.clock - 1.0)

    def failed(self, p: Any, s: Any) -> Any:
        """The point is beside the ledge."""
        return jnp.abs(s.x - 0.13) > 0.03

    def period(self, p: Any) -> Any:
        return 1.0 + 0.0 * p.rate


@pytest.mark.parametrize("when", ["after", "beside"])
def test_settled_rows_are_added_to_a_sample_without_one(
    tmp_path: Path, when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One row of 40 settles, and it is none of the four sampled ones."""
    monkeypatch.setattr(execute, "_rows_leave_the_host_idle", lambda _: when == "beside")
    fields: dict[str, Any] = {
        "model": "test_self_check:Ledge",
        "vary": {"x_0": {"linspace": [-1, 1, 40]}},
        "run": {"kind": "settle", "max_cycles": 60},
        "verify": 4,
    }
    result = checked(tmp_path, **fields)
    assert (result["verdict"], result["rows"], result["added"]) == ("passed", 5, 1)
    assert result["largest"]["x"] < 1e-3

    def again(*_: Any) -> Any:
        raise AssertionError("the self-check is complete")

    monkeypatch.setattr(concurrent_self_check, "self_check", again)
    assert checked(tmp_path, **fields) == result


class Dropped(gs.MjcfModel):
    """A ball whose bounces take a few steps, and change with finer ones."""

    body_file = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="1 1 .1"/>
      <body pos="0 0 .1"><joint name="z" type="slide" axis="0 0 1"/>
        <geom type="sphere" size=".1" mass="1" solref="-400000 -5"/></body></worldbody></mujoco>"""
    turns = gs.parameter("1", "nominal cycles a second", 1.0)

    def control(self, p: Any, s: Any) -> Any:
        return jnp.zeros(0)

    def period(self, p: Any) -> Any:
        return 1.0 / p.turns

    @gs.observable("m", "height", scale=0.1)
    def height(self, p: Any, s: Any) -> Any:
        return s.body.q[0]


@pytest.mark.slow
def test_rows_of_a_stepped_body_that_change_much_with_its_step_are_marked() -> None:
    """The first row does not land in time, and its flight changes by 8 mm, less than a tenth of 0.1 m."""
    run = {"kind": "fixed_time", "duration": 0.5}
    table = gs.sweep(Dropped(dynamics="mujoco"), z_0=[3.0, 0.1, 0.2, 0.3], run=run).table
    check = table.attrs["manifest"]["self_check"]
    marked = check["by_step"]
    assert check["verdict"] == "passed"
    assert 1 <= marked <= 3
    assert f"{marked} changed by more than a tenth" in self_check_sentence(check)
    assert remarks(table) == [f"self-check: {marked} of 4 rows depend on the model's step"]


def test_states_before_jumps_are_followed_first() -> None:
    """Of many states that rest, those before the largest changes and evenly spaced others are displaced."""
    ahead = np.zeros(1000)
    ahead[[333, 667]] = 1.0
    places = followed(ahead, 8)
    assert {0, 333, 667, 999} <= set(places)
    assert len(places) <= 8
    np.testing.assert_array_equal(followed(ahead[:5], 8), np.arange(5))


class Scramble(gs.DeclaredModel):
    """A map that multiplies errors by 1000 each cycle, and gaits by the half of x."""

    gaits = ("low", "high")
    factor = gs.parameter("1", "factor of a cycle", 1000.0)
    phi = gs.variable("rad", "clock", 0.0, observed=False)
    x = gs.variable("1", "state", 0.3, scale=1.0)

    def flow(self, p, s):
        return {"phi": 1.0, "x": -0.1 * s.x * jnp.cos(s.phi) ** 2}

    @gs.event("it ticks", section=True)
    def tick(self, p, s):
        return s.phi - 1.0

    @tick.jump
    def again(self, p, s):
        return s.replace(phi=0.0, x=jnp.mod(p.factor * s.x, 1.0))

    def period(self, p):
        return 1.0 + 0.0 * p.factor

    def label(self, p, at):
        return {"gait": jnp.where(at["x"] < 0.5, 0, 1)}


@pytest.mark.slow
def test_a_row_that_is_sensitive_at_its_end_and_before_counts_once() -> None:
    """Of chaotic rows that do not settle, ends and first crossings differ."""
    result = judged(Scramble, gs.Settle(max_cycles=25), x_0=np.linspace(0.1, 0.9, 40), verify=12)
    assert result["verdict"] == "passed"
    assert 0 < result["sensitive"] <= result["rows"] == 12
