"""Compiles straight-line Python to LLVM, as an intrinsic of Numba.

Numba takes half a minute for a function of a thousand statements, mostly in passes that such a function does
not need: loops, branches, type inference. Here each expression becomes an instruction directly. Numba itself
compiles only the loop around it, a few lines.

The language is that of `python_source`: assignments to names and to elements of flat arrays, arithmetic,
single comparisons, `a if c else b`, calls of functions of numbers, and `if any(c)` with `else`, in
which names are not defined for later.
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
_LINES = "assignments to a name or an element, and `if any(...)` with `else`"
_EXPRESSIONS = "names, numbers, arithmetic, a comparison of two, `a if c else b`, elements and calls"
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Eq: "==", ast.NotEq: "!="}
# Functions that are LLVM's own; the others are those that Numba calls.
_OWN = {
    "abs": "fabs",
    "floor32": "floor",
    "floor64": "floor",
    "sqrt32": "sqrt",
    "sqrt64": "sqrt",
    "fma": "fma",
}


def straight_line(source: str, lanes: int = 1) -> Any:
    """The Numba intrinsic of a function given as source.

    With several lanes each name stands for a vector of that many numbers, and an element of an array for that
    many from it on; whole numbers, which are places in arrays, stay single.

    Args:
        source: the function, of numbers, indices and flat arrays; it returns nothing.
        lanes: numbers in a vector.
    """
    head = source[: source.index(":")]
    names = head[head.index("(") + 1 : head.index(")")]
    name = head[len("def ") : head.index("(")]

    def typed(*given: Any) -> tuple[Any, Any]:
        function = ast.parse(source).body[0]
        assert isinstance(function, ast.FunctionDef)

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            _align_stack(builder, lanes)
            writer = _Writer(context, builder, lanes)
            writer.arguments(function, signature.args, args)
            writer.body(function.body)
            return context.get_dummy_value()

        return types.none(*given), generate

    definition = eval(f"lambda typing_context, {names}: typed({names})", {"typed": typed})
    definition.__name__ = definition.__qualname__ = name
    return intrinsic(definition)


def _align_stack(builder: Any, lanes: int) -> None:
    """Let vectors that are spilled begin at a multiple of their size.

    LLVM aligns the stack only for variables: a vector across two cache lines takes up to twice the time.
    """
    place = builder.alloca(_DOUBLE, lanes)
    place.align = 8 * lanes
    # an instruction that seems to use the variable, so that it is not removed
    builder.asm(ir.FunctionType(ir.VoidType(), [place.type]), "", "r", [place], True)


class _Writer:
    """Writes the instructions of one function at its call."""

    def __init__(self, context: Any, builder: Any, lanes: int) -> None:
        self.context, self.builder, self.lanes = context, builder, lanes
        self.double, self.single, self.flag = (
            kind if lanes == 1 else ir.VectorType(kind, lanes) for kind in (_DOUBLE, _SINGLE, _FLAG)
        )
        # the sign of zero may be ignored
        self.loose = ("nsz",)
        self.names: dict[str, Any] = {
            "inf": self._constant(self.double, math.inf),
            "nan": self._constant(self.double, math.nan),
        }
        self.arrays: dict[str, Any] = {}

    def _constant(self, kind: Any, value: float) -> Any:
        return ir.Constant(kind, value if self.lanes == 1 else [value] * self.lanes)

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
                    # a vector need not begin at a multiple of its size
                    self.builder.store(self._double(self.value(value)), self._element(place), align=8)
                case ast.If(test=ast.Call(func=ast.Name(id="any"), args=[flag]), body=yes, orelse=no):
                    self._branch(self.value(flag), yes, no)
                case ast.Expr(value=ast.Call(func=ast.Name(id="barrier"))):
                    self._barrier()
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
                return self._constant(self.flag, int(known))
            case ast.Constant(value=int() as known):
                return ir.Constant(_INDEX, known)
            case ast.Constant(value=float() as known):
                return self._constant(self.double, known)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                inner = self.value(operand)
                return builder.fneg(inner)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return builder.not_(self.value(operand))
            case ast.BinOp(left=left, op=op, right=right):
                return self._combined(type(op), self.value(left), self.value(right))
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return self._compared(_COMPARISONS[type(op)], self.value(left), self.value(right))
            case ast.IfExp(test=test, body=yes, orelse=no):
                return builder.select(self.value(test), self.value(yes), self.value(no))
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
            return self._library(operator.pow, [left, right])
        return getattr(self.builder, _ARITHMETIC[op])(left, right, flags=self.loose)

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
        if name in _OWN:
            return self.builder.call(
                _llvm_function(self.builder.module, _OWN[name], args[0].type, len(args)), args
            )
        return self._library(getattr(math, name.removeprefix("math.")), args)

    def _library(self, function: Any, args: list[Any]) -> Any:
        """The value of a function that takes one number at a time."""
        number = types.float64 if args[0].type == self.double else types.float32
        one = self.context.get_function(function, number(*[number] * len(args)))
        if self.lanes == 1:
            return one(self.builder, args)
        found = ir.Constant(args[0].type, ir.Undefined)
        for lane in range(self.lanes):
            place = ir.Constant(ir.IntType(32), lane)
            each = one(self.builder, [self.builder.extract_element(arg, place) for arg in args])
            found = self.builder.insert_element(found, each, place)
        return found

    def _branch(self, flag: Any, yes: list[ast.stmt], no: list[ast.stmt]) -> None:
        """Write the lines `yes` where the flag of some lane is true, and the lines `no` where none is."""
        bits = flag if self.lanes == 1 else self.builder.bitcast(flag, ir.IntType(self.lanes))
        some = self.builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))
        before = self.names
        with self.builder.if_else(some) as (then, otherwise):
            for branch, lines in ((then, yes), (otherwise, no)):
                self.names = dict(before)
                with branch:
                    self.body(lines)
        self.names = before

    def _barrier(self) -> None:
        """Elements that are loaded after this line are loaded again, and none is stored later."""
        nothing = ir.FunctionType(ir.VoidType(), [])
        self.builder.asm(nothing, "", "~{memory}", [], True)

    def _double(self, value: Any) -> Any:
        return self.builder.fpext(value, self.double) if value.type == self.single else value

    def _element(self, node: ast.Subscript) -> Any:
        assert isinstance(node.value, ast.Name)
        place = self.builder.gep(self.arrays[node.value.id], [self.value(node.slice)])
        return place if self.lanes == 1 else self.builder.bitcast(place, self.double.as_pointer())


def _llvm_function(module: Any, name: str, kind: Any, count: int) -> Any:
    """LLVM's own function of `count` numbers, or vectors of numbers."""
    one = getattr(kind, "element", kind)
    shape = "" if one is kind else f"v{kind.count}"
    full = f"llvm.{name}.{shape}{one.intrinsic_name}"
    return module.globals.get(full) or ir.Function(module, ir.FunctionType(kind, [kind] * count), full)
