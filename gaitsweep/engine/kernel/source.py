"""The statements of a scalar program in the language of a target."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Literal

from gaitsweep.engine.kernel.operations import OPERATIONS, Operation
from gaitsweep.engine.kernel.program import Kind, Program, Value


@dataclasses.dataclass(frozen=True)
class Language:
    """The syntax of a target language; in memory all kinds of values are float64.

    Attributes:
        field: the field of `Operation` that has the source of an operation.
        line: the line that defines {name} as {expression}, of the type {type}.
        types: names of types by kind, if lines have them.
        flags: the literals of false and true.
        nan, infinity: the literals of NaN and of infinity.
        single: the conversion of {} to float32.
        number: the number 1 or 0 for a flag {}.
    """

    field: Literal["python", "c"]
    line: str
    types: Mapping[Kind, str]
    flags: tuple[str, str]
    nan: str
    infinity: str
    single: str
    number: str

    def expression(self, operation: Operation, args: Sequence[str], bits: Literal[32, 64]) -> str:
        """The source of an operation.

        Args:
            operation: the operation.
            args: expressions of its arguments.
            bits: the width of the last argument.
        """
        return getattr(operation, self.field).format(*args, bits=bits, f="f" if bits == 32 else "")

    def definition(self, kind: Kind, name: str, expression: str) -> str:
        """The line that gives a name to a value.

        Args:
            kind: the kind of the value.
            name: the name.
            expression: the source of the value.
        """
        return self.line.format(type=self.types.get(kind), name=name, expression=expression)

    def literal(self, value: Value, kind: Kind) -> str:
        """A constant, in brackets where it needs them as an argument."""
        if kind == "bool":
            return self.flags[bool(value)]
        number = float(value)
        text = repr(number)
        if math.isnan(number):
            text = self.nan
        elif math.isinf(number):
            text = self.infinity if number > 0 else f"-{self.infinity}"
        if kind == "f32":
            return self.single.format(text)
        return f"({text})" if text.startswith("-") else text

    def loaded(self, kind: Kind, place: str) -> str:
        """The expression that loads a value of a kind from memory."""
        if kind == "bool":
            return f"{place} != 0.0"
        return self.single.format(place) if kind == "f32" else place

    def stored(self, kind: Kind, value: str) -> str:
        """The expression that is stored in memory for a value of a kind."""
        return self.number.format(value) if kind == "bool" else value


# Python for one lane of a CPU; `llvm_code` compiles it to LLVM.
PYTHON = Language(
    field="python",
    line="{name} = {expression}",
    types={},
    flags=("False", "True"),
    nan="nan",
    infinity="inf",
    single="float32({})",
    number="1.0 if {} else 0.0",
)
# C for one thread of an NVIDIA GPU; INFINITE and NOT_A_NUMBER are defined at the head of its source.
C = Language(
    field="c",
    line="const {type} {name} = {expression};",
    types={"f64": "double", "int": "double", "f32": "float", "bool": "bool"},
    flags=("false", "true"),
    nan="NOT_A_NUMBER",
    infinity="INFINITE",
    single="((float){})",
    number="{} ? 1.0 : 0.0",
)


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


def c_structure(name: str, members: Mapping[str, Kind]) -> str:
    """The definition of a C structure with these members; one without any has a member that is not used."""
    lines = [f"    {C.types[kind]} {member};" for member, kind in members.items()] or ["    double none;"]
    return "\n".join([f"struct {name} {{", *lines, "};\n"])


def c_function(head: str, lines: Sequence[str]) -> str:
    """The definition of a C function from its head, without braces, and the lines of its body."""
    return "\n".join([f"{head} {{", *(f"    {line}" for line in lines), "}\n"])


def name_all(language: Language, program: Program, order: Sequence[int], names: dict[int, str]) -> list[str]:
    """The lines that compute some nodes.

    Args:
        language: the language of the lines.
        program: the program.
        order: the nodes, each after its arguments.
        names: expressions of nodes that are available; those of `order` are added.
    """
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
    """The literal of a constant node."""
    node = program.nodes[at]
    assert node.value is not None
    return language.literal(node.value, node.kind)
