"""A scalar program: an acyclic graph of scalar operations without duplicates."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Container, Hashable, Iterable, Mapping, Sequence

import numpy as np

from gaitsweep.engine.kernel.operations import OPERATIONS, Kind, Operation
from gaitsweep.engine.kernel.simplify import simplified

Value = float | int | bool

# Integers are represented by float64, exact up to 2^53, so that they share vector registers with floats.
_NUMPY: dict[str, type] = {"f64": np.float64, "f32": np.float32, "int": np.float64, "bool": np.bool_}


@dataclasses.dataclass(frozen=True, slots=True)
class Node:
    """One scalar operation.

    `op` is a name in `OPERATIONS`, "constant" or "input"; `args` are the argument nodes; `value` is the value
    of a constant, or the number of an input.
    """

    op: str
    args: tuple[int, ...]
    kind: Kind
    value: Value | None = None


class Program:
    """Nodes in topological order; a node is identified by its index, the argument `at`.

    Equal operations share one node, and operations are simplified (`gaitsweep.engine.kernel.simplify`),
    unless `simplify` is False: a product with 0 becomes 0, also where the other factor would be NaN, and so
    does x - x.
    """

    def __init__(self, *, simplify: bool = True) -> None:
        self._simplify = simplify
        self.nodes: list[Node] = []
        # constant along a trajectory: constants, steady inputs, and functions of these
        self.steady: list[bool] = []
        self.usual: dict[int, bool] = {}  # conditions that nearly always have this value
        self._known: dict[tuple[Hashable, ...], int] = {}

    def copy(self) -> Program:
        """A program with the same nodes, which may be extended on its own."""
        copy = Program(simplify=self._simplify)
        copy.nodes = self.nodes.copy()
        copy.steady = self.steady.copy()
        copy.usual = self.usual.copy()
        copy._known = self._known.copy()
        return copy

    def constant(self, value: Value, kind: Kind) -> int:
        """The node of a constant."""
        typed = _NUMPY[kind](value).item()
        # by representation: 0.0 and -0.0 differ, NaN equals itself
        key = ("constant", kind, repr(typed))
        return self._add(key, Node("constant", (), kind, typed), steady=True)

    def input(self, number: int, kind: Kind, *, steady: bool = False) -> int:
        """The node of an input; `steady`: it is constant along a trajectory."""
        return self._add(("input", number), Node("input", (), kind, number), steady=steady)

    def apply(self, op: str, *args: int) -> int:
        """The node of an operation on nodes, simplified."""
        simpler = simplified(self, op, args) if self._simplify else self.evaluated(op, args)
        return self.write(op, *args) if simpler is None else simpler

    def write(self, op: str, *args: int) -> int:
        """The node of an operation on nodes, without simplification."""
        node = Node(op, args, self._kind(OPERATIONS[op], args))
        return self._add((op, args), node, steady=all(self.steady[a] for a in args))

    def _kind(self, operation: Operation, args: Sequence[int]) -> Kind:
        return self.nodes[args[-1]].kind if operation.kind == "same" else operation.kind

    def value(self, at: int) -> Value | None:
        """The value of a constant; None for another node."""
        node = self.nodes[at]
        return node.value if node.op == "constant" else None

    def is_input(self, at: int, number: int) -> bool:
        """Whether a node is the input of this number."""
        return self.nodes[at].op == "input" and self.nodes[at].value == number

    def evaluated(self, op: str, args: Sequence[int]) -> int | None:
        """The constant result of an operation on constants, in the arithmetic of their kind; else None."""
        constants = []
        for a in args:
            node = self.nodes[a]
            if node.op != "constant":  # of most operations, so this comes first
                return None
            constants.append(node)
        operation = OPERATIONS[op]
        typed = [_NUMPY[node.kind](node.value) for node in constants]
        with np.errstate(all="ignore"):
            result = operation.evaluate(*typed)
        kind = self._kind(operation, args)
        if kind == "int" and not math.isfinite(float(result)):
            return None
        return self.constant(result, kind)

    def needed(self, wanted: Iterable[int], known: Container[int] = ()) -> list[int]:
        """The nodes on which others depend, in order, these included.

        Args:
            wanted: the nodes.
            known: nodes whose arguments are left out.
        """
        reached: set[int] = set()
        waiting = list(wanted)
        while waiting:
            at = waiting.pop()
            if at not in reached:
                reached.add(at)
                if at not in known:
                    waiting.extend(self.nodes[at].args)
        return sorted(reached)

    def likely(self, wanted: Sequence[int]) -> tuple[list[int], int]:
        """Simpler nodes that hold where all conditions have their usual value.

        Returns:
            The nodes that replace `wanted`, and the node of the flag that a condition is unusual.
        """
        settled: dict[int, int] = {}  # flags, where the conditions before them have their usual value
        exception = self.constant(False, "bool")
        for at in self.needed(wanted):
            if self.nodes[at].kind == "bool":
                flag = self._with(at, settled)
                usual = self.usual.get(at)
                if usual is not None:
                    exception = self.apply("or", exception, self.apply("not", flag) if usual else flag)
                    flag = self.constant(usual, "bool")
                settled[at] = flag
        # numbers that the conditions need are computed anyway
        replaced = {at: at for at in self.needed([exception]) if self.nodes[at].kind != "bool"}
        for at in self.needed(wanted):
            if at in self.usual:
                replaced[at] = settled[at]
            replaced.setdefault(at, self._with(at, replaced))
        return [replaced[at] for at in wanted], exception

    def _with(self, at: int, replaced: Mapping[int, int]) -> int:
        """A node with its arguments replaced where there is a replacement."""
        node = self.nodes[at]
        args = tuple(replaced.get(a, a) for a in node.args)
        return at if args == node.args else self.apply(node.op, *args)

    def _add(self, key: tuple[Hashable, ...], node: Node, *, steady: bool) -> int:
        """The index of a node, which is added unless there is an equal one."""
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(node)
            self.steady.append(steady)
        return self._known[key]
