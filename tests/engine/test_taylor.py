"""Taylor's method: its coefficients are derivatives, its steps meet the tolerance, and no event is missed."""

from __future__ import annotations

import dataclasses
import functools
import math
import types
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep import DeclaredModel, event, observable, parameter, variable
from gaitsweep.engine.solver.taylor import along, bends_back, first_zero, solution
from gaitsweep.engine.switches import ROOTS, curving_operation, moving_operations, switching
from gaitsweep.examples.compass_walker import CompassWalker

ORDER = 6


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Point:
    x: jax.Array
    y: jax.Array


FUNCTIONS = {
    "product": lambda x, y: x * y,
    "quotient": lambda x, y: x / (2.0 + y),
    "square": lambda x, y: jnp.square(x) + y**3 - y**-2,
    "roots": lambda x, y: jnp.sqrt(2.0 + x) + jax.lax.rsqrt(2.0 + y) + jnp.cbrt(3.0 + x),
    "powers": lambda x, y: (2.0 + x) ** 1.7 + 2.0**y,
    "remainder": lambda x, y: jnp.mod(7.0 * x + 5.0, 6.0) * y + jnp.mod(y - 8.0, 3.0) * x,
    # x is 0.4 at the start: a whole power at zero
    "powers at zero": lambda x, y: (x - 0.4) ** 2.0 + (x - 0.4) ** 3.0 * y + jax.lax.integer_pow(x - 0.4, 0),
    "powers of nothing": lambda x, y: (
        y + jnp.maximum(x - 9.0, 0.0) ** 1.5 + jnp.sqrt(jnp.minimum(y + 9.0, 0.0))
    ),
    "exponential": lambda x, y: jnp.exp(x) + jnp.expm1(y),
    "logarithm": lambda x, y: jnp.log(2.0 + x) + jnp.log1p(y),
    "circular": lambda x, y: jnp.sin(x) * jnp.cos(y) + jnp.arctan(x - y),
    "hyperbolic": lambda x, y: jnp.sinh(x) + jnp.cosh(y) + jnp.tanh(x * y),
    "logistic": lambda x, y: jax.nn.sigmoid(3.0 * x) - jax.nn.softplus(y),
    "chosen": lambda x, y: jnp.where(x > 0.0, x * y, y) + jnp.maximum(x + 1.0, y**2) + jnp.minimum(x, -y),
    "extremes": lambda x, y: (
        jnp.max(jnp.stack([x, y + 1.0, x * y]))
        + jnp.min(jnp.array([[x, -1.0], [y + 1.0, x - 2.0]]), axis=0) @ jnp.ones(2)
    ),
    "size": lambda x, y: jnp.abs(-x) + jnp.clip(y, -3.0, 3.0) + jnp.sign(x) * y,
    "clamped": lambda x, y: (
        jax.lax.clamp(-3.0, x, 3.0) * y + jax.lax.clamp(y + 1.0, x, 3.0) + jax.lax.clamp(-3.0, x, y - 2.0)
    ),
    "moved": lambda x, y: jnp.stack([x, y, x * y])[::-1].reshape(3, 1)[1:].sum() + jnp.array([x, y])[1],
    "matrix": lambda x, y: jnp.array([[x, y], [1.0, x]]) @ jnp.array([y, 2.0 * x]) @ jnp.array([1.0, y]),
    "of numbers and arrays": lambda x, y: jnp.where(x > 0.0, jnp.arange(2.0) - y, x * jnp.arange(2.0)).sum(),
    "indexed": lambda x, y: jnp.zeros(3).at[1].set(x * y)[jnp.array([1, 0])].sum(),
}


@functools.cache
def coefficients() -> dict[str, list[jax.Array]]:
    """The coefficients of all functions along one path, of one program."""
    path = {
        "x": [jnp.asarray(c) for c in (0.4, 0.3, -1.0)],
        "y": [jnp.asarray(c) for c in (0.5, -0.7, 0.0, 0.2)],
    }
    start = Point(path["x"][0], path["y"][0])
    return jax.jit(
        lambda: {name: along(lambda s, f=f: f(s.x, s.y), start, path, ORDER) for name, f in FUNCTIONS.items()}
    )()


