"""Ends of rows: by their limits, on the wrap of an angle, and where their numbers leave all bounds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.contract import Quantity
from gaitsweep.engine.carry import Halt
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.poincare.poincare_return import PoincareReturn, ReturnStatus, crossing_of
from gaitsweep.engine.recorders.recorder import BUFFER
from gaitsweep.engine.recorders.recordings import (
    CrossingRecorder,
    FixedTimeRecorder,
    TraceRecorder,
    end_values,
)
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.status import Status
from plane_maps import Logistic, Params, Spiral, State
from tests.support.sweeping import run_rows, scalars
from toy_model import Toy, bounce_times, launches

ENGINES = ("xla", "kernel")
ONE = Numerics(dt=1.0)  # a step is a crossing
TURN = 2.0 * np.pi


def names(found: RowOutcome) -> list[str]:
    return [Status(code).name for code in found.status]


class Turning(Spiral):
    """The angle `angle + ratio^n (x_0 - angle)`, seen after n more turns, or on the turn from 0 (`y_0` 1)."""

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return (Quantity("psi", "rad", "an angle", circular=True),)

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return self.observables

    def step(self, params: Params, state: State, dt: jax.Array) -> State:
        return State(params.angle + params.ratio * (state.x - params.angle) + TURN, state.y)

    def init(self, params: Params, start: Mapping[str, jax.Array]) -> State:
        return State(jnp.asarray(start["x_0"]), jnp.asarray(start["y_0"]))

    def observe(self, params: Params, state: State) -> dict[str, jax.Array]:
        return {"psi": jnp.where(state.y > 0.5, jnp.mod(state.x, TURN), state.x)}

    def label(self, params: Params, observations: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        return {"gait": jnp.zeros((), jnp.int32)}


class Turned(Turning):
    """The same, whose own numbers stay on a turn on either side of the wrap: psi, then psi - 2 pi."""

    def step(self, params: Params, state: State, dt: jax.Array) -> State:
        away = params.ratio * state.x
        return State(away, 1.0 - state.y)

    def observe(self, params: Params, state: State) -> dict[str, jax.Array]:
        return {"psi": state.x + TURN * state.y}


@pytest.mark.slow("xla")
@pytest.mark.parametrize("engine", ENGINES)
def test_an_angle_that_jumps_to_and_fro_over_the_wrap_settles(engine: str) -> None:
    """Settles by |0.9^n (0.9^-10 - 1)| < 10 tolerances, as an angle away from the wrap does."""
    result = run_rows(
        Turned(),
        SettleRecorder(Turned()),
        {"x_0": [0.4, -0.4, 0.4], "y_0": [0.0, 1.0, 1.0]},
        numerics=ONE,
        engine=engine,
    )
    assert names(result) == ["settled"] * 3
    n = int(np.ceil(np.log(0.01 / (0.4 * (0.9**-10 - 1.0))) / np.log(0.9)))
    assert result.cycles.tolist() == [n] * 3
    assert result.numbers["period"].tolist() == [1] * 3


@pytest.mark.slow("xla")
@pytest.mark.parametrize("engine", ENGINES)
def test_an_angle_that_advances_by_a_turn_each_cycle_settles(engine: str) -> None:
    """A row settles whether or not the model's numbers include whole turns."""

    class Going(Turning):
        def step(self, params: Params, state: State, dt: jax.Array) -> State:
            return State(state.x + TURN, state.y)

    result = run_rows(
        Going(),
        SettleRecorder(Going()),
        {"x_0": [1.0, 0.0, 6.2], "y_0": [0.0, 0.0, 1.0]},
        numerics=ONE,
        engine=engine,
    )
    assert names(result) == ["settled"] * 3
    assert result.cycles.tolist() == [10] * 3


