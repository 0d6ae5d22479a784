"""The program of a chunk for an NVIDIA GPU, in CUDA C: one thread for each trajectory that runs.

There are more lanes than threads: a thread whose trajectory has ended goes on with the next lane that waits.

Memory is ordered slot by slot and, inside a slot, lane by lane, so that neighbouring threads read
neighbouring numbers. The carry is kept in registers, the record in memory. Values that are constant along a
trajectory are computed once, when it is placed in its lane. Those that are equal in all rows are in constant
memory, which needs no registers; as arguments of the kernel they would (the compiler then spills 490 bytes of
the chain's rk4 instead of 70).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gaitsweep.engine.kernel import philox
from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.program import Kind, Program
from gaitsweep.engine.kernel.registers import depth_first, scheduled
from gaitsweep.engine.kernel.source import C, c_function, c_structure, name_all, statements
from gaitsweep.engine.kernel.trace import TracedFunction
from gaitsweep.engine.recorders.recorder import POLL_INTERVAL
from gaitsweep.status import Status

# Threads of a block, each of which may have 255 registers, the maximum. With 168 or 128 registers more
# threads run at once, but spill more: the chain's rk4 makes 0.75 and 0.43 times the attempts, a body of 15
# joints 0.58 and 0.4 times. The bound of one block at a time keeps the compiler from choosing as few as 32.
THREADS = 128
# The parameters of a poll, by name.
_POLL_PARAMETERS = {
    "S": "double*",
    "samples": "double*",
    "n": "const index",
    "i": "const index",
    "constants": "const struct Constants",
    "carry": "const struct Carry",
}
# Statements of a poll after which a number of the record is read from memory again.
REREAD_AFTER = 60
_FORMATS: dict[Kind, type] = {"f64": np.float64, "int": np.float64, "f32": np.float32, "bool": np.bool_}

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
KERNEL void clear(double* S, index n, double* queue) {{
    const index i = THREAD;
    if (i < 2) queue[i] = 0.0;
    if (i >= n) return;
    for (int slot = 0; slot < {slots}; ++slot) S[slot * n + i] = 0.0;
    S[{status} * n + i] = {complete};
}}
"""

_PUT = """
KERNEL void put(double* S, double* samples, index n, const double* entries, index count) {{
    if (THREAD >= count) return;
    const index i = (index)entries[THREAD];
    open(S, samples, n, i, entries + count + THREAD, count);
    prepare(S, n, i);
}}
"""

_COLLECT = """
KERNEL void collect(double* S, index n, double* queue, double* output) {{
    const index i = THREAD;
    if (i == 0) {{
        queue[1] = (index)(queue[1] + queue[0]) % n;
        queue[0] = 0.0;
    }}
    if (i >= n) return;
{lines}
    S[{filled} * n + i] = 0.0;
}}
"""

_TRAJECTORY = """
KERNEL void trajectory(const double* S, index n, index i, double* output) {{
    if (THREAD < {slots}) output[THREAD] = S[THREAD * n + i];
}}
"""

_RUN = """
KERNEL void run(double* S, double* samples, index n, double* queue, index polls, index threads) {{
    bool has_lane = false, lanes_left = THREAD < threads;
    index i;
    struct Constants constants;
    struct Carry carry;
    for (index k = 0; k < polls; ++k) {{
        while (!has_lane && lanes_left) {{
            const index taken = NEXT(queue);
            lanes_left = taken < n;
            i = ((index)queue[1] + taken) % n;
            has_lane = lanes_left && S[{status} * n + i] == 0.0;
            if (has_lane) {{
                constants = read_constants(S, n, i);
                carry = read_carry(S, n, i);
            }}
        }}
        // the threads of a warp wait for each other here: they would go on one by one
        if (!ANY(has_lane)) break;
        if (has_lane)
            for (int j = 0; j < {interval} && carry.s{halt} == 0.0; ++j) carry = attempt(constants, carry);
        if (ANY(has_lane) && has_lane) {{
            carry = poll(S, samples, n, i, constants, carry);
            has_lane = S[{status} * n + i] == 0.0;
            if (!has_lane || k + 1 == polls) write_carry(S, n, i, carry);
        }}
    }}
}}
"""


