"""The kernel's own sine, exponential and the rest, against NumPy in extended precision."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import hypothesis
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import strategies as st
from jax import lax

from tests.scalar_programs import executable, on_many, traced_with

pytestmark = pytest.mark.skipif(
    np.finfo(np.longdouble).nmant < 63, reason="long double is no more than double here"
)

RANDOM = np.random.default_rng(20260731)
TINY = np.array([0.0, 5e-324, 1e-310, 2.3e-308, 1e-200, 1e-20, 1e-9, 1e-8])


def _logistic(x: Any) -> Any:
    return 1 / (1 + np.exp(-x))


def _between(low: float, high: float, n: int = 40_000) -> np.ndarray:
    return np.concatenate([RANDOM.uniform(low, high, n), np.linspace(low, high, 2001)])


def _signed(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values, -values])


def _both(function: Callable[..., Any], reference: Callable[..., Any], values: np.ndarray) -> Any:
    """What the kernel gives and what is right, in extended precision."""
    with np.errstate(all="ignore"):
        return on_many(function, values), reference(values.astype(np.longdouble))


def _units(mine: np.ndarray, right: np.ndarray) -> float:
    """The largest error, in units in the last place of the right value (of the least normal one at most)."""
    with np.errstate(all="ignore"):
        near = np.abs(right).astype(mine.dtype)
    outside = np.isinf(near)
    assert np.all(mine[outside] == np.sign(right[outside]) * np.inf)
    error = np.abs(mine[~outside].astype(np.longdouble) - right[~outside])
    return float(np.max(error / np.spacing(near[~outside])))


@pytest.mark.parametrize(("function", "reference"), [(jnp.sin, np.sin), (jnp.cos, np.cos)])
def test_sine_and_cosine_are_right_to_the_last_place(function: Any, reference: Any) -> None:
    quarters = np.arange(-640, 641) * (np.pi / 2)
    x = np.concatenate([_between(-1e3, 1e3), quarters, np.nextafter(quarters, 9e9), _signed(TINY)])
    mine, right = _both(function, reference, x)
    # the values are at most 1: two units in the last place of 1
    assert np.max(np.abs(mine - right)) < 2 * np.spacing(0.5)
    assert np.max(np.abs(mine)) <= 1.0 + np.finfo(float).eps
    near_zero = np.abs(x) < np.pi / 4
    assert _units(mine[near_zero], right[near_zero]) < 1.5


@pytest.mark.parametrize(("function", "reference"), [(jnp.sin, np.sin), (jnp.cos, np.cos), (jnp.tan, np.tan)])
def test_large_angles(function: Any, reference: Any) -> None:
    mine, right = _both(function, reference, _between(-1e6, 1e6))
    assert np.max(np.abs(mine - right) / (1 + right**2)) < 1e-15
    # and a little further, where what is taken off is no longer exact
    mine, right = _both(function, reference, _between(1e7, 1e8))
    assert np.max(np.abs(mine - right) / (1 + right**2)) < 1e-10


def test_sine_keeps_the_sign_of_small_angles() -> None:
    x = _signed(TINY[1:])
    np.testing.assert_array_equal(on_many(jnp.sin, x), x)
    np.testing.assert_array_equal(on_many(jnp.tan, x), x)


def test_tangent() -> None:
    x = np.concatenate([_between(-1e3, 1e3), _between(-1.57, 1.57)])
    mine, right = _both(jnp.tan, np.tan, x[x != 0])
    # near the poles an ulp of the angle counts tan^2 times: its reduction is right to far less than that
    assert np.max(np.abs(mine - right) / np.abs(right)) < 1e-15


def test_sine_and_cosine_lie_on_the_circle() -> None:
    x = _between(-1e4, 1e4)
    assert np.max(np.abs(on_many(lambda x: jnp.sin(x) ** 2 + jnp.cos(x) ** 2, x) - 1)) < 1e-15


@pytest.mark.parametrize("function", [jnp.sin, jnp.cos, jnp.tan])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_angles_that_are_no_numbers(function: Any, dtype: Any) -> None:
    assert np.all(np.isnan(on_many(function, np.array([np.nan, np.inf, -np.inf], dtype))))


def test_the_exponential_over_its_whole_range() -> None:
    x = np.concatenate([_between(-708, 709.78), _signed(TINY), _between(-1, 1)])
    assert _units(*_both(jnp.exp, np.exp, x)) < 1.6


def test_the_exponential_of_what_underflows() -> None:
    # between the least normal and the least number of all: right to one of these, and then zero
    mine, right = _both(jnp.exp, np.exp, _between(-745.13, -708))
    assert np.max(np.abs(mine - right)) <= 5e-324
    assert np.min(mine) > 0
    np.testing.assert_array_equal(on_many(jnp.exp, np.array([-745.2, -746.0, -1e4, -1e300, -np.inf])), 0.0)


def test_the_exponential_of_what_overflows() -> None:
    highest = np.log(np.finfo(float).max)
    assert np.isfinite(on_many(jnp.exp, np.array([highest])))[0]
    np.testing.assert_array_equal(on_many(jnp.exp, np.array([709.79, 710.0, 1e4, 1e300, np.inf])), np.inf)
    assert np.isnan(on_many(jnp.exp, np.array([np.nan])))[0]


def test_the_exponential_at_whole_powers_of_two() -> None:
    n = np.arange(-1080.0, 1030.0)
    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(on_many(jnp.exp2, n), np.exp2(n))


def test_powers_of_two() -> None:
    assert _units(*_both(jnp.exp2, np.exp2, np.concatenate([_between(-1022, 1023.9), _signed(TINY)]))) < 2
    mine, right = _both(jnp.exp2, np.exp2, _between(-1076, -1022))
    assert np.max(np.abs(mine - right)) <= 5e-324
    odd = np.array([-1e300, -np.inf, 1024.0, 1e300, np.inf, np.nan])
    np.testing.assert_array_equal(on_many(jnp.exp2, odd), [0, 0, np.inf, np.inf, np.inf, np.nan])


@pytest.mark.parametrize(
    ("function", "reference", "high", "units"),
    [
        (jnp.tanh, np.tanh, 25.0, 4.0),
        (jnp.sinh, np.sinh, 711.0, 4.0),
        (jnp.cosh, np.cosh, 711.0, 4.0),
        (jax.nn.sigmoid, _logistic, 700.0, 4.0),
        (jnp.cbrt, np.cbrt, 1e9, 2.0),
    ],
)
def test_hyperbolic_functions(function: Any, reference: Any, high: float, units: float) -> None:
    x = np.concatenate([_between(-high, high), _between(-3, 3), _signed(TINY)])
    assert _units(*_both(function, reference, x)) < units
    mine, right = _both(function, reference, np.array([np.inf, -np.inf, np.nan, 1e4, -1e4]))
    with np.errstate(over="ignore"):
        np.testing.assert_allclose(mine, right.astype(float), rtol=1e-15)


@pytest.mark.parametrize("function", [jnp.sin, jnp.tan, jnp.sinh, jnp.tanh, jnp.cbrt])
def test_odd_functions_are_odd_to_the_last_place(function: Any) -> None:
    x = _between(0, 30)
    np.testing.assert_array_equal(on_many(function, -x), -on_many(function, x))


@pytest.mark.parametrize("function", [jnp.exp, jnp.exp2, jnp.tanh, jnp.sinh, jnp.cosh, jax.nn.sigmoid])
def test_monotonic_to_an_ulp_over_the_seams_of_the_pieces(function: Any) -> None:
    x = np.linspace(0, 20, 200_001)
    y = on_many(function, x)
    assert np.all(np.diff(y) >= -4 * np.spacing(y[:-1]))


SINGLE: list[tuple[Any, Any, tuple[float, float]]] = [
    (jnp.sin, np.sin, (-1e3, 1e3)),
    (jnp.cos, np.cos, (-1e3, 1e3)),
    (jnp.exp, np.exp, (-87.3, 88.7)),
    (jnp.exp2, np.exp2, (-126, 127.9)),
    (jnp.tanh, np.tanh, (-10, 10)),
    (jnp.sinh, np.sinh, (-89.4, 89.4)),
    (jnp.cosh, np.cosh, (-89.4, 89.4)),
    (jnp.tan, np.tan, (-1.5, 1.5)),
    (jax.nn.sigmoid, _logistic, (-80, 80)),
    (jnp.cbrt, np.cbrt, (-1e4, 1e4)),
]


@pytest.mark.parametrize(("function", "reference", "range_"), SINGLE)
def test_single_precision(function: Any, reference: Any, range_: tuple[float, float]) -> None:
    x = np.concatenate([_between(*range_), _between(-1, 1)]).astype(np.float32)
    x = x[x != 0]
    mine, right = _both(function, reference, x)
    assert mine.dtype == np.float32
    # sine and cosine to a part of 1, the others to a part of the value
    size = 1.0 if function in (jnp.sin, jnp.cos) else np.abs(right)
    assert np.max(np.abs(mine - right) / size) < 4e-7


def test_single_precision_at_its_ends() -> None:
    odd = np.array([np.nan, np.inf, -np.inf, 89.0, -104.0, 1e30, -1e30], np.float32)
    np.testing.assert_array_equal(on_many(jnp.exp, odd), [np.nan, np.inf, 0, np.inf, 0, np.inf, 0])
    np.testing.assert_array_equal(on_many(jnp.tanh, odd), [np.nan, 1, -1, 1, -1, 1, -1])
    np.testing.assert_array_equal(on_many(jax.nn.sigmoid, odd), [np.nan, 1, 0, 1, 0, 1, 0])
    mine, right = _both(jnp.exp, np.exp, _between(-103.9, -87.4).astype(np.float32))
    assert np.max(np.abs(mine - right)) <= 1.5e-45


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_rounding(dtype: Any) -> None:
    limits = np.finfo(dtype)
    large = dtype(2.0) ** (limits.nmant + np.arange(-2, 3))
    below_half = np.nextafter(dtype(0.5), dtype(0))
    x = _signed(np.concatenate([np.arange(0, 8.25, 0.25), [below_half], large, large + 1]).astype(dtype))
    np.testing.assert_array_equal(on_many(jnp.round, x), np.rint(x))
    away = on_many(lambda x: lax.round(x, lax.RoundingMethod.AWAY_FROM_ZERO), x)
    np.testing.assert_array_equal(away, _away(x))
    np.testing.assert_array_equal(on_many(jnp.ceil, x), np.ceil(x))
    np.testing.assert_array_equal(on_many(jnp.trunc, x), np.trunc(x))


def _away(x: np.ndarray) -> np.ndarray:
    """To the nearest whole number and halves away from zero, worked out in extended precision."""
    wide = x.astype(np.longdouble)
    return np.trunc(wide + np.copysign(np.longdouble(0.5), wide)).astype(x.dtype)


# Traced once for all examples.
DIVIDED = executable(traced_with(lambda a, b: (lax.div(a, b), lax.rem(a, b)), np.int64(1), np.int64(1)))


@hypothesis.given(st.integers(-(2**53), 2**53), st.integers(-(2**40), 2**40).filter(bool))
def test_whole_numbers_divide_exactly(a: int, b: int) -> None:
    quotient, rest = (int(result) for result in DIVIDED(np.float64(a), np.float64(b)))
    assert quotient * b + rest == a
    assert abs(rest) < abs(b)
    assert rest == 0 or (rest < 0) == (a < 0)
