"""Staircases: a parameter held on stairs, against piecewise trajectories by SciPy."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from firing_neuron import Neuron
from gaitsweep.contract import Quantity, SteppedModel
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.parameter_schedules import StepSchedule
from gaitsweep.engine.recorders.staircase import StepRecorder
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.status import Status
from tests.support.sweeping import run_rows
from toy_model import Toy

NUMERICS = Numerics(dt=1e-2)


def climb(stairs: StepSchedule, parameter: str, starts: dict[str, Any], **options: Any) -> RowOutcome:
    """Rows of the toy on a staircase of one of its parameters."""

    def drive(values: Any, t: jax.Array) -> Any:
        return Toy().params({**values, parameter: stairs.at(t)})

    options = {"numerics": NUMERICS, **options}
    return run_rows(Toy(), StepRecorder(Toy(), stairs), starts, drive=drive, **options)


# The path


@pytest.mark.slow
def test_each_pass_has_equal_stairs_and_its_turning_value_once() -> None:
    stairs = StepSchedule((2.0, 3.2, 2.7, 2.7001), step=0.4, dwell=3.0, first_dwell=5.0)
    assert stairs.lengths == [3, 2, 1]
    value = stairs.value(jnp.arange(7.0))
    np.testing.assert_allclose(value, [2.0, 2.4, 2.8, 3.2, 2.95, 2.7, 2.7001], rtol=1e-15)
    assert [float(value[i]) for i in (0, 3, 5, 6)] == [2.0, 3.2, 2.7, 2.7001], "the path's own to the bit"
    np.testing.assert_array_equal(stairs.passes(np.arange(7)), [0, 0, 0, 0, 1, 1, 2])
    np.testing.assert_array_equal(stairs.end(np.arange(3)), [5.0, 8.0, 11.0])
    assert stairs.duration == 23.0
    fine = StepSchedule((2.0, 3.2), 0.05, 1.0)
    assert len(fine.value(jnp.arange(25.0))) == fine.count
    many = StepSchedule((0.0, 0.98, 0.0), 0.02, 1.0)
    assert many.value(jnp.arange(99.0))[jnp.array([0, 49, 98])].tolist() == [0.0, 0.98, 0.0]


@pytest.mark.slow
@settings(max_examples=60)
@given(
    values=st.lists(st.floats(-9, 9), min_size=2, max_size=4, unique=True),
    step=st.floats(0.02, 9),
    dwell=st.floats(1e-2, 1e3),
    first=st.floats(0.01, 100),
    dtype=st.sampled_from([np.float64, np.float32]),
)
def test_a_stair_lasts_from_the_end_of_the_one_before(values, step, dwell, first, dtype) -> None:
    """The value at the time of a change is the new one, whatever the rounding; then it is constant."""
    stairs = StepSchedule(tuple(values), step, dwell, first * dwell)
    # always as many, since JAX compiles anew for other shapes
    some = np.round(np.linspace(0, stairs.count - 1, 64)).astype(dtype)
    after = np.minimum(some + 1, stairs.count - 1)
    np.testing.assert_array_equal(stairs.stair(stairs.end(some)), after)
    np.testing.assert_array_equal(stairs.stair(jnp.asarray(stairs.middle(some).astype(dtype))), some)
    apart = np.abs(stairs.value(jnp.asarray(after)) - stairs.value(jnp.asarray(some)))
    assert apart.max() <= step * (1 + 1e-9) + 64 * np.finfo(dtype).eps


# Along trajectories


def piecewise(launch: float, stairs: StepSchedule) -> np.ndarray:
    """Crossings and the last launch speed at the end of each stair of the toy's stiffness, by SciPy."""

    def landing(t: float, y: np.ndarray) -> float:
        return y[0]

    landing.terminal, landing.direction = True, -1  # type: ignore[attr-defined]
    y, t, crossings, last, rows = np.array([0.0, launch]), 0.0, 0, launch, []
    for number in range(stairs.count):
        stiffness, end = float(stairs.value(jnp.asarray(float(number)))), float(stairs.end(np.array(number)))
        while t < end:

            def flow(t: float, y: np.ndarray, stiffness: float = stiffness) -> list[float]:
                return [y[1], -stiffness * (y[0] + 0.5)]

            part = solve_ivp(flow, (t, end), y, "DOP853", events=landing, rtol=1e-12, atol=1e-13)
            t, y = float(part.t[-1]), part.y[:, -1]
            if part.status == 1:
                last, crossings = 0.5 * abs(y[1]) + 0.5, crossings + 1
                y = np.array([0.0, last])
        rows.append([crossings, last])
    return np.array(rows)