class LaneKernels(NamedTuple):
    """The kernels that fill lanes and that collect what the host reads.

    `clear(S, n, queue)` makes all lanes idle. `put(S, samples, n, entries, count)` opens trajectories:
    `entries` (1 + inputs, count) has their lanes, and the inputs of the function that opens them.
    `collect(S, n, queue, output)` copies the slots that the host reads to `output` (len, n) and empties the
    buffers. `trajectory(S, n, i, output)` copies all slots of lane i. `S` (slots, n) and `samples`
    (BUFFER, n, width) are the memory of n lanes; all numbers are float64.

    Attributes:
        source: their source.
        slots: the number of slots of a lane.
        inputs: the number of inputs of the function that opens a trajectory.
        from_row: whether these are a row's parameters and initial conditions; else they are its `OpenedRows`.
        read: for each slot of a trajectory's constants, the inputs that decide it.
    """

    source: str
    slots: int
    inputs: int
    from_row: bool
    read: Sequence[Sequence[int]]


class RunKernel(NamedTuple):
    """The kernel `run(S, samples, n, queue, polls, threads)`, which advances trajectories.

    Each of the first `threads` threads makes up to `polls` polls; the others of their block do nothing. `S`
    (slots, n) float64 has n lanes; `samples` (BUFFER, n, width) float64 has room for samples; `queue` (2,)
    float64 is the number of lanes taken and the lane taken first; the variable `uniform` has the values that
    are equal in all rows, as `uniform_bytes` gives them.

    Attributes:
        source: its source.
        uniform: the slots of the variable `uniform` with their kinds.
    """

    source: str
    uniform: Sequence[tuple[int, Kind]]


def lane_kernels(
    chunk: Chunk, opening: TracedFunction, read_slots: Sequence[int], title: str, *, from_row: bool
) -> LaneKernels:
    """Write the kernels that fill lanes and that collect what the host reads.

    Args:
        chunk: the program.
        opening: the function that opens a trajectory; its outputs are the numbers of one of the `OpenedRows`.
        read_slots: the slots that the host reads.
        title: names the run in the first line.
        from_row: as of `LaneKernels`.
    """
    program = chunk.program
    nodes = list(chunk.steady.values())
    loads, names = _loads(chunk, program.needed(nodes))
    lines, results = statements(C, program, nodes, names)
    stores = []
    for slot, at, result in zip(chunk.steady, nodes, results, strict=True):
        stores.append(_write(chunk, at, slot, result))
    head_of_prepare = "PART void prepare(double* S, const index n, const index i)"
    copies = [f"    output[{k} * n + i] = S[{slot} * n + i];" for k, slot in enumerate(read_slots)]
    status = chunk.record.status.first
    parts = [
        *_beginning([chunk.program, opening.program], title),
        _opening(opening, chunk.width),
        c_function(head_of_prepare, [*loads, *lines, *stores]),
        _CLEAR.format(slots=chunk.n_slots, status=status, complete=float(Status.complete)),
        _PUT.format(),
        _COLLECT.format(lines="\n".join(copies), filled=chunk.record.filled.first),
        _TRAJECTORY.format(slots=chunk.n_slots),
    ]
    numbers = {at: number for number, at in enumerate(opening.inputs)}
    read = [
        [numbers[at] for at in opening.program.needed([output]) if at in numbers]
        for output in opening.outputs[: chunk.first_of_carry]
    ]
    return LaneKernels("\n".join(parts), chunk.n_slots, len(opening.inputs), from_row, read)


