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

from gaitsweep.engine.kernel.operations import OPERATIONS
from gaitsweep.engine.kernel.trace import UnsupportedError
from tests.support.scalar_programs import executable, native, on_many, storing_source_of, traced_with

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
    """Results of the kernel, and correct ones in extended precision."""
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


def test_squares_of_sine_and_cosine_add_up_to_1() -> None:
    x = _between(-1e4, 1e4)
    assert np.max(np.abs(on_many(lambda x: jnp.sin(x) ** 2 + jnp.cos(x) ** 2, x) - 1)) < 1e-15


@pytest.mark.parametrize("function", [jnp.sin, jnp.cos, jnp.tan])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_angles_that_are_nan_or_infinite(function: Any, dtype: Any) -> None:
    assert np.all(np.isnan(on_many(function, np.array([np.nan, np.inf, -np.inf], dtype))))


def test_the_exponential_over_its_whole_range() -> None:
    x = np.concatenate([_between(-708, 709.78), _signed(TINY), _between(-1, 1)])
    assert _units(*_both(jnp.exp, np.exp, x)) < 1.6


def test_the_exponential_underflows() -> None:
    # between the least normal and the least number of all: right to one of these, and then zero
    mine, right = _both(jnp.exp, np.exp, _between(-745.13, -708))
    assert np.max(np.abs(mine - right)) <= 5e-324
    assert np.min(mine) > 0
    np.testing.assert_array_equal(on_many(jnp.exp, np.array([-745.2, -746.0, -1e4, -1e300, -np.inf])), 0.0)


def test_the_exponential_overflows() -> None:
    highest = np.log(np.finfo(float).max)
    assert np.isfinite(on_many(jnp.exp, np.array([highest])))[0]
    np.testing.assert_array_equal(on_many(jnp.exp, np.array([709.79, 710.0, 1e4, 1e300, np.inf])), np.inf)
    assert np.isnan(on_many(jnp.exp, np.array([np.nan])))[0]


def test_the_exponential_at_whole_powers_of_two() -> None:
    n = np.arange(-1080.0, 1030.0)
    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(on_many(jnp.exp2, n), np.exp2(n))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("exponent", [0.5, -0.5, 1.5])
def test_powers_of_infinities(exponent: float, dtype: Any) -> None:
    x = np.array([-np.inf, -1.0, 0.0, 4.0, np.inf, np.nan], dtype)
    with np.errstate(all="ignore"):
        right = np.power(x, np.full_like(x, exponent))
        np.testing.assert_array_equal(on_many(lambda x: x**exponent, x), right)


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


INVERSES: list[tuple[Any, Any, float]] = [
    (jnp.arctan, np.arctan, 4.0),
    (jnp.arcsin, np.arcsin, 1.0),
    (jnp.arccos, np.arccos, 1.0),
]
# Millions of random arguments gave at most 1.6 for angles and arctangents, 1.82 for arcsines.
INVERSE_UNITS = 1.9


@pytest.mark.parametrize(("function", "reference", "high"), INVERSES)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_inverse_functions(function: Any, reference: Any, high: float, dtype: Any) -> None:
    scales = 2.0 ** RANDOM.uniform(-60, 0, 20_000)
    parts = [_between(-high, high), *map(_signed, (_between(0.54, 0.58), scales, 1 - scales))]
    x = np.concatenate(parts).astype(dtype)
    assert _units(*_both(function, reference, x[x != 0])) < INVERSE_UNITS
    np.testing.assert_array_equal(
        on_many(function, np.array([0, -0.0], dtype)), reference(np.zeros(2, dtype))
    )


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_inverse_functions_at_their_ends(dtype: Any) -> None:
    x = np.array([1, -1, np.nextafter(dtype(1), dtype(2)), -1.5, np.inf, -np.inf, np.nan], dtype)
    with np.errstate(invalid="ignore"):
        for function, reference, _ in INVERSES:
            np.testing.assert_array_max_ulp(on_many(function, x), reference(x), 1)
    beyond = np.concatenate(
        [2.0 ** RANDOM.uniform(0, np.finfo(dtype).maxexp - 1, 20_000), _between(1.77, 1.79)]
    )
    assert _units(*_both(jnp.arctan, np.arctan, _signed(beyond).astype(dtype))) < INVERSE_UNITS
    least = _signed(np.geomspace(np.finfo(dtype).smallest_subnormal, 1e-10, 2000, dtype=dtype))
    np.testing.assert_array_equal(on_many(jnp.arctan, least), least)
    np.testing.assert_array_equal(on_many(jnp.arcsin, least), least)


