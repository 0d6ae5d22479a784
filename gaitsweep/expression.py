"""Arithmetic and conditions written in jobs, models and claims: checked by a short grammar, then evaluated.

An expression is a number, or arithmetic with `+ - * / // % **` and parentheses over names, `pi`, `e` and the
functions of `FUNCTIONS`. A condition on the columns of a table compares expressions, or a column of text with
texts in quotes, by `< <= > >= == !=` and `in [...]`, and joins comparisons by `and`, `or` and `not`. All
other Python syntax is refused before anything is evaluated.
"""

from __future__ import annotations

import ast
import functools
import graphlib
import math
import operator
import re
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from gaitsweep import near_miss
from gaitsweep.errors import UserError

__all__ = ["ExpressionError", "evaluate", "names_used"]

CONSTANTS: Mapping[str, float] = {"pi": math.pi, "e": math.e}
FUNCTIONS = ("sqrt", "sin", "cos", "tan", "exp", "log", "abs", "floor", "min", "max")
VARY_GROUPS = ("zip", "sample")  # keys of `vary` that move several quantities together
# Names that no quantity may have.
RESERVED = frozenset({*CONSTANTS, *FUNCTIONS, *VARY_GROUPS})

_LONGEST = 500  # characters
_DEEPEST = 60  # operations inside each other
_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
# Syntax that is refused, in words.
_REFUSED_SYNTAX: dict[type, str] = {
    ast.Attribute: "a dot after a name",
    ast.Subscript: "an index in brackets",
    ast.Lambda: "a lambda",
    **dict.fromkeys((ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp), "a comprehension"),
    ast.Compare: "a comparison",
    ast.BoolOp: "and / or",
    ast.IfExp: "if / else",
    ast.Tuple: "a comma outside a function (a decimal point is a dot)",
    ast.List: "a list",
    ast.Dict: "a mapping",
    ast.Set: "a set",
    ast.JoinedStr: "text in quotes",
    ast.NamedExpr: "an assignment",
    ast.Starred: "a star before an argument",
    ast.BitXor: "^ (a power is written **)",
    ast.BitAnd: "&",
    ast.BitOr: "|",
    ast.LShift: "<<",
    ast.RShift: ">>",
    ast.MatMult: "@",
    ast.Not: "not",
    ast.Invert: "~",
    ast.Constant: "a parenthesis after a number (a product needs its star)",
}


class ExpressionError(UserError, ValueError):
    """An expression that cannot be read or evaluated; the message is a sentence that quotes it."""


def evaluate(
    expression: str | float,
    names: Mapping[str, Any],
    functions: Mapping[str, Callable[..., Any]] | None = None,
) -> Any:
    """The value of a number or of an expression over `names`.

    Args:
        expression: a number, or text such as "2*(1-beta)*pi".
        names: the value of each name: numbers, or NumPy arrays that broadcast together; JAX arrays or
            tracers where `functions` is given. They may not redefine `pi` or `e`.
        functions: what FUNCTIONS stand for, `functions_of(jnp)` under a JAX trace; NumPy's by default.

    Returns:
        A float where all is scalar, else an array of the broadcast shape. Without `functions` the result is
        finite: overflow, division by zero and roots of negative numbers are refused.

    Raises:
        ExpressionError: with a sentence that quotes the expression and names the near miss.

    Example:
        >>> import gaitsweep as gs
        >>> round(gs.expression.evaluate("2*(1-beta)*pi", {"beta": 0.75}), 4)
        1.5708
        >>> gs.expression.evaluate("sqrt(x)", {"x": [1.0, 4.0]}).tolist()
        [1.0, 2.0]
        >>> gs.expression.evaluate("2*bta", {"beta": 0.75})
        Traceback (most recent call last):
        gaitsweep.expression.ExpressionError: in "2*bta", bta is not a known name; did you mean beta? ...
    """
    if not isinstance(expression, str):
        return _number(expression)
    tree = _parsed(expression)
    for name in names_used(expression):
        if name not in names:
            allowed = [*names, *CONSTANTS]
            raise error_in(expression, f"{name} is not a known name{near_miss.suggestion(name, allowed)}")
    if clash := sorted(set(names) & set(CONSTANTS)):
        raise ExpressionError(f"{clash[0]} is a constant and cannot be redefined.")
    if functions is not None:
        return evaluate_tree(expression, tree, {**CONSTANTS, **names}, functions, float)
    # A lone number goes through the loops of arrays too: NumPy's scalar powers differ from them by an ulp.
    used = {**CONSTANTS, **{name: names[name] for name in names_used(expression)}}
    known = {name: np.atleast_1d(np.asarray(value, np.float64)) for name, value in used.items()}
    with np.errstate(divide="raise", over="raise", invalid="raise", under="ignore"):
        result = evaluate_tree(expression, tree, known, functions_of(np), lambda number: np.array([number]))
    if not np.all(np.isfinite(result)):
        raise ExpressionError(f"{quoted(expression)} is not a finite number.")
    scalar = all(np.ndim(names[name]) == 0 for name in names_used(expression))
    return float(result[0]) if scalar else np.array(result)  # not the caller's own array


