"""The program of a chunk for the CPU: lanes side by side in vector registers, compiled by Numba.

One flat array holds a tile of lanes, slot by slot. Each stage is a loop over the lanes of a tile around
straight-line code, which LLVM vectorises. Rare operations, such as keeping a row, have a loop of their own.
Each core runs its own tiles, in a thread.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gaitsweep.engine.kernel.cache import module_of
from gaitsweep.engine.kernel.chunk import Chunk
from gaitsweep.engine.kernel.python_source import loaded, statements, stored
from gaitsweep.engine.recorders.recorder import POLL_INTERVAL

# Lanes of a tile: two vectors of 8, so that one computes while the other waits for its results.
TILE = 8
VECTOR = 8

_PREAMBLE = """# Written by gaitsweep: {title}
from numba import njit

from gaitsweep.engine.kernel.llvm_code import CpuCalls, straight_line

compiled = njit(nogil=True, cache=True, error_model="numpy", boundscheck=False)
"""


def compiled(chunk: Chunk, title: str) -> Callable[[Any, Any, int], None]:
    """The function `run` of `source`, compiled now or loaded from the cache of kernels."""
    _prefer_wide_vectors()
    return module_of(source(chunk, TILE, title)).run


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


def source(chunk: Chunk, lanes: int, title: str) -> str:
    """The source of the module for a CPU; its `run(S, kept, polls)` advances all tiles by a chunk.

    `S` (tiles, slots * lanes) float64; `kept` (tiles * lanes, BUFFER, width) receives the rows to keep.
    """
    steady = {at: f"s[{slot * lanes} + lane]" for slot, at in chunk.steady.items()}
    row = {chunk.n_slots + 1 + i: at for i, at in enumerate(chunk.row)}
    settled = {chunk.n_slots + 1 + chunk.width + i: at for i, at in enumerate(chunk.settled)}
    poll = {**chunk.poll, **row, chunk.n_slots: chunk.keep}
    status = chunk.record.status.first
    parts = [
        _PREAMBLE.format(title=title),
        _stage("prepare", chunk, chunk.steady, {}, lanes),
        _stage("settle", chunk, settled, steady, lanes),
        _attempt(chunk, steady, settled, lanes),
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
    """The number of slots of a lane: the program's, a flag and a row for the loop that keeps rows, settled values."""
    return chunk.n_slots + 1 + chunk.width + len(chunk.settled)


def _stage(name: str, chunk: Chunk, outputs: dict[int, int], given: dict[int, str], lanes: int) -> str:
    lines, _ = _block(chunk, outputs, given, lanes, ())
    return _function(name, lines, lanes)


def _attempt(chunk: Chunk, given: dict[int, str], settled: dict[int, int], lanes: int) -> str:
    """An attempt: what happens at an event is computed only if a lane of the vector needs it."""
    anew, _ = _block(chunk, settled, given, lanes, ())
    given = given | {at: f"s[{slot * lanes} + lane]" for slot, at in settled.items()}
    if chunk.program.value(chunk.rare) is False:
        return _stage("attempt", chunk, chunk.attempt, given, lanes)
    moved = {slot: at for slot, at in chunk.plain.items() if not chunk.program.is_input(at, slot)}
    lines, names = _block(chunk, {}, given, lanes, [*moved.values(), chunk.rare])
    rare, _ = _block(chunk, chunk.attempt, given, lanes, (), names)
    plain, _ = _block(chunk, moved, given, lanes, (), names)
    lines += [f"if any({names[chunk.rare]}):", *(f"    {each}" for each in [*rare, *anew])]
    lines += ["else:", *(f"    {each}" for each in plain)]
    return _function("attempt", lines, lanes)


def _block(
    chunk: Chunk,
    outputs: dict[int, int],
    given: dict[int, str],
    lanes: int,
    wanted: Sequence[int],
    known: Mapping[int, str] | None = None,
) -> tuple[list[str], dict[int, str]]:
    """Lines that load what is needed, compute it and store `outputs`; the names of all nodes computed.

    Args:
        chunk: the program.
        outputs: the nodes to store, by slot.
        given: the places in memory of nodes that are not inputs.
        lanes: lanes of a tile.
        wanted: more nodes to compute.
        known: names of nodes that are computed already.
    """
    program = chunk.program
    names = dict(known or {})
    wanted = [*outputs.values(), *wanted]
    lines = []
    for at in program.needed(wanted, given.keys() | names.keys()):
        node = program.nodes[at]
        if at not in names and (at in given or node.op == "input"):
            place = given[at] if at in given else f"s[{chunk.slot_of(at) * lanes} + lane]"
            names[at] = f"x{at}"
            lines.append(f"{names[at]} = {loaded(node.kind, place)}")
    more, results = statements(program, wanted, names)
    names.update(zip(wanted, results, strict=True))
    names.update({int(each[1:]): each for line in more if (each := line.split(" = ")[0])[0] == "v"})
    stores = [
        f"s[{slot * lanes} + lane] = {stored(program.nodes[at].kind, names[at])}"
        for slot, at in outputs.items()
    ]
    return [*lines, *more, *stores], names


def _function(name: str, lines: list[str], lanes: int) -> str:
    body = "\n".join(f"    {line}" for line in [*lines, "pass"])
    return _STAGE.format(name=name, lanes=lanes, vector=VECTOR, body=body)


_STAGE = """{name}_of_vector = straight_line(CpuCalls, '''def {name}_of_vector(s, lane):
{body}
''', {vector})


@compiled
def {name}(s):
    for lane in range(0, {lanes}, {vector}):
        {name}_of_vector(s, lane)
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
        settle(s)
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
            settle(s)
            {keep}
"""
