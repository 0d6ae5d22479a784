"""Expressions: Python's values for floats, arrays and tracers; no other code is executed."""

from __future__ import annotations

import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from gaitsweep.expression import (
    FUNCTIONS,
    ExpressionError,
    evaluate,
    fulfilled,
    functions_of,
    names_used,
    read_condition,
    resolve,
)

NAMES = {"beta": 0.8, "kappa": 100.0, "m_B": 0.9}

PYTHON = {
    "sqrt": math.sqrt, "sin": math.sin, "cos": math.cos, "tan": math.tan, "exp": math.exp, "log": math.log,
    "abs": abs, "floor": math.floor, "min": min, "max": max, "pi": math.pi, "e": math.e,
}  # fmt: skip


# A jump turns an ulp between NumPy and Python into a whole step: these have a test of their own.
NOT_SMOOTH = ("min", "max", "floor")


def _leaves() -> st.SearchStrategy[str]:
    numbers = st.floats(0.01, 100.0).map(lambda number: repr(round(number, 4)))
    return st.one_of(numbers, st.integers(0, 50).map(str), st.sampled_from([*NAMES, "pi", "e"]))


def _grown(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    binary = st.tuples(inner, st.sampled_from(["+", "-", "*", "/", "**"]), inner)
    calls = st.tuples(st.sampled_from([name for name in FUNCTIONS if name not in NOT_SMOOTH]), inner)
    pairs = st.tuples(st.sampled_from(["min", "max"]), inner, inner)
    return st.one_of(
        binary.map(lambda parts: f"({parts[0]} {parts[1]} {parts[2]})"),
        inner.map(lambda text: f"-{text}"),
        calls.map(lambda parts: f"{parts[0]}({parts[1]})"),
        pairs.map(lambda parts: f"{parts[0]}({parts[1]}, {parts[2]})"),
    )


EXPRESSIONS = st.recursive(_leaves(), _grown, max_leaves=8)


def _python(text: str) -> float | None:
    """Python's own value of the text, its whole numbers made floats, or None where it has none."""
    floats = re.sub(r"(?<![\w.])(\d+)(?![\w.])", r"\1.0", text)
    try:
        value = eval(floats, {"__builtins__": {}}, {**PYTHON, **NAMES})
        return None if isinstance(value, complex) or not math.isfinite(value) else float(value)
    except (ValueError, ZeroDivisionError, OverflowError):
        return None


@given(EXPRESSIONS)
def test_agrees_with_python(text: str) -> None:
    expected = _python(text)
    assume(expected is not None and abs(expected) < 1e12)
    # A chain of eight operations loses a few ulps, more where tan or a power is steep.
    assert evaluate(text, NAMES) == pytest.approx(expected, rel=1e-6, abs=1e-9)


@given(st.floats(-100, 100), st.floats(0.01, 100), st.sampled_from(["+", "-", "*", "/", "//", "%"]))
def test_one_operation_is_exactly_pythons(left: float, right: float, sign: str) -> None:
    text = f"({left!r}) {sign} ({right!r})"
    assert evaluate(text, {}) == eval(text)
    assert evaluate(f"floor({left!r})", {}) == math.floor(left)


def test_a_lone_name_gives_an_array_of_its_own() -> None:
    column = np.array([0.5, 0.7])
    result = evaluate("beta", {"beta": column})
    assert result.tolist() == column.tolist()
    assert not np.shares_memory(result, column)


@given(EXPRESSIONS, st.lists(st.floats(0.1, 0.9), min_size=1, max_size=5))
def test_arrays_are_the_scalars_side_by_side(text: str, betas: list[float]) -> None:
    def alone(beta: float) -> float | None:
        try:
            return evaluate(text, {**NAMES, "beta": beta})
        except ExpressionError:
            return None

    expected = [alone(beta) for beta in betas]
    if None in expected:
        with pytest.raises(ExpressionError):
            evaluate(text, {**NAMES, "beta": np.array(betas)})
        return
    value = evaluate(text, {**NAMES, "beta": np.array(betas)})
    assert np.array_equal(np.broadcast_to(value, len(betas)), np.array(expected))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2*(1-beta)*pi", 2 * (1 - 0.8) * math.pi),
        ("-2**2", -4.0),
        ("2**-1", 0.5),
        ("7//2", 3.0),
        ("-7 % 3", 2.0),
        ("1e-3", 1e-3),
        ("2*sqrt(kappa)", 20.0),
        ("max(1, 2, kappa)", 100.0),
        (" ( 1 +\t2 ) ", 3.0),
        (3, 3.0),
        (np.float32(0.5), 0.5),
    ],
)
def test_known_values(text: str | float, value: float) -> None:
    result = evaluate(text, NAMES)
    assert isinstance(result, float)
    assert result == value


