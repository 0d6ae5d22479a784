"""The choice of products and sums that become one instruction, which rounds once.

A compiler would choose by the surrounding operations: the same sum could be rounded differently in two places
of a program, and a row that shares a vector with a row at an event could have another result.
"""

from __future__ import annotations

import dataclasses

import jax

from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.program import Program

# The fused operations of b * c + a and a + b * c, and of b * c - a and a - b * c, with arguments b, c, a.
_FUSED = {"add": ("fma", "fma"), "sub": ("fms", "fnma")}


def contracted(chunk: Chunk) -> Chunk:
    """The same chunk with fused operations where a product is an argument of sums alone.

    Values that are computed once for a trajectory, or only at events, are not fused.
    """
    program = chunk.program
    wanted = [*chunk.attempt.values(), *chunk.plain.values(), chunk.unusual]
    wanted += [*chunk.polled, *chunk.quiet, chunk.eventful]
    needed = program.needed(wanted)
    fusable = _only_in_sums(program, needed) - {*chunk.shared, *wanted}
    rewritten: dict[int, int] = {}  # the node that replaces each node
    for at in needed:
        node = program.nodes[at]
        if program.steady[at] or not node.args:
            rewritten[at] = at
            continue
        args = tuple(rewritten[a] for a in node.args)
        op = node.op
        if op in _FUSED:
            for place in (1, 0):
                product = node.args[place]
                if product in fusable:
                    factors = program.nodes[product].args
                    op = _FUSED[op][place]
                    args = (*(rewritten[a] for a in factors), args[1 - place])
                    break
        rewritten[at] = program.write(op, *args)

    fields = "attempt", "plain", "unusual", "poll", "keep", "sample", "quiet", "eventful", "shared"
    replaced = {field: jax.tree.map(lambda at: rewritten[at], getattr(chunk, field)) for field in fields}
    return dataclasses.replace(chunk, **replaced)


def _only_in_sums(program: Program, needed: list[int]) -> set[int]:
    """The products that are arguments of sums and differences alone, and not constant along a trajectory."""
    products = {at for at in needed if program.nodes[at].op == "mul" and not program.steady[at]}
    for at in needed:
        if program.nodes[at].op not in _FUSED:
            products.difference_update(program.nodes[at].args)
    return products