@functools.cache
def values(radius: float = 0.2) -> tuple[np.ndarray, dict[str, jax.Array]]:
    """Times, and the values of all functions on the path."""
    t = radius * np.cos(np.pi * (np.arange(30) + 0.5) / 30)
    x, y = 0.4 + 0.3 * t - t**2, 0.5 - 0.7 * t + 0.2 * t**3
    return t, jax.jit(lambda x, y: {name: jax.vmap(f)(x, y) for name, f in FUNCTIONS.items()})(x, y)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_coefficients_are_those_of_a_fitted_polynomial(name: str) -> None:
    t, measured = values()
    fitted = np.polynomial.Polynomial.fit(t, np.asarray(measured[name]), 18).convert().coef[: ORDER + 1]
    # a coefficient of order k is fitted with an error of rounding / radius^k
    error = 1e-11 * np.abs(measured[name]).max() * 0.2 ** -np.arange(ORDER + 1)
    assert np.all(np.abs(np.asarray(coefficients()[name]) - fitted) < error)


def test_a_rate_without_derivative_moves_as_any_other() -> None:
    """The flow is x' = -x; the same function as a guard's margin counts as constant."""
    hidden = jax.jit(jax.lax.stop_gradient)
    point = Point(jnp.asarray(2.0), jnp.asarray(0.0))
    series = solution(lambda _, s: {"x": -hidden(s.x)}, None, point, 5)
    np.testing.assert_allclose(series["x"], [2.0 * (-1) ** k / math.factorial(k) for k in range(6)])
    np.testing.assert_array_equal(along(lambda s: hidden(s.x), point, series, 2), [2.0, 0.0, 0.0])


class Orbit(DeclaredModel):
    """A planet on an ellipse of eccentricity 0.6, from its nearest point."""

    mass = parameter("1", "mass of the star", 1.0)
    x = variable("m", "place", 0.4)
    y = variable("m", "place across")
    u = variable("m/s", "speed")
    v = variable("m/s", "speed across", 2.0)

    def flow(self, p, s):
        pull = p.mass * (s.x**2 + s.y**2) ** -1.5
        return {"x": s.u, "y": s.v, "u": -pull * s.x, "v": -pull * s.y}

    @observable("m", "distance")
    def distance(self, p, s):
        return jnp.hypot(s.x, s.y)

    @event("passes its nearest point", section=True)
    def nearest(self, p, s):
        return s.x * s.u + s.y * s.v

    def period(self, p):
        return 2.0 * jnp.pi * jnp.ones(())


@pytest.mark.slow
@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-12])
def test_an_orbit_closes_to_the_tolerance(rtol: float) -> None:
    numerics = {"method": "taylor", "rtol": rtol, "atol": rtol}
    found = gs.sweep(Orbit(), run={"kind": "settle", "max_cycles": 3, "tolerance": 1e-30}, numerics=numerics)
    row = found.table.iloc[0]
    # Kepler's third law; the error of three turns, of which each takes some 30 steps
    assert abs(row["t_end"] - 6.0 * math.pi) < 100.0 * rtol
    assert abs(row["x_end"] - 0.4) < 1000.0 * rtol


class Peaks(DeclaredModel):
    """A clock with a bell that rings while a wave is above its level, which is short."""

    wave = parameter("rad/s", "frequency of the wave", 60.0)
    level = parameter("1", "level of the bell", 0.99)
    clock = variable("s", "time")
    rings = variable("1", "number of rings")

    @observable("1", "number of rings so far")
    def count(self, p, s):
        return s.rings

    def flow(self, p, s):
        return {"clock": jnp.ones(()), "rings": jnp.zeros(())}

    @event("rings")
    def ring(self, p, s):
        return jnp.cos(p.wave * s.clock - 1.0) - p.level

    @ring.jump
    def counted(self, p, s):
        return s.replace(rings=s.rings + 1.0)

    @event("ends", section=True)
    def end(self, p, s):
        return s.clock - 1.0

    @end.jump
    def again(self, p, s):
        return s.replace(clock=0.0)

    def period(self, p):
        return jnp.ones(())


