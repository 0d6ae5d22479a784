"""A scalar program: a graph of scalar operations without loops, each written once."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Container, Iterable, Sequence
from typing import Literal

import numpy as np

from gaitsweep.engine.kernel.fold import simplified
from gaitsweep.engine.kernel.operations import OPERATIONS

Kind = Literal["f64", "f32", "int", "bool"]
Value = float | int | bool

# Whole numbers are carried as float64, exact up to 2^53, so that they share vector registers with the rest.
_NUMPY: dict[str, type] = {"f64": np.float64, "f32": np.float32, "int": np.float64, "bool": np.bool_}


@dataclasses.dataclass(frozen=True, slots=True)
class Node:
    """One scalar operation.

    `op` a name in `OPERATIONS`, or "constant" or "input"; `args` the nodes that it reads; `value` of a
    constant, or an input's number.
    """

    op: str
    args: tuple[int, ...]
    kind: Kind
    value: Value | None = None


class Program:
    """Nodes in the order in which they can be computed; a node is known by its place.

    An operation that has been written before is not written again, and what can be worked out now is:
    see `gaitsweep.engine.kernel.fold`.
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.steady: list[bool] = []  # known before the time loop: constants, steady inputs, what follows
        self._known: dict[tuple, int] = {}

    def constant(self, value: Value, kind: Kind) -> int:
        typed = _NUMPY[kind](value).item()
        # by its bits: 0.0 and -0.0 differ, NaN is itself
        key = ("constant", kind, repr(typed))
        return self._add(key, Node("constant", (), kind, typed), True)

    def input(self, number: int, kind: Kind, *, steady: bool = False) -> int:
        return self._add(("input", number), Node("input", (), kind, number), steady)

    def apply(self, op: str, *args: int) -> int:
        """The node of an operation on nodes: a new one, an old one, or a constant."""
        found = simplified(self, op, args)
        return self.write(op, *args) if found is None else found

    def write(self, op: str, *args: int) -> int:
        """The node of an operation as it stands, without simplification."""
        kind = OPERATIONS[op].kind
        chosen: Kind = self.nodes[args[-1]].kind if kind == "same" else kind  # type: ignore[assignment]
        node = Node(op, args, chosen)
        return self._add((op, args), node, all(self.steady[a] for a in args))

    def value(self, at: int) -> Value | None:
        """A constant's value; None for any other node."""
        node = self.nodes[at]
        return node.value if node.op == "constant" else None

    def evaluated(self, op: str, args: Sequence[int]) -> int | None:
        """The constant that an operation on constants gives, in the arithmetic of its kind."""
        operation = OPERATIONS[op]
        values = [self.value(a) for a in args]
        if any(value is None for value in values):
            return None
        typed = [_NUMPY[self.nodes[a].kind](v) for a, v in zip(args, values, strict=True)]
        with np.errstate(all="ignore"):
            result = operation.evaluate(*typed)
        kind: Kind = self.nodes[args[-1]].kind if operation.kind == "same" else operation.kind  # type: ignore[assignment]
        if kind == "int" and not math.isfinite(float(result)):
            return None
        return self.constant(result, kind)

    def needed(self, wanted: Iterable[int], given: Container[int] = ()) -> list[int]:
        """The nodes on which `wanted` depend, themselves included, in order; none behind what is `given`."""
        reached: set[int] = set()
        waiting = list(wanted)
        while waiting:
            at = waiting.pop()
            if at not in reached:
                reached.add(at)
                if at not in given:
                    waiting.extend(self.nodes[at].args)
        return sorted(reached)

    def _add(self, key: tuple, node: Node, steady: bool) -> int:
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(node)
            self.steady.append(steady)
        return self._known[key]
