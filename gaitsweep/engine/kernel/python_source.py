"""Python source of a scalar program, for one lane or one thread; `llvm_code` compiles it to LLVM."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from gaitsweep.engine.kernel.operations import OPERATIONS
from gaitsweep.engine.kernel.program import Kind, Program


def statements(
    program: Program, wanted: Sequence[int], given: Mapping[int, str]
) -> tuple[list[str], list[str]]:
    """The lines that compute the nodes `wanted`, and an expression for each of these nodes.

    Args:
        program: the program.
        wanted: the nodes to compute.
        given: expressions of nodes that are available already, such as inputs.
    """
    names = dict(given)
    lines = name_all(program, wanted, names)
    return lines, [names[at] for at in wanted]


def name_all(program: Program, wanted: Iterable[int], names: dict[int, str]) -> list[str]:
    """The lines that compute the nodes `wanted`; an expression of each computed node is added to `names`."""
    lines: list[str] = []
    for at in program.needed(wanted, names):
        if at in names:
            continue
        node = program.nodes[at]
        if node.op == "constant":
            names[at] = literal(program, at)
            continue
        operation = OPERATIONS[node.op]
        args = [names[a] for a in node.args]
        bits = 32 if program.nodes[node.args[-1]].kind == "f32" else 64
        names[at] = f"v{at}"
        lines.append(f"{names[at]} = {operation.source.format(*args, bits=bits)}")
    return lines


def loaded(kind: Kind, place: str) -> str:
    """The expression that loads a value of a kind from memory, where all kinds are float64."""
    if kind == "bool":
        return f"{place} != 0.0"
    return f"float32({place})" if kind == "f32" else place


def stored(kind: Kind, value: str) -> str:
    """The expression that is stored in memory for a value of a kind."""
    return f"1.0 if {value} else 0.0" if kind == "bool" else value


def steady_results(program: Program, wanted: Sequence[int]) -> list[int]:
    """The nodes that are constant along a trajectory and are arguments of nodes that are not.

    Inputs and constants are left out, since they need no computation.
    """
    needed = program.needed(wanted)
    readers = {a for at in needed if not program.steady[at] for a in program.nodes[at].args}
    readers |= {at for at in wanted if program.steady[at]}
    return sorted(
        at for at in readers if program.steady[at] and program.nodes[at].op not in ("input", "constant")
    )


def literal(program: Program, at: int) -> str:
    """A constant as source, with its type if it is float32."""
    node = program.nodes[at]
    if node.kind == "bool":
        return str(bool(node.value))
    value = float(node.value)  # type: ignore[arg-type]
    if math.isnan(value):
        text = "nan"
    elif math.isinf(value):
        text = "inf" if value > 0 else "-inf"
    else:
        text = repr(value)
    if node.kind == "f32":
        return f"float32({text})"
    return f"({text})" if text.startswith("-") else text