class Ball(DeclaredModel):
    """A ball that bounces from a floor far from height 0, and whose take-offs are events too."""

    base = parameter("m", "height of the floor", 1.0)
    h = variable("m", "height", 2.0)
    v = variable("m/s", "speed upwards")

    @observable("m", "height")
    def height(self, p, s):
        return s.h

    def flow(self, p, s):
        return {"h": s.v, "v": -9.81}

    @event("lands", section=True)
    def lands(self, p, s):
        return p.base - s.h

    @lands.jump
    def bounce(self, p, s):
        return s.replace(v=-0.4 * s.v)

    @event("takes off")
    def takes_off(self, p, s):
        return s.h - p.base

    def period(self, p):
        return jnp.ones(())


@pytest.mark.slow
@pytest.mark.parametrize("wave", [20.0, 60.0, 200.0])
def test_no_short_event_is_missed(wave: float) -> None:
    found = gs.sweep(
        Peaks(),
        wave=wave,
        run={"kind": "settle", "max_cycles": 1, "tolerance": 1e-30},
        numerics={"method": "taylor"},
    )
    assert (
        found.table["count_end"].iloc[0] == math.floor((wave - 1.0 - math.acos(0.99)) / (2.0 * math.pi)) + 1
    )


@pytest.mark.slow
def test_impacts_that_accumulate_stall_within_few_attempts() -> None:
    """Flights become shorter than rounding of the heights: roots of polynomials that no guard reaches."""
    found = gs.sweep(
        Ball(),
        run={"kind": "settle", "max_cycles": 3000},
        numerics={"method": "taylor"},
        verify=0,
    )
    assert found.table["status"].iloc[0] == "event_stall"
    assert found.manifest["timings"]["attempts"] < 5000


class Pulse(DeclaredModel):
    """A charge that a short pulse of current raises by 1, from a given time on."""

    width = parameter("s", "length of the pulse", 1e-3)
    clock = variable("s", "time")
    charge = variable("1", "charge")

    @observable("1", "charge")
    def level(self, p, s):
        return s.charge

    def flow(self, p, s):
        flows = (s.clock > 0.5941) & (s.clock < 0.5941 + p.width)
        return {"clock": jnp.ones(()), "charge": jnp.where(flows, 1.0 / p.width, 0.0)}

    def period(self, p):
        return jnp.ones(())


def test_switches_of_the_flow_are_met_to_the_tolerance() -> None:
    run = {"kind": "fixed_time", "duration": 1.0}
    found = gs.sweep(Pulse(), width=[3e-4, 3e-3, 3e-2], run=run, numerics={"method": "taylor"}, verify=0)
    np.testing.assert_allclose(found.table["level_end"], 1.0, rtol=0.0, atol=1e-6)


class Filled(DeclaredModel):
    """A charge that a current raises, which may switch, once per turn of a clock."""

    current = parameter("1/s", "current", 0.0)
    clock = variable("s", "time", 0.5, observed=False)
    charge = variable("1", "charge", 0.0)

    def flow(self, p, s):
        return {"clock": 1.0, "charge": jnp.where(s.clock < 99.0, p.current, 0.0)}

    @event("turn", section=True)
    def turn(self, p, s):
        return s.clock - 1.0

    @turn.jump
    def turned(self, p, s):
        return s.replace(clock=0.0)

    def period(self, p):
        return jnp.ones(())


@pytest.mark.slow
def test_a_parameter_that_moves_is_no_switch_of_the_flow() -> None:
    run = gs.Ramp(parameter="current", path=[0.0, 1.0], rate=0.05)
    found = gs.sweep(Filled(), run=run, numerics={"method": "taylor"}, verify=0)
    np.testing.assert_allclose(found.table["charge_n"], 0.025 * found.table["t"] ** 2, rtol=0.0, atol=1e-9)
    assert found.manifest["timings"]["attempts"] < 5000