def test_tracers_with_the_functions_of_jax() -> None:
    """A formula followed under jit and differentiated: sigma = 2 sqrt(kappa) has the slope 1/sqrt(kappa)."""

    def sigma(kappa: jax.Array) -> jax.Array:
        return evaluate(
            "2*sqrt(kappa) + max(0, min(beta, 1)) - 0.8", {"kappa": kappa, "beta": 0.8}, functions_of(jnp)
        )

    value, slope = jax.jit(jax.value_and_grad(sigma))(100.0)
    assert value == pytest.approx(20.0, rel=1e-14)
    assert slope == pytest.approx(0.1, rel=1e-14)


def test_tracers_keep_their_precision() -> None:
    traced = jax.eval_shape(lambda k: evaluate("2*pi*sqrt(k)", {"k": k}, functions_of(jnp)), jnp.float32(1.0))
    assert traced.dtype == jnp.float32


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("   ", "empty"),
        ("2*kapa", "did you mean kappa?"),
        ("2*m_b", "did you mean m_B?"),
        ("sine(1)", "did you mean sin?"),
        ("2pi", "2*pi"),
        ("2 ms", "if ms is a unit, 2 alone"),
        ("2(3)", "star"),
        ("kappa^2", "**"),
        ("1,5", "a decimal point is a dot"),
        ("sin", "write sin(...)"),
        ("sin(1, 2)", "one number"),
        ("min(1)", "at least two numbers"),
        ("log(x=1)", "no named arguments"),
        ("1/0", "divides by zero"),
        ("0**-1", "divides by zero"),
        ("5 % 0", "divides by zero"),
        ("1/(1e308*10)", "1.8e308"),
        ("10**400", "1.8e308"),
        ("1e999", "not a finite number"),
        ("exp(1000)", "1.8e308"),
        ("9" * 400, "not a finite number"),
        ("9" * 5000, "longer than"),
        ("-" * 300 + "1", "nested"),
        ("(" * 240 + "1" + ")" * 240, "not a number or arithmetic"),
        ("sqrt(-1)", "not a finite number"),
        ("(-8)**(1/3)", "not a finite number"),
        ("log(-1)", "not a finite number"),
        ("True", "not a number"),
        ("None", "not a number"),
        ("1j", "not a number"),
        ("'a'", "text in quotes"),
        ("b'a'", "not a number"),
        ("f'{beta}'", "text in quotes"),
        ("beta.real", "a dot after a name"),
        ("beta.__class__", "a dot after a name"),
        ("().__class__", "a dot after a name"),
        ("beta[0]", "an index"),
        ("[1]", "a list"),
        ("{}", "a mapping"),
        ("{1}", "a set"),
        ("lambda: 1", "a lambda"),
        ("[x for x in (1,)]", "a comprehension"),
        ("min(x for x in (1,))", "a comprehension"),
        ("1 if beta else 2", "if / else"),
        ("beta < 1", "a comparison"),
        ("beta and 1", "and / or"),
        ("not beta", "not is not allowed"),
        ("~1", "~ is not allowed"),
        ("1 << 3", "<< is not allowed"),
        ("beta & 1", "& is not allowed"),
        ("beta @ 1", "@ is not allowed"),
        ("(x := 3)", "an assignment"),
        ("min(*beta)", "a star"),
        ("__import__('os').system('true')", "a dot after a name"),
        ("__import__('os')", "not a known function"),
        ("open('/etc/passwd')", "not a known function"),
        ("x = 3", "not a number or arithmetic"),
        ("import os", "not a number or arithmetic"),
        ("1; 2", "not a number or arithmetic"),
        ("1\x002", "not a number or arithmetic"),
        ("010", "not a number or arithmetic"),
        ("2 +", "not a number or arithmetic"),
    ],
)
def test_refuses_with_a_sentence(text: str, words: str) -> None:
    with pytest.raises(ExpressionError) as refused:
        evaluate(text, NAMES)
    sentence = str(refused.value)
    assert words in sentence
    assert sentence.endswith(".")
    assert len(sentence) < 400


