"""JAX functions as scalar programs: the same numbers as JAX, and no more arithmetic than is needed."""

from __future__ import annotations

import functools
import inspect
import math
import re
from collections.abc import Callable
from typing import Any

import hypothesis
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import strategies as st
from jax import lax

from gaitsweep.engine.kernel import arrays, primitives
from gaitsweep.engine.kernel.trace import UnsupportedError
from tests.support.scalar_programs import (
    executable,
    native,
    outputs_of,
    source_of,
    storing_source_of,
    traced_with,
)
from tests.support.traced_cases import CASES

TOGETHER = 16


def _by_jax(function: Callable[..., Any], *args: Any) -> Any:
    # run once: XLA's optimizations would take longer than they save
    compiled = jax.jit(function).lower(*args).compile({"xla_backend_optimization_level": "0"})
    return compiled(*args)


@functools.cache
def _cases_by_jax(place: int) -> dict[str, Any]:
    """Results of JAX for `TOGETHER` cases, as one program: XLA takes as long for a program of a few lines."""
    cases = dict(list(CASES.items())[place : place + TOGETHER])

    def every(args: dict[str, tuple[Any, ...]]) -> dict[str, Any]:
        return {name: function(*args[name]) for name, (function, _) in cases.items()}

    return _by_jax(every, {name: args for name, (_, args) in cases.items()})


def _compare(function: Callable[..., Any], args: tuple[Any, ...], by_jax: Any = None) -> None:
    expected = jax.tree.leaves(_by_jax(function, *args) if by_jax is None else by_jax)
    jax_args = jax.tree.map(jnp.asarray, args)
    for mine, theirs in zip(outputs_of(function, *jax_args), expected, strict=True):
        assert mine.dtype == theirs.dtype
        # sums in another order and functions right to an ulp or two: some 1e-15 of numbers near 1
        near = 1e-12 if theirs.dtype == np.float64 else 2e-6
        np.testing.assert_allclose(mine, theirs, rtol=near, atol=near / 100)


@pytest.mark.slow("backward derivative")
@pytest.mark.parametrize("name", CASES)
def test_a_program_gives_what_jax_gives(name: str) -> None:
    place = list(CASES).index(name) // TOGETHER * TOGETHER
    _compare(*CASES[name], by_jax=_cases_by_jax(place)[name])


def _primitives_of(jaxpr: Any) -> set[str]:
    names = set()
    for equation in jaxpr.eqns:
        names.add(equation.primitive.name)
        for value in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda v: hasattr(v, "eqns")):
            if hasattr(value, "eqns"):
                names |= _primitives_of(value)
    return names


# Names of other releases of JAX, and what only appears on devices.
ELSEWHERE = {
    "add_any",
    "expand_dims",
    "pjit",
    "core_call",
    "closed_call",
    "custom_vjp_call_jaxpr",
    "remat",
    "checkpoint",
    "custom_lin",
    "device_put",
    # since JAX 0.11
    "call_hi_primitive",
    "log2",
    "one_minus_square",
}


def test_every_supported_primitive_has_a_case() -> None:
    rooms = (primitives._ELEMENTWISE, primitives._REDUCTIONS, primitives._SUB_PROGRAMS, arrays.RULES)
    known = {name for room in rooms for name in room}
    tried = set()
    for function, args in CASES.values():
        tried |= _primitives_of(jax.make_jaxpr(function)(*jax.tree.map(jnp.asarray, args)).jaxpr)
    assert tried - known == set()
    assert known - tried <= ELSEWHERE


