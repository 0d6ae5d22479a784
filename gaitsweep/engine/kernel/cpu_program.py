"""The program of a chunk for the CPU: lanes side by side in a vector register, compiled by Numba.

One flat array holds a tile, the lanes of one vector, slot by slot. Each stage is straight-line code on
vectors. An attempt in which no lane meets an event computes only what it needs: what happens at events, and
what depends on modes alone, is computed where a lane meets one. Rare operations, such as keeping a row, have
a loop over lanes. Each core runs its own tiles, in a thread.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import llvmlite.binding as llvm

from gaitsweep.engine.kernel.cache import module_of
from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.python_source import Python, loaded, stored
from gaitsweep.engine.kernel.source import name_all
from gaitsweep.engine.recorders.recorder import POLL_INTERVAL


def _vector_width() -> int:
    """Numbers of float64 in a vector register of this processor."""
    has = llvm.get_host_cpu_features()
    return 8 if has.get("avx512f") else 4 if has.get("avx") else 2


TILE = _vector_width()  # lanes of a tile

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

    After the program's slots come a flag and a row for the loop that keeps rows, then what plain attempts
    share.
    """

    def __init__(self, chunk: Chunk, lanes: int) -> None:
        self.chunk, self.lanes = chunk, lanes
        self.keep = chunk.n_slots
        self.row = self.keep + 1
        self.shared = {self.row + chunk.width + i: at for i, at in enumerate(chunk.shared)}
        self.slots = self.row + chunk.width + len(self.shared)
        self._steady = {at: slot for slot, at in chunk.steady.items()}

    def stages(self) -> list[str]:
        chunk = self.chunk
        poll = {**chunk.poll, self.keep: chunk.keep, **{self.row + i: at for i, at in enumerate(chunk.row)}}
        return [
            self._stage("prepare", self._stored(chunk.steady, {}, {})),
            self._stage("share", self._stored(self.shared, self._steady, {})),
            self._stage("attempt", self._attempt()),
            self._stage("poll", self._stored(poll, self._steady, {})),
        ]

    def _attempt(self) -> list[str]:
        """An attempt: what happens at an event is computed only if a lane of the tile needs it."""
        chunk, program = self.chunk, self.chunk.program
        at_hand = self._steady | {at: slot for slot, at in self.shared.items()}
        if program.value(chunk.unusual) is False:
            return self._stored(chunk.attempt, at_hand, {})
        plain = {slot: at for slot, at in chunk.plain.items() if not program.is_input(at, slot)}
        names: dict[int, str] = {}
        lines = self._named([*plain.values(), chunk.unusual], at_hand, names)
        unusual = [*self._stored(chunk.attempt, at_hand, names), *self._stored(self.shared, self._steady, {})]
        return [
            *lines,
            f"if any({names[chunk.unusual]}):",
            *(f"    {line}" for line in unusual),
            "else:",
            *(f"    {line}" for line in self._stored(plain, at_hand, names)),
        ]

    def _stored(
        self, outputs: Mapping[int, int], at_hand: Mapping[int, int], names: dict[int, str]
    ) -> list[str]:
        """Lines that compute the nodes `outputs` and store each in its slot."""
        names = dict(names)
        lines = self._named(outputs.values(), at_hand, names)
        kinds = self.chunk.program.nodes
        return lines + [
            f"{self._place(slot)} = {stored(kinds[at].kind, names[at])}" for slot, at in outputs.items()
        ]

    def _named(self, wanted: Iterable[int], at_hand: Mapping[int, int], names: dict[int, str]) -> list[str]:
        """Lines that compute the nodes `wanted`.

        Args:
            wanted: the nodes to compute.
            at_hand: nodes that are in memory, with their slots; inputs need not be named.
            names: names of nodes that are known; what is computed is added.
        """
        program, lines, wanted = self.chunk.program, [], list(wanted)
        for at in program.needed(wanted, at_hand.keys() | names.keys()):
            if at in names:
                continue
            slot = at_hand.get(at)
            if slot is None and program.nodes[at].op == "input":
                slot = self.chunk.slot_of(at)
            if slot is not None:
                names[at] = f"x{at}"
                lines.append(f"{names[at]} = {loaded(program.nodes[at].kind, self._place(slot))}")
        order = program.needed(wanted, names)
        return lines + name_all(Python(), program, order, names)

    def _place(self, slot: int) -> str:
        return f"s[{slot * self.lanes}]"

    def _stage(self, name: str, lines: list[str]) -> str:
        body = "\n".join(f"    {line}" for line in [*lines, "pass"])
        return _STAGE.format(name=name, lanes=self.lanes, body=body)


_STAGE = """{name}_of_vector = straight_line('''def {name}_of_vector(s):
{body}
''', {lanes}, contraction=CONTRACTION)


@compiled
def {name}(s):
    {name}_of_vector(s)
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
                attempt(s)
            poll(s)
            share(s)
            {keep}
"""
