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
            return builder.call(_intrinsic(builder.module, name, args[0].type), args)
        from numba.core import types

        number = types.float64 if args[0].type == _DOUBLE else types.float32
        function = operator.pow if name == "pow" else getattr(math, name)
        return context.get_function(function, number(*[number] * len(args)))(builder, args)


def _intrinsic(module: Any, name: str, kind: Any) -> Any:
    """LLVM's own function of a number or of a vector of numbers."""
    one = getattr(kind, "element", kind)
    shape = f"v{kind.count}" if one is not kind else ""
    full = f"llvm.{name}.{shape}{one.intrinsic_name}"
    return module.globals.get(full) or ir.Function(module, ir.FunctionType(kind, [kind]), full)


class CudaCalls:
    """Functions of a number on an NVIDIA GPU, from libdevice."""

    own = ()

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


def straight_line(target: type, source: str, lanes: int = 1) -> Any:
    """The Numba intrinsic of a function given as source, for `CpuCalls` or `CudaCalls`.

    With several lanes each name stands for a vector of that many numbers, and an element of an array for that
    many from it on; whole numbers, which are places in arrays, stay single.
    """
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
            writer = _Writer(target, context, builder, lanes)
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

    def __init__(self, target: type, context: Any, builder: Any, lanes: int = 1) -> None:
        self.target, self.context, self.builder, self.lanes = target, context, builder, lanes
        self.double, self.single, self.flag = (
            kind if lanes == 1 else ir.VectorType(kind, lanes) for kind in (_DOUBLE, _SINGLE, _FLAG)
        )
        self.names: dict[str, Any] = {
            "inf": self._constant(self.double, math.inf),
            "nan": self._constant(self.double, math.nan),
        }
        self.arrays: dict[str, Any] = {}

    def _constant(self, kind: Any, value: float) -> Any:
        return ir.Constant(kind, value if self.lanes == 1 else [value] * self.lanes)

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
                    self.builder.store(self._double(self.value(value)), self._element(place), align=8)
                case ast.If(test=test, body=inner, orelse=[]):
                    with self.builder.if_then(self.value(test)):
                        self.body(inner)
                case ast.If(test=test, body=inner, orelse=other):
                    before = self.names
                    with self.builder.if_else(self.value(test)) as (then, otherwise):
                        for branch, own in ((then, inner), (otherwise, other)):
                            self.names = dict(before)
                            with branch:
                                self.body(own)
                    self.names = before
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
                return self._constant(self.flag, int(known))
            case ast.Constant(value=int() as known):
                return ir.Constant(_INDEX, known)
            case ast.Constant(value=float() as known):
                return self._constant(self.double, known)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                inner = self.value(operand)
                return builder.fsub(self._constant(inner.type, -0.0), inner, flags=_LOOSE)
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
                return builder.load(self._element(node), align=8)
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
            return self._call("pow", [left, right])
        return getattr(self.builder, _ARITHMETIC[op])(left, right, flags=_LOOSE)

    def _compared(self, sign: str, left: Any, right: Any) -> Any:
        if left.type == self.flag:
            return self.builder.icmp_unsigned(sign, left, right)
        # comparisons with NaN are false, except !=
        ordered = self.builder.fcmp_unordered if sign == "!=" else self.builder.fcmp_ordered
        return ordered(sign, left, right)

    def _called(self, name: str, args: list[Any]) -> Any:
        if name == "float32":
            return self.builder.fptrunc(args[0], self.single) if args[0].type == self.double else args[0]
        if name == "float64":
            return self._double(args[0])
        if name == "int":
            return self.builder.fptosi(args[0], _INDEX)
        if name == "any":
            bits = args[0] if self.lanes == 1 else self.builder.bitcast(args[0], ir.IntType(self.lanes))
            return self.builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))
        own = {"abs": "fabs", "floor32": "floor", "floor64": "floor", "sqrt32": "sqrt", "sqrt64": "sqrt"}
        return self._call(own.get(name, name.removeprefix("math.")), args)

    def _call(self, name: str, args: list[Any]) -> Any:
        if self.lanes == 1 or name in self.target.own:
            return self.target.call(self.context, self.builder, name, args)
        # library functions take one number at a time
        found = ir.Constant(args[0].type, ir.Undefined)
        for lane in range(self.lanes):
            place = ir.Constant(ir.IntType(32), lane)
            each = [self.builder.extract_element(arg, place) for arg in args]
            one = self.target.call(self.context, self.builder, name, each)
            found = self.builder.insert_element(found, one, place)
        return found

    def _double(self, value: Any) -> Any:
        return self.builder.fpext(value, self.double) if value.type == self.single else value

    def _element(self, node: ast.Subscript) -> Any:
        assert isinstance(node.value, ast.Name)
        place = self.builder.gep(self.arrays[node.value.id], [self.value(node.slice)])
        return place if self.lanes == 1 else self.builder.bitcast(place, self.double.as_pointer())