# What random programs are grown from: smooth, or exact at their jumps.
UNARY: list[Callable[[Any], Any]] = [
    jnp.sin,
    jnp.cos,
    jnp.tanh,
    jnp.arctan,
    jnp.negative,
    jnp.abs,
    jax.nn.sigmoid,
    lambda x: x * x / (1 + x * x),
    lambda x: jnp.exp(-jnp.abs(x)),
    lambda x: jnp.sqrt(1 + x * x),
    lambda x: jnp.log1p(jnp.abs(x)),
    lambda x: x[::-1],
    lambda x: jnp.roll(x, 1),
    lambda x: jnp.cumsum(x) / 3,
    lambda x: x.at[1].set(0.5),
    lambda x: x.at[0].add(x[2]),
    lambda x: x[jnp.array([2, 0, 0])],
    lambda x: jnp.full(3, jnp.sum(x)),
    lambda x: jnp.outer(x, x)[0] / (1 + x @ x),
    lambda x: jnp.concatenate([x[1:], x[:1]]),
    lambda x: 0.0 * x + x,
    lambda x: jax.jvp(jnp.sin, (x,), (x,))[1],
    lambda x: lax.fori_loop(0, 2, lambda i, y: 0.5 * y + x, x),
]
BINARY: list[Callable[[Any, Any], Any]] = [
    jnp.add,
    jnp.subtract,
    jnp.multiply,
    jnp.maximum,
    jnp.minimum,
    lambda x, y: x / (2 + jnp.cos(y)),
    lambda x, y: jnp.where(jnp.arange(3) < 2, x, y),
    lambda x, y: jnp.full(3, x @ y),
    jnp.arctan2,
    lambda x, y: lax.cond(np.True_, jnp.sin, jnp.cos, x - y),
    lambda x, y: jnp.stack([x, y]).mean(0),
]


