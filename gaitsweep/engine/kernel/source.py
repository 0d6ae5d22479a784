"""The statements of a scalar program in the language of a target."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Protocol

from gaitsweep.engine.kernel.operations import OPERATIONS, Operation
from gaitsweep.engine.kernel.program import Kind, Program, Value


class Language(Protocol):
    """How a language writes the parts of a program: `python_source`, `c_source`."""

    def expression(self, operation: Operation, args: Sequence[str], bits: Literal[32, 64]) -> str:
        """An operation on arguments, the last of which has so many bits."""
        ...

    def definition(self, kind: Kind, name: str, expression: str) -> str:
        """The line that gives a name to a value."""
        ...

    def literal(self, value: Value, kind: Kind) -> str:
        """A constant, in brackets where it needs them as an argument."""
        ...


def statements(
    language: Language, program: Program, wanted: Sequence[int], given: Mapping[int, str]
) -> tuple[list[str], list[str]]:
    """The lines that compute the nodes `wanted`, and an expression for each of these nodes.

    Args:
        language: the language of the lines.
        program: the program.
        wanted: the nodes to compute.
        given: expressions of nodes that are available already, such as inputs.
    """
    lines: list[str] = []
    names: dict[int, str] = {}
    for at in program.needed(wanted, given):
        if at in given:
            continue
        node = program.nodes[at]
        if node.op == "constant":
            assert node.value is not None
            names[at] = language.literal(node.value, node.kind)
            continue
        args = [given[a] if a in given else names[a] for a in node.args]
        bits = 32 if program.nodes[node.args[-1]].kind == "f32" else 64
        names[at] = f"v{at}"
        expression = language.expression(OPERATIONS[node.op], args, bits)
        lines.append(language.definition(node.kind, names[at], expression))
    return lines, [given[at] if at in given else names[at] for at in wanted]