@pytest.fixture(scope="module", params=[np.float64, np.float32])
def angle(request: pytest.FixtureRequest) -> Any:
    """The kind of number, and the angle of y and x as the kernel computes it."""
    one = request.param(1)
    return request.param, lambda y, x: executable(traced_with(jnp.arctan2, one, one))(y, x)[0]


def _angle_units(angle: Any, y: np.ndarray, x: np.ndarray) -> float:
    dtype, mine = angle
    y, x = y.astype(dtype), x.astype(dtype)
    return _units(mine(y, x), np.arctan2(y.astype(np.longdouble), x.astype(np.longdouble)))


def test_angles_all_around(angle: Any) -> None:
    turn = np.concatenate([_between(-np.pi, np.pi, 200_000), _between(0.35, 0.55, 100_000)])
    size = RANDOM.uniform(1, 4, turn.size)
    assert _angle_units(angle, size * np.sin(turn), size * np.cos(turn)) < INVERSE_UNITS


def test_angles_of_the_least_and_largest_numbers(angle: Any) -> None:
    limits = np.finfo(angle[0])
    least = np.log2(float(limits.smallest_subnormal))
    for low, high in [(least, least + 6), (least, limits.minexp + 4), (limits.maxexp - 3, limits.maxexp)]:
        sizes = np.minimum(2.0 ** RANDOM.uniform(low, high, (2, 20_000)), limits.max)
        y, x = sizes * RANDOM.choice([-1, 1], sizes.shape)
        assert _angle_units(angle, y, x) < INVERSE_UNITS


def _odd_points(dtype: Any) -> list[np.ndarray]:
    """All pairs of numbers at which something happens, each with both signs."""
    least, largest = np.finfo(dtype).smallest_subnormal, np.finfo(dtype).max
    small, large = [0, least, 3 * least, np.finfo(dtype).tiny, 1e-30], [1e30, 0.6 * largest, largest, np.inf]
    odd = np.append(_signed(np.array([*small, 0.3, 0.5, 9 / 16, 1, 2, *large])), np.nan).astype(dtype)
    return [side.ravel() for side in np.meshgrid(odd, odd)]


def _same_angles(mine: np.ndarray, y: np.ndarray, x: np.ndarray) -> None:
    right = np.arctan2(y, x)
    np.testing.assert_array_equal(np.isnan(mine), np.isnan(right))
    known = ~np.isnan(right)
    np.testing.assert_array_max_ulp(mine[known], right[known], 2)
    np.testing.assert_array_equal(np.signbit(mine[known]), np.signbit(right[known]))


def test_angles_of_zeros_infinities_and_no_numbers(angle: Any) -> None:
    y, x = _odd_points(angle[0])
    _same_angles(angle[1](y, x), y, x)


def test_compiled_angles_know_the_sign_of_zero(angle: Any) -> None:
    dtype = angle[0]
    traced = traced_with(jnp.arctan2, dtype(1), dtype(1))
    compiled = native(storing_source_of(traced))
    y, x = _odd_points(dtype)
    points = np.stack([y, x, np.zeros_like(x)], axis=1).astype(float)
    for point in points:
        compiled(point)
    _same_angles(points[:, 2].astype(dtype), y, x)


@pytest.mark.parametrize(
    ("function", "double", "single"),
    [(jnp.arctan, 44, 30), (jnp.arcsin, 41, 27), (jnp.arccos, 44, 30), (jnp.arctan2, 64, 48)],
)
def test_inverse_functions_call_no_library(function: Any, double: int, single: int) -> None:
    for dtype, most in ((np.float64, double), (np.float32, single)):
        fields = [dtype(0.3)] * (2 if function is jnp.arctan2 else 1)
        program, wanted = (traced := traced_with(function, *fields)).program, traced.outputs
        names = [program.nodes[at].op for at in program.needed(wanted)]
        sources = [OPERATIONS[name].python for name in names if name not in ("input", "constant")]
        assert not [source for source in sources if "math." in source or "**" in source]
        assert len(sources) <= most


@pytest.mark.parametrize("function", [jnp.sin, jnp.tan, jnp.sinh, jnp.tanh, jnp.cbrt, jnp.arctan])
def test_odd_functions_are_odd_to_the_last_place(function: Any) -> None:
    x = _between(0, 30)
    np.testing.assert_array_equal(on_many(function, -x), -on_many(function, x))


@pytest.mark.parametrize("function", [jnp.exp, jnp.exp2, jnp.tanh, jnp.sinh, jnp.cosh, jax.nn.sigmoid])
def test_monotonic_to_an_ulp_over_the_seams_of_the_pieces(function: Any) -> None:
    x = np.linspace(0, 20, 200_001)
    y = on_many(function, x)
    assert np.all(np.diff(y) >= -4 * np.spacing(y[:-1]))