def resolve(
    settings: Mapping[str, str | float],
    names: Mapping[str, Any],
    functions: Mapping[str, Callable[..., Any]] | None = None,
) -> dict[str, Any]:
    """`names` with the values of `settings`, numbers or expressions, each after those that it uses.

    Args:
        settings: by name, in an order in which they can be evaluated. NaN, a start that the model itself
            decides, stays NaN.
        names: the values that are known, as for `evaluate`.
        functions: as for `evaluate`.

    Raises:
        ExpressionError: as `evaluate`.
    """
    known = dict(names)
    for name, setting in settings.items():
        undecided = isinstance(setting, float) and math.isnan(setting)
        known[name] = math.nan if undecided else evaluate(setting, known, functions)
    return known


def in_order(settings: Mapping[str, str | float]) -> dict[str, str | float]:
    """`settings` in an order in which `resolve` can evaluate them; as they are where none is possible."""
    uses = {name: sorted(names_used(setting) & settings.keys()) for name, setting in settings.items()}
    try:
        return {name: settings[name] for name in graphlib.TopologicalSorter(uses).static_order()}
    except graphlib.CycleError:
        return dict(settings)


@functools.lru_cache(maxsize=1024)
def names_used(expression: str | float) -> frozenset[str]:
    """The names that an expression uses, constants and functions left out; empty for a number."""
    if not isinstance(expression, str):
        return frozenset()
    return frozenset(names_of_tree(_parsed(expression))).difference(CONSTANTS)


def terms_of(expression: str) -> list[str]:
    """The terms of a sum or difference, without their signs; of another expression itself."""
    terms, trees = [], [_parsed(expression)]
    while trees:
        match trees.pop():
            case ast.BinOp(left, ast.Add() | ast.Sub(), right):
                trees += [right, left]
            case ast.UnaryOp(ast.UAdd() | ast.USub(), operand):
                trees.append(operand)
            case tree:
                terms.append(ast.unparse(tree))
    return terms


def names_of_tree(tree: ast.expr) -> set[str]:
    """The names in a tree, without those of the functions that it calls."""
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in called}


def functions_of(module: Any) -> dict[str, Callable[..., Any]]:
    """The functions of FUNCTIONS by name; min and max take two or more arguments.

    Args:
        module: numpy or jax.numpy.
    """
    table = {name: getattr(module, name) for name in FUNCTIONS if name not in ("min", "max")}
    table["min"] = lambda *values: functools.reduce(module.minimum, values)
    table["max"] = lambda *values: functools.reduce(module.maximum, values)
    return table


def quoted(text: str) -> str:
    """The text in quotes, shortened for a message."""
    return f'"{text}"' if len(text) <= 60 else f'"{text[:57]}..."'