@pytest.mark.slow
def test_the_parameter_is_held_on_each_stair_with_both_engines() -> None:
    """The stiffness changes in flight, so the energy depends on the time and the size of the change."""
    stairs = StepSchedule((4.0, 9.0, 3.0), step=1.7, dwell=3.3, first_dwell=4.1)
    kernel, xla = (
        climb(stairs, "stiffness", {"launch_1": [0.5, 2.0]}, engine=name) for name in ("kernel", "xla")
    )
    for result in (kernel, xla):
        assert np.all(result.status == Status.complete)
        np.testing.assert_allclose(result.t_end, stairs.duration, rtol=1e-14)
    np.testing.assert_array_equal(kernel.owner, xla.owner)
    np.testing.assert_allclose(kernel.samples, xla.samples, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(kernel.sample_labels["gait"], xla.sample_labels["gait"])
    for row, launch in enumerate((0.5, 2.0)):
        number, crossing, t, _, _, last = xla.samples[xla.owner == row].T
        np.testing.assert_array_equal(number, np.arange(stairs.count))
        np.testing.assert_allclose(t, stairs.end(number), rtol=1e-14)
        expected = piecewise(launch, stairs)
        np.testing.assert_array_equal(crossing, expected[:, 0])
        # rk4 of 0.01 s is right to 1e-9 here; a step held at a wrong value would be wrong by 1e-3
        np.testing.assert_allclose(last, expected[:, 1], rtol=0, atol=1e-8)


@pytest.mark.slow
def test_more_stairs_than_a_buffer_holds() -> None:
    """Each poll meets the end of another stair: the row waits until the host has read its buffer."""
    stairs = StepSchedule((1.0, 3.0), step=0.01, dwell=0.05)
    result = climb(stairs, "kick", {"launch_1": [1.0, 0.7]}, lanes=2)
    assert np.all(result.status == Status.complete)
    for row in (0, 1):
        np.testing.assert_array_equal(result.samples[result.owner == row, 0], np.arange(201))


@pytest.mark.slow
@pytest.mark.parametrize("crossings", [(9, 10), (10, 9)])
def test_a_stair_settles_after_ten_crossings_of_its_own(crossings: tuple[int, int]) -> None:
    """Each launch speed is the kick without restitution, so only the number of crossings decides."""
    kick, preload = 0.5, (0.5, 1.0)
    flight = np.arctan(kick / (2.0 * np.array(preload)))
    # the change comes at the apex, from where the mass falls with the new preload
    apex = np.hypot(preload[0], kick / 2.0) - preload[0]
    fall = 0.5 * np.arccos(preload[1] / (apex + preload[1]))
    first, dwell = (crossings[0] + 0.5) * flight[0], fall + (crossings[1] - 0.5) * flight[1]
    stairs = StepSchedule(preload, step=0.5, dwell=float(dwell), first_dwell=float(first))
    result = climb(stairs, "preload", {"launch_1": kick}, params={"restitution": 0.0, "kick": kick})
    assert np.diff(result.samples[:, 1], prepend=0.0).tolist() == list(crossings)
    assert result.samples[:, 3].tolist() == [n >= 10 for n in crossings]


@pytest.mark.slow
def test_an_observable_that_still_moves_is_not_settled() -> None:
    stairs = StepSchedule((0.5, 1.0, 0.5), step=0.25, dwell=25.0)
    slow = climb(stairs, "kick", {"launch_1": 0.5}, params={"restitution": 0.9})
    assert slow.samples[1:, 3].tolist() == [0.0] * 4
    assert climb(stairs, "kick", {"launch_1": 0.5}).samples[:, 3].tolist() == [1.0] * 5


@pytest.mark.slow
def test_events_of_a_new_value_happen_at_the_change() -> None:
    """The threshold falls below the potential, and the neuron fires at that instant."""
    model, first = Neuron(), 21.85
    period = np.arctan([2.0, 0.5]) - np.arctan(-1.0)
    crossed, begun = np.divmod(first - np.arctan(2.0), period[0])
    crossed += 1  # the first firing, from the start
    assert 0.5 < np.tan(begun + np.arctan(-1.0)) < 2.0, "the potential at the change"
    for dwell, more in ((7.99 * period[1], 8), (8.01 * period[1], 9)):
        stairs = StepSchedule((2.0, 0.5), step=2.0, dwell=float(dwell), first_dwell=first)

        def drive(values: Any, t: jax.Array, stairs: StepSchedule = stairs) -> Any:
            return model.params({**values, "threshold": stairs.at(t)})

        recorder = StepRecorder(model, stairs)
        result = run_rows(model, recorder, {"v_0": 0.0}, numerics=NUMERICS, drive=drive, engine="kernel")
        assert result.samples[:, 1].tolist() == [crossed, crossed + more]


@functools.partial(jax.tree_util.register_dataclass, data_fields=["angle", "turned"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Wheel:
    """An angle in turns, and all that was turned up to the last crossing."""

    angle: jax.Array
    turned: jax.Array


@dataclasses.dataclass(frozen=True)
class Turning(SteppedModel):
    """A wheel with a step of its own; each whole turn is a crossing, read at the step's end."""

    name: ClassVar[str] = "turning"
    source: ClassVar[str] = "this file"
    gaits: ClassVar[tuple[str, ...]] = ("turning",)
    parameters = (Quantity("rate", "1/s", "turns a second", 1.0),)  # pyright: ignore
    initial_conditions = (Quantity("angle", "1", "angle in turns", 0.0),)  # pyright: ignore
    observables = (Quantity("turned", "1", "turned up to the crossing"),)  # pyright: ignore
    signals = ()  # pyright: ignore

    def params(self, values):
        return {"rate": jnp.asarray(values["rate"])}

    def init(self, params, start):
        return Wheel(jnp.asarray(start["angle"]), jnp.zeros_like(params["rate"]))

    def step(self, params, state, dt):
        return dataclasses.replace(state, angle=state.angle + params["rate"] * dt)

    def events(self, params, before, after):
        return jnp.stack([jnp.floor(after.angle) > jnp.floor(before.angle)])

    def jump(self, params, state, fired):
        return dataclasses.replace(state, turned=state.angle)

    def section(self, params, before, fired):
        return fired[0]

    def observe(self, params, state):
        return {"turned": state.turned}

    def signal(self, params, state):
        return {}

    def label(self, params, observations):
        return {"gait": jnp.zeros((), jnp.int32)}

    def failed(self, params, state):
        return state.angle < -1.0

    def period(self, params):
        return jnp.ones_like(params["rate"])


@pytest.mark.slow
@pytest.mark.parametrize("dwell", [3.0, 2.6137, 0.004])
def test_a_simulator_of_fixed_steps_changes_at_the_nearest_step_end(dwell: float) -> None:
    stairs, dt, model = StepSchedule((1.0, 2.0, 1.0), step=0.3, dwell=dwell), 0.01, Turning()

    def drive(values: Any, t: jax.Array) -> Any:
        return model.params({**values, "rate": stairs.at(t)})

    options: dict[str, Any] = {"numerics": Numerics(dt=dt), "drive": drive}
    results = [
        run_rows(model, StepRecorder(model, stairs), {"angle": 0.0}, engine=name, **options)
        for name in ("kernel", "xla")
    ]
    angle, turned, steps, expected = 0.0, 0.0, 0, []
    for number in range(stairs.count):
        rate = float(stairs.value(jnp.asarray(float(number))))
        while (steps + 0.5) * dt < (number + 1) * dwell - 1e-9:
            before, angle, steps = angle, angle + rate * dt, steps + 1
            turned = angle if np.floor(angle) > np.floor(before) else turned
        expected.append([number, np.floor(angle), steps * dt, turned])
    for result in results:
        np.testing.assert_allclose(result.samples[:, [0, 1, 2, 5]], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("path", [(2.0, 3.2, 2.0), (0.3, -0.4, 0.3), (-1.6, 1.6, -1.6)])
def test_passes_up_and_down_have_equal_values(path: tuple[float, ...]) -> None:
    """So that a table is grouped by the parameter with both passes of a stair together."""
    schedule = StepSchedule(path, 0.1, dwell=1.0)
    values = np.asarray(schedule.value(jnp.arange(schedule.count, dtype=float)))
    np.testing.assert_array_equal(values, values[::-1])
    np.testing.assert_allclose(np.diff(values[: schedule.count // 2 + 1]), np.sign(path[1] - path[0]) * 0.1)
