"""Compiles the functions of a kernel to machine code by LLVM.

A stage of a kernel is straight-line Python with up to a thousand statements, of which each expression becomes
an instruction directly. The language is that of `source.PYTHON`: assignments to names and to elements of one
flat array, arithmetic, single comparisons, `a if c else b`, calls of functions of numbers, and `if any(c)`
with `else`; a name that a branch assigns has no value after it.
"""

from __future__ import annotations

import ast
import contextlib
import ctypes
import functools
import math
from collections.abc import Callable, Iterator
from typing import Any, Literal

import llvmlite.binding as llvm
from llvmlite import ir

from gaitsweep.engine.kernel import philox

DOUBLE = ir.DoubleType()
INDEX = ir.IntType(64)
VOID = ir.VoidType()
ARRAY = DOUBLE.as_pointer()
_SINGLE = ir.FloatType()
_FLAG = ir.IntType(1)
_Kind = Literal["number", "whole number", "flag", "array"]
# methods of LLVM's builder by the kind of both operands and Python's operator
_OPERATORS: dict[_Kind, dict[type, str]] = {
    "number": {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv", ast.Pow: "pow"},
    "whole number": {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul"},
    "flag": {ast.BitAnd: "and_", ast.BitOr: "or_"},
    "array": {},
}
# what LLVM may assume of them: the sign of zero does not count; sums of whole numbers do not overflow
_ASSUMED: dict[_Kind, tuple[str, ...]] = {"number": ("nsz",), "whole number": ("nsw",), "flag": ()}
_ALLOWED_LINES = "numbers assigned to elements, values to names, and `if any(...)` of a flag with `else`"
_ALLOWED_EXPRESSIONS = (
    "names with a value, literals, + - * / ** of two numbers of one precision and - of one, + - * of whole "
    "numbers, & | `not` of flags, one comparison of two numbers or flags, `a if flag else b` of these, "
    "elements of the array at a whole number, and calls of functions of numbers"
)
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Eq: "==", ast.NotEq: "!="}
# LLVM's own functions by ours, which take vectors too; all others take one number at a time
_INTRINSICS = {
    "abs": "fabs",
    "floor32": "floor",
    "floor64": "floor",
    "sqrt32": "sqrt",
    "sqrt64": "sqrt",
    "fma": "fma",
}
_OF_VECTORS = {*_INTRINSICS.values()}
# numbers of arguments of all functions; a name that is none of them would crash the process when it is called
_ARGUMENTS = {
    **dict.fromkeys(("abs", "floor32", "floor64", "sqrt32", "sqrt64", "float32", "float64"), 1),
    **{f"math.{name}": 1 for name in ("log", "log1p", "expm1", "asinh", "acosh", "atanh", "erf", "erfc")},
    **dict.fromkeys(("fma", "philox0", "philox1"), 3),
}
_ALLOWED_CALLS = ", ".join(f"{name} of {count}" for name, count in _ARGUMENTS.items())


def add_function(module: ir.Module, source: str, lanes: int = 1) -> ir.Function:
    """Add a function that returns nothing to a module.

    With several lanes each name stands for a vector of that many numbers, and an element of the array for
    that many from it on; whole numbers, which are places in the array, stay single.

    Args:
        module: the module.
        source: the function; its first argument is a flat array of float64, the others are whole numbers.
        lanes: numbers in a vector.

    Raises:
        ValueError: the source has a line or an expression that the language does not have.
    """
    tree = ast.parse(source).body[0]
    assert isinstance(tree, ast.FunctionDef)
    names = [argument.arg for argument in tree.args.args]
    kinds = [ARRAY, *[INDEX] * (len(names) - 1)]
    function = ir.Function(module, ir.FunctionType(VOID, kinds), tree.name)
    function.linkage = "internal"
    builder = ir.IRBuilder(function.append_basic_block("entry"))
    _align_stack(builder, lanes)
    _Writer(builder, lanes, dict(zip(names, function.args, strict=True))).body(tree.body)
    builder.ret_void()
    return function


@contextlib.contextmanager
def loop(builder: ir.IRBuilder, count: Any) -> Iterator[tuple[Any, ir.Block]]:
    """Write the instructions of the context `count` times; yields the loop's index and the block after it."""
    before = builder.block
    head = builder.append_basic_block("head")
    body = builder.append_basic_block("body")
    after = builder.append_basic_block("after")
    builder.branch(head)
    builder.position_at_end(head)
    index = builder.phi(INDEX)
    index.add_incoming(INDEX(0), before)
    builder.cbranch(builder.icmp_signed("<", index, count), body, after)
    builder.position_at_end(body)
    yield index, after
    index.add_incoming(builder.add(index, INDEX(1)), builder.block)
    builder.branch(head)
    builder.position_at_end(after)


def vector(kind: ir.Type, lanes: int) -> ir.Type:
    """The type of a vector, which for one lane is the number's."""
    return kind if lanes == 1 else ir.VectorType(kind, lanes)


def some_lane(builder: ir.IRBuilder, flags: Any) -> Any:
    """Whether the flag of some lane is true."""
    if isinstance(flags.type, ir.VectorType):
        flags = builder.bitcast(flags, ir.IntType(flags.type.count))
    return builder.icmp_unsigned("!=", flags, flags.type(0))


def machine_code(module: ir.Module, *, quick: bool = False) -> bytes:
    """The machine code of a module for this processor, as an object file.

    Args:
        module: the module.
        quick: compile in a fifth of the time, to code of the same results that runs up to twice as long.
    """
    if quick:
        return _target_machine(opt=0).emit_object(llvm.parse_assembly(str(module)))
    return _target_machine().emit_object(_optimised(module))


def _optimised(module: ir.Module) -> llvm.ModuleRef:
    """The module after LLVM's passes."""
    parsed = llvm.parse_assembly(str(module))
    machine = _target_machine()
    parsed.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = options.slp_vectorization = False  # lanes fill the vectors already
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(parsed, passes)
    return parsed


def loaded(code: bytes, name: str, *kinds: Any) -> Callable[..., None]:
    """The function `name` of an object file, with arguments of these `ctypes`; it releases Python's lock."""
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    function: Any = ctypes.CFUNCTYPE(None, *kinds)(engine.get_function_address(name))
    function.engine = engine  # which holds the memory of the code
    return function


def processor() -> tuple[str, str]:
    """The name of this processor and its features, by which its machine code differs."""
    features = llvm.get_host_cpu_features()
    # LLVM avoids the widest vectors by itself; these kernels are faster with them
    wide = ",-prefer-256-bit" if features.get("avx512f") else ""
    return llvm.get_host_cpu_name(), features.flatten() + wide


@functools.cache
def _target() -> llvm.Target:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple()


def _target_machine(opt: int = 3) -> llvm.TargetMachine:
    """A new description of this processor, since an engine takes its own; `opt` as of LLVM, 0 to 3."""
    target = _target()
    (name, features) = processor()
    relocation = "static" if target.name.startswith("x86") else "default"
    return target.create_target_machine(
        cpu=name, features=features, opt=opt, reloc=relocation, codemodel="jitdefault", jit=True
    )


def _align_stack(builder: Any, lanes: int) -> None:
    """Let vectors that are spilled begin at a multiple of their size.

    LLVM aligns the stack only for variables: a vector across two cache lines takes up to twice the time.
    """
    place = builder.alloca(DOUBLE, lanes)
    place.align = 8 * lanes
    # an instruction that seems to use the variable, so that it is not removed
    builder.asm(ir.FunctionType(VOID, [place.type]), "", "r", [place], True)


class _Writer:
    """Translator of a function's lines to instructions, which are written where `builder` stands.

    `names` has the values of arguments and of names that the lines so far assigned.

    Args:
        builder: the builder of the function's instructions.
        lanes: numbers in a vector.
        arguments: the values of the function's arguments by name.
    """

    def __init__(self, builder: Any, lanes: int, arguments: dict[str, Any]) -> None:
        self.builder = builder
        self.lanes = lanes
        self.double = vector(DOUBLE, lanes)
        self.single = vector(_SINGLE, lanes)
        self.flag = vector(_FLAG, lanes)
        self.names: dict[str, Any] = {
            **arguments,
            "inf": self._constant(self.double, math.inf),
            "nan": self._constant(self.double, math.nan),
        }

    def _constant(self, kind: Any, value: float) -> Any:
        return ir.Constant(kind, value if self.lanes == 1 else [value] * self.lanes)

    def body(self, lines: list[ast.stmt]) -> None:
        """Write lines, whose assignments define names for the lines after them."""
        for line in lines:
            match line:
                case ast.Assign(targets=[ast.Name(id=name)], value=value):
                    self.names[name] = self.value(value)
                case ast.Assign(targets=[ast.Subscript() as place], value=value):
                    stored = self.value(value)
                    if self._kind(stored) != "number":
                        raise _not_lowered("line", line, _ALLOWED_LINES)
                    # a vector need not begin at a multiple of its size
                    self.builder.store(self._double(stored), self._element(place), align=8)
                case ast.If(
                    test=ast.Call(func=ast.Name(id="any"), args=[test], keywords=[]), body=yes, orelse=no
                ):
                    flag = self.value(test)
                    if self._kind(flag) != "flag":
                        raise _not_lowered("expression", line.test, _ALLOWED_LINES)
                    self._branch(flag, yes, no)
                case ast.Expr(value=ast.Call(func=ast.Name(id="barrier"), args=[], keywords=[])):
                    self._barrier()
                case ast.Pass():
                    pass
                case _:
                    raise _not_lowered("line", line, _ALLOWED_LINES)

    def value(self, node: ast.expr) -> Any:
        """Write the instructions of an expression, and return its value."""
        builder = self.builder
        match node:
            case ast.Name(id=name) if name in self.names:
                return self.names[name]
            case ast.Constant(value=bool() as known):
                return self._constant(self.flag, int(known))
            case ast.Constant(value=int() as known):
                return INDEX(known)
            case ast.Constant(value=float() as known):
                return self._constant(self.double, known)
            case ast.UnaryOp(op=ast.USub() | ast.Not() as op, operand=operand):
                inner = self.value(operand)
                negation = {"number": ast.USub, "flag": ast.Not}.get(self._kind(inner))
                if negation is type(op):
                    return builder.fneg(inner) if negation is ast.USub else builder.not_(inner)
            case ast.BinOp(left=left, op=op, right=right):
                operands = self.value(left), self.value(right)
                kind = self._common_kind(*operands)
                if kind is not None and type(op) in _OPERATORS[kind]:
                    return self._combined(kind, _OPERATORS[kind][type(op)], *operands)
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _COMPARISONS:
                operands = self.value(left), self.value(right)
                if self._common_kind(*operands) in ("number", "flag"):
                    return self._compared(_COMPARISONS[type(op)], *operands)
            case ast.IfExp(test=test, body=yes, orelse=no):
                flag, *choices = self.value(test), self.value(yes), self.value(no)
                if self._kind(flag) == "flag" and self._common_kind(*choices) in ("number", "flag"):
                    return builder.select(flag, *choices)
            case ast.Subscript():
                return builder.load(self._element(node), align=8)
            case ast.Call():
                return self._called(node)
        raise _not_lowered("expression", node, _ALLOWED_EXPRESSIONS)

    def _kind(self, value: Any) -> _Kind:
        """The kind of a value, by its type."""
        if value.type in (self.double, self.single):
            return "number"
        if value.type == self.flag:
            return "flag"
        return "whole number" if value.type == INDEX else "array"

    def _common_kind(self, first: Any, second: Any) -> _Kind | None:
        """The kind of two values of one type, which for numbers includes their precision; else None."""
        return self._kind(first) if first.type == second.type else None

    def _combined(self, kind: _Kind, operator: str, left: Any, right: Any) -> Any:
        """The instruction of an operator between two values of a kind."""
        if operator == "pow":
            return self._call(operator, [left, right])
        return getattr(self.builder, operator)(left, right, flags=_ASSUMED[kind])

    def _compared(self, sign: str, left: Any, right: Any) -> Any:
        """The instruction of a comparison of two values."""
        if left.type == self.flag:
            return self.builder.icmp_unsigned(sign, left, right)
        # comparisons with NaN are false, except !=
        ordered = self.builder.fcmp_unordered if sign == "!=" else self.builder.fcmp_ordered
        return ordered(sign, left, right)

    def _called(self, node: ast.Call) -> Any:
        """The instructions of a call of a function of numbers."""
        name = ast.unparse(node.func)
        if node.keywords or _ARGUMENTS.get(name) != len(node.args):
            raise _not_lowered("expression", node, _ALLOWED_CALLS)
        args = [self.value(arg) for arg in node.args]
        one_type = name.startswith("philox") or all(arg.type == args[0].type for arg in args)
        if not one_type or any(self._kind(arg) != "number" for arg in args):
            raise _not_lowered("expression", node, _ALLOWED_CALLS)
        if name == "float32":
            return self.builder.fptrunc(args[0], self.single) if args[0].type == self.double else args[0]
        if name == "float64":
            return self._double(args[0])
        if name in ("philox0", "philox1"):
            numbers = [self._double(arg) for arg in args]
            return philox.in_llvm(self.builder, lambda x: self._call("floor", [x]), numbers, int(name[-1]))
        return self._call(_INTRINSICS.get(name, name.removeprefix("math.")), args)

    def _call(self, name: str, args: list[Any]) -> Any:
        """The value of LLVM's own function, or of one of the C library, for each lane."""
        if self.lanes == 1 or name in _OF_VECTORS:
            return self.builder.call(_declared(self.builder.module, name, args[0].type, len(args)), args)
        values = ir.Constant(args[0].type, ir.Undefined)
        for lane in range(self.lanes):
            place = ir.Constant(ir.IntType(32), lane)
            numbers = [self.builder.extract_element(arg, place) for arg in args]
            one = _declared(self.builder.module, name, numbers[0].type, len(args))
            values = self.builder.insert_element(values, self.builder.call(one, numbers), place)
        return values

    def _branch(self, flag: Any, yes: list[ast.stmt], no: list[ast.stmt]) -> None:
        """Write the lines `yes` where the flag of some lane is true, and the lines `no` where none is."""
        before = self.names
        assigned: set[str] = set()
        with self.builder.if_else(some_lane(self.builder, flag)) as (then, otherwise):
            for branch, lines in ((then, yes), (otherwise, no)):
                self.names = dict(before)
                with branch:
                    self.body(lines)
                assigned |= {name for name, value in self.names.items() if value is not before.get(name)}
                assigned |= before.keys() - self.names.keys()  # which a branch inside this one assigned
        self.names = {name: value for name, value in before.items() if name not in assigned}

    def _barrier(self) -> None:
        """Elements that are loaded after this line are loaded again, and none is stored later."""
        nothing = ir.FunctionType(VOID, [])
        self.builder.asm(nothing, "", "~{memory}", [], True)

    def _double(self, value: Any) -> Any:
        return self.builder.fpext(value, self.double) if value.type == self.single else value

    def _element(self, node: ast.Subscript) -> Any:
        array, index = self.value(node.value), self.value(node.slice)
        if array.type != ARRAY or index.type != INDEX:
            raise _not_lowered("expression", node, _ALLOWED_EXPRESSIONS)
        place = self.builder.gep(array, [index])
        return place if self.lanes == 1 else self.builder.bitcast(place, self.double.as_pointer())


def _not_lowered(kind: str, node: ast.AST, allowed: str) -> ValueError:
    """The error about source that the language does not have."""
    return ValueError(f"The {kind} `{ast.unparse(node)}` of a kernel is not lowered. Allowed: {allowed}.")


def _declared(module: Any, name: str, kind: Any, count: int) -> Any:
    """A function of `count` numbers, or vectors of numbers: LLVM's own, or one of the C library."""
    one = getattr(kind, "element", kind)
    if name in _OF_VECTORS or name in ("log", "pow"):
        shape = "" if one is kind else f"v{kind.count}"
        name = f"llvm.{name}.{shape}{one.intrinsic_name}"
    elif one == _SINGLE:
        name = f"{name}f"
    return module.globals.get(name) or ir.Function(module, ir.FunctionType(kind, [kind] * count), name)