def _number(value: Any) -> float:
    """A finite number as a float; raises ExpressionError for others."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise ExpressionError(f"{value!r} is not a number.")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ExpressionError(f"{number} is not a finite number.")
    return number


def evaluate_tree(
    text: str,
    tree: ast.expr,
    names: Mapping[str, Any],
    functions: Mapping[str, Callable[..., Any]],
    constant: Callable[[float], Any],
) -> Any:
    """The value of a checked tree.

    Args:
        text: the expression, for messages.
        tree: its tree.
        names: the value of each name.
        functions: the functions by name.
        constant: converts the numbers of the expression.

    Raises:
        ExpressionError: Python or NumPy refuses the arithmetic, or its result is complex.
    """

    def value(node: ast.expr) -> Any:
        match node:
            case ast.Constant():
                return constant(node.value)  # pyright: ignore[reportArgumentType] (`check_arithmetic` made it a float)
            case ast.Name():
                return names[node.id]
            case ast.UnaryOp():
                return _OPERATORS[type(node.op)](value(node.operand))
            case ast.BinOp():
                return _OPERATORS[type(node.op)](value(node.left), value(node.right))
            case ast.Call(func=ast.Name(id=name)):
                return functions[name](*map(value, node.args))
        raise AssertionError(node)  # `check_arithmetic` lets no other node through

    try:
        result = value(tree)
    except (ZeroDivisionError, OverflowError, FloatingPointError) as error:
        raise ExpressionError(f"{quoted(text)} is not a finite number ({_arithmetic(error)}).") from None
    if isinstance(result, complex):
        raise ExpressionError(f"{quoted(text)} is not a real number.")
    return result


def _arithmetic(error: Exception) -> str:
    """The reason of an error in arithmetic, from the message of Python or NumPy."""
    message = str(error)
    if "divi" in message or "remainder" in message:
        return "it divides by zero, or takes the logarithm of zero"
    if "overflow" in message or "too large" in message:
        return "it grows past 1.8e308"
    return "a root, power or logarithm is not defined for its number"


@functools.lru_cache(maxsize=4096)
def _parsed(expression: str) -> ast.expr:
    """The tree of an expression, its numbers floats; raises ExpressionError if it is not arithmetic."""
    tree = parse(expression, "a number", "a number or arithmetic")
    check_arithmetic(expression, tree)
    return tree


def parse(text: str, needed: str, described: str) -> ast.expr:
    """The tree of a text as Python's parser reads it; nothing in it is checked yet.

    Args:
        text: the text.
        needed: what it should be, for the message about an empty text.
        described: the same in more words, for the message about other text.

    Raises:
        ExpressionError: it is empty or too long, or Python's parser refuses it.
    """
    if not text.strip():
        raise ExpressionError(f"the text is empty where {needed} is needed.")
    if len(text) > _LONGEST:
        raise ExpressionError(f"{quoted(text)} is longer than {_LONGEST} characters.")
    try:
        with warnings.catch_warnings():
            # about calls of numbers and the like, which are refused later
            warnings.simplefilter("ignore", SyntaxWarning)
            return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise ExpressionError(f"{quoted(text)} is not {described}{_hint(text)}.") from None


def _hint(text: str) -> str:
    """The end of a message about a single =, or about a number directly before a name or a parenthesis."""
    if re.search(r"(?<![=<>!])=(?!=)", text):
        return "; equality is written =="
    if product := re.search(r"(?<![\w.])(\d+\.?\d*)\s*((?!(?:and|or)\b|e[-+]?\d)[A-Za-z_]\w*|\()", text):
        number, name = product.groups()
        unit = "" if name == "(" else f", or, if {name} is a unit, {number} alone, in the unit of the field"
        return f"; write a product with a star, {number}*{name}{unit}"
    return ""


def check_arithmetic(text: str, body: ast.expr) -> None:
    """Refuse text that is not arithmetic, and make its numbers floats."""
    stack: list[tuple[ast.AST, int]] = [(body, 1)]
    while stack:
        node, depth = stack.pop()
        if depth > _DEEPEST:
            raise ExpressionError(f"{quoted(text)} is nested more than {_DEEPEST} deep.")
        if isinstance(node, ast.Constant):
            node.value = _constant(text, node.value)
        elif isinstance(node, ast.Call):
            _check_call(text, node)
            stack.extend((argument, depth + 1) for argument in node.args)
            continue
        elif isinstance(node, ast.Name):
            if node.id in FUNCTIONS:
                raise error_in(text, f"{node.id} is a function: write {node.id}(...).")
        elif isinstance(node, (ast.BinOp, ast.UnaryOp)):
            if type(node.op) not in _OPERATORS:
                raise _refusal(text, node.op)
        elif not isinstance(node, (ast.operator, ast.unaryop, ast.expr_context)):
            raise _refusal(text, node)
        stack.extend((child, depth + 1) for child in ast.iter_child_nodes(node))


def _constant(text: str, value: object) -> float:
    """A number that an expression has, as a float; raises ExpressionError for text and other constants."""
    if isinstance(value, str):
        raise error_in(text, "text in quotes is not allowed; only arithmetic is.")
    try:
        return _number(value)
    except ExpressionError as error:
        raise error_in(text, str(error)) from None


def _check_call(text: str, node: ast.Call) -> None:
    """Refuse a call of anything but one of FUNCTIONS with its number of arguments."""
    if not isinstance(node.func, ast.Name):
        raise _refusal(text, node.func)
    name = node.func.id
    if name not in FUNCTIONS:
        raise error_in(text, f"{name} is not a known function{near_miss.suggestion(name, FUNCTIONS)}")
    for argument in node.args:
        if isinstance(argument, (ast.Starred, ast.GeneratorExp)):
            raise _refusal(text, argument)
    if node.keywords:
        raise error_in(text, f"{name} has no named arguments.")
    if name in ("min", "max"):
        if len(node.args) < 2:
            raise error_in(text, f"{name} needs at least two numbers.")
    elif len(node.args) != 1:
        raise error_in(text, f"{name} needs exactly one number.")


def error_in(text: str, reason: str) -> ExpressionError:
    """The error in an expression, which it quotes."""
    return ExpressionError(f"in {quoted(text)}, {reason}")


def _refusal(text: str, node: ast.AST) -> ExpressionError:
    """The error for syntax that is not arithmetic."""
    allowed = f"+ - * / // % ** and {', '.join(FUNCTIONS)}"
    return error_in(text, f"{_REFUSED_SYNTAX.get(type(node), 'this')} is not allowed; only {allowed} are.")


_COMPARISONS: dict[type, Callable[..., Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}


def read_condition(text: str) -> str:
    """Return a condition unchanged if it is one, for a field of a file.

    Raises:
        ExpressionError: the text is not a condition, with a sentence that quotes it.
    """
    _parsed_condition(text)
    return text


def fulfilled(
    condition: str, columns: Mapping[str, Any], read: Callable[[Any], np.ndarray] = np.asarray
) -> np.ndarray:
    """Evaluate a condition on rows, (n,) of bool.

    A missing number or text (NaN) is unequal to all others, and neither below nor above them.

    Args:
        condition: text such as `gait == 'trot' and 0.5 <= speed < 1`.
        columns: arrays (n,) by name: numbers, texts (of dtype object) or truth values.
        read: gives the array of a column; called for those that the condition names.

    Raises:
        ExpressionError: the text is not a condition, a name is unknown, or text is compared with a number.
    """
    tree = _parsed_condition(condition)
    used = names_of_tree(tree) - (set(CONSTANTS) - set(columns))
    for name in used:
        if name not in columns:
            near = near_miss.suggestion(name, list(columns))
            raise error_in(condition, f"{name} is not a column{near}")
    if not used:
        raise ExpressionError(f"{quoted(condition)} does not name a column.")
    known = {name: read(columns[name]) for name in used}
    with np.errstate(all="ignore"):
        truth = _truth(condition, tree, known)
    return np.array(np.broadcast_to(truth, np.shape(next(iter(known.values())))), bool)


def _truth(text: str, node: ast.expr, columns: Mapping[str, np.ndarray]) -> Any:
    """The truth values of a condition's part, which `_check_condition` has let through."""
    match node:
        case ast.BoolOp():
            parts = [_truth(text, part, columns) for part in node.values]
            join = np.logical_and if isinstance(node.op, ast.And) else np.logical_or
            return functools.reduce(join, parts)
        case ast.UnaryOp():
            return np.logical_not(_truth(text, node.operand, columns))
        case ast.Name():
            if columns[node.id].dtype.kind != "b":
                raise error_in(text, f"{node.id} is a column of values, not of truth values: compare it.")
            return columns[node.id]
        case ast.Compare():
            operands = [_operand(text, part, columns) for part in (node.left, *node.comparators)]
            pairs = zip(operands, node.ops, operands[1:], strict=False)
            return functools.reduce(np.logical_and, [_compared(text, *pair) for pair in pairs])
    raise AssertionError(node)


