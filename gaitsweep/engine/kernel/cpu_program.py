"""The program of a chunk for the CPU: lanes side by side in a vector register, compiled by Numba.

One flat array holds a tile, the lanes of one vector, slot by slot. Each stage is straight-line code on
vectors. An attempt in which no lane meets an event computes only what it needs: what happens at events, and
what depends on modes alone, is computed where a lane meets one. Rare operations, such as keeping a row, have
a loop over lanes. Each core runs its own tiles, in a thread.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import llvmlite.binding as llvm

from gaitsweep.engine.kernel.cache import module_of
from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.python_source import Python, loaded, stored
from gaitsweep.engine.kernel.registers import depth_first, steps
from gaitsweep.engine.kernel.source import name_all
from gaitsweep.engine.recorders.recorder import POLL_INTERVAL


def _vector_width() -> int:
    """Numbers of float64 in a vector register of this processor."""
    has = llvm.get_host_cpu_features()
    return 8 if has.get("avx512f") else 4 if has.get("avx") else 2


TILE = _vector_width()  # lanes of a tile
import os as _os
REGISTERS = int(_os.environ.get("REGS", {8: 28, 4: 14, 2: 14}[TILE]))

_PREAMBLE = """# Written by gaitsweep: {title}
from numba import njit

from gaitsweep.engine.kernel.llvm_code import straight_line

