"""Translates a JAX function of one trajectory, by its jaxpr, to a scalar program.

An array is represented by an array of the same shape whose elements are nodes of the program, so reshaping,
slicing and indexing cost nothing: only scalar arithmetic remains.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal

from gaitsweep.engine.kernel.program import Kind, Program
from gaitsweep.engine.kernel.whole_numbers import WholeNumbers

# Of int64: the nodes of the program that represent the elements of an array of the same shape.
Nodes = np.ndarray


class UnsupportedError(Exception):
    """A model uses an operation that the scalar kernel does not have; the message names it and its place."""


class RuleError(UnsupportedError):
    """A rule cannot translate an equation; the tracer adds the equation's place in the source."""


class Writer:
    """Writer of operations whose constants have the kind of a given node."""

    def __init__(self, program: Program, like: int) -> None:
        self.program = program
        self.kind: Kind = program.nodes[like].kind

    def number(self, value: float) -> int:
        """The node of a constant."""
        return self.program.constant(value, self.kind)

    def __call__(self, op: str, *args: int | float) -> int:
        return self.program.apply(op, *(self.number(a) if isinstance(a, float) else a for a in args))

    def polynomial(self, x: int, coefficients: list[float]) -> int:
        """A polynomial by Horner's scheme; `coefficients` are in order of rising power."""
        total = self.number(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            total = self("add", self("mul", total, x), c)
        return total

    @property
    def single(self) -> bool:
        """Whether constants are float32."""
        return self.kind == "f32"


# Writes the operations of one element, from its nodes.
Build = Callable[..., int]


class Tracer:
    """Translates jaxprs into one program."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self._whole_numbers = WholeNumbers(program)

    def read(self, closed: ClosedJaxpr, args: Sequence[Nodes]) -> list[Nodes]:
        """The output nodes of a closed jaxpr with these input nodes."""
        consts = [self.constants(np.asarray(value)) for value in closed.consts]
        return self.read_open(closed.jaxpr, consts, args)

    def read_open(self, jaxpr: Jaxpr, consts: Sequence[Nodes], args: Sequence[Nodes]) -> list[Nodes]:
        """The output nodes of a jaxpr.

        Args:
            jaxpr: the jaxpr, with open constants.
            consts, args: the nodes of its constants and of its inputs.

        Raises:
            UnsupportedError: the scalar kernel lacks an operation, or cannot represent its results.
        """
        from gaitsweep.engine.kernel.primitives import rule_for

        known: dict[Any, Nodes] = {}
        known.update(zip(jaxpr.constvars, consts, strict=True))
        known.update(zip(jaxpr.invars, args, strict=True))

        def get(atom: Any) -> Nodes:
            return self.constants(np.asarray(atom.val)) if isinstance(atom, Literal) else known[atom]

        for equation in jaxpr.eqns:
            try:
                of_equation = [get(atom) for atom in equation.invars]
                outputs = rule_for(equation.primitive.name)(self, equation, of_equation)
                # indexing may return NumPy scalars instead of arrays
                outputs = [np.asarray(nodes) for nodes in outputs]
                if fault := self._whole_numbers.fault(equation, of_equation, outputs):
                    raise RuleError(f"the scalar kernel cannot represent {fault}")
                outputs = self._whole_numbers.wrapped(equation, outputs)
            except RuleError as error:
                place = _place_of(equation)
                if not place:  # inside a function of JAX: the calling equation may have a place
                    raise
                raise UnsupportedError(f"{error}{place}") from error
            known.update(zip(equation.outvars, outputs, strict=True))
        return [get(atom) for atom in jaxpr.outvars]

    def inputs(self, tree: Any, first: int, *, steady: bool) -> list[Nodes]:
        """Input nodes for each leaf of a pytree.

        Args:
            tree: a pytree of arrays or of shapes.
            first: the number of the first input.
            steady: whether the inputs are constant along a trajectory.
        """
        arrays = []
        for leaf in jax.tree.leaves(tree):
            size = int(np.prod(leaf.shape))
            kind = kind_of(leaf.dtype)
            nodes = [self.program.input(first + i, kind, steady=steady) for i in range(size)]
            arrays.append(np.array(nodes, np.int64).reshape(leaf.shape))
            self._whole_numbers.add_inputs(arrays[-1], leaf.dtype)
            first += size
        return arrays

    def constants(self, values: np.ndarray) -> Nodes:
        """The nodes of an array of constants."""
        kind = kind_of(values.dtype)
        flat = [self.program.constant(value, kind) for value in values.ravel().tolist()]
        return np.array(flat, np.int64).reshape(values.shape)

    def each(self, function: Callable[..., int], *arrays: Nodes) -> Nodes:
        """`function` of nodes, element by element, with broadcasting."""
        shape = arrays[0].shape
        if any(a.shape != shape for a in arrays):
            shape = np.broadcast_shapes(*(a.shape for a in arrays))
            arrays = tuple(np.broadcast_to(a, shape) for a in arrays)
        columns = [a.ravel().tolist() for a in arrays]
        return np.array([function(*row) for row in zip(*columns, strict=True)], np.int64).reshape(shape)

    def apply(self, op: str, *arrays: Nodes) -> Nodes:
        """An operation, element by element, with broadcasting."""
        return self.each(lambda *nodes: self.program.apply(op, *nodes), *arrays)

    def write(self, build: Build, *arrays: Nodes) -> Nodes:
        """The results of `build`, which writes several operations, element by element, with broadcasting."""
        return self.each(lambda *nodes: build(Writer(self.program, nodes[0]), *nodes), *arrays)

    def known(self, nodes: Nodes) -> np.ndarray | None:
        """The values of an array of constants; None if a node is not a constant."""
        values = [self.program.value(at) for at in nodes.ravel().tolist()]
        return None if any(v is None for v in values) else np.array(values).reshape(nodes.shape)


class TracedArray(NamedTuple):
    """The size, shape and dtype of an array that a function returns."""

    size: int
    shape: tuple[int, ...]
    dtype: str


class TracedFunction(NamedTuple):
    """A function as a scalar program.

    `inputs` and `outputs` are its nodes, `arrays` the arrays that it returns, each of whose places is in the
    tree `results`.
    """

    program: Program
    inputs: list[int]
    outputs: list[int]
    arrays: list[TracedArray]
    results: Any


def traced_function(function: Callable[..., Any], shapes: Any, *, simplify: bool = True) -> TracedFunction:
    """Translate a function.

    Args:
        function: a JAX function, from pytrees to a pytree of arrays.
        shapes: shapes and dtypes of its arguments.
        simplify: as of `Program`.

    Raises:
        UnsupportedError: the function uses an operation that the scalar kernel does not have.
    """
    jaxpr, out = jax.make_jaxpr(function, return_shape=True)(*shapes)
    program = Program(simplify=simplify)
    tracer = Tracer(program)
    inputs = tracer.inputs(shapes, 0, steady=False)
    outputs = tracer.read(jaxpr, inputs)
    likes, structure = jax.tree.flatten(out)
    arrays = [
        TracedArray(nodes.size, like.shape, str(like.dtype))
        for nodes, like in zip(outputs, likes, strict=True)
    ]
    places = jax.tree.unflatten(structure, range(len(arrays)))
    return TracedFunction(program, _flat(inputs), _flat(outputs), arrays, places)


def _flat(arrays: list[Nodes]) -> list[int]:
    """The nodes of arrays, one after the other."""
    return [at for nodes in arrays for at in nodes.ravel().tolist()]


# The output nodes of an equation from its input nodes.
Rule = Callable[[Tracer, Any, list[Nodes]], list[Nodes]]


def kind_of(dtype: Any) -> Kind:
    """The kind of node that represents scalars of a dtype.

    Raises:
        RuleError: no kind represents them.
    """
    if not jnp.issubdtype(dtype, jax.dtypes.extended):  # such as random number keys
        kinds: dict[str, Kind] = {"b": "bool", "i": "int", "u": "int", "f4": "f32", "f8": "f64"}
        scalar = np.dtype(dtype)
        if (kind := kinds.get(scalar.str[1:] if scalar.kind == "f" else scalar.kind)) is not None:
            return kind
    raise RuleError(f"numbers of type {dtype} cannot run in the scalar kernel")


def _place_of(equation: JaxprEqn) -> str:
    """The line of the model's source that an equation comes from, in brackets; empty if unknown."""
    try:
        from jax._src import source_info_util

        frame = source_info_util.user_frame(equation.source_info.traceback)
    except (ImportError, AttributeError, TypeError):  # JAX's private module, which may change
        return ""
    return "" if frame is None else f" ({frame.file_name}, line {frame.start_line})"
