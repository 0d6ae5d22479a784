"""The program of a chunk for an NVIDIA GPU: one thread for each trajectory, compiled by numba-cuda.

Memory is ordered slot by slot and, inside a slot, lane by lane, so that neighbouring threads read
neighbouring numbers. The carry is kept in registers, the record in memory. Values that are constant along a
trajectory are computed once, when it is placed in its lane; those that are equal in all rows are kernel
arguments, which need no registers.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.llvm_code import KINDS
from gaitsweep.engine.kernel.python_source import loaded, statements, stored
from gaitsweep.engine.recorders.recorder import POLL_INTERVAL

# Registers of a thread: the maximum. With fewer, more threads run at once, but spilled registers cost more.
REGISTERS = 255

_HEAD = """# Written by gaitsweep: {title}
from numba import cuda

from gaitsweep.engine.kernel.llvm_code import CudaCalls, straight_line


def lowered(source):
    return straight_line(CudaCalls, source)
"""

_STAGE = """
{name} = lowered('''def {name}({parameters}){kinds}:
{body}
''')
"""

_PUT = """

@cuda.jit(cache=True)
def put(S, n, lanes, opened):
    k = cuda.grid(1)
    if k < lanes.size:
        i = lanes[k]
        for slot in range(opened.shape[0]):
            S[slot * n + i] = opened[slot, k]
        prepare(S, n, i)


@cuda.jit(cache=True)
def put_rows(kept, lanes, rows):
    k = cuda.grid(1)
    if k < lanes.size:
        for number in range(rows.shape[1]):
            kept[0, number, lanes[k]] = rows[k, number]
"""

_RUN = """

@cuda.jit(cache=True, max_registers={registers})
def run(S, kept, n, polls, same):
    i = cuda.grid(1)
    if i >= n:
        return
    if S[{status} * n + i] != 0.0:
        return
    own = read_own(S, n, i)
    c = read_carry(S, n, i)
    for _ in range(polls):
        for _ in range({interval}):
            if c[{halt}] != 0.0:
                break
            c = attempt(own, same, c)
        c = poll(S, kept, n, i, own, same, c)
        if S[{status} * n + i] != 0.0:
            break
    write_carry(S, n, i, c)
"""


def placing(chunk: Chunk, title: str) -> str:
    """The source of the module that fills lanes: `put(S, n, lanes, opened)`, `put_rows(kept, lanes, rows)`.

    `S` (slots * n,) float64 has n lanes; `opened` (slots, len(lanes)) are the new values of the slots.
    """
    program, nodes = chunk.program, list(chunk.steady.values())
    lines, names = _loads(chunk, program.needed(nodes))
    more, results = statements(program, nodes, names)
    stores = [
        _write(chunk, at, slot, result) for slot, at, result in zip(chunk.steady, nodes, results, strict=True)
    ]
    stage = _stage("prepare", "S, n, i", [*lines, *more, *stores])
    return _HEAD.format(title=title) + stage + _PUT


def running(chunk: Chunk, varying: Collection[int], title: str) -> str:
    """The source of the kernel `run(S, kept, n, polls, same)`, which advances n lanes by up to `polls` polls.

    `S` (slots * n,) float64; `kept` (BUFFER * width * n,) receives the rows to keep; `same` are the values of
    the nodes `same(chunk, varying)`; `varying` are the slots of constants that differ between rows.
    """
    thread = _Thread(chunk, varying)
    run = _RUN.format(
        registers=REGISTERS,
        interval=POLL_INTERVAL,
        status=chunk.record.status.first,
        halt=thread.carry.index(chunk.carry.halt.first),
    )
    return _HEAD.format(title=title) + "".join(thread.stages()) + run


def same(chunk: Chunk, varying: Collection[int]) -> dict[int, int]:
    """The nodes with equal values in all rows and their slots, in the order of the kernel's argument."""
    return {at: slot for at, slot in _steady(chunk).items() if not _varies(chunk, at, varying)}


def _steady(chunk: Chunk) -> dict[int, int]:
    """The nodes that are constant along a trajectory and read by attempts or polls, with their slots."""
    given = {at: slot for slot, at in chunk.steady.items()}
    wanted = [*chunk.attempt.values(), *chunk.poll.values(), *chunk.row, chunk.keep]
    for at in chunk.program.needed(wanted, given):
        node = chunk.program.nodes[at]
        if node.op == "input" and chunk.program.steady[at]:
            given[at] = chunk.slot_of(at)
    return given


def _varies(chunk: Chunk, at: int, varying: Collection[int]) -> bool:
    nodes = chunk.program.nodes
    return any(nodes[a].op == "input" and chunk.slot_of(a) in varying for a in chunk.program.needed([at]))


def _read(chunk: Chunk, at: int, slot: int) -> str:
    return loaded(chunk.program.nodes[at].kind, f"S[{slot} * n + i]")


