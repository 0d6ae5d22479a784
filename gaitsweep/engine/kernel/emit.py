"""A scalar program printed as lines of Python that Numba compiles, for one lane or one thread."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from gaitsweep.engine.kernel.operations import OPERATIONS
from gaitsweep.engine.kernel.program import Program

Read = Callable[[int], str]


def statements(
    program: Program, wanted: Sequence[int], given: Mapping[int, str], prefix: str = "v"
) -> tuple[list[str], list[str]]:
    """The lines that compute the nodes `wanted`, and an expression for each of them.

    Args:
        program: where the nodes are.
        wanted: nodes to compute.
        given: expressions of nodes that need no computing, such as inputs.
        prefix: of the variables' names.
    """
    lines: list[str] = []
    names: dict[int, str] = {}
    for at in _computed(program, wanted, given):
        node = program.nodes[at]
        if node.op == "constant":
            names[at] = literal(program, at)
            continue
        operation = OPERATIONS[node.op]
        args = [given[a] if a in given else names[a] for a in node.args]
        single = program.nodes[node.args[-1]].kind == "f32"
        source = operation.source.format(*args)
        if node.op in ("floor", "sqrt"):
            source = f"{node.op}{'32' if single else '64'}({args[0]})"
        names[at] = f"{prefix}{at}"
        lines.append(f"{names[at]} = {source}")
    return lines, [given[at] if at in given else names[at] for at in wanted]


def _computed(program: Program, wanted: Sequence[int], given: Mapping[int, str]) -> list[int]:
    """The nodes to compute, in order; what is given needs nothing of what it was made from."""
    reached: set[int] = set()
    waiting = [at for at in wanted if at not in given]
    while waiting:
        at = waiting.pop()
        if at not in reached:
            reached.add(at)
            waiting.extend(a for a in program.nodes[at].args if a not in given)
    return sorted(reached)


def used_inputs(program: Program, wanted: Sequence[int], given: Mapping[int, str] | None = None) -> list[int]:
    """The input nodes that `wanted` depend on, other than through what is given."""
    given = given or {}
    nodes = {at for at in wanted if at not in given} | set(_computed(program, wanted, given))
    return sorted(at for at in nodes if program.nodes[at].op == "input")


def steady_results(program: Program, wanted: Sequence[int]) -> list[int]:
    """The nodes that stay the same along a trajectory and that what changes along it reads.

    Inputs and constants are not among them: they cost nothing.
    """
    needed = program.needed(wanted)
    readers = {a for at in needed if not program.steady[at] for a in program.nodes[at].args}
    readers |= {at for at in wanted if program.steady[at]}
    return sorted(
        at for at in readers if program.steady[at] and program.nodes[at].op not in ("input", "constant")
    )


def literal(program: Program, at: int) -> str:
    """A constant as source, typed where its kind asks for it."""
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
