"""The program of a chunk for an NVIDIA GPU, in CUDA C: one thread for each trajectory that runs.

There are more lanes than threads: a thread whose trajectory has ended goes on with the next lane that waits.

Memory is ordered slot by slot and, inside a slot, lane by lane, so that neighbouring threads read
neighbouring numbers. The carry is kept in registers, the record in memory. Values that are constant along a
trajectory are computed once, when it is placed in its lane; those that are equal in all rows are in constant
memory, which needs no registers. (As arguments of the kernel they did: the compiler spilled 490 bytes of the
chain's rk4 instead of 70.)
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from gaitsweep.engine.kernel import philox
from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.program import Kind
from gaitsweep.engine.kernel.schedule import depth_first, scheduled
from gaitsweep.engine.kernel.source import C, c_function, c_structure, name_all, statements
from gaitsweep.engine.recorders.recorder import POLL_INTERVAL
from gaitsweep.status import Status

# Threads of a block, each of which may have 255 registers, the maximum. With 168 or 128 registers more
# threads run at once, but spill more: a body of 15 joints makes 0.58 and 0.4 times the steps. The bound of
# one block at a time keeps the compiler from choosing as few as 32.
THREADS = 128
# The parameters of a poll, by name.
_OF_POLL = {
    "S": "double*",
    "kept": "double*",
    "n": "const index",
    "i": "const index",
    "own": "const struct Own",
    "carry": "const struct Carry",
}
# Statements of a poll after which a number of the record is read from memory again.
REREAD_AFTER = 60
# Numbers of a lane that is filled, before its slots: the lane, and whether its first sample is kept.
FILLING = 2
_FORMATS: dict[Kind, Any] = {"f64": np.float64, "int": np.float64, "f32": np.float32, "bool": np.bool_}

# Definitions for the compiler of a card; tests compile the same source for a host with others.
HEAD = f"""#define INFINITE __longlong_as_double(0x7ff0000000000000LL)
#define NOT_A_NUMBER __longlong_as_double(0x7ff8000000000000LL)
#define CONSTANT __constant__
#define PART static __device__ __forceinline__
#define KERNEL extern "C" __global__ __launch_bounds__({THREADS}, 1)
#define THREAD (blockIdx.x * (index)blockDim.x + threadIdx.x)
#define NEXT(counter) (index) atomicAdd(counter, 1.0)
#define ANY(flag) __any_sync(0xffffffffu, flag)
typedef long long index;
"""

_CLEAR = """
KERNEL void clear(double* S, index n, double* turn) {{
    const index i = THREAD;
    if (i < 2) turn[i] = 0.0;
    if (i >= n) return;
    for (int slot = 0; slot < {slots}; ++slot) S[slot * n + i] = 0.0;
    S[{status} * n + i] = {complete};
}}
"""

_PUT = """
KERNEL void put(double* S, double* kept, index n, const double* filling, index count) {{
    if (THREAD >= count) return;
    const double* mine = filling + THREAD * {width_of_filling};
    const index i = (index)mine[0];
    for (int slot = 0; slot < {opened}; ++slot) S[slot * n + i] = mine[{FILLING} + slot];
    if (mine[1] != 0.0)
        for (int k = 0; k < {width}; ++k) kept[i * {width} + k] = mine[{FILLING} + {opened} + k];
    prepare(S, n, i);
}}
"""

_COLLECT = """
KERNEL void collect(double* S, index n, double* turn, double* seen) {{
    const index i = THREAD;
    if (i == 0) {{
        turn[1] = (index)(turn[1] + turn[0]) % n;
        turn[0] = 0.0;
    }}
    if (i >= n) return;
{lines}
    S[{filled} * n + i] = 0.0;
}}
"""

_TRAJECTORY = """
KERNEL void trajectory(const double* S, index n, index i, double* slots) {{
    if (THREAD < {slots}) slots[THREAD] = S[THREAD * n + i];
}}
"""

_RUN = """
KERNEL void run(double* S, double* kept, index n, double* turn, index polls, index threads) {{
    bool running = false, more = THREAD < threads;
    index i;
    struct Own own;
    struct Carry carry;
    for (index k = 0; k < polls; ++k) {{
        while (!running && more) {{
            const index place = NEXT(turn);
            more = place < n;
            i = ((index)turn[1] + place) % n;
            running = more && S[{status} * n + i] == 0.0;
            if (running) {{
                own = read_own(S, n, i);
                carry = read_carry(S, n, i);
            }}
        }}
        // the threads of a warp wait for each other here: they would go on one by one
        if (!ANY(running)) break;
        if (running)
            for (int j = 0; j < {interval} && carry.s{halt} == 0.0; ++j) carry = attempt(own, carry);
        if (ANY(running) && running) {{
            carry = poll(S, kept, n, i, own, carry);
            running = S[{status} * n + i] == 0.0;
            if (!running || k + 1 == polls) write_carry(S, n, i, carry);
        }}
    }}
}}
"""


def placing(chunk: Chunk, seen: Sequence[int], title: str) -> str:
    """The source of the kernels that fill lanes and that collect what the host reads.

    `clear(S, n, turn)` makes all lanes idle. `put(S, kept, n, filling, count)` starts trajectories: `filling`
    (count, `filling_width`) has for each its lane, whether its sample is kept, its slots and its sample.
    `collect(S, n, turn, seen)` copies the slots `seen` to `seen` (len, n) and empties the buffers.
    `trajectory(S, n, i, slots)` copies all slots of lane i. `S` (slots, n) and `kept` (BUFFER, n, width) are
    the memory of n lanes; all numbers are float64.

    Args:
        chunk: the program.
        seen: the slots that the host reads.
        title: names the run in the first line.
    """
    program = chunk.program
    nodes = list(chunk.steady.values())
    loads, names = _loads(chunk, program.needed(nodes))
    lines, results = statements(C, program, nodes, names)
    stores = []
    for slot, at, result in zip(chunk.steady, nodes, results, strict=True):
        stores.append(_write(chunk, at, slot, result))
    copies = [f"    seen[{k} * n + i] = S[{slot} * n + i];" for k, slot in enumerate(seen)]
    return "\n".join(
        [
            *_beginning(chunk, title),
            c_function(
                "PART void prepare(double* S, const index n, const index i)", [*loads, *lines, *stores]
            ),
            _CLEAR.format(
                slots=chunk.n_slots, status=chunk.record.status.first, complete=float(Status.complete)
            ),
            _PUT.format(
                FILLING=FILLING,
                width_of_filling=filling_width(chunk),
                opened=_opened(chunk),
                width=chunk.width,
            ),
            _COLLECT.format(lines="\n".join(copies), filled=chunk.record.filled.first),
            _TRAJECTORY.format(slots=chunk.n_slots),
        ]
    )


def filling_width(chunk: Chunk) -> int:
    """Numbers for each lane that is filled."""
    return FILLING + _opened(chunk) + chunk.width


def _opened(chunk: Chunk) -> int:
    """The slots of a trajectory when it is opened: all but those that are computed once from these."""
    return chunk.n_slots - len(chunk.steady)


def running(chunk: Chunk, varying: Collection[int], title: str) -> str:
    """The source of the kernel `run(S, kept, n, turn, polls, threads)`.

    Each of the first `threads` threads makes up to `polls` polls; the others of their block do nothing. `S`
    (slots, n) float64 has n lanes; `kept` (BUFFER, n, width) float64 has room for samples; `turn` (2,)
    float64 is the number of lanes taken and the lane taken first; the variable `same` has the values of the
    nodes `uniform(chunk, varying)`, as `packed` gives them.

    Args:
        chunk: the program.
        varying: the slots of constants that differ between rows.
        title: names the run in the first line.
    """
    run = _RUN.format(interval=POLL_INTERVAL, status=chunk.record.status.first, halt=chunk.carry.halt.first)
    return "\n".join([*_beginning(chunk, title), *_Thread(chunk, varying).parts(), run])


def _beginning(chunk: Chunk, title: str) -> list[str]:
    """The head of a source, with the functions that its program calls."""
    draws = any(node.op.startswith("philox") for node in chunk.program.nodes)
    return [f"// Written by gaitsweep: {title}", HEAD, *([philox.IN_C] if draws else [])]


def packed(chunk: Chunk, varying: Collection[int], slots: Float[np.ndarray, " slots"]) -> bytes:
    """The bytes of the variable `same` of a kernel.

    Args:
        chunk, varying: as for `running`.
        slots: all slots (n_slots,) of a trajectory.
    """
    kinds: dict[int, Kind] = {
        slot: chunk.program.nodes[at].kind for at, slot in uniform(chunk, varying).items()
    }
    formats = [_FORMATS[kind] for kind in kinds.values()]
    layout = np.dtype({"names": [f"s{slot}" for slot in kinds], "formats": formats}, align=True)
    return np.array(tuple(slots[slot] for slot in kinds), layout).tobytes()


def uniform(chunk: Chunk, varying: Collection[int]) -> dict[int, int]:
    """The nodes with equal values in all rows and their slots, in the order of the variable `same`."""
    return {at: slot for at, slot in _steady(chunk).items() if not _varies(chunk, at, varying)}


def _steady(chunk: Chunk) -> dict[int, int]:
    """The nodes that are constant along a trajectory and read by attempts or polls, with their slots."""
    slots = {at: slot for slot, at in chunk.steady.items()}
    wanted = [*chunk.attempt.values(), *chunk.polled, *chunk.quiet, chunk.eventful]
    for at in chunk.program.needed(wanted, slots):
        node = chunk.program.nodes[at]
        if node.op == "input" and chunk.program.steady[at]:
            slots[at] = chunk.slot_of(at)
    return slots


def _varies(chunk: Chunk, at: int, varying: Collection[int]) -> bool:
    """Whether a node depends on one of the slots that differ between rows."""
    nodes = chunk.program.nodes
    return any(nodes[a].op == "input" and chunk.slot_of(a) in varying for a in chunk.program.needed([at]))


def _read(chunk: Chunk, at: int, slot: int) -> str:
    return C.loaded(chunk.program.nodes[at].kind, f"S[{slot} * n + i]")


def _write(chunk: Chunk, at: int, slot: int, value: str) -> str:
    return f"S[{slot} * n + i] = {C.stored(chunk.program.nodes[at].kind, value)};"


def _loads(chunk: Chunk, nodes: Iterable[int]) -> tuple[list[str], dict[int, str]]:
    """Lines that load the inputs among `nodes` from memory, and the names of these."""
    slots = {at: chunk.slot_of(at) for at in nodes if chunk.program.nodes[at].op == "input"}
    kinds: dict[int, Kind] = {at: chunk.program.nodes[at].kind for at in slots}
    lines = [C.definition(kinds[at], f"r{slot}", _read(chunk, at, slot)) for at, slot in slots.items()]
    return lines, {at: f"r{slot}" for at, slot in slots.items()}


class _Thread:
    """The parts of one thread's program.

    `own` and `same` are constant along a trajectory; a member s12 of a structure is the value of slot 12.
    """

    def __init__(self, chunk: Chunk, varying: Collection[int]) -> None:
        self.chunk = chunk
        self.uniform = uniform(chunk, varying)
        self.own = {at: slot for at, slot in _steady(chunk).items() if at not in self.uniform}
        self.carried = self._carried_inputs()
        self._names = {at: f"carry.s{slot}" for at, slot in self.carried.items()}
        self._names |= {at: f"own.s{slot}" for at, slot in self.own.items()}
        self._names |= {at: f"same.s{slot}" for at, slot in self.uniform.items()}

    def _carried_inputs(self) -> dict[int, int]:
        """The carry's inputs that some node reads or that an attempt or poll changes, with their slots."""
        chunk = self.chunk
        nodes = self.chunk.program.nodes
        read = set(chunk.program.needed([*chunk.attempt.values(), *chunk.polled, *chunk.quiet]))
        changed = {*chunk.attempt, *chunk.poll}
        inputs = {at: chunk.slot_of(at) for at, node in enumerate(nodes) if node.op == "input"}
        return {
            at: slot
            for at, slot in inputs.items()
            if chunk.first_of_carry <= slot < chunk.first_of_record and (at in read or slot in changed)
        }

    def _members(self, nodes: dict[int, int]) -> dict[str, Kind]:
        return {f"s{slot}": self.chunk.program.nodes[at].kind for at, slot in nodes.items()}

    def parts(self) -> list[str]:
        """The structures, and the functions that `run` calls."""
        back = [_write(self.chunk, at, slot, f"carry.s{slot}") for at, slot in self.carried.items()]
        return [
            c_structure("Same", self._members(self.uniform)) + "CONSTANT struct Same same;\n",
            c_structure("Own", self._members(self.own)),
            c_structure("Carry", self._members(self.carried)),
            self._reading("Own", "read_own", self.own),
            self._reading("Carry", "read_carry", self.carried),
            self._attempt(),
            *self._polls(),
            c_function(
                "PART void write_carry(double* S, const index n, const index i, const struct Carry carry)",
                back,
            ),
        ]

    def _reading(self, structure: str, name: str, nodes: dict[int, int]) -> str:
        lines = [f"read.s{slot} = {_read(self.chunk, at, slot)};" for at, slot in nodes.items()]
        head = f"PART struct {structure} {name}(const double* S, const index n, const index i)"
        return c_function(head, [f"struct {structure} read;", *lines, "return read;"])

    def _attempt(self) -> str:
        """The function `attempt`, which returns the carry after one more attempt."""
        # a waiting trajectory makes no attempt
        halt = self.chunk.carry.halt.first
        going = {at: "0.0" for at, slot in self.carried.items() if slot == halt}
        wanted = list(self.chunk.attempt.values())
        names = self._names | going
        order = scheduled(self.chunk.program, wanted, names)
        lines, results = statements(C, self.chunk.program, wanted, names, order)
        changed = dict(zip(self.chunk.attempt, results, strict=True))
        parameters = "const struct Own own, const struct Carry carry"
        return c_function(f"PART struct Carry attempt({parameters})", [*lines, *self._moved(changed)])

    def _polls(self) -> list[str]:
        """The function `poll`, and the two that it chooses from if there are quiet polls."""
        chunk = self.chunk
        arguments = ", ".join(_OF_POLL)
        head = "PART struct Carry {}(" + ", ".join(f"{kind} {name}" for name, kind in _OF_POLL.items()) + ")"
        if chunk.program.value(chunk.eventful) is False:
            return [c_function(head.format("poll"), self._poll(chunk.polled))]
        needed = chunk.program.needed([chunk.eventful], self._names)
        inputs, names = _loads(chunk, [at for at in needed if at not in self._names])
        lines, (eventful,) = statements(C, chunk.program, [chunk.eventful], self._names | names)
        choice = f"return {eventful} ? full_poll({arguments}) : quiet_poll({arguments});"
        return [
            c_function(head.format("full_poll"), self._poll(chunk.polled)),
            c_function(head.format("quiet_poll"), self._poll(chunk.quiet)),
            c_function(head.format("poll"), [*inputs, *lines, choice]),
        ]

    def _poll(self, polled: Sequence[int]) -> list[str]:
        """The lines of a poll whose nodes are those of `Chunk.polled`."""
        chunk = self.chunk
        program = self.chunk.program
        names = dict(self._names)
        changed = {
            slot: at for slot, at in zip(chunk.poll, polled, strict=False) if not program.is_input(at, slot)
        }
        sample = polled[len(chunk.poll) : -1]
        keep = polled[-1]
        wanted = [*changed.values(), *sample, keep]
        order = depth_first(program, wanted, names)
        last_use = {a: place for place, at in enumerate(order) for a in program.nodes[at].args}
        of_slot = {chunk.slot_of(at): at for at in order if program.nodes[at].op == "input"}
        unwritten = {slot: at for slot, at in changed.items() if slot >= chunk.first_of_record}
        lines: list[str] = []
        read_at: dict[int, int] = {}

        def read(at: int, place: int) -> None:
            # a value that is read again needs no register in between; without `volatile` it would be read
            # once
            slot = chunk.slot_of(at)
            read_at[at] = place
            names[at] = f"r{slot}_{place}"
            value = C.loaded(program.nodes[at].kind, f"((volatile const double*)S)[{slot} * n + i]")
            lines.append(C.definition(program.nodes[at].kind, names[at], value))

        for place, at in enumerate(order):
            if program.nodes[at].op == "input":
                read(at, place)
            else:
                for a in program.nodes[at].args:
                    if place - read_at.get(a, place) > REREAD_AFTER:
                        read(a, place)
                lines += name_all(C, program, [at], names)
            for slot, value in list(unwritten.items()):
                if value in names and last_use.get(of_slot.get(slot, -1), -1) <= place:
                    lines.append(_write(chunk, value, slot, names[value]))
                    del unwritten[slot]
        constants, results = statements(C, program, wanted, names)
        lines += constants
        if chunk.width and program.value(keep) is not False:
            lines.insert(0, f"const index filled = (index)S[{chunk.record.filled.first} * n + i];")
            lines += [
                f"if ({results[-1]}) {{",
                f"    double* row = kept + (filled * n + i) * {chunk.width};",
                *(
                    f"    row[{k}] = {C.stored(program.nodes[at].kind, value)};"
                    for k, (at, value) in enumerate(zip(sample, results[len(changed) : -1], strict=True))
                ),
                "}",
            ]
        values = dict(zip(changed, results, strict=False))
        lines += [_write(chunk, at, slot, values[slot]) for slot, at in unwritten.items()]
        return [*lines, *self._moved(values)]

    def _moved(self, changed: dict[int, str]) -> list[str]:
        """The lines that return the carry after a stage."""
        slots = (slot for slot in self.carried.values() if slot in changed)
        return [
            "struct Carry moved = carry;",
            *(f"moved.s{slot} = {changed[slot]};" for slot in slots),
            "return moved;",
        ]