def _grown(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    one = st.tuples(st.sampled_from(UNARY), inner).map(lambda p: lambda a: p[0](p[1](a)))
    two = st.tuples(st.sampled_from(BINARY), inner, inner).map(lambda p: lambda a: p[0](p[1](a), p[2](a)))
    return st.one_of(one, two)


_leaves = st.one_of(
    st.integers(0, 1).map(lambda i: lambda a: a[i]),
    st.sampled_from([0.0, 1.0, -1.0, 0.7]).map(lambda value: lambda a: jnp.full(3, value)),
)
_inputs = st.lists(st.floats(-3, 3).map(lambda x: round(x, 3)), min_size=6, max_size=6)


@pytest.mark.slow
@hypothesis.settings(max_examples=60)
@hypothesis.given(st.recursive(_leaves, _grown, max_leaves=12), _inputs)
def test_random_programs_agree_with_jax(tree: Any, numbers: list[float]) -> None:
    args = (jnp.array(numbers).reshape(2, 3),)
    expected = _by_jax(tree, *args)
    hypothesis.assume(bool(jnp.all(jnp.abs(expected) < 1e6)))
    # relative to the largest element: sums that cancel leave the rounding of what they are sums of
    (mine,) = outputs_of(tree, *args)
    np.testing.assert_allclose(
        mine, expected, rtol=1e-12, atol=1e-12 * (1 + float(jnp.max(jnp.abs(expected))))
    )


def _refusal(function: Callable[..., Any], *args: Any) -> str:
    with pytest.raises(UnsupportedError) as caught:
        traced_with(function, *args)
    return str(caught.value)


def _model_with_a_cholesky(x: Any) -> Any:
    return lax.linalg.cholesky(x)


def test_an_unknown_primitive_is_refused_by_name_file_and_line() -> None:
    message = _refusal(_model_with_a_cholesky, jnp.eye(2))
    _, first = inspect.getsourcelines(_model_with_a_cholesky)
    assert "'cholesky'" in message
    assert message.endswith(f"({__file__}, line {first + 1})")


def test_a_refusal_in_a_called_function_names_its_place_once() -> None:
    message = _refusal(
        lambda x: lax.cond(x[0, 0] > 0, jax.jit(_model_with_a_cholesky), lambda x: x, x), jnp.eye(2)
    )
    assert len(re.findall("line", message)) == 1


X1 = jnp.asarray(0.5)


@pytest.mark.parametrize(
    ("function", "args", "words"),
    [
        (lambda x: x + jax.random.uniform(jax.random.PRNGKey(0)), (X1,), "random"),
        (lambda x: x + jax.random.uniform(jax.random.key(0)), (X1,), "random"),
        (lambda x: lax.while_loop(lambda y: y < 1, lambda y: y + x, x), (X1,), "turns does not depend"),
        (lambda x: lax.fori_loop(0, 10**9, lambda i, y: y + i, x), (X1,), "256 turns"),
        (
            lambda x: lax.while_loop(lambda s: s[0] < 300, lambda s: (s[0] + 1, s[1]), (0, x)),
            (X1,),
            "256 turns",
        ),
        (lambda x: x.astype(jnp.float16), (X1,), "float16"),
        # a generator of random numbers, and 0 - 1, which is 2^64 - 1 in JAX
        (lambda i: (1103515245 * i + 12345) % 2**31, (np.int64(1),), "'mul'"),
        (lambda i: i - jnp.uint64(1), (np.uint64(1),), "uint64"),
        (lambda x: jnp.asarray(x, complex), (X1,), "complex128"),
        (lambda x, i: jnp.zeros(65).at[3].set(x)[i], (X1, np.int64(1)), "64 indices"),
        (lambda x, i: x * jnp.zeros(65).at[i].set(x), (X1, np.int64(1)), "64 indices"),
        (lambda i: i & 3, (np.int64(1),), "'and' of flags only"),
        (lambda i: i ^ 3, (np.int64(1),), "'xor' of flags only"),
        (lambda x: lax.reduce_precision(x, 5, 10), (X1,), "float32 and float64 only"),
        (
            lambda x: lax.reduce_max_p.bind(jnp.zeros(0) + x, axes=(0,), out_sharding=None),
            (X1,),
            "no elements",
        ),
        (lambda x: jax.pure_callback(np.sin, x, x), (X1,), "outside of JAX"),
    ],
)
def test_unsupported_operations_are_refused(function: Any, args: Any, words: str) -> None:
    message = _refusal(function, *args)
    assert words in message
    assert "line" in message


def test_inputs_of_other_types_are_refused() -> None:
    assert "float16" in _refusal(lambda x: x, np.float16(1))


def _lines(function: Callable[..., Any], *args: Any, steady: Any = None) -> list[str]:
    """The statements of the emitted function, without its first and last line."""
    return [
        line.strip() for line in source_of(traced_with(function, *args, steady=steady)).splitlines()[1:-1]
    ]


def _result(function: Callable[..., Any], *args: Any) -> str:
    return source_of(traced_with(function, *args)).splitlines()[-1].strip()


@pytest.mark.parametrize(
    ("function", "result"),
    [
        (lambda x: 0 * x, "0.0"),
        (lambda x: x + 0, "x0"),
        (lambda x: 0 + x, "x0"),
        (lambda x: 1 * x, "x0"),
        (lambda x: x - 0, "x0"),
        (lambda x: x / 1, "x0"),
        (lambda x: jnp.negative(-x), "x0"),
        (lambda x: 0 / x, "0.0"),
        (lambda x: x * -1 * -1, "x0"),
        (lambda x: jnp.where(x > 0, x, x), "x0"),
        (lambda x: 2.0 + jnp.sqrt(4.0) + 0 * x, "4.0"),
        (lambda x: jnp.where(True, x, 2 * x), "x0"),
        (lambda x: lax.cond(np.False_, jnp.sin, lambda x: x, x), "x0"),
        (lambda x: jnp.where(x > 0, True, False) | True, "True"),
        (lambda x: x**1, "x0"),
        (lambda x: x.astype(float), "x0"),
        (lambda x: (jnp.eye(3) @ jnp.stack([x, 2 * x, x]))[0], "x0"),
        (lambda x: (x > 0) & ~(x > 0), "False"),
    ],
)
def test_constants_are_folded(function: Any, result: str) -> None:
    assert _lines(function, X1) == []
    assert _result(function, X1) == f"return ({result}, )"


def test_a_common_part_is_written_once() -> None:
    lines = _lines(lambda x, y: (jnp.log(x * y) + jnp.log(y * x), y * x), X1, X1)
    assert sum("math.log" in line for line in lines) == 1
    assert sum("*" in line for line in lines) == 1


def test_unused_operations_are_omitted() -> None:
    assert _lines(lambda x: (x, jnp.exp(x), jnp.sort(jnp.stack([x, -x])))[0], X1) == []


def test_flags_read_as_numbers_are_flags_again() -> None:
    (line,) = _lines(lambda x: jnp.where(x > 0, 1, 0) == 1, X1)
    assert line.endswith("0.0 < x0")


def test_a_choice_that_has_been_made_is_not_made_again() -> None:
    lines = _lines(lambda x, y: jnp.where(x > 0, jnp.where(x > 0, x, y), 3 * y), X1, X1)
    assert sum(" if " in line for line in lines) == 1
    assert not any("x1 if" in line for line in lines)


def test_divisions_by_a_steady_value_share_one_reciprocal() -> None:
    lines = _lines(lambda x, y, p: (x / p, y / p, (x - y) / p), X1, X1, X1, steady=[False, False, True])
    assert sum("/" in line for line in lines) == 1
    assert sum("*" in line for line in lines) == 3
    # nothing is gained where the quotient stays the same too, and a known divisor rounds as JAX rounds it
    assert sum("/" in line for line in _lines(lambda p, q: p / q, X1, X1, steady=[True, True])) == 1
    assert any("/ 3.0" in line for line in _lines(lambda x: x / 3.0, X1))
    assert any("* 0.25" in line for line in _lines(lambda x: x / 4.0, X1))


def test_a_wrap_keeps_its_division() -> None:
    lines = _lines(lambda x, p: jnp.mod(x, p), X1, X1, steady=[False, True])
    assert any("x0 / x1" in line for line in lines)


@pytest.mark.parametrize(
    "function",
    [
        lambda x, p: jnp.floor(x / p),
        lambda x, p: jnp.ceil(-x / p + 1.0),
        lambda x, p: jnp.where(x / p >= 1.0, 1.0, 0.0),
        lambda x, p: jnp.where(x / p == jnp.floor(x / p), 1.0, 0.0),
    ],
)
def test_floors_and_comparisons_keep_their_divisions(function: Any) -> None:
    """49 times 1 / 49 is the float below 1."""
    number = np.float64(49.0)
    (result,) = executable(traced_with(function, X1, X1, steady=[False, True]))(number, number)
    assert result == function(number, number)


def test_single_precision_stays_single() -> None:
    lines = _lines(lambda x: jnp.sqrt(x) * 0.1 + jnp.floor(x), jnp.float32(2))
    assert any("sqrt32(" in line for line in lines)
    assert any("floor32(" in line for line in lines)
    assert any("float32(0.1" in line for line in lines)


def _of_all_kinds(x: Any, y: Any, n: Any, flag: Any) -> Any:
    sides = (jnp.sin(x) + jnp.floor(y), jnp.exp(y) * x.astype(jnp.float32), jnp.where(flag, x, y), n // 3)
    checks = (jnp.isfinite(x), jnp.argmax(jnp.stack([x, x * x])), x.astype(int) + n, jnp.round(y), ~flag)
    calls = (jnp.log(x), jnp.arctan2(y, y), jnp.arcsin(x), y**y, jnp.log1p(y), jax.lax.erf(y), jnp.sqrt(x))
    return sides, checks, calls


@pytest.mark.parametrize("x", [0.7, -0.3, 40.0, 0.0, math.nan, math.inf])
def test_machine_code_runs_a_program_as_numpy_does(x: float, compiled: Callable[..., Any]) -> None:
    inputs = (np.float64(x), np.float32(x), np.float64(7), np.bool_(x > 0))
    expected = executable(traced_with(_of_all_kinds, *KINDS))(*inputs)
    for mine, theirs in zip(compiled(*inputs), expected, strict=True):
        near = 2e-7 if np.asarray(theirs).dtype == np.float32 else 1e-15
        np.testing.assert_allclose(mine, theirs, rtol=near, atol=near)


KINDS = (np.float64(0), np.float32(0), np.int64(0), np.bool_(True))


@pytest.fixture(scope="module")
def compiled() -> Callable[..., Any]:
    """The emitted source as it is lowered to LLVM and compiled for a CPU."""
    traced = traced_with(_of_all_kinds, *KINDS)
    run = native(storing_source_of(traced))

    def returned(*inputs: Any) -> np.ndarray:
        values = np.array([*inputs, *np.zeros(len(traced.outputs))], float)
        run(values)
        return values[len(inputs) :]

    return returned
