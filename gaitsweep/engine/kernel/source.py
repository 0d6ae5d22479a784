"""The statements of a scalar program in the language of a target."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Protocol

from gaitsweep.engine.kernel.operations import OPERATIONS, Operation
from gaitsweep.engine.kernel.program import Kind, Program, Value


class Language(Protocol):
    """The syntax of a target language: `python_source`, `c_source`."""

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
    language: Language,
    program: Program,
    wanted: Sequence[int],
    known: Mapping[int, str],
    order: Sequence[int] | None = None,
) -> tuple[list[str], list[str]]:
    """The lines that compute the nodes `wanted`, and an expression for each of these nodes.

    Args:
        language: the language of the lines.
        program: the program.
        wanted: the nodes to compute.
        known: expressions of nodes that are available already, such as inputs.
        order: the nodes to compute, with all that they need, in the order of their lines; by default that
            of the program.
    """
    names = dict(known)
    lines = name_all(language, program, program.needed(wanted, known) if order is None else order, names)
    return lines, [names[at] if at in names else _literal(language, program, at) for at in wanted]


def name_all(language: Language, program: Program, order: Sequence[int], names: dict[int, str]) -> list[str]:
    """The lines that compute the nodes `order`, in this order; `names` gets an expression of each."""
    lines: list[str] = []
    for at in order:
        node = program.nodes[at]
        if at in names:
            continue
        if node.op == "constant":
            names[at] = _literal(language, program, at)
            continue
        for a in node.args:
            if a not in names:
                names[a] = _literal(language, program, a)
        bits = 32 if program.nodes[node.args[-1]].kind == "f32" else 64
        names[at] = f"v{at}"
        expression = language.expression(OPERATIONS[node.op], [names[a] for a in node.args], bits)
        lines.append(language.definition(node.kind, names[at], expression))
    return lines


def _literal(language: Language, program: Program, at: int) -> str:
    node = program.nodes[at]
    assert node.value is not None
    return language.literal(node.value, node.kind)