def _opening(opening: TracedFunction, width: int) -> str:
    """The function `open`, which opens the trajectory of a lane; its sample has `width` numbers."""
    program = opening.program
    names = {at: f"x{number}" for number, at in enumerate(opening.inputs)}
    loads = [
        C.definition(
            program.nodes[at].kind, name, C.loaded(program.nodes[at].kind, f"inputs[{number} * count]")
        )
        for number, (at, name) in enumerate(names.items())
    ]
    lines, results = statements(C, program, opening.outputs, names)
    stored = [
        C.stored(program.nodes[at].kind, result) for at, result in zip(opening.outputs, results, strict=True)
    ]
    slots, sample = stored[: -1 - width], stored[-1 - width : -1]
    lines += [f"S[{slot} * n + i] = {value};" for slot, value in enumerate(slots)]
    lines.append(f"if (!({results[-1]})) return;")
    lines += [f"samples[i * {width} + {k}] = {value};" for k, value in enumerate(sample)]
    arguments = "double* S, double* samples, const index n, const index i"
    return c_function(
        f"PART void open({arguments}, const double* inputs, const index count)", [*loads, *lines]
    )


def run_kernel(chunk: Chunk, varying: Collection[int], title: str) -> RunKernel:
    """Write the kernel that advances trajectories.

    Args:
        chunk: the program.
        varying: the slots of constants that differ between rows.
        title: names the run in the first line.
    """
    run = _RUN.format(interval=POLL_INTERVAL, status=chunk.record.status.first, halt=chunk.carry.halt.first)
    source = "\n".join([*_beginning([chunk.program], title), *_Thread(chunk, varying).parts(), run])
    uniform = _uniform_nodes(chunk, varying).items()
    return RunKernel(source, [(slot, chunk.program.nodes[at].kind) for at, slot in uniform])


def _beginning(programs: Sequence[Program], title: str) -> list[str]:
    """The head of a source, with the functions that its programs call."""
    parts = [f"// Written by gaitsweep: {title}", HEAD]
    if any(node.op.startswith("philox") for program in programs for node in program.nodes):
        parts.append(philox.IN_C)
    return parts


def uniform_bytes(uniform: Sequence[tuple[int, Kind]], slots: Float[np.ndarray, " slots"]) -> bytes:
    """The bytes of the variable `uniform` of a kernel.

    Args:
        uniform: as of the `RunKernel`.
        slots: all slots (slots,) of a trajectory.
    """
    layout = np.dtype([(f"s{slot}", _FORMATS[kind]) for slot, kind in uniform], align=True)
    return np.array(tuple(slots[slot] for slot, _ in uniform), layout).tobytes()


def _uniform_nodes(chunk: Chunk, varying: Collection[int]) -> dict[int, int]:
    """The nodes with equal values in all rows and their slots, in the order of the variable `uniform`."""
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
    """The expression that loads a node from its slot."""
    return C.loaded(chunk.program.nodes[at].kind, f"S[{slot} * n + i]")


def _write(chunk: Chunk, at: int, slot: int, value: str) -> str:
    """The line that stores a node's value in a slot."""
    return f"S[{slot} * n + i] = {C.stored(chunk.program.nodes[at].kind, value)};"


def _loads(chunk: Chunk, nodes: Iterable[int]) -> tuple[list[str], dict[int, str]]:
    """Lines that load the inputs among `nodes` from memory, and the names of these."""
    lines: list[str] = []
    names: dict[int, str] = {}
    for at in nodes:
        node = chunk.program.nodes[at]
        if node.op == "input":
            slot = chunk.slot_of(at)
            names[at] = f"r{slot}"
            lines.append(C.definition(node.kind, names[at], _read(chunk, at, slot)))
    return lines, names