def _write(chunk: Chunk, at: int, slot: int, value: str) -> str:
    return f"S[{slot} * n + i] = {stored(chunk.program.nodes[at].kind, value)}"


def _loads(chunk: Chunk, nodes: Iterable[int]) -> tuple[list[str], dict[int, str]]:
    """Lines that load the inputs among `nodes` from memory, and the names of these."""
    slots = {at: chunk.slot_of(at) for at in nodes if chunk.program.nodes[at].op == "input"}
    lines = [f"r{slot} = {_read(chunk, at, slot)}" for at, slot in slots.items()]
    return lines, {at: f"r{slot}" for at, slot in slots.items()}


def _stage(name: str, parameters: str, lines: list[str], kinds: str = "") -> str:
    body = "\n".join(f"    {line}" for line in lines or ["pass"])
    return _STAGE.format(name=name, parameters=parameters, kinds=f' -> "{kinds}"' if kinds else "", body=body)


class _Thread:
    """The stages of one thread; `c` is the carry, `own` and `same` are constant along a trajectory."""

    def __init__(self, chunk: Chunk, varying: Collection[int]) -> None:
        self.chunk = chunk
        self.polled = [*chunk.poll.values(), *chunk.row, chunk.keep]
        steady = _steady(chunk)
        self.own = {at: slot for at, slot in steady.items() if _varies(chunk, at, varying)}
        self._carried = self._carried_inputs()
        self.carry = list(self._carried.values())
        self._kinds = self._letters(self._carried)
        self._names = {at: f"c[{k}]" for k, at in enumerate(self._carried)}
        self._names |= {at: f"own[{k}]" for k, at in enumerate(self.own)}
        self._names |= {at: f"same[{k}]" for k, at in enumerate(same(chunk, varying))}

    def _carried_inputs(self) -> dict[int, int]:
        """The carry's inputs that some node reads or that an attempt or poll changes, with their slots."""
        chunk, nodes = self.chunk, self.chunk.program.nodes
        read = set(chunk.program.needed([*chunk.attempt.values(), *self.polled]))
        changed = {*chunk.attempt, *chunk.poll}
        inputs = {at: chunk.slot_of(at) for at, node in enumerate(nodes) if node.op == "input"}
        return {
            at: slot
            for at, slot in inputs.items()
            if chunk.first_of_carry <= slot < chunk.first_of_record and (at in read or slot in changed)
        }

    def _letters(self, nodes: Iterable[int]) -> str:
        return "".join(KINDS[self.chunk.program.nodes[at].kind] for at in nodes)

    def stages(self) -> list[str]:
        own = [_read(self.chunk, at, slot) for at, slot in self.own.items()] or ["0.0"]
        carry = [_read(self.chunk, at, slot) for at, slot in self._carried.items()]
        back = [_write(self.chunk, at, slot, f"c[{k}]") for k, (at, slot) in enumerate(self._carried.items())]
        return [
            _stage("read_own", "S, n, i", [_given(own)], self._letters(self.own) or "d"),
            _stage("read_carry", "S, n, i", [_given(carry)], self._kinds),
            self._attempt(),
            self._poll(),
            _stage("write_carry", "S, n, i, c", back),
        ]

    def _attempt(self) -> str:
        # a waiting trajectory makes no attempt
        halt = self.chunk.carry.halt.first
        going = {at: "0.0" for at, slot in self._carried.items() if slot == halt}
        wanted = list(self.chunk.attempt.values())
        lines, results = statements(self.chunk.program, wanted, self._names | going)
        changed = dict(zip(self.chunk.attempt, results, strict=True))
        return _stage("attempt", "own, same, c", [*lines, self._moved(changed)], self._kinds)

    def _poll(self) -> str:
        chunk, program = self.chunk, self.chunk.program
        reached = program.needed(self.polled, self._names)
        lines, names = _loads(chunk, (at for at in reached if at not in self._names))
        more, results = statements(program, self.polled, self._names | names)
        changed = dict(zip(chunk.poll, results, strict=False))
        lines += more
        if chunk.width:
            lines += [f"if {results[-1]}:", f"    place = int(S[{chunk.record.filled.first} * n + i])"]
            kept = zip(chunk.row, results[len(chunk.poll) : -1], strict=True)
            lines += [
                f"    kept[(place * {chunk.width} + {k}) * n + i] = {stored(program.nodes[at].kind, value)}"
                for k, (at, value) in enumerate(kept)
            ]
        record = ((slot, at) for slot, at in chunk.poll.items() if slot >= chunk.first_of_record)
        lines += [_write(chunk, at, slot, changed[slot]) for slot, at in record]
        return _stage("poll", "S, kept, n, i, own, same, c", [*lines, self._moved(changed)], self._kinds)

    def _moved(self, changed: dict[int, str]) -> str:
        """The carry after a stage, from changed and unchanged values."""
        return _given([changed.get(slot, f"c[{k}]") for k, slot in enumerate(self.carry)])


def _given(values: list[str]) -> str:
    return f"return ({', '.join(values)},)"