def test_an_angle_that_turns_by_less_does_not_settle() -> None:
    class Part(Turning):
        def step(self, params: Params, state: State, dt: jax.Array) -> State:
            return State(state.x + 0.3 * TURN + 0.01, state.y)

    result = run_rows(Part(), SettleRecorder(Part(), 60), {"x_0": [1.0], "y_0": [1.0]}, numerics=ONE)
    assert names(result) == ["cycle_limit"]


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_the_time_of_settling_has_its_limit(engine: str) -> None:
    """Rows end at `max_time`, to the bit, unless they settle before it."""
    model, starts = Toy(), {"launch_1": [1.0, 1.0]}
    params = {"restitution": [0.9, 0.2]}
    for limit in (3.7, 11.0):
        result = run_rows(
            model, SettleRecorder(model, 150, 1e-6, max_time=limit), starts, params=params,
            numerics=Numerics(dt=1e-2), engine=engine,
        )  # fmt: skip
        bounces = bounce_times(1.0, 2.0, 0.5, 0.9, 0.5, 60)
        assert names(result)[0] == "time_limit"
        assert result.t_end[0] == limit
        assert result.cycles[0] == np.count_nonzero(bounces < limit)
        np.testing.assert_allclose(
            result.last[0, 0], launches(1.0, 0.9, 0.5, 60)[result.cycles[0]], atol=1e-8
        )
    assert names(result)[1] == "settled"
    assert result.t_end[1] < 11.0
    free = run_rows(
        model,
        SettleRecorder(model, 400, 1e-6),
        starts,
        params=params,
        numerics=Numerics(dt=1e-2),
        engine=engine,
    )
    assert names(free) == ["settled", "settled"]
    assert free.t_end[0] > 11.0


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_the_number_of_cycles_has_its_limit(engine: str) -> None:
    result = run_rows(
        Logistic(),
        SettleRecorder(Logistic(), 37),
        {"x_0": [0.3, 0.3]},
        params={"r": [3.9, 2.8]},
        numerics=ONE,
        engine=engine,
    )
    assert names(result) == ["cycle_limit", "settled"]
    assert result.cycles[0] == 37
    assert result.labels["gait"][0] >= 0  # it is labelled all the same


class Escaping(Logistic):
    """x_0 grows by `r` each step, and becomes NaN where it is beyond `angle`; observed is y, which stays."""

    def step(self, params: Params, state: State, dt: jax.Array) -> State:
        x = params.r * state.x
        return State(jnp.where(x > params.angle, jnp.nan, x), state.y)

    def observe(self, params: Params, state: State) -> dict[str, jax.Array]:
        return {"x": state.y, "y": state.y}


RECORDERS = {
    "crossings": lambda model: CrossingRecorder(model, crossings=400),
    "hold": lambda model: FixedTimeRecorder(model, 400.0),
    "trace": lambda model: TraceRecorder(model, duration=400.0, every=1.0),
}


@pytest.mark.slow("crossings-kernel", "trace-kernel", "hold-xla", "trace-xla")
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", RECORDERS)
def test_diverging_numbers_end_a_row(kind: str, engine: str) -> None:
    """Beyond +-1e9 a row has diverged, also in unobserved variables; NaN has its own status."""
    model = Escaping()
    result = run_rows(
        model, RECORDERS[kind](model), {"x_0": [1.0, -1.0, 1.0, 1.0], "y_0": np.linspace(0.1, 0.4, 4)},
        params={"r": [1.5, 1.5, 1.5, 1.0], "angle": [1e300, 1e300, 1e3, 1e300]}, numerics=ONE, engine=engine,
    )  # fmt: skip
    assert names(result) == ["diverged", "diverged", "not_a_number", "complete"]