def _operand(text: str, node: ast.expr, columns: Mapping[str, np.ndarray]) -> Any:
    """Numbers as float64, texts as str or an array of object, a list as a list of these."""
    if isinstance(node, (ast.List, ast.Tuple)):
        return [_operand(text, item, columns) for item in node.elts]
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.Name) and node.id in columns and columns[node.id].dtype.kind not in "biuf":
        return columns[node.id].astype(object)
    numbers: dict[str, Any] = {**CONSTANTS}
    for name in names_of_tree(node) & set(columns):
        if columns[name].dtype.kind not in "biuf":
            raise error_in(text, f"{name} is a column of text, not of numbers.")
        numbers[name] = columns[name].astype(np.float64)
    return evaluate_tree(text, node, numbers, functions_of(np), np.float64)


def _compared(text: str, left: Any, comparison: ast.cmpop, right: Any) -> Any:
    """The truth values of one comparison of operands."""
    if isinstance(right, list):
        equal_to_items = [_compared(text, left, ast.Eq(), item) for item in right]
        equal = functools.reduce(np.logical_or, equal_to_items, np.zeros(np.shape(left), bool))
        return np.logical_not(equal) if isinstance(comparison, ast.NotIn) else equal
    texts = [isinstance(item, str) or np.asarray(item).dtype.kind == "O" for item in (left, right)]
    if texts[0] != texts[1]:
        raise ExpressionError(f"{quoted(text)} compares text with a number.")
    if texts[0] and type(comparison) not in (ast.Eq, ast.NotEq):
        raise ExpressionError(f"{quoted(text)} orders texts, but only ==, != and in [...] can compare them.")
    return np.asarray(_COMPARISONS[type(comparison)](left, right), bool)


