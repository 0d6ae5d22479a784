"""Events: sections by a plane, flows without any, and stalled rows with the names of their guards."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import gaitsweep as gs
from firing_neuron import Neuron
from gaitsweep import models
from gaitsweep.cli import show
from gaitsweep.contract import HybridModel
from gaitsweep.dynamics.event_declarations import EventSurface
from gaitsweep.engine.carry import packed, unpacked
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder, FixedTimeRecorder, TraceRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.examples.lorenz import Lorenz
from gaitsweep.models.conformity import fault
from gaitsweep.status import Status
from gaitsweep.table import Snapshot
from smooth_oscillators import Spring, VanDerPol
from tests.support.sweeping import run_rows
from toy_model import Toy, flight_time

ENGINES = ("xla", "kernel")


def crossings(model: HybridModel, count: int, starts: dict[str, Any], **options: Any) -> np.ndarray:
    """The records (rows, count + 1, crossing t and observables) of rows that all complete."""
    result = run_rows(model, CrossingRecorder(model, count), starts, **options)
    assert set(result.status.tolist()) == {Status.complete}
    return result.samples.reshape(result.status.size, count + 1, -1)


# Sections by a plane


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_crossings_of_lorenz_are_scipys(engine: str) -> None:
    """The first ten crossings downwards: DOP853 at 1e-13 is right to 1e-11 there, as a step of 0.25 ms is."""

    def flow(t: float, at: np.ndarray) -> list[float]:
        x, y, z = at
        return [10.0 * (y - x), x * (28.0 - z) - y, x * y - 8.0 / 3.0 * z]

    def plane(t: float, at: np.ndarray) -> float:
        return at[2] - 27.0

    plane.direction = -1  # type: ignore[attr-defined]
    true = solve_ivp(flow, (0.0, 12.0), [1.0, 1.0, 1.0], "DOP853", events=plane, rtol=1e-13, atol=1e-13)
    (at,) = crossings(Lorenz(), 10, {"x_0": 1.0}, numerics=Numerics(dt=2.5e-4), engine=engine)
    np.testing.assert_allclose(at[1:, 1], true.t_events[0][:10], rtol=0, atol=1e-10)
    np.testing.assert_allclose(at[1:, 2:], true.y_events[0][:10], rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_van_der_pol_crosses_once_a_cycle(engine: str) -> None:
    """The period at mu = 1 is 6.6632868593 (Andersen and Geer 1982, SIAM J. Appl. Math. 42:678).

    All starts lie on the plane v = 0 but one: none of them is a crossing, whichever way it moves.
    """
    starts = {"x_0": [2.0, -2.0, 0.5, 2.0, 2.0, 0.0], "v_0": [0.0, 0.0, 0.0, 1e-17, -1e-17, 1.0]}
    at = crossings(VanDerPol(), 30, starts, numerics=Numerics(dt=2e-3), engine=engine)
    t = at[:, :, 1]
    np.testing.assert_allclose(t[:, -1] - t[:, -2], 6.6632868593, rtol=0, atol=1e-9)
    assert np.all(np.diff(t[:, 1:]) > 5.0)
    assert np.all(at[:, 1:, 2] < 0.0), "upwards through v = 0 where x is least"
    # from x = 2 the first crossing is half a cycle away, from x = -2, where it moves up, a whole one
    np.testing.assert_allclose(t[[0, 1], 1], [3.32, 6.65], rtol=0, atol=0.01)
    # events are located to 1e-12 of the nominal period
    np.testing.assert_allclose(t[[3, 4], 1], t[0, 1], rtol=0, atol=1e-11)


@pytest.mark.slow
def test_van_der_pol_settles_on_its_cycle() -> None:
    model = VanDerPol()
    result = run_rows(model, SettleRecorder(model), {"x_0": [0.5, 3.0]}, params={"mu": [1.0, 5.0]})
    assert result.status.tolist() == [Status.settled] * 2
    assert result.numbers["period"].tolist() == [1, 1]
    # the amplitude at mu = 1 is 2.00862
    assert abs(result.last[0, 0] + 2.00862) < 1e-4


@pytest.mark.slow
@settings(max_examples=50)
@given(
    size=st.sampled_from([1e-8, 1.0, 1e8]),
    wave=st.lists(st.floats(-1.0, 1.0), min_size=5, max_size=40),
)
def test_each_crossing_of_any_wave_is_met_once(size: float, wave: list[float]) -> None:
    """The guards, looked at along a polygon: as many crossings as sign changes upwards, none at the start."""
    points = [value if abs(value) > 1e-6 else 0.0 for value in wave]
    seen = [EventSurface.seen_from(jnp.array([value, 1.0]), lambda x: size * x[0]) for value in points]
    mode = seen[0].begun(seen[0].rounding, jnp.ones(()), turned=False)
    met = 0
    for surface, rate in zip(seen, np.diff(points, prepend=points[0] - 1.0), strict=True):
        for _ in range(2):  # what fires at one instant
            fired = surface.guards(mode) >= 0.0
            assert not fired.all()
            met += int(fired[0])
            if fired.any():
                mode = surface.jumped(mode, *fired, surface.rounding, jnp.asarray(rate), impact=False)
        assert not (surface.guards(mode) >= 0.0).any(), "it chatters"
    below = [value < 0.0 for value in points]
    assert met == sum(1 for before, after in itertools.pairwise(below) if before and not after)


def test_rounding_of_a_surface_is_not_its_far_side() -> None:
    """X - 1e6 is known to 1e-10: a state nearer than that lies on the surface, and has crossed it."""
    for distance, armed in ((1e-8, True), (1e-10, False), (0.0, False), (-1e-10, False)):
        surface = EventSurface.seen_from(jnp.asarray(1e6 - distance), lambda x: x - 1e6)
        assert bool(surface.begun(surface.rounding, jnp.ones(()), turned=False).armed) is armed


# No events at all


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_a_flow_without_guards_runs(engine: str) -> None:
    model, options = Spring(), {"numerics": Numerics(dt=2e-3), "engine": engine}
    assert fault(model) is None
    traced = run_rows(model, TraceRecorder(model, 2.0, 0.25), {"x_0": 1.0}, **options)
    t, x, v = traced.samples.T
    np.testing.assert_allclose(x, np.cos(2.0 * t), rtol=0, atol=1e-10)
    np.testing.assert_allclose(v, -2.0 * np.sin(2.0 * t), rtol=0, atol=1e-10)
    held = run_rows(model, FixedTimeRecorder(model, 3.0), {"x_0": 1.0}, **options)
    assert (Status(held.status[0]).name, held.cycles[0], held.t_end[0]) == ("complete", 0, 3.0)
    # there is no section to settle on: the row comes to its limit of time
    never = run_rows(model, SettleRecorder(model, 5), {"x_0": 1.0}, **options)
    assert Status(never.status[0]).name == "time_limit"


@pytest.mark.slow
def test_a_job_of_a_flow_without_guards(tmp_path: Path) -> None:
    job = {
        "name": "spring",
        "model": "smooth_oscillators:Spring",
        "vary": {"k": {"values": [1.0, 4.0]}},
        "run": {"kind": "trace", "duration": 1.0, "every": 0.5},
        "numerics": {"dt": 1e-3},
    }
    table = gs.run(gs.Job.model_validate(job), tmp_path / "out").table
    np.testing.assert_allclose(table["x"], np.cos(np.sqrt(table["k"]) * table["t"]), rtol=0, atol=1e-12)
    assert np.all(table["stalled_by"].isna())


# Rows that events stall


class Masses(Toy):
    """Masses whose guards have names."""

    @property
    def guard_names(self) -> tuple[str, ...]:
        return tuple(f"mass {i} lands" for i in range(1, self.N + 1))


def stalls(model: str, **fields: Any) -> dict[str, Any]:
    """Masses that land on a floor that keeps them: their guards stay at zero."""
    return {
        "name": "stalls",
        "model": model,
        "structure": {"N": 2},
        "params": {"restitution": 0.0},
        "vary": {"zip": {"launch_1": {"values": [1.0, 1.0, 0.5]}, "launch_2": {"values": [2.0, 1.0, 3.0]}}},
        "start": {},
        "numerics": {"dt": 1e-3},
        **fields,
    }


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_a_stall_has_its_guards_and_its_time(engine: str, tmp_path: Path) -> None:
    job = stalls(
        "test_events:Masses",
        run={"kind": "settle", "max_cycles": 20},
        engine={"name": engine},
        params={"restitution": 0.0, "kicking": 0.0},
    )
    out = tmp_path / "out"
    table = gs.run(gs.Job.model_validate(job), out).table
    assert set(table["status"]) == {"event_stall"}
    messages = ["mass 1 lands", "mass 1 lands and mass 2 lands", "mass 1 lands"]
    assert table["stalled_by"].tolist() == messages
    times = [flight_time(launch, 2.0, 0.5) for launch in (1.0, 1.0, 0.5)]
    np.testing.assert_allclose(table["t_end"], times, rtol=0, atol=1e-9)
    line = show.outcome(Snapshot.of(out))
    assert f"2 event_stall: mass 1 lands, t = {times[2]:.6g} to {times[0]:.6g} s" in line
    assert f"1 event_stall: mass 1 lands and mass 2 lands, t = {times[0]:.6g} s" in line
    assert "mass 1 lands and mass 2 lands" in show.directory(Snapshot.of(out))


@pytest.mark.slow
def test_guards_without_names_are_reported_by_number(tmp_path: Path) -> None:
    """Tables of every run kind name guards by number."""
    runs = {
        "return_map": {"crossings": 40},
        "trace": {"duration": 2.0, "every": 0.5},
        "fixed_time": {"duration": 2.0},
        "ramp": {"parameter": "stiffness", "path": [4.0, 4.1], "rate": 0.05},
        "staircase": {"parameter": "stiffness", "path": [4.0, 4.1], "step": 0.1, "dwell": 1.0},
    }
    for kind, fields in runs.items():
        job = stalls("toy_model:Toy", run={"kind": kind, **fields})
        job["params"] = {"restitution": 0.0, "kicking": 0.0}
        table = gs.run(gs.Job.model_validate(job), tmp_path / kind).table
        assert set(table["status"]) == {"event_stall"}, kind
        last = table.drop_duplicates("row", keep="last")["stalled_by"].tolist()
        assert last == ["guard 1", "guard 1 and guard 2", "guard 1"], kind
        assert "event_stall: guard 1" in show.outcome(Snapshot.of(tmp_path / kind)), kind


class Alternating(Neuron):
    """A neuron whose potential alternates between two guards."""

    def guards(self, params, state):
        (fires,) = super().guards(params, state)
        return jnp.stack([-1.0 + 0.0 * fires, fires, jnp.where(fires < -3.0, 1.0, -1.0)])

    def jump(self, params, state, fired):
        after = super().jump(params, state, fired[1:2])
        return dataclasses.replace(after, v=jnp.where(fired[2], 2.5, after.v))

    def section(self, params, before, fired):
        return fired[1]


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_all_guards_of_a_chain_of_jumps_are_reported(engine: str) -> None:
    """A reset fires another guard, which reverses it: both at one instant, in separate jumps."""
    model = Alternating()
    result = run_rows(
        model, SettleRecorder(model), {"v_0": np.zeros(3)}, params={"reset": [-0.5, 2.5, -2.0]}, engine=engine
    )
    assert [Status(code).name for code in result.status] == ["settled", "event_stall", "event_stall"]
    fired = unpacked(result.fired)[:, :3]
    np.testing.assert_array_equal(fired, [[False] * 3, [False, True, False], [False, True, True]])
    np.testing.assert_allclose(result.t_end[1:], np.arctan(2.0), rtol=0, atol=1e-8)


def test_more_guards_than_fit_in_one_number() -> None:
    """The chain of 65 legs has 130."""
    fired = np.zeros(130, bool)
    fired[[0, 31, 32, 63, 64, 129]] = True
    words = np.asarray(packed(jnp.asarray(fired)))
    # as a kernel's slots hold them
    words = words.astype(np.float64).astype(np.int64)
    np.testing.assert_array_equal(np.flatnonzero(unpacked(words[None, :])[0]), np.flatnonzero(fired))


def test_shipped_models_name_their_guards() -> None:
    for name in models.names():
        model = models.find(name)()
        if isinstance(model, HybridModel):
            assert fault(model) is None
            assert model.guard_names, name
            assert len(set(model.guard_names)) == len(model.guard_names)


def test_names_that_are_too_few_are_refused() -> None:
    class Few(Alternating):
        @property
        def guard_names(self) -> tuple[str, ...]:
            return ("one", "two")

    assert fault(Few()) == "but its function guard_names returns 2 names, but guards returns 3 numbers."


@pytest.mark.slow
def test_a_row_that_makes_too_many_steps_is_not_stalled() -> None:
    """A row whose steps stay short reaches the limit of steps without a jump at one instant."""

    class Brief(SettleRecorder):  # pyright: ignore[reportGeneralTypeIssues] (only a test sets this limit)
        def max_attempts(self, params, dt):
            return jnp.asarray(200.0)

    model = Neuron()
    result = run_rows(model, Brief(model), {"v_0": 0.0}, params={"current": 1.0}, numerics=Numerics(dt=1e-5))
    assert Status(result.status[0]).name == "step_limit"
    assert not result.fired.any()
