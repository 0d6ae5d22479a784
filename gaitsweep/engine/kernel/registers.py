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


def steps(
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
    last = _written_last(order, overwrites, uses)
    for at in [*last, *([] if flag is None else [flag])]:
        uses.setdefault(at, []).insert(0, len(order))
    allocation = _Allocation(program, uses, set(in_memory))
    for at in order:
        allocation.compute(at)
        if at in overwrites and at not in last:
            allocation.write(at)
        allocation.keep(at, registers)
    for at in last:
        allocation.load(at)
    for at in last:
        allocation.write(at)
    return allocation.steps


def _written_last(
    order: Sequence[int], overwrites: Mapping[int, Collection[int]], uses: Mapping[int, Sequence[int]]
) -> list[int]:
    """The nodes to write at the end: not computed here, or in the place of values that are needed later."""
    computed = {at: place for place, at in enumerate(order)}
    last = [at for at in overwrites if at not in computed]
    needed_at_end = set(last)
    for at, lost in overwrites.items():
        if at in computed and any(a in needed_at_end or uses.get(a, [-1])[0] > computed[at] for a in lost):
            last.append(at)
    return last


class _Allocation:
    """The actions so far, and the values that are in registers.

    Args:
        program: the program.
        uses: the places that still need each node, the next one last.
        memory: the nodes that can be loaded.
    """

    def __init__(self, program: Program, uses: dict[int, list[int]], memory: set[int]) -> None:
        self.steps: list[Step] = []
        self._program = program
        self._uses = uses
        self._memory = memory
        self._in_registers: set[int] = set()

    def load(self, at: int) -> None:
        """Load a value unless it is in a register; constants are part of instructions."""
        if at not in self._in_registers and self._program.nodes[at].op != "constant":
            self.steps.append(("load", at))
            self._in_registers.add(at)

    def compute(self, at: int) -> None:
        """Load the arguments of a node and compute it; arguments that are not needed again give way."""
        needed = arguments(self._program, at)
        for a in needed:
            self.load(a)
        for a in needed:
            self._uses[a].pop()
            if not self._uses[a]:
                self._in_registers.discard(a)
        self.steps.append(("compute", at))

    def write(self, at: int) -> None:
        """Write a value to its slots, from which it can be loaded later."""
        self.steps.append(("write", at))
        self._memory.add(at)

    def keep(self, at: int, registers: int | None) -> None:
        """Keep a computed value while it is needed; if there are too few registers, others give way."""
        if self._uses.get(at):
            self._in_registers.add(at)
        numbers = [a for a in self._in_registers if self._program.nodes[a].kind != "bool"]
        while registers is not None and len(numbers) > registers:
            farthest = max(numbers, key=self._distance)
            numbers.remove(farthest)
            self._in_registers.discard(farthest)
            if farthest not in self._memory:
                self._memory.add(farthest)
                self.steps.append(("store", farthest))

    def _distance(self, at: int) -> tuple[int, int]:
        """The place of the next use of a value, later for one in memory; of equal ones the last node."""
        return self._uses[at][-1] + (RELOAD_DISTANCE if at in self._memory else 0), at