@functools.lru_cache(maxsize=256)
def _parsed_condition(condition: str) -> ast.expr:
    """The tree of a condition, the numbers in it floats; raises ExpressionError if it is not a condition."""
    tree = parse(condition, "a condition", "a condition")
    _check_condition(condition, tree)
    return tree


def _check_condition(text: str, node: ast.expr) -> None:
    """Refuse text that is not a condition; its length limits the depth of the recursion."""
    match node:
        case ast.BoolOp():
            for part in node.values:
                _check_condition(text, part)
        case ast.UnaryOp(op=ast.Not()):
            _check_condition(text, node.operand)
        case ast.Compare():
            _check_operand(text, node.left)
            for comparison, part in zip(node.ops, node.comparators, strict=True):
                if type(comparison) in _COMPARISONS:
                    _check_operand(text, part)
                elif (
                    isinstance(comparison, (ast.In, ast.NotIn))
                    and isinstance(part, (ast.List, ast.Tuple))
                    and part is node.comparators[-1]
                ):
                    for item in part.elts:
                        _check_operand(text, item)
                else:
                    allowed = "only < <= > >= == != and, after all of these, in [...] are comparisons"
                    raise error_in(text, f"{allowed}.")
        case ast.Name() if node.id not in FUNCTIONS:
            pass
        case _:
            needed = "conditions compare columns and numbers, such as gait == 'trot' and speed < 1"
            raise ExpressionError(f"{quoted(text)} is not a condition: {needed}.")


def _check_operand(text: str, node: ast.expr) -> None:
    """Refuse an operand of a comparison that is neither text in quotes nor arithmetic."""
    if not (isinstance(node, ast.Constant) and isinstance(node.value, str)):
        check_arithmetic(text, node)