@pytest.mark.parametrize("engine", ENGINES)
def test_the_bound_of_divergence(engine: str) -> None:
    """A state at 0.9e9 runs to its end; one at 1.1e9, of either sign, has diverged."""
    model = Escaping()
    x_0 = np.array([0.9e9, -0.9e9, 1.1e9, -1.1e9])
    result = run_rows(
        model, FixedTimeRecorder(model, 100.0), {"x_0": x_0, "y_0": 0.5}, params={"r": 1.0, "angle": 1e300},
        numerics=ONE, engine=engine,
    )  # fmt: skip
    assert names(result) == ["complete", "complete", "diverged", "diverged"]
    assert np.all(result.labels["gait"][2:] == -1)
    assert np.all(result.labels["gait"][:2] >= 0)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_a_row_that_falls_keeps_its_last_crossing(engine: str) -> None:
    """The last crossing is one before the fall, and no gait is read from it."""
    model = Toy()
    params: dict[str, Any] = {"restitution": 0.5, "kick": [3.0, 0.5], "ceiling": [0.62, 1e3]}
    result = run_rows(
        model, CrossingRecorder(model, duration=20.0), {"launch_1": [1.0, 1.0]}, params=params,
        numerics=Numerics(dt=1e-2), engine=engine,
    )  # fmt: skip
    assert names(result) == ["fell", "complete"]
    # launched at 1 m/s it reaches 0.21 m, at 3.5 m/s (after its first bounce) 1.3 m
    speeds = launches(1.0, 0.5, 3.0, 6)
    mine = result.samples[result.owner == 0]
    np.testing.assert_allclose(mine[:, 2], speeds[: len(mine)], atol=1e-8)
    assert result.last[0, 0] == mine[-1, 2]
    assert result.cycles[0] == len(mine) - 1 == 1


@pytest.mark.slow("1-0-kernel", "101-0-kernel", "1-0-xla", "32-3-xla")
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("count", "after"), [(1, 0), (BUFFER, 3), (3 * BUFFER + 5, 0)])
def test_every_crossing_is_kept_once(count: int, after: int, engine: str) -> None:
    """Around the size of the buffer: `count` crossings after the first `after`, which is kept too."""
    model = Logistic()
    result = run_rows(
        model, CrossingRecorder(model, crossings=count, after_cycles=after), {"x_0": [0.3, 0.2]},
        params={"r": 3.9}, numerics=ONE, engine=engine, lanes=2,
    )  # fmt: skip
    assert names(result) == ["complete"] * 2
    for row, x in enumerate((0.3, 0.2)):
        orbit = [x]
        for _ in range(after + count):
            orbit.append(3.9 * orbit[-1] * (1.0 - orbit[-1]))
        mine = result.samples[result.owner == row]
        np.testing.assert_array_equal(mine[:, 0], np.arange(after, after + count + 1))
        np.testing.assert_allclose(mine[:, 1], np.arange(after, after + count + 1), atol=1e-12)
        np.testing.assert_allclose(mine[:12, 2], orbit[after : after + 12][: len(mine)], atol=1e-9)
        assert result.cycles[row] == after + count


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_rows_without_crossings_end_at_their_time_limit(engine: str) -> None:
    """The limit is four nominal periods for each crossing, skipped ones and ten to spare included."""

    @dataclasses.dataclass(frozen=True)
    class Still(Logistic):
        def events(self, params: Params, before: State, after: State) -> jax.Array:
            return jnp.zeros((1,), bool)

    model = Still()
    for recorder, limit in (
        (CrossingRecorder(model, crossings=5, after_cycles=2), 4.0 * 17),
        (SettleRecorder(model, 5), 4.0 * 15),
        (TraceRecorder(model, duration=3.0, every=1.0, after_cycles=2), 4.0 * 12),
    ):
        result = run_rows(model, recorder, {"x_0": [0.3]}, numerics=ONE, engine=engine)
        assert (names(result), result.t_end[0]) == (["time_limit"], limit)
        assert result.cycles[0] == 0
    held = run_rows(model, FixedTimeRecorder(model, 7.0), {"x_0": [0.3]}, numerics=ONE, engine=engine)
    assert (names(held), held.t_end[0], held.cycles[0]) == (["complete"], 7.0, 0)
    ramp = run_rows(model, CrossingRecorder(model, duration=9.0), {"x_0": [0.3]}, numerics=ONE, engine=engine)
    assert (names(ramp), ramp.t_end[0]) == (["complete"], 9.0)


