"""Compiles straight-line Python to LLVM, as an intrinsic of Numba.

Numba takes half a minute for a function of a thousand statements, mostly in passes that such a function does
not need: loops, branches, type inference. Here each expression becomes an instruction directly. Numba itself
compiles only the loop around it, a few lines.

The language is that of `python_source`: assignments to names and to elements of flat arrays, arithmetic,
single comparisons, `a if c else b`, and calls of functions of one or two numbers.
"""

from __future__ import annotations

import ast
import math
import operator
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

_DOUBLE, _SINGLE, _FLAG, _INDEX = ir.DoubleType(), ir.FloatType(), ir.IntType(1), ir.IntType(64)
_ARITHMETIC = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}
_FLAGS = {ast.BitAnd: "and_", ast.BitOr: "or_"}
_WHOLE = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul"}
_LINES = "assignments to a name or an element"
_EXPRESSIONS = "names, numbers, arithmetic, a comparison of two, `a if c else b`, elements and calls"
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Eq: "==", ast.NotEq: "!="}
# Functions that are LLVM's own; the others are those that Numba calls.
_OWN = {"abs": "fabs", "floor32": "floor", "floor64": "floor", "sqrt32": "sqrt", "sqrt64": "sqrt"}


def straight_line(source: str, *, contraction: bool = True) -> Any:
    """The Numba intrinsic of a function given as source.

    Args:
        source: the function, of numbers, indices and flat arrays; it returns nothing.
        contraction: whether a product and a sum may become one instruction, which rounds once.
    """
    head = source[: source.index(":")]
    names = head[head.index("(") + 1 : head.index(")")]
    name = head[len("def ") : head.index("(")]

    def typed(*given: Any) -> tuple[Any, Any]:
        function = ast.parse(source).body[0]
        assert isinstance(function, ast.FunctionDef)

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            writer = _Writer(context, builder, contraction)
            writer.arguments(function, signature.args, args)
            writer.body(function.body)
            return context.get_dummy_value()

        return types.none(*given), generate

    definition = eval(f"lambda typing_context, {names}: typed({names})", {"typed": typed})
    definition.__name__ = definition.__qualname__ = name
    return intrinsic(definition)


class _Writer:
    """Writes the instructions of one function at its call."""

    def __init__(self, context: Any, builder: Any, contraction: bool) -> None:
        self.context, self.builder = context, builder
        # the sign of zero may be ignored
        self.loose = ("contract", "nsz") if contraction else ("nsz",)
        self.names: dict[str, Any] = {
            "inf": ir.Constant(_DOUBLE, math.inf),
            "nan": ir.Constant(_DOUBLE, math.nan),
        }
        self.arrays: dict[str, Any] = {}

    def arguments(self, function: ast.FunctionDef, kinds: Any, values: Any) -> None:
        for argument, kind, value in zip(function.args.args, kinds, values, strict=True):
            if hasattr(kind, "ndim"):
                array = self.context.make_array(kind)(self.context, self.builder, value)
                self.arrays[argument.arg] = array.data
            else:
                self.names[argument.arg] = value

    def body(self, lines: list[ast.stmt]) -> None:
        for line in lines:
            match line:
                case ast.Assign(targets=[ast.Name(id=name)], value=value):
                    self.names[name] = self.value(value)
                case ast.Assign(targets=[ast.Subscript() as place], value=value):
                    self.builder.store(self._double(self.value(value)), self._element(place))
                case ast.Pass():
                    pass
                case _:
                    text = f"The line `{ast.unparse(line)}` of a kernel is not lowered. Allowed: {_LINES}."
                    raise ValueError(text)

    def value(self, node: ast.expr) -> Any:
        builder = self.builder
        match node:
            case ast.Name(id=name):
                return self.names[name]
            case ast.Constant(value=bool() as known):
                return ir.Constant(_FLAG, int(known))
            case ast.Constant(value=int() as known):
                return ir.Constant(_INDEX, known)
            case ast.Constant(value=float() as known):
                return ir.Constant(_DOUBLE, known)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                inner = self.value(operand)
                return builder.fsub(ir.Constant(inner.type, -0.0), inner, flags=self.loose)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return builder.not_(self.value(operand))
            case ast.BinOp(left=left, op=op, right=right):
                return self._combined(type(op), self.value(left), self.value(right))
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return self._compared(_COMPARISONS[type(op)], self.value(left), self.value(right))
            case ast.IfExp(test=test, body=yes, orelse=no):
                return builder.select(self.value(test), self.value(yes), self.value(no))
            case ast.Subscript():
                return builder.load(self._element(node))
            case ast.Call(func=function, args=args):
                return self._called(ast.unparse(function), [self.value(a) for a in args])
        text = f"The expression `{ast.unparse(node)}` of a kernel is not lowered. Allowed: {_EXPRESSIONS}."
        raise ValueError(text)

    def _combined(self, op: type, left: Any, right: Any) -> Any:
        if op in _FLAGS:
            return getattr(self.builder, _FLAGS[op])(left, right)
        if left.type == _INDEX:
            return getattr(self.builder, _WHOLE[op])(left, right, flags=("nsw",))
        if op is ast.Pow:
            return self._library(operator.pow, [left, right])
        return getattr(self.builder, _ARITHMETIC[op])(left, right, flags=self.loose)

    def _compared(self, sign: str, left: Any, right: Any) -> Any:
        if left.type == _FLAG:
            return self.builder.icmp_unsigned(sign, left, right)
        # comparisons with NaN are false, except !=
        ordered = self.builder.fcmp_unordered if sign == "!=" else self.builder.fcmp_ordered
        return ordered(sign, left, right)

    def _called(self, name: str, args: list[Any]) -> Any:
        if name == "float32":
            return self.builder.fptrunc(args[0], _SINGLE) if args[0].type == _DOUBLE else args[0]
        if name == "float64":
            return self._double(args[0])
        if name in _OWN:
            own = self.builder.module.declare_intrinsic(f"llvm.{_OWN[name]}", [args[0].type])
            return self.builder.call(own, args)
        return self._library(getattr(math, name.removeprefix("math.")), args)

    def _library(self, function: Any, args: list[Any]) -> Any:
        number = types.float64 if args[0].type == _DOUBLE else types.float32
        return self.context.get_function(function, number(*[number] * len(args)))(self.builder, args)

    def _double(self, value: Any) -> Any:
        return self.builder.fpext(value, _DOUBLE) if value.type == _SINGLE else value

    def _element(self, node: ast.Subscript) -> Any:
        assert isinstance(node.value, ast.Name)
        return self.builder.gep(self.arrays[node.value.id], [self.value(node.slice)])
