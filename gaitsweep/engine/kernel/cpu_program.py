"""The program of a chunk for the CPU: lanes side by side in a vector register, compiled by Numba.

One flat array holds a tile, the lanes of one vector, slot by slot. Each stage is straight-line code on
vectors. An attempt in which no lane meets an event computes few values: the effects of events, and values
that depend on modes alone, are computed where a lane meets one. Such an attempt writes its results beside the
state that it began with, and the rest reads both. Rare operations, such as keeping a sample, have a loop over
lanes. Each core runs its own tiles, in a thread.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import llvmlite.binding as llvm

from gaitsweep.engine.kernel.cache import module_of
from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.contraction import contracted
from gaitsweep.engine.kernel.python_source import Python, loaded, stored
from gaitsweep.engine.kernel.registers import steps
from gaitsweep.engine.kernel.schedule import from_the_end
from gaitsweep.engine.kernel.source import name_all
from gaitsweep.engine.recorders.recorder import POLL_INTERVAL

_HAS = llvm.get_host_cpu_features()
_ARM = platform.machine().lower() in ("arm64", "aarch64")
TILE = 8 if _HAS.get("avx512f") else 4 if _HAS.get("avx") else 2  # lanes of a tile: float64 in a vector
FUSES = _ARM or bool(_HAS.get("fma"))  # whether a product and a sum can be one instruction
# Values in registers at a time, four less than a processor of 32 vector registers has. With 16 registers the
# compiler chooses: it does better there for long steps (the chain's propagator6).
REGISTERS = 28 if TILE == 8 or _ARM else None

_PREAMBLE = """# Written by gaitsweep: {title}
from numba import int64

from gaitsweep.engine.kernel.cache import compiled
from gaitsweep.engine.kernel.llvm_code import straight_line
"""


def compiled(
    chunk: Chunk, title: str, *, contraction: bool = True
) -> tuple[Callable[[Any, Any, int], None], int]:
    """The function `run` of `source`, compiled now or loaded from the cache, and the slots of a lane."""
    _prefer_wide_vectors()
    tile = _Tile(chunk, TILE, contraction)
    return module_of(_printed(tile, title)).run, tile.slots


def _prefer_wide_vectors() -> None:
    """Let LLVM use the processor's widest vectors, which it avoids by itself; these kernels are faster so."""
    if "numba" in sys.modules:  # Numba has read its settings already
        return
    if not llvm.get_host_cpu_features().get("avx512f"):
        return
    features = llvm.get_host_cpu_features().flatten() + ",-prefer-256-bit"
    os.environ.setdefault("NUMBA_CPU_NAME", llvm.get_host_cpu_name())
    os.environ.setdefault("NUMBA_CPU_FEATURES", features)


def source(chunk: Chunk, lanes: int, title: str, *, contraction: bool = True) -> str:
    """The source of the module for a CPU; its `run(S, kept, polls)` advances all tiles by a chunk.

    `S` (tiles, slots * lanes) float64; `kept` (tiles * lanes, BUFFER, width) receives the rows to keep.
    `contraction`: whether a product and a sum may become one instruction.
    """
    return _printed(_Tile(chunk, lanes, contraction), title)


def _printed(tile: _Tile, title: str) -> str:
    """The source of a tile's module."""
    chunk, lanes = tile.chunk, tile.lanes
    keep = _KEEP.format(
        lanes=lanes,
        keep=tile.keep * lanes,
        filled=chunk.record.filled.first * lanes,
        first=tile.sample * lanes,
        width=chunk.width,
    )
    parts = [
        _PREAMBLE.format(title=title),
        *tile.stages,
        *([keep] if chunk.width else []),
        _RUN.format(
            lanes=lanes,
            interval=POLL_INTERVAL,
            status=chunk.record.status.first * lanes,
            halt=("i + " if chunk.carry.halt.first in tile.twice else "")
            + str(chunk.carry.halt.first * lanes),
            apart=tile.apart * lanes,
            keep="keep(s, kept, tile)" if chunk.width else "pass",
        ),
    ]
    return "\n\n".join(parts)


