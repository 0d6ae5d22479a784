"""C source of a scalar program, for one thread of an NVIDIA GPU."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

from gaitsweep.engine.kernel.operations import Operation
from gaitsweep.engine.kernel.program import Kind, Value

TYPES: dict[Kind, str] = {"f64": "double", "int": "double", "f32": "float", "bool": "bool"}


class C:
    """C as a `Language`; `INFINITE` and `NOT_A_NUMBER` are defined at the head of the source."""

    def expression(self, operation: Operation, args: Sequence[str], bits: Literal[32, 64]) -> str:
        return operation.c.format(*args, f="f" if bits == 32 else "")

    def definition(self, kind: Kind, name: str, expression: str) -> str:
        return f"const {TYPES[kind]} {name} = {expression};"

    def literal(self, value: Value, kind: Kind) -> str:
        if kind == "bool":
            return "true" if value else "false"
        number = float(value)
        cast = "(float)" if kind == "f32" else ""
        if math.isnan(number):
            return f"({cast}NOT_A_NUMBER)"
        if math.isinf(number):
            return f"({cast}INFINITE)" if number > 0 else f"(-{cast}INFINITE)"
        text = repr(number) + ("f" if kind == "f32" else "")
        return f"({text})" if text.startswith("-") else text


def loaded(kind: Kind, place: str) -> str:
    """The expression that loads a value of a kind from memory, where all kinds are float64."""
    if kind == "bool":
        return f"{place} != 0.0"
    return f"(float){place}" if kind == "f32" else place


def stored(kind: Kind, value: str) -> str:
    """The expression that is stored in memory for a value of a kind."""
    return f"{value} ? 1.0 : 0.0" if kind == "bool" else value


def structure(name: str, members: Mapping[str, Kind]) -> str:
    """The definition of a structure with these members; one without any has a member that is not used."""
    lines = [f"    {TYPES[kind]} {member};" for member, kind in members.items()] or ["    double none;"]
    return "\n".join([f"struct {name} {{", *lines, "};\n"])


def function(head: str, lines: Sequence[str]) -> str:
    """The definition of a function from its head, without braces, and the lines of its body."""
    return "\n".join([f"{head} {{", *(f"    {line}" for line in lines), "}\n"])
