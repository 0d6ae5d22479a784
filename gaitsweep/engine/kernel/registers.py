"""Which values of a straight-line program stay in a CPU's registers, and which are loaded again.

A compiler loads what it needs early and keeps it, so that it spills many values of a long program. Here the
statements come in depth-first order, and the value whose next use is farthest away gives way (Belady's rule):
it is loaded again from where it is in memory already, or stored once if it is nowhere.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Literal

from gaitsweep.engine.kernel.program import Program

# load a value; compute it; store it to be loaded later; write it to its slots
Step = tuple[Literal["load", "compute", "store", "write"], int]

# A value that is in memory already gives way before one whose next use is so many statements later.
CHEAP = 60


def depth_first(program: Program, wanted: Iterable[int], given: Collection[int]) -> list[int]:
    """The nodes, neither `given` nor constants, that `wanted` need, each with its arguments just before it."""
    placed: dict[int, None] = {}
    waiting = [(at, False) for at in reversed(list(wanted))]
    while waiting:
        at, ready = waiting.pop()
        if ready:
            placed[at] = None
        elif at not in placed and at not in given and program.nodes[at].op not in ("constant", "input"):
            waiting.append((at, True))
            waiting.extend((a, False) for a in reversed(program.nodes[at].args))
    return list(placed)


def steps(
    program: Program,
    order: Sequence[int],
    in_memory: Collection[int],
    overwrites: Mapping[int, Collection[int]],
    registers: int,
    *,
    flags: bool,
) -> list[Step]:
    """The nodes `order` computed with few registers, and written where they belong.

    Args:
        program: the program.
        order: the nodes to compute.
        in_memory: nodes that can be loaded, until they are overwritten.
        overwrites: the nodes to write, each with those that cannot be loaded from then on.
        registers: values that may be at hand at a time.
        flags: whether flags need such registers too.
    """
    uses = _uses(program, order)
    end = len(order)
    place_of = {at: place for place, at in enumerate(order)}

    def later(at: int) -> bool:
        """Whether what this node overwrites is needed after it is computed."""
        return any(uses[a][0] > place_of[at] for a in overwrites[at] if a in uses)

    # what is in memory already is written at the end
    last = [at for at in overwrites if at not in place_of]
    for at in last:
        uses.setdefault(at, []).insert(0, end)
    pending = [at for at in overwrites if at in place_of and later(at)]
    for at in pending:
        uses.setdefault(at, []).insert(0, end)
    last += pending
    memory, at_hand = set(in_memory), set()
    found: list[Step] = []

    def load(at: int) -> None:
        if at not in at_hand and program.nodes[at].op != "constant":
            found.append(("load", at))
            at_hand.add(at)

    for place, at in enumerate(order):
        arguments = _arguments(program, at)
        for a in arguments:
            load(a)
        for a in arguments:
            uses[a].pop()
            if not uses[a]:
                at_hand.discard(a)
        found.append(("compute", at))
        if at in overwrites and at not in last:
            found.append(("write", at))
            memory.add(at)
        if uses.get(at):
            at_hand.add(at)
        held = [a for a in at_hand if flags or program.nodes[a].kind != "bool"]
        while len(held) > registers:
            farthest = max(held, key=lambda a: (uses[a][-1] + (CHEAP if a in memory else 0), a))
            held.remove(farthest)
            at_hand.discard(farthest)
            if farthest not in memory:
                memory.add(farthest)
                found.append(("store", farthest))
    for at in last:
        load(at)
    return [*found, *(("write", at) for at in last)]


def _uses(program: Program, order: Sequence[int]) -> dict[int, list[int]]:
    """The places in `order` that need each node, the first one last."""
    uses: dict[int, list[int]] = {}
    for place in range(len(order) - 1, -1, -1):
        for a in _arguments(program, order[place]):
            uses.setdefault(a, []).append(place)
    return uses


def _arguments(program: Program, at: int) -> list[int]:
    """The different arguments of a node that are not constants."""
    return [a for a in dict.fromkeys(program.nodes[at].args) if program.nodes[a].op != "constant"]
