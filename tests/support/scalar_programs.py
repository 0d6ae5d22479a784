"""Scalar programs as NumPy runs them: the emitted source, without a compiler."""

from __future__ import annotations

import ast
import ctypes
import dataclasses
import functools
import math
import types
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from llvmlite import ir
from scipy import special

from gaitsweep.dynamics.random_numbers import fraction
from gaitsweep.engine.kernel import llvm_code
from gaitsweep.engine.kernel.program import Kind, Program
from gaitsweep.engine.kernel.source import PYTHON, statements
from gaitsweep.engine.kernel.trace import Nodes, Tracer, kind_of

_TYPES = {"f64": np.float64, "f32": np.float32, "int": np.float64, "bool": np.bool_}

_MATH = {
    **{name: getattr(np, name) for name in ("log", "log1p", "expm1")},
    **{name: getattr(np, f"arc{name[1:]}") for name in ("asinh", "acosh", "atanh")},
    "erf": special.erf,
    "erfc": special.erfc,
}

# The names that the emitted source reads, as in the preamble of the compiled module.
NAMES: dict[str, Any] = {
    "math": types.SimpleNamespace(**_MATH),
    "inf": np.inf,
    "nan": np.nan,
    "float32": np.float32,
    "float64": np.float64,
    "floor32": np.floor,
    "floor64": np.floor,
    "sqrt32": np.sqrt,
    "sqrt64": np.sqrt,
    **{f"philox{half}": functools.partial(fraction, half=half) for half in (0, 1)},
    "_where": np.where,
    "_not": np.logical_not,
}


@dataclasses.dataclass
class Traced:
    """A function as a scalar program: `inputs` and `outputs` are flat lists of nodes."""

    program: Program
    inputs: list[int]
    outputs: list[int]


def trace(function: Callable[..., Any], *trees: Any, steady: Sequence[bool]) -> Traced:
    """The scalar program of `function` for arguments of these shapes.

    Args:
        function: a pure JAX function of one trajectory.
        trees: its arguments, pytrees of arrays or of shapes with dtypes.
        steady: for each argument, whether it is constant along a trajectory.

    Raises:
        UnsupportedError: the function uses an operation that the kernel does not have.
    """
    closed = jax.make_jaxpr(function)(*trees)
    program = Program()
    tracer = Tracer(program)
    arrays: list[Nodes] = []
    for tree, still in zip(trees, steady, strict=True):
        arrays += tracer.inputs(tree, sum(array.size for array in arrays), steady=still)
    given = tracer.read(closed, arrays)
    inputs, outputs = ([int(at) for array in side for at in array.ravel()] for side in (arrays, given))
    return Traced(program, inputs, outputs)


class _OfArrays(ast.NodeTransformer):
    """`a if c else b` and `not c` as calls, which take arrays of many inputs at once."""

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        self.generic_visit(node)
        return ast.Call(ast.Name("_where", ast.Load()), [node.test, node.body, node.orelse], [])

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, ast.Not):
            return ast.Call(ast.Name("_not", ast.Load()), [node.operand], [])
        return node


def source_of(traced: Traced) -> str:
    """A Python function of the inputs `x0`, `x1`, ... that gives all outputs."""
    given = {at: f"x{i}" for i, at in enumerate(traced.inputs)}
    lines, results = statements(PYTHON, traced.program, traced.outputs, given)
    body = "\n".join(f"    {line}" for line in [*lines, f"return ({''.join(f'{r}, ' for r in results)})"])
    return f"def run({', '.join(given.values())}):\n{body}\n"


def storing_source_of(traced: Traced) -> str:
    """A Python function of a flat array: the inputs come first, and all outputs are stored after them."""
    given = {at: f"x{i}" for i, at in enumerate(traced.inputs)}
    nodes, first = traced.program.nodes, len(traced.inputs)
    loads = [f"x{i} = {PYTHON.loaded(nodes[at].kind, f's[{i}]')}" for i, at in enumerate(traced.inputs)]
    lines, results = statements(PYTHON, traced.program, traced.outputs, given)
    kinds: list[Kind] = [traced.program.nodes[at].kind for at in traced.outputs]
    lines += [
        f"s[{first + k}] = {PYTHON.stored(kind, result)}"
        for k, (kind, result) in enumerate(zip(kinds, results, strict=True))
    ]
    return "\n".join(["def run(s):", *(f"    {line}" for line in [*loads, *lines])])


def native(source: str) -> Callable[[np.ndarray], None]:
    """The machine code of a function of a flat array of float64."""
    module = ir.Module()
    function = llvm_code.add_function(module, source)
    function.linkage = "external"
    run = llvm_code.loaded(llvm_code.machine_code(module), function.name, ctypes.c_void_p)
    return lambda s: run(s.ctypes.data)


def executable(traced: Traced) -> Callable[..., tuple[Any, ...]]:
    """The emitted function; each of its inputs may be an array of many values."""
    tree = ast.fix_missing_locations(_OfArrays().visit(ast.parse(source_of(traced))))
    names = dict(NAMES)
    exec(compile(tree, "emitted", "exec"), names)
    run = names["run"]

    def quietly(*inputs: Any) -> tuple[Any, ...]:
        with np.errstate(all="ignore"):
            return run(*inputs)

    return quietly


def traced_with(function: Callable[..., Any], *args: Any, steady: Sequence[bool] | None = None) -> Traced:
    return trace(function, *args, steady=steady or [False] * len(args))


def outputs_of(function: Callable[..., Any], *args: Any) -> list[np.ndarray]:
    """The leaves of `function(*args)` by way of the scalar program, in their shapes and types."""
    args = jax.tree.map(np.asarray, args)
    results = executable(traced_with(function, *args))(*_scalars(args))
    leaves = []
    for leaf in jax.tree.leaves(jax.eval_shape(function, *args)):
        size = math.prod(leaf.shape)
        mine, results = results[:size], results[size:]
        kind = _TYPES[kind_of(leaf.dtype)]
        assert all(isinstance(m, bool | float) or m.dtype == kind for m in mine), "a number of another kind"
        leaves.append(np.array(mine).reshape(leaf.shape).astype(leaf.dtype))
    assert not results
    return leaves


def on_many(function: Callable[[Any], Any], values: np.ndarray) -> np.ndarray:
    """A function of one number at many, all in one run of the emitted source."""
    (result,) = executable(traced_with(function, values[0]))(values)
    assert result.dtype == values.dtype
    return result


def _scalars(args: Any) -> list[Any]:
    scalars: list[Any] = []
    for leaf in jax.tree.leaves(args):
        kind = _TYPES[kind_of(leaf.dtype)]
        scalars.extend(kind(value) for value in leaf.ravel())
    return scalars