@pytest.mark.parametrize("value", [True, np.bool_(False), None, [1.0], math.nan, math.inf, 10**400])
def test_numbers_that_are_not_finite_are_refused(value: object) -> None:
    with pytest.raises(ExpressionError):
        evaluate(value, {})  # type: ignore[arg-type]
    if not (isinstance(value, float) and math.isnan(value)):  # a start that the model decides
        with pytest.raises(ExpressionError):
            resolve({"beta": value}, {})  # type: ignore[dict-item]


def test_a_refusal_in_one_row_refuses_the_array() -> None:
    with pytest.raises(ExpressionError, match="divides by zero"):
        evaluate("1/beta", {"beta": np.array([1.0, 0.0, 2.0])})


def test_constants_keep_their_meaning() -> None:
    with pytest.raises(ExpressionError, match="e is a constant"):
        evaluate("2*e", {"e": 0.5})


def test_names_used() -> None:
    assert names_used("2*(1-beta)*pi + sqrt(kappa/m_B) - max(beta, e)") == {"beta", "kappa", "m_B"}
    assert names_used("2*pi") == set()
    assert names_used(3.0) == set()


# Conditions

COLUMNS = {
    "gait": np.array(["trot", "walk", np.nan, "trot"], object),
    "speed": np.array([0.5, 1.0, np.nan, 2.0]),
    "stair": np.array([0, 1, 2, 3]),
    "settled": np.array([True, False, True, True]),
}


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("gait == 'trot'", [1, 0, 0, 1]),
        ("gait != 'trot'", [0, 1, 1, 0]),  # a missing text is unequal to all
        ("gait in ['walk', 'pace'] or stair == 3", [0, 1, 0, 1]),
        ("gait not in ('walk',)", [1, 0, 1, 1]),
        ("0.5 <= speed < 2", [1, 1, 0, 0]),
        ("not speed < 2", [0, 0, 1, 1]),
        ("settled and abs(speed - 2) < 1e-9", [0, 0, 0, 1]),
        ("settled and not (stair**2 > 4 or gait == 'trot')", [0, 0, 1, 0]),
        ("settled or stair == 1 and speed == 1", [1, 1, 1, 1]),
        ("speed == speed", [1, 1, 0, 1]),
        ("pi < 2*stair", [0, 0, 1, 1]),
    ],
)
def test_a_condition_selects_records(condition: str, expected: list[int]) -> None:
    assert fulfilled(condition, COLUMNS).tolist() == [bool(each) for each in expected]


@pytest.mark.parametrize(
    "text",
    [
        "@pd.io.common.os.system('touch PWNED') == 0", "speed.to_csv('/path')", "speed.dtype == 'f'",
        "__import__('os') == 1", "speed[0] > 1", "[gait for gait in ()] == 1", "f'{speed}' == 'a'",
        "speed", "speed + 1", "not 3", "", "speed >", "speed == True", "(speed > 1) + 1 > 1", "speed is 1",
        "gait in stair", "settled & settled", "abs > 1", "1 < 2", "speeds > 1", "gait < 'b'", "gait == 1",
        "stair in [1, 2] == 1", "stair in [0, 1, 2, 3] < 2",
        "stair == 'a'", "-gait > 1", "not " * 130 + "settled", "(speed := 1) > 0", "`speed` > 1", "lambda: 1",
    ],
)  # fmt: skip
def test_only_conditions_are_evaluated(text: str) -> None:
    with pytest.raises(ExpressionError):
        fulfilled(text, COLUMNS)


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("speed < 1 and gait = 'trot'", "equality is written =="),
        ("speed < 2 m", "2*m"),
        ("speed < 1e5 and", "is not a condition."),
    ],
)
def test_the_hint_about_a_condition_is_that_of_its_slip(text: str, hint: str) -> None:
    with pytest.raises(ExpressionError, match=re.escape(hint)) as raised:
        read_condition(text)
    assert "*and" not in str(raised.value)