def test_zeros_within_a_step() -> None:
    """Two zeros that the ends do not show are suspected; one that they show is found."""
    h = jnp.asarray(1.0)
    hidden = [jnp.asarray([c]) for c in (-0.24, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0)]  # at 0.4 and 0.6
    below = [jnp.asarray([c]) for c in (-1.26, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0)]  # none
    shown = [jnp.asarray([c]) for c in (-0.125, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)]  # at 0.5
    unknown = [*below[:-1], jnp.asarray([0.1])]  # the last term is not small
    assert bends_back(hidden, h)
    assert not bends_back(below, h)
    assert not bends_back(shown, h)
    assert bends_back(unknown, h)
    assert first_zero(shown, h) == h  # which starts far from the zero
    near = [jnp.asarray([c]) for c in (-0.28, 0.5, 0.12, 0.0, 0.0, 0.0, 0.0)]  # at 0.5
    assert abs(first_zero(near, h) - 0.5) < 1e-15
    assert first_zero(below, h) == jnp.inf


@pytest.mark.slow
def test_a_walkers_steps_are_those_of_a_runge_kutta_pair() -> None:
    tables = []
    for method in ("tsit5", "taylor"):
        found = gs.sweep(
            CompassWalker(),
            stance_rate_0=np.linspace(1.08, 1.1, 8),
            run={"kind": "settle", "max_cycles": 20, "tolerance": 1e-30},
            numerics={"method": method, "rtol": 1e-12, "atol": 1e-12},
        )
        tables.append(found.table[["stance_end", "stance_rate_end", "swing_rate_end", "t_end"]])
    np.testing.assert_allclose(tables[1], tables[0], rtol=0.0, atol=1e-9)


class Fastest(DeclaredModel):
    """A place that moves as fast as the fastest of three waves."""

    lag = parameter("rad", "lag of each wave", 2.0)
    clock = variable("s", "time")
    x = variable("m", "place")

    def flow(self, p, s):
        waves = jnp.sin(s.clock + p.lag * jnp.arange(3.0))
        return {"clock": jnp.ones(()), "x": jnp.max(waves)}

    @observable("m", "place")
    def place(self, p, s):
        return s.x

    def period(self, p):
        return 2.0 * jnp.pi * jnp.ones(())


@jax.custom_jvp
def logaddexp(x: Any, y: Any) -> Any:
    """A function of a user with the name of one of JAX, which is smooth."""
    return jnp.maximum(x, y)


logaddexp.defjvp(lambda at, along: (logaddexp(*at), along[0]))


@jax.custom_jvp
def positive_part(x: jax.Array) -> jax.Array:
    return jnp.where(x > 0.0, x, 0.0)


positive_part.defjvps(lambda rate, _, x: jnp.where(x > 0.0, rate, 0.0))


@pytest.mark.parametrize(
    ("rate", "switches"),
    [
        (jnp.sign, True),
        (jax.nn.relu, True),
        (positive_part, True),
        (jax.checkpoint(jnp.abs), True),
        (lambda x: jnp.array([1.0, 3.0])[jnp.argmax(jnp.stack([x, -x]))], True),
        (lambda x: jax.nn.relu(jnp.array([1.0, 3.0])[jnp.argmin(jnp.stack([x, -x]))]), True),
        (jax.nn.softplus, False),
        (lambda x: logaddexp(x, 0.0), True),
        (lambda x: jax.nn.softplus(x) + jax.checkpoint(jnp.sin)(x), False),
        # by a program of one round, which is no part of the flow
        (lambda x: jnp.sign(jax.lax.reduce(jnp.stack([x, x]), 0.0, jax.lax.add, (0,))), True),
    ],
)
def test_switches_at_zero_are_found(rate, switches: bool) -> None:
    """A step is shortened at the switches that are found; each of these is at x = 0."""
    flow = lambda _, s: {"x": rate(s.x), "y": 0.0}  # noqa: E731
    before, after = (switching(flow, None, Point(jnp.asarray(x), jnp.asarray(1.0))) for x in (-0.1, 0.1))
    assert np.any(before.surfaces * after.surfaces < 0.0) == switches
    model = types.SimpleNamespace(flow=lambda _, s: {"x": s.y * rate(s.x), "y": 0.0})
    curving = curving_operation(model, None, Point(jnp.asarray(0.1), jnp.asarray(1.0)))  # type: ignore[arg-type]
    assert curving != "mul"  # y is constant


