"""Allocation of a straight-line program's values to a CPU's registers, and their reloads.

A compiler keeps loaded values in registers, and spills many values of a long program. Here the value whose
next use is farthest away gives way (Belady's rule): it is loaded again from its place in memory, or stored
once if it has none.

Source: L. A. Belady, "A study of replacement algorithms for a virtual-storage computer", IBM Systems
Journal 5 (1966), 78-101.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Literal

from gaitsweep.engine.kernel.program import Program
from gaitsweep.engine.kernel.schedule import arguments

# An action on a node: load its value; compute it; store it, to be loaded later; write it to its slots.
Step = tuple[Literal["load", "compute", "store", "write"], int]

# A value that is in memory, and so need not be stored, counts as needed this many statements later.
RELOAD_DISTANCE = 60


def steps(  # noqa: C901 - one pass over the program, whose cases share all of its state
    program: Program,
    order: Sequence[int],
    in_memory: Collection[int],
    overwrites: Mapping[int, Collection[int]],
    registers: int | None,
    flag: int | None = None,
) -> list[Step]:
    """The nodes `order` computed with few values in registers at a time, and written to their slots.

    Flags do not count, since processors with many vector registers have others for them.

    Args:
        program: the program.
        order: the nodes to compute.
        in_memory: the nodes that can be loaded, until they are overwritten.
        overwrites: the nodes to write, each with the nodes of `in_memory` whose places it takes.
        registers: values in registers at a time; None for all.
        flag: a node that is needed at the end, but not written.
    """
    uses: dict[int, list[int]] = {}  # the places in `order` that need a node, the first one last
    for place in range(len(order) - 1, -1, -1):
        for a in arguments(program, order[place]):
            uses.setdefault(a, []).append(place)
    computed = {at: place for place, at in enumerate(order)}
    # written at the end: nodes that are not computed here, or overwrite values that are needed later
    last = [at for at in overwrites if at not in computed]
    needed_at_end = set(last)
    for at, lost in overwrites.items():
        if at in computed and any(a in needed_at_end or uses.get(a, [-1])[0] > computed[at] for a in lost):
            last.append(at)
    for at in [*last, *([] if flag is None else [flag])]:
        uses.setdefault(at, []).insert(0, len(order))
    memory = set(in_memory)
    at_hand = set()
    sequence: list[Step] = []

    def load(at: int) -> None:
        if at not in at_hand and program.nodes[at].op != "constant":
            sequence.append(("load", at))
            at_hand.add(at)

    for at in order:
        needed = arguments(program, at)
        for a in needed:
            load(a)
        for a in needed:
            uses[a].pop()
            if not uses[a]:
                at_hand.discard(a)
        sequence.append(("compute", at))
        if at in overwrites and at not in last:
            sequence.append(("write", at))
            memory.add(at)
        if uses.get(at):
            at_hand.add(at)
        in_registers = [a for a in at_hand if program.nodes[a].kind != "bool"]
        while registers is not None and len(in_registers) > registers:
            farthest = max(
                in_registers, key=lambda a: (uses[a][-1] + (RELOAD_DISTANCE if a in memory else 0), a)
            )
            in_registers.remove(farthest)
            at_hand.discard(farthest)
            if farthest not in memory:
                memory.add(farthest)
                sequence.append(("store", farthest))
    for at in last:
        load(at)
    return [*sequence, *(("write", at) for at in last)]