SINGLE: list[tuple[Any, Any, tuple[float, float]]] = [
    (jnp.sin, np.sin, (-5e4, 5e4)),
    (jnp.cos, np.cos, (-5e4, 5e4)),
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


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_remainders_of_infinite_divisors_and_of_quotients_without_digits(dtype: Any) -> None:
    inf, large = np.inf, np.finfo(dtype).max
    a = np.array([1, -1, 2.5, 0, inf, np.nan, 1, 1, large, -7.25, large], dtype)
    b = np.array([inf, inf, -inf, inf, inf, 2, np.nan, 0, large / 2, 2, 1e-30], dtype)
    with np.errstate(all="ignore"):
        (mine,) = executable(traced_with(lax.rem, a[0], b[0]))(a, b)
    np.testing.assert_array_equal(mine[:-1], lax.rem(a, b)[:-1])
    assert np.isnan(mine[-1])  # JAX's remainder is exact, but less than the rounding of a


def _whole(a: Any, b: Any) -> tuple[Any, ...]:
    """Arithmetic that leaves the range of a dtype; the last is a generator of random numbers."""
    sums = a + b, a - b, -a, a + b + 1, a + b + a + b, jnp.sum(jnp.stack([a, b, a]))
    return *sums, a * 77, (a - b) * 5, a.astype(jnp.int8) + jnp.int8(100), a * 22695 + 1


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32])
def test_whole_numbers_of_up_to_32_bits_wrap_as_in_jax(dtype: Any) -> None:
    limits = np.iinfo(dtype)
    edges = np.array(
        [limits.min + 1, limits.min + 2, 0, 1, limits.max // 2, limits.max - 1, limits.max], dtype
    )
    a, b = (pair.ravel() for pair in np.meshgrid(edges, edges))
    results = executable(traced_with(_whole, a[0], b[0]))(a.astype(np.float64), b.astype(np.float64))
    for mine, right in zip(results, jax.vmap(_whole)(a, b), strict=True):
        np.testing.assert_array_equal(mine, np.asarray(right).astype(np.float64))


def _divided(a: Any, b: Any) -> tuple[Any, ...]:
    """Quotients and remainders, also of constants, and what wraps around after them."""
    seven, zero = jnp.asarray(7, a.dtype), jnp.asarray(0, a.dtype)
    by_constants = lax.div(a, seven), lax.rem(a, seven), lax.div(a, zero), lax.rem(a, zero), lax.div(seven, b)
    return *by_constants, lax.div(a, b), lax.rem(a, b), a // b, a % b, lax.div(a, b) + seven, jnp.abs(a)


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64])
def test_whole_numbers_divide_as_in_jax_also_by_zero(dtype: Any) -> None:
    limits = np.iinfo(dtype)
    # int64 is exact up to 2^53, and 32 bits do not wrap at their least number, which no model counts to
    edges = [limits.min, limits.max] if limits.bits < 32 else [-(2**30), 2**30] if limits.min else [2**30]
    values = np.array([-100, -7, -2, -1, 0, 1, 2, 9, 100][0 if limits.min else 4 :] + edges, dtype)
    a, b = (pair.ravel() for pair in np.meshgrid(values, values))
    results = executable(traced_with(_divided, a[0], b[0]))(a.astype(np.float64), b.astype(np.float64))
    for mine, right in zip(results, jax.vmap(_divided)(a, b), strict=True):
        np.testing.assert_array_equal(np.broadcast_to(mine, a.shape), np.asarray(right).astype(np.float64))


def test_quotients_that_float64_cannot_represent_are_refused() -> None:
    """XLA's quotient by 0 is 2^64 - 1 in uint64."""
    with pytest.raises(UnsupportedError, match=r"uint64.* above 2\^53"):
        traced_with(lax.div, np.uint64(1), np.uint64(1))
    traced_with(lambda count: lax.div(count, jnp.uint64(3)), np.uint64(1))


@pytest.mark.parametrize("real", [np.float32, np.float64])
@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int32, np.uint32, np.int64])
def test_floats_become_whole_numbers_as_in_jax(dtype: Any, real: Any) -> None:
    x = np.array([np.nan, np.inf, -np.inf, 1e20, -1e20, 300.7, -300.7, -1.5, 2.0**31, -0.5], real)
    (mine,) = executable(traced_with(lambda x: x.astype(dtype), x[0]))(x)
    np.testing.assert_array_equal(mine, np.asarray(jax.jit(lambda x: x.astype(dtype))(x)).astype(np.float64))


def test_counts_that_cannot_leave_their_dtype_are_not_wrapped() -> None:
    traced = traced_with(lambda count: count + jnp.int32(1), np.int32(0))
    assert [node.op for node in traced.program.nodes] == ["input", "constant", "add"]