@pytest.mark.slow("0.1-0-xla", "0.3-2-xla")
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("every", "after"), [(0.1, 0), (0.3, 2)])
def test_a_trace_has_all_of_its_samples(every: float, after: int, engine: str) -> None:
    """From its begin to its end, both included, more than the buffer holds, at the heights in closed form."""
    model, duration = Toy(), 9.0
    result = run_rows(
        model, TraceRecorder(model, duration, every, after_cycles=after), {"launch_1": [1.3]},
        numerics=Numerics(dt=5e-3), engine=engine,
    )  # fmt: skip
    count = int(duration / every + 1e-9) + 1
    t, height = result.samples[:, 0], result.samples[:, 1]
    np.testing.assert_allclose(t, every * np.arange(count), rtol=0.0, atol=1e-9)
    assert names(result) == ["complete"]
    bounces = np.r_[0.0, bounce_times(1.3, 2.0, 0.5, 0.5, 0.5, 40)]
    speeds = launches(1.3, 0.5, 0.5, 40)
    at = t + bounces[after]
    flight = np.searchsorted(bounces, at + 1e-9, side="right") - 1
    since = at - bounces[flight]
    exact = -0.5 + 0.5 * np.cos(2.0 * since) + speeds[flight] / 2.0 * np.sin(2.0 * since)
    np.testing.assert_allclose(height, exact, atol=1e-7)
    assert result.t_end[0] == pytest.approx(bounces[after] + every * (count - 1), abs=1e-9)
    assert result.cycles[0] == np.count_nonzero(bounces[1:] < result.t_end[0] + 1e-9)


class Watched(Toy):
    """Observes the speed itself, which changes between bounces."""

    def observe(self, params: Any, state: Any) -> dict[str, jax.Array]:
        return {"launch_1": state.speed[0]}