class _Tile:
    """The stages of a tile, and its slots.

    After the program's slots come a flag and a sample for the loop that keeps samples, what plain attempts
    share, and room for values that a stage loads again. Slots that plain attempts change are there twice,
    `apart` slots from each other: an attempt reads those of one side, `i`, and writes those of the other,
    `j`.
    """

    def __init__(self, chunk: Chunk, lanes: int, contraction: bool) -> None:
        self.chunk = chunk = contracted(chunk) if contraction and FUSES else chunk
        self.lanes = lanes
        self.keep = chunk.n_slots
        self.sample = self.keep + 1
        self.shared = {self.sample + chunk.width + i: at for i, at in enumerate(chunk.shared)}
        # an attempt without conditions that are seldom true has one part, and changes slots where they are
        self._whole = chunk.program.value(chunk.unusual) is False
        self.twice = {} if self._whole else chunk.changed
        end = self.sample + chunk.width + len(self.shared)
        self.apart = end - min(self.twice, default=end)
        self.slots = self._room = max(self.twice, default=end - 1) + self.apart + 1
        self._steady = {at: self._place(slot) for slot, at in chunk.steady.items()}
        self.stages = [
            self._stage("prepare", "s", self._lines(chunk.steady, {})),
            self._stage("share", "s", self._lines(self.shared, self._steady)),
            self._stage("attempt", "s, i, j", self._attempt()),
            self._stage("poll", "s, i", self._poll()),
            self._stage(
                "back", "s", [f"{self._place(k)} = {self._place(k + self.apart)}" for k in self.twice]
            ),
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
        rest = [
            "barrier()",
            *self._lines(others, at_hand | computed, "i", "j", registers=REGISTERS),
            "barrier()",
            *self._lines(self.shared, self._steady),
        ]
        return [*plain, *_choice(rest, ["pass"])]

    def _poll(self) -> list[str]:
        """A poll, which computes the effects of events only if a lane of the tile needs them."""
        chunk, program = self.chunk, self.chunk.program
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
            old, new: the sides that are read and written, of slots that are there twice.
            flag: a flag, which the lines name `unusual`.
            registers: values in registers at a time; None if the compiler chooses them.
        """
        program = self.chunk.program
        nodes, names = program.nodes, {}
        wanted = [*outputs.values(), *([] if flag is None else [flag])]
        places, order = dict(at_hand), []
        for at in program.needed(wanted, at_hand):
            if at not in at_hand and nodes[at].op == "input":
                places[at] = self._place(self.chunk.slot_of(at), old)
            elif at not in at_hand and nodes[at].op != "constant":
                order.append(at)
        if registers is not None:
            order = from_the_end(program, order, wanted)
        targets: dict[int, list[str]] = {}
        for slot, at in outputs.items():
            targets.setdefault(at, []).append(self._place(slot, new))
        held = {place: at for at, place in places.items()}
        overwrites = {at: [held[place] for place in found if place in held] for at, found in targets.items()}
        lines: list[str] = []
        touched: set[int] = set()  # loaded or stored since the last barrier
        room = self._room
        for what, at in steps(program, order, places, overwrites, registers, flag):
            kind = nodes[at].kind
            if what == "compute":
                lines += name_all(Python(), program, [at], names)
                continue
            if what == "load":
                if at in touched:
                    lines.append("barrier()")
                    touched.clear()
                names[at] = f"x{at}"
                lines.append(f"{names[at]} = {loaded(kind, places[at])}")
            else:
                if what == "store":
                    stores = [f"s[{room * self.lanes}]"]
                    room += 1
                else:
                    stores = targets[at]
                    name_all(Python(), program, [at], names)  # a constant
                places[at] = stores[0]
                lines += [f"{place} = {stored(kind, names[at])}" for place in stores]
            touched.add(at)
        self.slots = max(self.slots, room)
        return lines if flag is None else [*lines, f"unusual = {names[flag]}"]

    def _place(self, slot: int, side: str = "") -> str:
        """The element of the first lane of a slot; `side` names the elements before the side."""
        place = str(slot * self.lanes)
        return f"s[{side} + {place}]" if side and slot in self.twice else f"s[{place}]"

    def _stage(self, name: str, arguments: str, lines: list[str]) -> str:
        body = "\n".join(f"    {line}" for line in [*lines, "pass"])
        return _STAGE.format(name=name, arguments=arguments, lanes=self.lanes, body=body)


def _choice(yes: list[str], no: list[str]) -> list[str]:
    """The lines `yes` where the flag `unusual` of some lane is true, else the lines `no`."""
    indented = [[f"    {line}" for line in lines] for lines in (yes, no)]
    return ["if any(unusual):", *indented[0], "else:", *indented[1]]


_STAGE = """{name}_of_vector = straight_line('''def {name}_of_vector({arguments}):
{body}
''', {lanes})


@compiled
def {name}({arguments}):
    {name}_of_vector({arguments})
"""

_KEEP = """@compiled
def keep(s, kept, tile):
    for lane in range({lanes}):
        if s[{keep} + lane] != 0.0:
            place = int(s[{filled} + lane]) - 1
            for i in range({width}):
                kept[tile * {lanes} + lane, place, i] = s[{first} + i * {lanes} + lane]
"""

_RUN = """@compiled
def run(S, kept, polls):
    for tile in range(S.shape[0]):
        s = S[tile]
        i, j = int64(0), int64({apart})
        prepare(s)
        share(s)
        for _ in range(polls):
            running = 0
            for lane in range({lanes}):
                running += s[{status} + lane] == 0.0
            if running == 0:
                break
            for _ in range({interval}):
                going = 0
                for lane in range({lanes}):
                    going += s[{halt} + lane] == 0.0
                if going == 0:  # all wait for the poll, and would stay as they are
                    break
                attempt(s, i, j)
                i, j = j, i
            poll(s, i)
            share(s)
            {keep}
        if i != 0:
            back(s)
"""
