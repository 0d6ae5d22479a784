"""The scalar program of a chunk: the changes by an attempt, and the changes and the sample of a poll.

A trajectory is stored in numbered slots: first its constants (parameters), then the carry, then the record.
Later slots belong to the kernel: values that are computed once, and a sample that may be kept.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import jax

from gaitsweep.contract import Model
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.kernel.program import Program
from gaitsweep.engine.kernel.trace import Nodes, Tracer
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.sweep.lane import RowDrive, row_attempt

_EXACT = ("constant", "input", "select")  # operations that do not round


@dataclasses.dataclass(frozen=True)
class Leaf:
    """An array of a trajectory: its first slot and its shape."""

    first: int
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        """The number of its slots."""
        return math.prod(self.shape)


@dataclasses.dataclass(frozen=True)
class TracedAttempt:
    """The program of an attempt and its slots, which do not depend on the recorder.

    Attributes:
        program: the program.
        constants, carry: the engine's pytrees with a `Leaf` for each array.
        inputs: the input nodes of each of these arrays.
        attempt: the nodes that an attempt writes, by slot.
        plain: simpler nodes, by slot, for a plain attempt, in which no condition holds that is seldom true.
        unusual: the node of the flag that one of these conditions holds.
        n_slots: the number of slots.
    """

    program: Program
    constants: Any
    carry: Any
    inputs: list[Nodes]
    attempt: dict[int, int]
    plain: dict[int, int]
    unusual: int
    n_slots: int


@dataclasses.dataclass(frozen=True)
class Chunk(TracedAttempt):
    """The program of a chunk and its slots.

    Attributes:
        record: the record, with a `Leaf` for each array.
        poll: the nodes that a poll writes, by slot.
        keep: the node that decides whether the sample is kept.
        sample: the nodes of the sample.
        quiet: simpler nodes in place of `polled` for a poll in which the node `eventful` is false.
        eventful: the node of that flag.
        steady: the nodes that are computed once for a trajectory, by slot.
        shared: nodes that are constant along plain attempts.
    """

    record: Any
    poll: dict[int, int]
    keep: int
    sample: list[int]
    quiet: list[int]
    eventful: int
    steady: dict[int, int]
    shared: list[int]

    @property
    def width(self) -> int:
        """The number of numbers in a sample."""
        return len(self.sample)

    @property
    def polled(self) -> list[int]:
        """The nodes of `poll`, of `sample`, and `keep`."""
        return [*self.poll.values(), *self.sample, self.keep]

    @property
    def changed(self) -> dict[int, int]:
        """The nodes of `plain` whose slots do not have their values already."""
        program = self.program
        # a plain attempt has the usual values of conditions, so what such an equality compares is equal
        equal = [
            program.nodes[at].args
            for at in program.needed(self.attempt.values())
            if program.usual.get(at) and program.nodes[at].op == "eq"
        ]

        def is_unchanged(slot: int, at: int) -> bool:
            if program.is_input(at, slot):
                return True
            return any(at in pair and any(program.is_input(a, slot) for a in pair) for pair in equal)

        return {slot: at for slot, at in self.plain.items() if not is_unchanged(slot, at)}

    @property
    def first_of_carry(self) -> int:
        """The first slot of the carry."""
        return min(leaf.first for leaf in jax.tree.leaves(self.carry))

    @property
    def first_of_record(self) -> int:
        """The first slot of the record."""
        return min(leaf.first for leaf in jax.tree.leaves(self.record))

    def slot_of(self, at: int) -> int:
        """The slot of an input node."""
        value = self.program.nodes[at].value
        assert value is not None
        return int(value)


class TracedLane(Protocol):
    """The functions of one trajectory from which a chunk is made; `OneLane` describes them."""

    @property
    def deciding(self) -> tuple[Model, ResolvedNumerics, RowDrive | None, int] | None:
        """The arguments of `row_attempt` if `attempt` is the attempt of rows, else None."""
        ...

    @property
    def open(self) -> Callable[..., tuple[Any, Any, Any, Any, Any]]:
        """The function that opens a trajectory."""
        ...

    def attempt(self, constants: Any, carry: Any, /) -> Any: ...

    def poll(self, constants: Any, carry: Any, record: Any, /) -> tuple[Any, Any, Any, Any]: ...


def chunk_of(lane: TracedLane, *row: Any) -> Chunk:
    """The scalar program of a chunk of one trajectory.

    Args:
        lane: the functions of one trajectory.
        row: shapes and dtypes of the arguments of its `open`.

    Raises:
        UnsupportedError: the model uses an operation that the scalar kernel does not have.
    """
    constants, carry, record, _, _ = jax.eval_shape(lane.open, *row)
    traced = _traced(lane, constants, carry)
    program = traced.program.copy()
    tracer = Tracer(program)
    slots = _Slots(tracer, traced.n_slots)
    record_leaves, record_nodes = slots.place(record, steady=False)
    inputs = [*traced.inputs, *record_nodes]
    *nodes_after, sample_nodes, keep_node = tracer.read(
        jax.make_jaxpr(lane.poll)(constants, carry, record), inputs
    )
    poll = slots.changes((traced.carry, record_leaves), nodes_after)
    sample = sample_nodes.ravel().tolist()
    keep = int(keep_node)
    polled = [*poll.values(), *sample, keep]
    quiet, eventful = _plain(program, polled)
    wanted = [*traced.attempt.values(), *traced.plain.values(), traced.unusual, *polled, *quiet, eventful]
    steady = _steady_results(program, wanted)
    of_attempt = {**vars(traced), "program": program, "n_slots": slots.count + len(steady)}
    return Chunk(
        **of_attempt,
        record=record_leaves,
        poll=poll,
        keep=keep,
        sample=sample,
        quiet=quiet,
        eventful=eventful,
        steady={slots.count + i: at for i, at in enumerate(steady)},
        shared=_shared(program, traced, steady),
    )


def _traced(lane: TracedLane, constants: Any, carry: Any) -> TracedAttempt:
    """Trace an attempt from the shapes of its arguments."""
    leaves, structure = jax.tree.flatten((constants, carry))
    if lane.deciding is None:
        return _trace_attempt(lane.attempt, structure, leaves)
    return _shared_attempt(*lane.deciding, structure, tuple(leaves))


# A run and its self-check have several recorders, and the attempt takes most of the time of tracing.
@cached_by_content(maxsize=2)
def _shared_attempt(
    model: Model,
    numerics: ResolvedNumerics,
    drive: RowDrive | None,
    tangents: int,
    structure: Any,
    leaves: tuple[jax.ShapeDtypeStruct, ...],
) -> TracedAttempt:
    """The traced attempt of rows; the other arguments as of `row_attempt` and `_trace_attempt`."""
    return _trace_attempt(row_attempt(model, numerics, drive, tangents), structure, leaves)


def _trace_attempt(
    attempt: Callable[..., Any], structure: Any, leaves: Sequence[jax.ShapeDtypeStruct]
) -> TracedAttempt:
    """Trace an attempt; its program is copied before it is extended.

    Args:
        attempt: the function `(constants, carry) -> carry`.
        structure: the structure of its arguments.
        leaves: shapes and dtypes of their arrays.
    """
    constants, carry = jax.tree.unflatten(structure, leaves)
    program = Program()
    tracer = Tracer(program)
    slots = _Slots(tracer)
    constant_leaves, constant_nodes = slots.place(constants, steady=True)
    carry_leaves, carry_nodes = slots.place(carry, steady=False)
    inputs = [*constant_nodes, *carry_nodes]
    nodes_after = tracer.read(jax.make_jaxpr(attempt)(constants, carry), inputs)
    changes = slots.changes(carry_leaves, nodes_after)
    nodes, unusual = _plain(program, [*changes.values()])
    plain = dict(zip(changes, nodes, strict=True))
    return TracedAttempt(program, constant_leaves, carry_leaves, inputs, changes, plain, unusual, slots.count)


class _Slots:
    """The slots of a trajectory, numbered from 0; the input node of a slot has its number.

    Args:
        tracer: of the program that has the input nodes.
        count: the number of slots that have been given already.
    """

    def __init__(self, tracer: Tracer, count: int = 0) -> None:
        self.count = count
        self._tracer = tracer

    def place(self, tree: Any, *, steady: bool) -> tuple[Any, list[Nodes]]:
        """Give the next slots to the arrays of a tree.

        Args:
            tree: a pytree of shapes.
            steady: whether the arrays are constant along a trajectory.

        Returns:
            The tree with a `Leaf` for each array, and the input nodes of each array.
        """
        nodes = self._tracer.inputs(tree, self.count, steady=steady)
        leaves = []
        for array in nodes:
            leaves.append(Leaf(self.count, array.shape))
            self.count += array.size
        return jax.tree.unflatten(jax.tree.structure(tree), leaves), nodes

    def changes(self, leaves: Any, nodes_after: list[Nodes]) -> dict[int, int]:
        """The nodes after a stage whose slots do not keep their values, by slot.

        Args:
            leaves: a pytree of `Leaf`.
            nodes_after: the nodes of each of its arrays after the stage.
        """
        nodes_by_slot: dict[int, int] = {}
        for leaf, nodes in zip(jax.tree.leaves(leaves), nodes_after, strict=True):
            for slot, at in enumerate(nodes.ravel().tolist(), leaf.first):
                if not self._tracer.program.is_input(at, slot):
                    nodes_by_slot[slot] = at
        return nodes_by_slot


def _plain(program: Program, nodes: list[int]) -> tuple[list[int], int]:
    """The simpler nodes of `Program.likely`, and the node that is true where they do not hold.

    The nodes themselves, and false, if the simpler ones round numbers that the others do not compute: other
    products and sums would be fused, and a row's bits would depend on its neighbours.
    """
    plain, unusual = program.likely(nodes)
    only_plain = set(program.needed([*plain])) - set(program.needed([*nodes, unusual]))
    if any(program.nodes[at].kind != "bool" and program.nodes[at].op not in _EXACT for at in only_plain):
        return nodes, program.constant(False, "bool")
    return plain, unusual


def _steady_results(program: Program, wanted: Sequence[int]) -> list[int]:
    """The nodes that are constant along a trajectory and are arguments of nodes that are not.

    Inputs and constants are left out, since they need no computation.
    """
    read = {at for at in wanted if program.steady[at]}
    for at in program.needed(wanted):
        if not program.steady[at]:
            read.update(program.nodes[at].args)
    return sorted(
        at for at in read if program.steady[at] and program.nodes[at].op not in ("input", "constant")
    )


def _shared(program: Program, traced: TracedAttempt, steady: Sequence[int]) -> list[int]:
    """The numbers that no plain attempt changes, and that attempts read to compute others.

    Flags are left out, since to load one takes a comparison, as most of them do.
    """
    nodes = program.nodes
    changed = {slot for slot, at in traced.plain.items() if not program.is_input(at, slot)}
    wanted = [*traced.attempt.values(), *traced.plain.values(), traced.unusual]
    needed = program.needed(wanted, set(steady))
    unchanged: set[int] = set()
    read: set[int] = set()
    for at in needed:
        node = nodes[at]
        keeps_value = node.value not in changed if node.op == "input" else unchanged.issuperset(node.args)
        if keeps_value or program.steady[at]:
            unchanged.add(at)
        else:
            read.update(node.args)
    return [
        at
        for at in sorted(read & unchanged)
        if not program.steady[at] and nodes[at].args and nodes[at].kind != "bool"
    ]
