"""Constant folding and algebraic simplification of scalar operations.

A product with zero is zero, a number plus zero is that number, and a number minus itself is zero, for all
numbers (NaN and infinity included): this removes the zeros of spatial algebra. A division by a number that is
constant along a trajectory becomes a product with its reciprocal, which is computed once; but not inside a
floor or a comparison, where 49 / 49 must not be the float below 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from gaitsweep.engine.kernel.operations import OPERATIONS

if TYPE_CHECKING:
    from gaitsweep.engine.kernel.program import Program

Rule = Callable[["Program", tuple[int, ...]], int | None]


def simplified(program: Program, op: str, args: tuple[int, ...]) -> int | None:
    """A cheaper node with the value of an operation, or None.

    Args:
        program: the program, to which nodes are added.
        op: a name in `OPERATIONS`.
        args: the argument nodes.
    """
    known = program.evaluated(op, args)
    if known is not None:
        return known
    if op in _RULES:
        simpler = _RULES[op](program, args)
        if simpler is not None:
            return simpler
    if OPERATIONS[op].commutes and args[0] > args[1]:
        return program.apply(op, args[1], args[0])
    return _through_select(program, op, args) if OPERATIONS[op].kind == "bool" else None


def _add(program: Program, args: tuple[int, ...]) -> int | None:
    a, b = args
    if program.value(a) == 0.0:
        return b
    if program.value(b) == 0.0:
        return a
    for x, y in ((a, b), (b, a)):
        if program.nodes[y].op == "neg":
            return program.apply("sub", x, program.nodes[y].args[0])
    return None


def _sub(program: Program, args: tuple[int, ...]) -> int | None:
    a, b = args
    if program.value(b) == 0.0:
        return a
    if program.value(a) == 0.0:
        return program.apply("neg", b)
    if a == b:
        return program.constant(0.0, program.nodes[a].kind)
    if program.nodes[b].op == "neg":
        return program.apply("add", a, program.nodes[b].args[0])
    return None


def _mul(program: Program, args: tuple[int, ...]) -> int | None:
    for x, y in (args, args[::-1]):
        if program.value(x) == 0.0:
            return program.constant(0.0, program.nodes[y].kind)
        if program.value(x) == 1.0:
            return y
        if program.value(x) == -1.0:
            return program.apply("neg", y)
        if program.nodes[x].op == "neg":
            return program.apply("neg", program.apply("mul", program.nodes[x].args[0], y))
    return None


def _div(program: Program, args: tuple[int, ...]) -> int | None:
    a, b = args
    if program.nodes[a].kind == "int":
        return None
    if program.value(b) == 1.0:
        return a
    if program.value(a) == 0.0 and program.value(b) is None:
        return a
    if program.nodes[a].op == "neg":
        return program.apply("neg", program.apply("div", program.nodes[a].args[0], b))
    known = program.value(b)
    if known is not None and abs(math.frexp(known)[0]) != 0.5:
        # rounded as by JAX: wrapping an angle by `floor(x / period)` depends on it
        return None
    if program.steady[b] and not program.steady[a]:
        one = program.constant(1.0, program.nodes[a].kind)
        return program.apply("mul", a, program.apply("div", one, b))
    return None


def _floor(program: Program, args: tuple[int, ...]) -> int | None:
    at = _divided(program, args[0])
    return None if at == args[0] else program.apply("floor", at)


def _compared(op: str) -> Rule:
    """The rule of a comparison, between quotients instead of products with reciprocals."""

    def rule(program: Program, args: tuple[int, ...]) -> int | None:
        # the sign of both is the same, and NaN alone differs from itself
        if args[0] == args[1] or 0.0 in map(program.value, args):
            return None
        exact = tuple(_divided(program, at, depth=0) for at in args)
        return None if exact == args else program.apply(op, *exact)

    return rule


def _divided(program: Program, at: int, depth: int = 2) -> int:
    """The node of a number in which a product that `_div` has written, or a term of a sum, is a quotient."""
    node = program.nodes[at]
    if node.op in ("neg", "add", "sub") and depth:
        args = tuple(_divided(program, a, depth - 1) for a in node.args)
        return at if args == node.args else program.apply(node.op, *args)
    if node.op == "mul":
        for x, y in (node.args, node.args[::-1]):
            factor = program.nodes[y]
            if program.steady[y] and factor.op == "div" and program.value(factor.args[0]) == 1.0:
                return program.write("div", x, factor.args[1])
    return at


def _neg(program: Program, args: tuple[int, ...]) -> int | None:
    node = program.nodes[args[0]]
    if node.op == "neg":
        return node.args[0]
    if node.op == "sub":
        return program.apply("sub", node.args[1], node.args[0])
    return None


def _select(program: Program, args: tuple[int, ...]) -> int | None:
    condition, yes, no = args
    if yes == no:
        return yes
    chosen = program.value(condition)
    if chosen is not None:
        return yes if chosen else no
    node = program.nodes[condition]
    if node.op == "not":
        return program.apply("select", node.args[0], no, yes)
    if program.nodes[yes].kind == "bool":
        return _select_truth(program, condition, yes, no)
    # nested selections by the same condition
    if program.nodes[yes].op == "select" and program.nodes[yes].args[0] == condition:
        return program.apply("select", condition, program.nodes[yes].args[1], no)
    if program.nodes[no].op == "select" and program.nodes[no].args[0] == condition:
        return program.apply("select", condition, yes, program.nodes[no].args[2])
    return None


def _select_truth(program: Program, condition: int, yes: int, no: int) -> int | None:
    """A selection among flags, as `and` and `or`."""
    negated = program.apply("not", condition)
    if program.value(yes) is not None:
        return program.apply("or", condition, no) if program.value(yes) else program.apply("and", negated, no)
    if program.value(no):
        return program.apply("or", negated, yes)
    both = program.apply("and", condition, yes)
    if program.value(no) is False:
        return both
    return program.apply("or", both, program.apply("and", negated, no))


def _joined(*, neutral: bool) -> Rule:
    """The rule of `and` (neutral element True) or of `or` (neutral element False)."""

    def rule(program: Program, args: tuple[int, ...]) -> int | None:
        a, b = args
        if a == b:
            return a
        for x, y in (args, args[::-1]):
            known = program.value(x)
            if known is not None:
                return y if known == neutral else x
            if program.nodes[y].op == "not" and program.nodes[y].args[0] == x:
                return program.constant(not neutral, "bool")
        return None

    return rule


def _not(program: Program, args: tuple[int, ...]) -> int | None:
    node = program.nodes[args[0]]
    if node.op == "not":
        return node.args[0]
    # the negation of < is not >= for NaN
    if node.op in ("eq", "ne"):
        return program.apply("ne" if node.op == "eq" else "eq", *node.args)
    return None


def _same_kind(program: Program, args: tuple[int, ...], kind: str) -> int | None:
    return args[0] if program.nodes[args[0]].kind == kind else None


def _through_select(program: Program, op: str, args: tuple[int, ...]) -> int | None:
    """`(k if c else l) == m` with constants k, l, m is c, not c, or a constant (flags as numbers)."""
    if len(args) != 2:
        return None
    for place in (0, 1):
        node = program.nodes[args[place]]
        if node.op != "select" or program.value(args[1 - place]) is None:
            continue
        if any(program.value(a) is None for a in node.args[1:]):
            continue
        args_if_true = list(args)
        args_if_false = list(args)
        args_if_true[place] = node.args[1]
        args_if_false[place] = node.args[2]
        yes = program.apply(op, *args_if_true)
        no = program.apply(op, *args_if_false)
        return program.apply("select", node.args[0], yes, no)
    return None


_RULES: dict[str, Rule] = {
    "add": _add,
    "sub": _sub,
    "mul": _mul,
    "div": _div,
    "floor": _floor,
    "neg": _neg,
    "select": _select,
    "and": _joined(neutral=True),
    "or": _joined(neutral=False),
    "not": _not,
    **{op: _compared(op) for op in ("lt", "le", "eq", "ne")},
    "to_f32": lambda program, args: _same_kind(program, args, "f32"),
    "to_f64": lambda program, args: _same_kind(program, args, "f64"),
    "to_int": lambda program, args: _same_kind(program, args, "int"),
}
