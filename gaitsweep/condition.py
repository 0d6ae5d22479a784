"""Conditions on the columns of a table, written in claims: checked by a short grammar, then evaluated.

A condition compares expressions, or a column of text with texts in quotes, by `< <= > >= == !=` and
`in [...]`, and joins comparisons by `and`, `or` and `not`. All other Python syntax is refused before anything
is evaluated.
"""

from __future__ import annotations

import ast
import functools
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from gaitsweep import near_miss
from gaitsweep.expression import (
    CONSTANTS,
    FUNCTIONS,
    ExpressionError,
    check_arithmetic,
    error_in,
    evaluate_tree,
    functions_of,
    names_of_tree,
    parse,
    quoted,
)

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
    _parsed(text)
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
    tree = _parsed(condition)
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
def _parsed(condition: str) -> ast.expr:
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
                elif isinstance(comparison, (ast.In, ast.NotIn)) and isinstance(part, (ast.List, ast.Tuple)):
                    for item in part.elts:
                        _check_operand(text, item)
                else:
                    raise error_in(text, "only < <= > >= == != and in [...] are comparisons.")
        case ast.Name() if node.id not in FUNCTIONS:
            pass
        case _:
            needed = "conditions compare columns and numbers, such as gait == 'trot' and speed < 1"
            raise ExpressionError(f"{quoted(text)} is not a condition: {needed}.")


def _check_operand(text: str, node: ast.expr) -> None:
    """Refuse an operand of a comparison that is neither text in quotes nor arithmetic."""
    if not (isinstance(node, ast.Constant) and isinstance(node.value, str)):
        check_arithmetic(text, node)
