"""Compiles straight-line Python to LLVM, as an intrinsic of Numba or of numba-cuda.

Numba takes half a minute for a function of a thousand statements, mostly in passes that such a function does
not need: loops, branches, type inference. Here each expression becomes an instruction directly. Numba itself
compiles only the loop around it, a few lines.

The language is that of `python_source`: assignments to names and to elements of flat arrays, arithmetic,
single comparisons, `a if c else b`, calls of functions of one or two numbers, `if` around assignments (to
elements, and to names that nothing reads afterwards), and a returned tuple, whose kinds the function's
annotation gives by the letters of `KINDS`.
"""

from __future__ import annotations

import ast
import importlib
import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir

# Letters in the annotation of a function that returns a tuple.
KINDS = {"f64": "d", "int": "d", "f32": "f", "bool": "b"}

_DOUBLE, _SINGLE, _FLAG, _INDEX = ir.DoubleType(), ir.FloatType(), ir.IntType(1), ir.IntType(64)
# LLVM may contract a product and a sum to one instruction, and may ignore the sign of zero.
_LOOSE = ("contract", "nsz")
_ARITHMETIC = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}
_FLAGS = {ast.BitAnd: "and_", ast.BitOr: "or_"}
_WHOLE = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul"}
_LINES = "assignments to a name or an element, `if` without `else`, and a tuple returned"
_EXPRESSIONS = "names, numbers, arithmetic, a comparison of two, `a if c else b`, elements and calls"
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Eq: "==", ast.NotEq: "!="}


class CpuCalls:
    """Functions of a number on a CPU: LLVM's intrinsics where they exist, else those that Numba calls."""

    intrinsic = "numba.extending"
    types = "numba.core.types"
    own = ("floor", "sqrt", "fabs")

    @staticmethod
    def call(context: Any, builder: Any, name: str, args: list[Any]) -> Any:
        if name in CpuCalls.own:
            return builder.call(builder.module.declare_intrinsic(f"llvm.{name}", [args[0].type]), args)
        from numba.core import types

        number = types.float64 if args[0].type == _DOUBLE else types.float32
        function = operator.pow if name == "pow" else getattr(math, name)
        return context.get_function(function, number(*[number] * len(args)))(builder, args)


class CudaCalls:
    """Functions of a number on an NVIDIA GPU, from libdevice."""

    intrinsic = "numba.cuda.extending"
    types = "numba.cuda.types"

    @staticmethod
    def call(context: Any, builder: Any, name: str, args: list[Any]) -> Any:
        kind = args[0].type
        full = f"__nv_{name}" + ("f" if kind == _SINGLE else "")
        function = builder.module.globals.get(full)
        if function is None:
            function = ir.Function(builder.module, ir.FunctionType(kind, [kind] * len(args)), full)
        return builder.call(function, args)


def straight_line(target: type, source: str) -> Any:
    """The Numba intrinsic of a function given as source, for `CpuCalls` or `CudaCalls`."""
    head = source[: source.index(":")]
    names = head[head.index("(") + 1 : head.index(")")]
    intrinsic = importlib.import_module(target.intrinsic).intrinsic
    name = head[len("def ") : head.index("(")]

    def typed(*given: Any) -> tuple[Any, Callable[..., Any]]:
        function = ast.parse(source).body[0]
        assert isinstance(function, ast.FunctionDef)
        types = importlib.import_module(target.types)
        result = types.none
        if function.returns is not None:
            letters = {"d": types.float64, "f": types.float32, "b": types.boolean}
            result = types.Tuple([letters[k] for k in ast.literal_eval(function.returns)])

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            writer = _Writer(target, context, builder)
            writer.arguments(function, signature.args, args)
            values = writer.body(function.body)
            if values is None:
                return context.get_dummy_value()
            return context.make_tuple(builder, signature.return_type, values)

        return result(*given), generate

    definition = eval(f"lambda typing_context, {names}: typed({names})", {"typed": typed})
    definition.__name__ = definition.__qualname__ = name
    return intrinsic(definition)


class _Writer:
    """Writes the instructions of one function at its call."""

    def __init__(self, target: type, context: Any, builder: Any) -> None:
        self.target, self.context, self.builder = target, context, builder
        self.names: dict[str, Any] = {
            "inf": ir.Constant(_DOUBLE, math.inf),
            "nan": ir.Constant(_DOUBLE, math.nan),
        }
        self.arrays: dict[str, Any] = {}

    def arguments(self, function: ast.FunctionDef, types: Any, values: Any) -> None:
        for argument, kind, value in zip(function.args.args, types, values, strict=True):
            if hasattr(kind, "ndim"):
                self.arrays[argument.arg] = self.context.make_array(kind)(
                    self.context, self.builder, value
                ).data
            elif isinstance(value.type, ir.IntType) and value.type.width in (16, 32):
                self.names[argument.arg] = self.builder.sext(value, _INDEX)
            else:
                self.names[argument.arg] = value

    def body(self, lines: list[ast.stmt]) -> list[Any] | None:
        for line in lines:
            match line:
                case ast.Assign(targets=[ast.Name(id=name)], value=value):
                    self.names[name] = self.value(value)
                case ast.Assign(targets=[ast.Subscript() as place], value=value):
                    self.builder.store(self._double(self.value(value)), self._element(place))
                case ast.If(test=test, body=inner, orelse=[]):
                    with self.builder.if_then(self.value(test)):
                        self.body(inner)
                case ast.Return(value=ast.Tuple(elts=elements)):
                    return [self.value(element) for element in elements]
                case ast.Pass():
                    pass
                case _:
                    text = f"The line `{ast.unparse(line)}` of a kernel is not lowered. Allowed: {_LINES}."
                    raise ValueError(text)
        return None

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
                return builder.fsub(ir.Constant(inner.type, -0.0), inner, flags=_LOOSE)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return builder.not_(self.value(operand))
            case ast.BinOp(left=left, op=op, right=right):
                return self._combined(type(op), self.value(left), self.value(right))
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return self._compared(_COMPARISONS[type(op)], self.value(left), self.value(right))
            case ast.IfExp(test=test, body=yes, orelse=no):
                return builder.select(self.value(test), self.value(yes), self.value(no))
            case ast.Subscript(value=ast.Name(id=name), slice=place) if name not in self.arrays:
                return builder.extract_value(self.names[name], ast.literal_eval(place))
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
            return self.target.call(self.context, self.builder, "pow", [left, right])
        return getattr(self.builder, _ARITHMETIC[op])(left, right, flags=_LOOSE)

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
        if name == "int":
            return self.builder.fptosi(args[0], _INDEX)
        own = {"abs": "fabs", "floor32": "floor", "floor64": "floor", "sqrt32": "sqrt", "sqrt64": "sqrt"}
        return self.target.call(self.context, self.builder, own.get(name, name.removeprefix("math.")), args)

    def _double(self, value: Any) -> Any:
        return self.builder.fpext(value, _DOUBLE) if value.type == _SINGLE else value

    def _element(self, node: ast.Subscript) -> Any:
        assert isinstance(node.value, ast.Name)
        return self.builder.gep(self.arrays[node.value.id], [self.value(node.slice)])
