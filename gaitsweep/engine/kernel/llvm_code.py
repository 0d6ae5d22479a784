"""Compiles the functions of a kernel to machine code by LLVM.

A stage of a kernel is straight-line Python with up to a thousand statements, of which each expression becomes
an instruction directly. The language is that of `source.PYTHON`: assignments to names and to elements of one
flat array, arithmetic, single comparisons, `a if c else b`, calls of functions of numbers, and `if any(c)`
with `else`, in which names are not defined for later.
"""

from __future__ import annotations

import ast
import contextlib
import ctypes
import functools
import math
from collections.abc import Callable, Iterator
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir

from gaitsweep.engine.kernel import philox

DOUBLE = ir.DoubleType()
INDEX = ir.IntType(64)
VOID = ir.VoidType()
ARRAY = DOUBLE.as_pointer()
_SINGLE = ir.FloatType()
_FLAG = ir.IntType(1)
# methods of LLVM's builder by Python's operator, for numbers, flags and whole numbers
_OF_NUMBERS = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}
_OF_FLAGS = {ast.BitAnd: "and_", ast.BitOr: "or_"}
_OF_WHOLE_NUMBERS = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul"}
_OPERATORS = {*_OF_NUMBERS, *_OF_FLAGS, ast.Pow}
_ALLOWED_LINES = "assignments to a name or an element, and `if any(...)` with `else`"
_ALLOWED_EXPRESSIONS = "names, numbers, arithmetic, a comparison of two, `a if c else b`, elements and calls"
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


def assembly(module: ir.Module) -> str:
    """The machine code of a module for this processor, as text."""
    return _target_machine().emit_assembly(_optimised(module))


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
    """Writer of the instructions of one function at its call."""

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
                    # a vector need not begin at a multiple of its size
                    self.builder.store(self._double(self.value(value)), self._element(place), align=8)
                case ast.If(test=ast.Call(func=ast.Name(id="any"), args=[flag]), body=yes, orelse=no):
                    self._branch(self.value(flag), yes, no)
                case ast.Expr(value=ast.Call(func=ast.Name(id="barrier"))):
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
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                inner = self.value(operand)
                return builder.fneg(inner)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return builder.not_(self.value(operand))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return self._combined(type(op), self.value(left), self.value(right))
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _COMPARISONS:
                return self._compared(_COMPARISONS[type(op)], self.value(left), self.value(right))
            case ast.IfExp(test=test, body=yes, orelse=no):
                return builder.select(self.value(test), self.value(yes), self.value(no))
            case ast.Subscript():
                return builder.load(self._element(node), align=8)
            case ast.Call(func=function, args=args):
                return self._called(ast.unparse(function), [self.value(a) for a in args])
        raise _not_lowered("expression", node, _ALLOWED_EXPRESSIONS)

    def _combined(self, op: type, left: Any, right: Any) -> Any:
        """The instruction of an operator between two values, by their type."""
        if op in _OF_FLAGS:
            return getattr(self.builder, _OF_FLAGS[op])(left, right)
        if left.type == INDEX:
            return getattr(self.builder, _OF_WHOLE_NUMBERS[op])(left, right, flags=("nsw",))
        if op is ast.Pow:
            return self._call("pow", [left, right])
        # the sign of zero may be ignored
        return getattr(self.builder, _OF_NUMBERS[op])(left, right, flags=("nsz",))

    def _compared(self, sign: str, left: Any, right: Any) -> Any:
        """The instruction of a comparison of two values."""
        if left.type == self.flag:
            return self.builder.icmp_unsigned(sign, left, right)
        # comparisons with NaN are false, except !=
        ordered = self.builder.fcmp_unordered if sign == "!=" else self.builder.fcmp_ordered
        return ordered(sign, left, right)

    def _called(self, name: str, args: list[Any]) -> Any:
        """The instructions of a call of a function of numbers."""
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
        with self.builder.if_else(some_lane(self.builder, flag)) as (then, otherwise):
            for branch, lines in ((then, yes), (otherwise, no)):
                self.names = dict(before)
                with branch:
                    self.body(lines)
        self.names = before

    def _barrier(self) -> None:
        """Elements that are loaded after this line are loaded again, and none is stored later."""
        nothing = ir.FunctionType(VOID, [])
        self.builder.asm(nothing, "", "~{memory}", [], True)

    def _double(self, value: Any) -> Any:
        return self.builder.fpext(value, self.double) if value.type == self.single else value

    def _element(self, node: ast.Subscript) -> Any:
        assert isinstance(node.value, ast.Name)
        place = self.builder.gep(self.names[node.value.id], [self.value(node.slice)])
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