class _Thread:
    """The parts of one thread's program.

    `constants` and `uniform` are constant along a trajectory; a member s12 of a structure is the value of
    slot 12.

    Args:
        chunk: the program.
        varying: the slots of constants that differ between rows.
    """

    def __init__(self, chunk: Chunk, varying: Collection[int]) -> None:
        self._chunk = chunk
        self._uniform = _uniform_nodes(chunk, varying)
        self._constants = {at: slot for at, slot in _steady(chunk).items() if at not in self._uniform}
        self._carried = self._carried_inputs()
        self._names = {at: f"carry.s{slot}" for at, slot in self._carried.items()}
        self._names |= {at: f"constants.s{slot}" for at, slot in self._constants.items()}
        self._names |= {at: f"uniform.s{slot}" for at, slot in self._uniform.items()}

    def _carried_inputs(self) -> dict[int, int]:
        """The carry's inputs that some node reads or that an attempt or poll changes, with their slots."""
        chunk = self._chunk
        read = set(chunk.program.needed([*chunk.attempt.values(), *chunk.polled, *chunk.quiet]))
        changed = {*chunk.attempt, *chunk.poll}
        carried: dict[int, int] = {}
        for at, node in enumerate(chunk.program.nodes):
            if node.op == "input":
                slot = chunk.slot_of(at)
                in_carry = chunk.first_of_carry <= slot < chunk.first_of_record
                if in_carry and (at in read or slot in changed):
                    carried[at] = slot
        return carried

    def parts(self) -> list[str]:
        """The structures, and the functions that `run` calls."""
        head_of_write = (
            "PART void write_carry(double* S, const index n, const index i, const struct Carry carry)"
        )
        writes = [_write(self._chunk, at, slot, f"carry.s{slot}") for at, slot in self._carried.items()]
        return [
            self._structure("Uniform", self._uniform) + "CONSTANT struct Uniform uniform;\n",
            self._structure("Constants", self._constants),
            self._structure("Carry", self._carried),
            self._reading("Constants", "read_constants", self._constants),
            self._reading("Carry", "read_carry", self._carried),
            self._attempt(),
            *self._polls(),
            c_function(head_of_write, writes),
        ]

    def _structure(self, name: str, nodes: Mapping[int, int]) -> str:
        """The structure with a member for each of some nodes with their slots."""
        return c_structure(
            name, {f"s{slot}": self._chunk.program.nodes[at].kind for at, slot in nodes.items()}
        )

    def _reading(self, structure: str, name: str, nodes: Mapping[int, int]) -> str:
        """The function `name` that reads a structure from memory."""
        lines = [f"read.s{slot} = {_read(self._chunk, at, slot)};" for at, slot in nodes.items()]
        head = f"PART struct {structure} {name}(const double* S, const index n, const index i)"
        return c_function(head, [f"struct {structure} read;", *lines, "return read;"])

    def _attempt(self) -> str:
        """The function `attempt`, which returns the carry after one more attempt."""
        program = self._chunk.program
        halt = self._chunk.carry.halt.first
        # a waiting trajectory makes no attempt
        names = self._names | {at: "0.0" for at, slot in self._carried.items() if slot == halt}
        wanted = list(self._chunk.attempt.values())
        lines, results = statements(C, program, wanted, names, scheduled(program, wanted, names))
        changed = dict(zip(self._chunk.attempt, results, strict=True))
        parameters = "const struct Constants constants, const struct Carry carry"
        return c_function(f"PART struct Carry attempt({parameters})", [*lines, *self._changed_carry(changed)])

    def _polls(self) -> list[str]:
        """The function `poll`, and the two that it chooses from if there are quiet polls."""
        chunk = self._chunk
        arguments = ", ".join(_POLL_PARAMETERS)
        parameters = ", ".join(f"{kind} {name}" for name, kind in _POLL_PARAMETERS.items())
        head = f"PART struct Carry {{}}({parameters})"
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
        poll = _Poll(self._chunk, polled, self._names)
        values = poll.write()
        return [*poll.lines, *self._changed_carry(values)]

    def _changed_carry(self, values: Mapping[int, str]) -> list[str]:
        """The lines that return the carry after a stage, with the values of slots that it changes."""
        slots = [slot for slot in self._carried.values() if slot in values]
        return [
            "struct Carry changed = carry;",
            *(f"changed.s{slot} = {values[slot]};" for slot in slots),
            "return changed;",
        ]


