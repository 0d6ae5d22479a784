"""The program of a chunk for the CPU: lanes side by side in vector registers, compiled by Numba.

One flat array holds a tile of lanes, slot by slot. Each stage is a loop over the lanes of a tile around
straight-line code, which LLVM vectorises. Rare operations, such as keeping a row, have a loop of their own.
Each core runs its own tiles, in a thread.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any

from gaitsweep.engine.kernel.cache import module_of
from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.python_source import Python, loaded, stored
from gaitsweep.engine.kernel.source import statements
from gaitsweep.engine.recorders.recorder import POLL_INTERVAL

# Lanes of a tile: two vectors of 8, so that one computes while the other waits for its results.
TILE = 16

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
    import llvmlite.binding as llvm

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
    steady = {at: f"s[{slot * lanes} + lane]" for slot, at in chunk.steady.items()}
    row = {chunk.n_slots + 1 + i: at for i, at in enumerate(chunk.row)}
    poll = {**chunk.poll, **row, chunk.n_slots: chunk.keep}
    status = chunk.record.status.first
    parts = [
        _PREAMBLE.format(title=title, contraction=contraction),
        _stage("prepare", chunk, chunk.steady, {}, lanes),
        _stage("attempt", chunk, chunk.attempt, steady, lanes),
        _stage("poll", chunk, poll, steady, lanes),
        _KEEP.format(
            lanes=lanes,
            keep=chunk.n_slots * lanes,
            filled=chunk.record.filled.first * lanes,
            first=chunk.n_slots + 1,
            width=chunk.width,
        )
        if chunk.width
        else "",
        _RUN.format(
            lanes=lanes,
            interval=POLL_INTERVAL,
            status=status * lanes,
            halt=chunk.carry.halt.first * lanes,
            keep="keep(s, kept, tile)" if chunk.width else "pass",
        ),
    ]
    return "\n\n".join(part for part in parts if part)


def slots(chunk: Chunk) -> int:
    """The number of slots of a lane: the program's, then a flag and a row for the loop that keeps rows."""
    return chunk.n_slots + 1 + chunk.width


def _stage(name: str, chunk: Chunk, outputs: dict[int, int], given: dict[int, str], lanes: int) -> str:
    program = chunk.program
    wanted = list(outputs.values())
    names = dict(given)
    loads = []
    for at in program.needed(wanted, given):
        node = program.nodes[at]
        if at in given or node.op == "input":
            place = given[at] if at in given else f"s[{chunk.slot_of(at) * lanes} + lane]"
            names[at] = f"x{at}"
            loads.append(f"{names[at]} = {loaded(node.kind, place)}")
    lines, results = statements(Python(), program, wanted, names)
    stores = [
        f"s[{slot * lanes} + lane] = {stored(program.nodes[at].kind, result)}"
        for slot, at, result in zip(outputs, wanted, results, strict=True)
    ]
    body = "\n".join(f"    {line}" for line in [*loads, *lines, *stores, "pass"])
    return _STAGE.format(name=name, lanes=lanes, body=body)


_STAGE = """{name}_of_lane = straight_line('''def {name}_of_lane(s, lane):
{body}
''', contraction=CONTRACTION)


@compiled
def {name}(s):
    for lane in range({lanes}):
        {name}_of_lane(s, lane)
"""

_KEEP = """@compiled
def keep(s, kept, tile):
    for lane in range({lanes}):
        if s[{keep} + lane] != 0.0:
            place = int(s[{filled} + lane]) - 1
            for i in range({width}):
                kept[tile * {lanes} + lane, place, i] = s[({first} + i) * {lanes} + lane]
"""

_RUN = """@compiled
def run(S, kept, polls):
    for tile in range(S.shape[0]):
        s = S[tile]
        prepare(s)
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
            {keep}
"""