@pytest.mark.slow("crossings", "settle")
@pytest.mark.parametrize("kind", ["settle", "hold", "crossings"])
def test_the_last_observation_is_that_of_the_last_crossing(kind: str) -> None:
    """The observation is not that of the end of the row's time, in flight."""
    model, end = Watched(), 3.7
    recorder = {
        "settle": SettleRecorder(model, 150, 1e-9, max_time=end),
        "hold": FixedTimeRecorder(model, end),
        "crossings": CrossingRecorder(model, duration=end),
    }[kind]
    result = run_rows(model, recorder, {"launch_1": [1.3]}, numerics=Numerics(dt=1e-2), engine="kernel")
    speeds = launches(1.3, 0.5, 0.5, 20)
    assert result.t_end[0] == end
    assert result.cycles[0] == np.count_nonzero(bounce_times(1.3, 2.0, 0.5, 0.5, 0.5, 20) < end) > 1
    np.testing.assert_allclose(result.last[0, 0], speeds[result.cycles[0]], atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("kind", RECORDERS)
def test_diverged_values_are_not_the_last_crossing(kind: str) -> None:
    """X grows by half each crossing; the last one recorded is below 1e9, or before the NaN beyond 1e3."""

    class Growing(Escaping):
        def observe(self, params: Params, state: State) -> dict[str, jax.Array]:
            return {"x": state.x, "y": state.y}

    model = Growing()
    starts, params = {"x_0": [1.0, 1.0], "y_0": 0.5}, {"r": 1.5, "angle": [1e300, 1e3]}
    result = run_rows(model, RECORDERS[kind](model), starts, params=params, numerics=ONE, engine="kernel")
    assert names(result) == ["diverged", "not_a_number"]
    n = [int(np.log(bound) / np.log(1.5)) for bound in (1e9, 1e3)]
    np.testing.assert_allclose(result.last[:, 0], [1.5 ** n[0], 1.5 ** n[1]], rtol=1e-12)


class Clock(gs.DeclaredModel):
    """`m` grows by `rate` a second; `x` only jumps, to 1000 times itself each second; the period is given."""

    rate = gs.parameter("1/s", "rate", 1.0)
    T_squared = gs.parameter("s^2", "the nominal period squared", 1.0)
    clock = gs.variable("s", "clock", 0.0, observed=False)
    m = gs.variable("1", "what grows", 0.0)
    x = gs.variable("1", "what jumps", 0.0)

    def flow(self, p, s):
        return {"clock": 1.0, "m": p.rate}

    @gs.event("a second is over", section=True)
    def tick(self, p, s):
        return s.clock - 1.0

    @tick.jump
    def again(self, p, s):
        return s.replace(clock=0.0, x=1e3 * s.x)

    def period(self, p):
        return jnp.where(p.T_squared == np.inf, jnp.inf, jnp.sqrt(p.T_squared))


def clocks(recorder: Any, engine: str, **params: list[float]) -> RowOutcome:
    starts = {"clock_0": [0.0] * 4, "m_0": [0.0] * 4, "x_0": [0.0, 0.0, 1e-3, 1.0]}
    numerics = Numerics(method="tsit5", rtol=1e-9, atol=1e-12)
    return run_rows(Clock(), recorder, starts, params=params, numerics=numerics, engine=engine)


@pytest.mark.parametrize("engine", [pytest.param("xla", marks=pytest.mark.slow), "kernel"])
def test_a_given_time_is_read_at_that_time_and_what_only_jumps_diverges(engine: str) -> None:
    """m(5.9) = 5.9 rate, not its value at the last crossing; x is above 1e9 after 4 jumps from 1e-3."""
    result = clocks(FixedTimeRecorder(Clock(), 5.9), engine, rate=[1.0, 2.0, 1.0, 1.0])
    assert names(result) == ["complete", "complete", "diverged", "diverged"]
    np.testing.assert_allclose(end_values(result)[:2], [[5.9, 0.0], [11.8, 0.0]], rtol=1e-9)
    np.testing.assert_allclose(result.last[:2, 0], [5.0, 10.0], rtol=1e-9)


@pytest.mark.parametrize(
    ("kind", "engine"),
    [
        ("crossings", "kernel"),
        *(pytest.param(kind, "kernel", marks=pytest.mark.slow) for kind in ("settle", "fixed_time")),
        *(
            pytest.param(kind, "xla", marks=pytest.mark.slow)
            for kind in ("settle", "crossings", "fixed_time")
        ),
    ],
)
def test_a_row_whose_period_is_not_finite_ends_at_once(kind: str, engine: str) -> None:
    """Such a period gives no limit of time or of steps; other rows are not affected."""
    model = Clock()
    recorder = {
        "settle": SettleRecorder(model, max_cycles=30),
        "crossings": CrossingRecorder(model, crossings=20),
        "fixed_time": FixedTimeRecorder(model, 20.0),
    }[kind]
    result = clocks(recorder, engine, T_squared=[1.0, -1.0, np.inf, 0.0])
    ends = names(result)
    assert ends[0] == ("cycle_limit" if kind == "settle" else "complete"), ends
    assert ends[1:3] == ["not_a_number"] * 2
    assert ends[3] == ("step_limit" if kind == "fixed_time" else "not_a_number")
    assert result.attempts.max() < 5000
    assert result.attempts[1:].max() <= 64


@pytest.mark.slow
@pytest.mark.parametrize(("T_squared", "status"), [(1.0, "crossed"), (-1.0, "lost"), (np.inf, "lost")])
def test_a_return_whose_period_is_not_finite_ends_at_once(T_squared: float, status: str) -> None:
    model = Clock()
    params = scalars(model, T_squared=T_squared)
    start = {name: jnp.zeros(()) for name in ("clock_0", "m_0", "x_0")}
    crossing = crossing_of(model, Numerics(method="tsit5", rtol=1e-9, atol=1e-12).resolve(model))
    assert ReturnStatus(int(crossing(params, model.init(params, start))[2])).name == status


@pytest.mark.parametrize(
    ("end", "status"),
    [
        ({"attempts": 10**7}, "step_limit"),
        ({"attempts": 10**7, "halt": Halt.FELL}, "fell"),
        ({"chain": 10**3, "halt": Halt.FELL}, "stalled"),
        ({"halt": Halt.TIME}, "late"),
    ],
)
def test_a_return_without_a_crossing_has_the_status_of_its_one_cause(end: Any, status: str) -> None:
    model = Clock()
    params = scalars(model)
    state = model.init(params, {name: jnp.zeros(()) for name in ("clock_0", "m_0", "x_0")})
    returns = PoincareReturn(model, Numerics(method="tsit5", rtol=1e-9, atol=1e-12).resolve(model))
    trajectory = returns.begin(params, state)
    trajectory = dataclasses.replace(trajectory, carry=dataclasses.replace(trajectory.carry, **end))
    assert returns.ended(trajectory)
    assert ReturnStatus(int(returns.status(params, trajectory))).name == status