class _Poll:
    """Writer of the lines of a poll, in which numbers of the record are read again rather than kept.

    Args:
        chunk: the program.
        polled: the nodes that a poll writes, of the sample, and `keep`, as `Chunk.polled` has them.
        names: expressions of the nodes that are in registers or constant memory.
    """

    def __init__(self, chunk: Chunk, polled: Sequence[int], names: Mapping[int, str]) -> None:
        self.lines: list[str] = []
        self._chunk = chunk
        self._program = chunk.program
        self._names = dict(names)
        self._changed: dict[int, int] = {}  # the nodes of slots that do not keep their values
        for slot, at in zip(chunk.poll, polled, strict=False):
            if not self._program.is_input(at, slot):
                self._changed[slot] = at
        self._sample = polled[len(chunk.poll) : -1]
        self._keep = polled[-1]
        # the nodes of the record's slots that are still to be written
        self._unwritten = {slot: at for slot, at in self._changed.items() if slot >= chunk.first_of_record}
        self._read_at: dict[int, int] = {}  # the place in the order at which an input was read last

    def write(self) -> dict[int, str]:
        """Write the lines, and return the expressions of the slots that the poll changes."""
        wanted = [*self._changed.values(), *self._sample, self._keep]
        self._compute(depth_first(self._program, wanted, self._names))
        constants, results = statements(C, self._program, wanted, self._names)
        self.lines += constants
        values = dict(zip(self._changed, results, strict=False))
        self._keep_sample(results[len(self._changed) : -1], results[-1])
        self.lines += [_write(self._chunk, at, slot, values[slot]) for slot, at in self._unwritten.items()]
        return values

    def _compute(self, order: Sequence[int]) -> None:
        """Compute nodes in this order; a slot is written once its old value is not read any more."""
        nodes = self._program.nodes
        last_use = {a: place for place, at in enumerate(order) for a in nodes[at].args}
        last_read = {
            self._chunk.slot_of(at): last_use[at]
            for at in order
            if nodes[at].op == "input" and at in last_use
        }
        for place, at in enumerate(order):
            if nodes[at].op == "input":
                self._read(at, place)
            else:
                for a in nodes[at].args:
                    if place - self._read_at.get(a, place) > REREAD_AFTER:
                        self._read(a, place)
                self.lines += name_all(C, self._program, [at], self._names)
            for slot, value in list(self._unwritten.items()):
                if value in self._names and (slot not in last_read or last_read[slot] <= place):
                    self.lines.append(_write(self._chunk, value, slot, self._names[value]))
                    del self._unwritten[slot]

    def _read(self, at: int, place: int) -> None:
        """Read an input from memory at a place in the order of statements."""
        slot = self._chunk.slot_of(at)
        kind = self._program.nodes[at].kind
        self._read_at[at] = place
        self._names[at] = f"r{slot}_{place}"
        # a value that is read again needs no register in between; without `volatile` it would be read once
        value = C.loaded(kind, f"((volatile const double*)S)[{slot} * n + i]")
        self.lines.append(C.definition(kind, self._names[at], value))

    def _keep_sample(self, values: Sequence[str], keep: str) -> None:
        """Write the sample to its buffer where the flag `keep` is true."""
        chunk = self._chunk
        if not chunk.width or self._program.value(self._keep) is False:
            return
        # read before the poll writes it
        self.lines.insert(0, f"const index filled = (index)S[{chunk.record.filled.first} * n + i];")
        self.lines += [
            f"if ({keep}) {{",
            f"    double* sample = samples + (filled * n + i) * {chunk.width};",
        ]
        for k, (at, value) in enumerate(zip(self._sample, values, strict=True)):
            self.lines.append(f"    sample[{k}] = {C.stored(self._program.nodes[at].kind, value)};")
        self.lines.append("}")