def test_a_softplus_curves_and_a_power_of_a_constant_is_no_root() -> None:
    point: Any = Point(jnp.asarray(0.1), jnp.asarray(1.0))
    smooth: Any = types.SimpleNamespace(flow=lambda _, s: {"x": jax.nn.softplus(s.x), "y": 0.0})
    assert curving_operation(smooth, None, point) is not None
    for rate, is_root in ((lambda x: 2.0**x, False), (lambda x: x**2.0, False), (lambda x: x**1.5, True)):
        model: Any = types.SimpleNamespace(flow=lambda _, s, rate=rate: {"x": rate(s.x), "y": 0.0})
        assert ROOTS.isdisjoint(moving_operations(model, None, point)) != is_root


@pytest.mark.parametrize(("method", "error"), [("tsit5", 1e-7), ("taylor", 1e-9)])
def test_switches_of_an_extreme_are_located(method: str, error: float) -> None:
    """Each of three switches adds an error of some of the tolerances, which are 1e-10."""
    numerics = {"method": method, "rtol": 1e-10, "atol": 1e-10}
    table = gs.simulate(Fastest(), duration=6.0, every=0.1, numerics=numerics)
    t = np.linspace(0.0, 6.0, 600_001)
    speed = np.max(np.sin(t + 2.0 * np.arange(3.0)[:, None]), axis=0)
    place = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) * (t[1] - t[0])
    np.testing.assert_allclose(table["x"], np.interp(table["t"], t, place), rtol=0.0, atol=error)


def test_one_rate_of_a_field_is_the_rate_of_each_of_its_numbers() -> None:
    """The contract allows a scalar rate of an array: here y' = 1 for both numbers, and x' = cos(y)."""
    start = Point(jnp.array([0.1, 0.2]), jnp.array([0.3, -0.4]))
    terms = solution(
        lambda _, s: {"x": jnp.where(s.x > 0.0, jnp.cos(s.y), s.y), "y": jnp.ones(())}, (), start, 12
    )
    moved = sum(term * 0.1**k for k, term in enumerate(terms["x"]))
    # the term of order 13 is below 0.1^13 / 13!
    expected = start.x + jnp.sin(start.y + 0.1) - jnp.sin(start.y)
    np.testing.assert_allclose(moved, expected, rtol=0.0, atol=1e-15)


def test_elements_that_a_function_changes_have_no_recurrence() -> None:
    point = Point(jnp.array([0.1, 0.2]), jnp.array([0.3, -0.4]))
    with pytest.raises(gs.ArgumentError, match="as by "):
        solution(lambda _, s: {"x": s.y, "y": s.x.at[0].apply(jnp.cos)}, (), point, 3)


def test_a_flow_without_recurrence_is_refused() -> None:
    class Odd(DeclaredModel):
        rate = parameter("1", "rate", 1.0)
        x = variable("1", "place")

        @observable("1", "place")
        def place(self, p, s):
            return s.x

        def flow(self, p, s):
            return {"x": jax.scipy.special.erfinv(0.5 * p.rate * jnp.cos(s.x))}

        def period(self, p):
            return jnp.ones(())

    with pytest.raises(gs.UserError, match="taylor, which has no recurrence for JAX's operation erf_inv in"):
        gs.sweep(Odd(), run={"kind": "trace", "duration": 1.0, "every": 0.1}, numerics={"method": "taylor"})