CONTRACTION = {contraction}
compiled = njit(nogil=True, cache=True, error_model="numpy", boundscheck=False)
"""


def compiled(chunk: Chunk, title: str, *, contraction: bool = True) -> Callable[[Any, Any, int], None]:
    """The function `run` of `source`, compiled now or loaded from the cache of kernels."""
    _prefer_wide_vectors()
    return module_of(source(chunk, TILE, title, contraction=contraction)).run


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
    tile = _Tile(chunk, lanes)
    parts = [
        _PREAMBLE.format(title=title, contraction=contraction),
        *tile.stages(),
        _KEEP.format(
            lanes=lanes,
            keep=tile.keep * lanes,
            filled=chunk.record.filled.first * lanes,
            first=tile.row * lanes,
            width=chunk.width,
        )
        if chunk.width
        else "",
        _RUN.format(
            lanes=lanes,
            interval=POLL_INTERVAL,
            apart=tile.apart * lanes if tile.splits else 0,
            status=chunk.record.status.first * lanes,
            halt=chunk.carry.halt.first * lanes,
            keep="keep(s, kept, tile)" if chunk.width else "pass",
        ),
    ]
    return "\n\n".join(part for part in parts if part)


def slots(chunk: Chunk) -> int:
    """The number of slots of a lane: those of `_Tile`."""
    return _Tile(chunk, 1).slots


class _Tile:
    """The stages of a tile, and its slots.

    After the program's slots come a flag and a row for the loop that keeps rows, what plain attempts share,
    and values that a stage loads again. The slots that every plain attempt changes are there twice, `apart`
    slots from each other: an attempt reads one side, `i`, and writes the other, `j`.
    """

    def __init__(self, chunk: Chunk, lanes: int) -> None:
        self.chunk, self.lanes = chunk, lanes
        program = chunk.program
        self.keep = chunk.n_slots
        self.row = self.keep + 1
        self.shared = {self.row + chunk.width + i: at for i, at in enumerate(chunk.shared)}
        self._steady = {at: slot for slot, at in chunk.steady.items()}
        self.splits = program.value(chunk.unusual) is not False
        self.plain = chunk.changed if self.splits else {}
        end = self.row + chunk.width + len(self.shared)
        self.apart = end - min(self.plain, default=end)
        self._scratch = end + max(self.plain, default=0) - min(self.plain, default=0) + 1
        self.slots = self._scratch
        self._stages = self._written()

    def stages(self) -> list[str]:
        return self._stages

    def _written(self) -> list[str]:
        chunk = self.chunk
        poll = {**chunk.poll, self.keep: chunk.keep, **{self.row + i: at for i, at in enumerate(chunk.row)}}
        back = [f"{self._place(slot)} = {self._place(slot, self.apart)}" for slot in self.plain]
        return [
            self._stage("prepare", self._stored(chunk.steady, {})),
            self._stage("share", self._stored(self.shared, self._steady)),
            self._stage("attempt", self._attempt(), "s, i, j"),
            self._stage("poll", self._stored(poll, self._steady, "i"), "s, i"),
            self._stage("back", back),
        ]

    def _attempt(self) -> list[str]:
        """An attempt: what happens at an event is computed only if a lane of the tile needs it."""
        chunk, program = self.chunk, self.chunk.program
        at_hand = self._steady | {at: slot for slot, at in self.shared.items()}
        places = {at: self._place(slot) for at, slot in at_hand.items()}
        if not self.splits:
            return self._computed(chunk.attempt, [], places, "")
        lines = self._computed(self.plain, [chunk.unusual], places, "i", "j")
        flag = self._flag
        written = {at: self._place(slot, "j") for slot, at in self.plain.items() if program.nodes[at].args}
        others = {slot: at for slot, at in chunk.attempt.items() if self.plain.get(slot) != at}
        unusual = [
            *self._computed(others, [], places | written, "i", "j"),
            "barrier()",
            *self._stored(self.shared, self._steady),
        ]
        return [*lines, f"if any({flag}):", "    barrier()", *(f"    {line}" for line in unusual), "else:", "    pass"]

    def _computed(
        self,
        outputs: Mapping[int, int],
        wanted: Sequence[int],
        places: Mapping[int, str],
        old: str,
        new: str = "",
    ) -> list[str]:
        """Lines that compute the nodes `outputs`, by slot, and `wanted`, with few values in registers.

        Args:
            outputs: the nodes to write, by slot.
            wanted: nodes that are needed in registers at the end.
            places: where nodes are in memory; inputs are in their slots.
            old, new: the sides from which inputs are read and to which outputs are written.
        """
        program = self.chunk.program
        nodes = program.nodes
        order = depth_first(program, [*outputs.values(), *wanted], places.keys())
        reached = program.needed([*outputs.values(), *wanted], places.keys())
        places = dict(places)
        for at in reached:
            if nodes[at].op == "input" and at not in places:
                places[at] = self._place(self.chunk.slot_of(at), old)
        content = {place: at for at, place in places.items()}
        targets: dict[int, list[str]] = {}
        for slot, at in outputs.items():
            targets.setdefault(at, []).append(self._place(slot, new))
        overwrites = {at: [content[place] for place in found if place in content] for at, found in targets.items()}
        names: dict[int, str] = {}
        lines: list[str] = []
        known = set()  # what has been loaded or stored since the last barrier
        scratch = self._scratch
        for what, at in steps(program, order, places.keys(), overwrites, REGISTERS, flags=self.lanes < 8):
            kind = nodes[at].kind
            if what == "compute":
                lines += name_all(Python(), program, [at], names)
            elif what == "load":
                if at in known:
                    lines.append("barrier()")
                    known.clear()
                known.add(at)
                names[at] = f"x{at}"
                lines.append(f"{names[at]} = {loaded(kind, places[at])}")
            elif what == "store":
                places[at] = f"s[{scratch * self.lanes}]"
                scratch += 1
                known.add(at)
                lines.append(f"{places[at]} = {stored(kind, names[at])}")
            else:
                if at not in names:
                    name_all(Python(), program, [at], names)
                lines += [f"{place} = {stored(kind, names[at])}" for place in targets[at]]
                if at in order:
                    places[at] = targets[at][0]
                    known.add(at)
        self.slots = max(self.slots, scratch)
        for at in wanted:
            self._flag = names[at]
        return lines

    def _stored(self, outputs: Mapping[int, int], at_hand: Mapping[int, int], side: str = "") -> list[str]:
        """Lines that compute the nodes `outputs` and store each in its slot; the compiler orders them.

        Args:
            outputs: the nodes, by slot.
            at_hand: nodes that are in memory, with their slots; inputs need not be named.
            side: the side of slots that are there twice.
        """
        program, names = self.chunk.program, {}
        lines: list[str] = []
        for at in program.needed(outputs.values(), at_hand):
            slot = at_hand.get(at)
            if slot is None and program.nodes[at].op == "input":
                slot = self.chunk.slot_of(at)
            if slot is not None:
                names[at] = f"x{at}"
                lines.append(f"{names[at]} = {loaded(program.nodes[at].kind, self._place(slot, side))}")
        lines += name_all(Python(), program, program.needed(outputs.values(), names), names)
        kinds = program.nodes
        return lines + [
            f"{self._place(slot, side)} = {stored(kinds[at].kind, names[at])}" for slot, at in outputs.items()
        ]

    def _place(self, slot: int, side: str | int = "") -> str:
        """The first lane of a slot; `side` is a number of slots, or a name of the numbers before it."""
        if isinstance(side, int):
            return f"s[{(slot + side) * self.lanes}]"
        return f"s[{side} + {slot * self.lanes}]" if side and slot in self.plain else f"s[{slot * self.lanes}]"

    def _stage(self, name: str, lines: list[str], arguments: str = "s") -> str:
        body = "\n".join(f"    {line}" for line in [*lines, "pass"])
        return _STAGE.format(name=name, lanes=self.lanes, body=body, arguments=arguments)


_STAGE = """{name}_of_vector = straight_line('''def {name}_of_vector({arguments}):
{body}
''', {lanes}, contraction=CONTRACTION)


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
        i, j = 0, {apart}
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
