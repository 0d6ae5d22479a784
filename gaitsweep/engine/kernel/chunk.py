"""A chunk of attempts as one scalar program: what an attempt changes, what a poll at it changes and keeps.

All that a trajectory is stands in numbered slots, first what is held (parameters), then the carry, then the
record. Slots after those are the kernel's own: what is worked out once, and a row that waits to be kept.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np

from gaitsweep.engine.kernel.emit import steady_results
from gaitsweep.engine.kernel.program import Program
from gaitsweep.engine.kernel.trace import Nodes, Tracer
from gaitsweep.engine.sweep.lane import OneLane


@dataclasses.dataclass(frozen=True)
class Leaf:
    """An array of a trajectory: its first slot and its shape."""

    first: int
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))


@dataclasses.dataclass(frozen=True)
class Chunk:
    """The program and its slots.

    `held`, `carry`, `record` the engine's trees, a `Leaf` for each array; `attempt` and `poll` the nodes that
    slots get, by slot; `keep` the node that says whether `row` (nodes) is kept; `steady` nodes worked out
    once, by slot.
    """

    program: Program
    held: Any
    carry: Any
    record: Any
    attempt: dict[int, int]
    poll: dict[int, int]
    keep: int
    row: list[int]
    steady: dict[int, int]
    n_slots: int

    @property
    def width(self) -> int:
        return len(self.row)

    @property
    def first_of_carry(self) -> int:
        return min(leaf.first for leaf in jax.tree.leaves(self.carry))

    @property
    def first_of_record(self) -> int:
        return min(leaf.first for leaf in jax.tree.leaves(self.record))

    def slot_of(self, at: int) -> int:
        """The slot that an input node stands for."""
        value = self.program.nodes[at].value
        assert value is not None
        return int(value)


def chunk_of(lane: OneLane, values: Any, starts: Any) -> Chunk:
    """The program of one trajectory's chunk.

    Args:
        lane: the engine's functions of one trajectory.
        values, starts: shapes and types of a row's parameters and starts.

    Raises:
        UnsupportedError: the model computes with what a scalar kernel cannot express.
    """
    held, carry, record, _, _ = jax.eval_shape(lane.open, values, starts)
    program = Program()
    tracer = Tracer(program)
    count = 0

    def place(tree: Any, steady: bool) -> tuple[Any, list[Nodes]]:
        nonlocal count
        nodes = tracer.inputs(tree, count, steady=steady)
        leaves = []
        for array in nodes:
            leaves.append(Leaf(count, array.shape))
            count += array.size
        return jax.tree.unflatten(jax.tree.structure(tree), leaves), nodes

    held_leaves, held_nodes = place(held, True)
    carry_leaves, carry_nodes = place(carry, False)
    record_leaves, record_nodes = place(record, False)

    def changes(leaves: Any, given: list[Nodes]) -> dict[int, int]:
        slots: dict[int, int] = {}
        for leaf, nodes in zip(jax.tree.leaves(leaves), given, strict=True):
            for i, at in enumerate(nodes.ravel().tolist()):
                if not (program.nodes[at].op == "input" and program.nodes[at].value == leaf.first + i):
                    slots[leaf.first + i] = at
        return slots

    given = tracer.read(jax.make_jaxpr(lane.attempt)(held, carry), [*held_nodes, *carry_nodes])
    attempt = changes(carry_leaves, given)
    polled = jax.make_jaxpr(lane.poll)(held, carry, record)
    given = tracer.read(polled, [*held_nodes, *carry_nodes, *record_nodes])
    poll = changes((carry_leaves, record_leaves), given[:-2])
    row, keep = given[-2].ravel().tolist(), int(given[-1])
    steady = steady_results(program, [*attempt.values(), *poll.values(), *row, keep])
    return Chunk(
        program=program,
        held=held_leaves,
        carry=carry_leaves,
        record=record_leaves,
        attempt=attempt,
        poll=poll,
        keep=keep,
        row=row,
        steady={count + i: at for i, at in enumerate(steady)},
        n_slots=count + len(steady),
    )
