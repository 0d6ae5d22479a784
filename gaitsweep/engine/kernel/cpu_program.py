"""The program of a chunk for the CPU: lanes side by side in a vector register, compiled by LLVM.

One flat array holds a tile, the lanes of one vector, slot by slot. Each stage is straight-line code on
vectors. An attempt in which no lane meets an event computes few values: the effects of events, and values
that depend on modes alone, are computed where a lane meets one. Such an attempt writes its results beside the
state that it began with, and the rest reads both. Rare operations, such as keeping a sample, have a loop over
lanes. Each core runs its own tiles, in a thread.
"""

from __future__ import annotations

import ctypes
import functools
import platform
import threading
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir

from gaitsweep.cache_folder import compiled_once, is_compiled
from gaitsweep.engine.kernel import llvm_code
from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.contraction import contracted
from gaitsweep.engine.kernel.llvm_code import ARRAY, DOUBLE, INDEX, VOID, loop
from gaitsweep.engine.kernel.registers import Step, from_the_end, steps
from gaitsweep.engine.kernel.source import PYTHON, name_all
from gaitsweep.engine.recorders.recorder import BUFFER, POLL_INTERVAL

_FEATURES = llvm.get_host_cpu_features()
_ARM = platform.machine().lower() in ("arm64", "aarch64")


def _lanes_of_a_tile() -> int:
    """The float64 numbers in a vector of this processor."""
    if _FEATURES.get("avx512f"):
        return 8
    return 4 if _FEATURES.get("avx") else 2


TILE = _lanes_of_a_tile()
FUSES = _ARM or bool(_FEATURES.get("fma"))  # whether a product and a sum can be one instruction
# Values in registers at a time, four less than a processor of 32 vector registers has. With 16 registers the
# compiler chooses: it does better there for long steps (the chain's propagator6).
REGISTERS = 28 if TILE == 8 or _ARM else None

# Modules that determine the instructions as well as a source does.
_DETERMINING = ("cpu_program", "llvm_code", "row_kernel")

# The kernels that were compiled or loaded, by source; batches of a search are measured by threads.
_LOADED: dict[str, Callable[..., None]] = {}
_LOCK = threading.Lock()


def compiled(
    chunk: Callable[[], Chunk], stored: Callable[..., Any], *, contraction: bool, quick: bool
) -> tuple[Callable[[Any, Any, int], None], int]:
    """The function `run` of `running` for a chunk, and the slots of a lane.

    Args:
        chunk: traces the program.
        stored: `stored(name, compute, *others)`, the result of `compute`, kept as by `stored_traces.stored`.
        contraction: whether a product and a sum may become one instruction, which rounds once.
        quick: as of `llvm_code.machine_code`.
    """
    tile = functools.cache(lambda: Tile(chunk(), TILE, contraction=contraction))
    # the processor decides which instructions a tile is written for
    layout, source = stored("tile", lambda: (tile().layout, tile().source), *llvm_code.processor())
    return running(tuple(layout), source, lambda: tile().module(), quick=quick), layout[1]


def running(
    layout: tuple[int, ...], source: str, module: Callable[[], ir.Module], *, quick: bool = False
) -> Callable[[Any, Any, int], None]:
    """The function `run(S, samples, polls)` that advances all tiles by a chunk, compiled or loaded.

    `S` (tiles, slots * lanes) float64, aligned to vectors; `samples` (tiles * lanes, BUFFER, width)
    receives the rows to keep.

    Args:
        layout, source: those of a `Tile`.
        module: writes the tile's module, if the kernel is not in the cache.
        quick: as of `llvm_code.machine_code`.
    """
    kinds = ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p, ctypes.c_int64
    function = loaded_once(f"{layout}\n{source}", module, *kinds, quick=quick)

    def run(S: np.ndarray, samples: np.ndarray, polls: int) -> None:
        assert S.flags.c_contiguous
        assert samples.flags.c_contiguous
        function(S.ctypes.data, S.shape[0], samples.ctypes.data, polls)

    return run


def loaded_once(
    source: str, module: Callable[[], ir.Module], *kinds: Any, quick: bool = False
) -> Callable[..., None]:
    """The function `run` of a module with arguments of these `ctypes`, loaded once in a process.

    Args:
        source: all that determines the module.
        module: writes the module, if it is not in the cache.
        kinds: the types of the arguments.
        quick: as of `llvm_code.machine_code`, unless the kernel has been optimised before.
    """
    with _LOCK:
        quick = quick and source not in _LOADED
        name = f"quick\n{source}" if quick else source
        if name not in _LOADED:
            own = [Path(__file__).with_name(f"{name}.py").read_text() for name in _DETERMINING]
            others = [*own, *llvm_code.processor(), version("llvmlite")]
            if quick and is_compiled("o", [source, *others]):  # by a run of more rows
                quick, name = False, source
            code = compiled_once("o", [name, *others], lambda: llvm_code.machine_code(module(), quick=quick))
            _LOADED[name] = llvm_code.loaded(code, "run", *kinds)
        return _LOADED[name]


class Tile:
    """The stages of a tile, and its slots.

    The program's slots are followed by a flag and a sample for the loop that keeps samples, by the values
    that plain attempts share, and by room for values that a stage loads again. Slots that plain attempts
    change exist twice, `apart` slots from each other: an attempt reads one side and writes the other. In the
    generated functions `s` is the array of slots, `i` the side that is read and `j` the side that is written.

    Args:
        chunk: the program.
        lanes: the number of lanes in a tile.
        contraction: whether a product and a sum may become one instruction, which rounds once.
    """

    def __init__(self, chunk: Chunk, lanes: int, *, contraction: bool) -> None:
        if contraction and FUSES:
            chunk = contracted(chunk)
        self.chunk = chunk
        self.lanes = lanes
        self.keep = chunk.n_slots
        self.sample = self.keep + 1
        self.shared = {self.sample + chunk.width + i: at for i, at in enumerate(chunk.shared)}
        # an attempt without conditions that are seldom true has one part, and changes slots where they are
        self._whole = chunk.program.value(chunk.unusual) is False
        self.twice = {} if self._whole else chunk.changed
        end = self.sample + chunk.width + len(self.shared)
        self.apart = end - min(self.twice, default=end)
        # slots from here on hold values that a stage loads again; stages that need more extend `slots`
        self._room = max(self.twice, default=end - 1) + self.apart + 1
        self.slots = self._room
        self._steady = {at: self._place(slot) for slot, at in chunk.steady.items()}
        back = [f"{self._place(slot)} = {self._place(slot + self.apart)}" for slot in self.twice]
        self.stages = [
            self._stage("prepare", "s", self._lines(chunk.steady, {})),
            self._stage("share", "s", self._lines(self.shared, self._steady)),
            self._stage("attempt", "s, i, j", self._attempt()),
            self._stage("poll", "s, i", self._poll()),
            self._stage("back", "s", back),
        ]

    def _attempt(self) -> list[str]:
        """An attempt, which computes the effects of events only if a lane of the tile needs them."""
        chunk = self.chunk
        at_hand = self._steady | {at: self._place(slot) for slot, at in self.shared.items()}
        if self._whole:
            return self._lines(chunk.attempt, at_hand)
        plain = self._lines(self.twice, at_hand, "i", "j", flag=chunk.unusual, registers=REGISTERS)
        computed = {
            at: self._place(slot, "j") for slot, at in self.twice.items() if chunk.program.nodes[at].args
        }
        others = {slot: at for slot, at in chunk.attempt.items() if self.twice.get(slot) != at}
        at_events = [
            "barrier()",
            *self._lines(others, at_hand | computed, "i", "j", registers=REGISTERS),
            "barrier()",
            *self._lines(self.shared, self._steady),
        ]
        return [*plain, *_choice(at_events, ["pass"])]

    def _poll(self) -> list[str]:
        """A poll, which computes the effects of events only if a lane of the tile needs them."""
        chunk = self.chunk
        program = self.chunk.program
        slots = [*chunk.poll, *range(self.sample, self.sample + chunk.width), self.keep]

        def lines(polled: Sequence[int]) -> list[str]:
            changed = {
                slot: at for slot, at in zip(slots, polled, strict=True) if not program.is_input(at, slot)
            }
            return self._lines(changed, self._steady, "i", "i")

        if program.value(chunk.eventful) is False:
            return lines(chunk.polled)
        flag = self._lines({}, self._steady, "i", "i", flag=chunk.eventful)
        return [*flag, *_choice(lines(chunk.polled), lines(chunk.quiet))]

    def _lines(
        self,
        outputs: Mapping[int, int],
        at_hand: Mapping[int, str],
        old: str = "",
        new: str = "",
        *,
        flag: int | None = None,
        registers: int | None = None,
    ) -> list[str]:
        """Lines that compute nodes and write them to slots.

        Args:
            outputs: the nodes, by slot.
            at_hand: where nodes are in memory already; inputs are in their slots.
            old, new: the sides that are read and written, of slots that exist twice.
            flag: a flag, which the lines name `unusual`.
            registers: values in registers at a time; None if the compiler chooses them.
        """
        program = self.chunk.program
        wanted = [*outputs.values(), *([] if flag is None else [flag])]
        places = dict(at_hand)
        order = []
        for at in program.needed(wanted, at_hand):
            if at not in at_hand and program.nodes[at].op == "input":
                places[at] = self._place(self.chunk.slot_of(at), old)
            elif at not in at_hand and program.nodes[at].op != "constant":
                order.append(at)
        if registers is not None:
            order = from_the_end(program, order, wanted)
        targets: dict[int, list[str]] = {}
        for slot, at in outputs.items():
            targets.setdefault(at, []).append(self._place(slot, new))
        overwrites = _overwritten(targets, places)
        actions = steps(program, order, places, overwrites, registers, flag)
        lines, names = self._lines_of_steps(actions, places, targets)
        return lines if flag is None else [*lines, f"unusual = {names[flag]}"]

    def _lines_of_steps(
        self, actions: Sequence[Step], places: dict[int, str], targets: Mapping[int, list[str]]
    ) -> tuple[list[str], dict[int, str]]:
        """Lines that load, compute, store and write nodes, and the names of these nodes.

        Args:
            actions: the steps, in order.
            places: where nodes are in memory; those that are stored or written are added.
            targets: the places to which each node is written.
        """
        program = self.chunk.program
        names: dict[int, str] = {}
        lines: list[str] = []
        touched: set[int] = set()  # loaded or stored since the last barrier
        room = self._room
        for action, at in actions:
            kind = program.nodes[at].kind
            if action == "compute":
                lines += name_all(PYTHON, program, [at], names)
                continue
            if action == "load":
                if at in touched:
                    lines.append("barrier()")
                    touched.clear()
                names[at] = f"x{at}"
                lines.append(f"{names[at]} = {PYTHON.loaded(kind, places[at])}")
            else:
                if action == "store":
                    stores = [f"s[{room * self.lanes}]"]
                    room += 1
                else:
                    stores = targets[at]
                    name_all(PYTHON, program, [at], names)  # a constant
                places[at] = stores[0]
                lines += [f"{place} = {PYTHON.stored(kind, names[at])}" for place in stores]
            touched.add(at)
        self.slots = max(self.slots, room)
        return lines, names

    def _place(self, slot: int, side: str = "") -> str:
        """The element of the first lane of a slot; `side` names the elements before the side."""
        place = str(slot * self.lanes)
        return f"s[{side} + {place}]" if side and slot in self.twice else f"s[{place}]"

    def _stage(self, name: str, arguments: str, lines: list[str]) -> str:
        """The source of a stage as a function."""
        body = "\n".join(_indented([*lines, "pass"]))
        return f"def {name}({arguments}):\n{body}\n"

    @property
    def source(self) -> str:
        """The source of the stages."""
        return "\n\n".join(self.stages)

    @property
    def layout(self) -> tuple[int, ...]:
        """The numbers that the loops around the stages depend on."""
        record = self.chunk.record
        halt = self.chunk.carry.halt.first
        slots = record.status.first, record.filled.first, halt, int(halt in self.twice)
        return self.lanes, self.slots, self.apart, self.keep, self.sample, self.chunk.width, *slots

    def module(self) -> ir.Module:
        """The kernel in LLVM's language: its stages, and the loops around them."""
        module = ir.Module()
        stages = [llvm_code.add_function(module, stage, self.lanes) for stage in self.stages]
        prepare, share, attempt, poll, back = stages
        run = ir.Function(module, ir.FunctionType(VOID, [ARRAY, INDEX, ARRAY, INDEX]), "run")
        tiles_array, tiles, samples, polls = run.args
        builder = ir.IRBuilder(run.append_basic_block("entry"))
        side = builder.alloca(INDEX)
        apart = INDEX(self.apart * self.lanes)
        record = self.chunk.record
        halt = self.chunk.carry.halt.first
        row = BUFFER * self.chunk.width  # numbers that a lane may keep
        with loop(builder, tiles) as (tile, _):
            s = builder.gep(tiles_array, [builder.mul(tile, INDEX(self.slots * self.lanes))])
            builder.call(prepare, [s])
            builder.call(share, [s])
            builder.store(INDEX(0), side)
            with loop(builder, polls) as (_, all_ended):
                self._leave_if_none_is_zero(builder, s, INDEX(record.status.first * self.lanes), all_ended)
                with loop(builder, INDEX(POLL_INTERVAL)) as (_, all_wait):
                    i = builder.load(side)
                    place = INDEX(halt * self.lanes)
                    # lanes that wait for the poll would stay as they are
                    place = builder.add(i, place) if halt in self.twice else place
                    self._leave_if_none_is_zero(builder, s, place, all_wait)
                    j = builder.sub(apart, i)
                    builder.call(attempt, [s, i, j])
                    builder.store(j, side)
                builder.call(poll, [s, builder.load(side)])
                builder.call(share, [s])
                if row:
                    first = builder.mul(tile, INDEX(self.lanes * row))
                    self._keep_samples(builder, s, builder.gep(samples, [first]), row)
            with builder.if_then(builder.icmp_signed("!=", builder.load(side), INDEX(0))):
                builder.call(back, [s])
        builder.ret_void()
        return module

    def _leave_if_none_is_zero(self, builder: ir.IRBuilder, s: Any, place: Any, after: ir.Block) -> None:
        """Leave a loop if the slot at `place` is zero in no lane."""
        kind = llvm_code.vector(DOUBLE, self.lanes)
        values = builder.load(builder.bitcast(builder.gep(s, [place]), kind.as_pointer()), align=8)
        zeros = builder.fcmp_ordered("==", values, ir.Constant(kind, [0.0] * self.lanes))
        with builder.if_then(builder.not_(llvm_code.some_lane(builder, zeros))):
            builder.branch(after)

    def _keep_samples(self, builder: ir.IRBuilder, s: Any, samples: Any, row: int) -> None:
        """Copy the samples of lanes whose flag is set to the rows to keep."""

        def slot(number: int, *places: Any) -> Any:
            """The value of a slot of the loop's lane."""
            place = functools.reduce(builder.add, places, builder.add(lane, INDEX(number * self.lanes)))
            return builder.load(builder.gep(s, [place]))

        with loop(builder, INDEX(self.lanes)) as (lane, _):
            kept_now = builder.fcmp_unordered("!=", slot(self.keep), DOUBLE(0.0))
            with builder.if_then(kept_now):
                filled = builder.fptosi(slot(self.chunk.record.filled.first), INDEX)
                first = builder.mul(builder.sub(filled, INDEX(1)), INDEX(self.chunk.width))
                first = builder.add(first, builder.mul(lane, INDEX(row)))
                with loop(builder, INDEX(self.chunk.width)) as (i, _):
                    value = slot(self.sample, builder.mul(i, INDEX(self.lanes)))
                    builder.store(value, builder.gep(samples, [builder.add(first, i)]))


def _overwritten(targets: Mapping[int, list[str]], places: Mapping[int, str]) -> dict[int, list[int]]:
    """The nodes whose places in memory each written node takes.

    Args:
        targets: the places to which each node is written.
        places: the place of each node that is in memory.
    """
    values_at = {place: at for at, place in places.items()}
    overwrites: dict[int, list[int]] = {}
    for at, places_of_node in targets.items():
        overwrites[at] = [values_at[place] for place in places_of_node if place in values_at]
    return overwrites


def _choice(yes: list[str], no: list[str]) -> list[str]:
    """The lines `yes` where the flag `unusual` of some lane is true, else the lines `no`."""
    return ["if any(unusual):", *_indented(yes), "else:", *_indented(no)]


def _indented(lines: list[str]) -> list[str]:
    return [f"    {line}" for line in lines]
