"""The order of statements that needs few registers."""

from __future__ import annotations

import pytest

from gaitsweep.engine.kernel.lanes import kernel_of
from gaitsweep.engine.kernel.program import Program
from gaitsweep.engine.kernel.schedule import most_alive, scheduled
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.crossings import CrossingRecorder
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged


def test_values_that_are_alive() -> None:
    """A sum of four squares, which take the places of their inputs."""
    program = Program()
    x = [program.input(k, "f64") for k in range(4)]
    squares = [program.write("mul", a, a) for a in x]
    total = squares[0]
    sums = [total := program.write("add", total, square) for square in squares[1:]]
    assert most_alive(program, [*squares, *sums], [total]) == 5
    best = scheduled(program, [total], {})
    assert most_alive(program, best, [total]) <= 5
    assert best[-1] == total


def test_inputs_of_many_outputs_are_not_computed_early() -> None:
    """Products that one late sum reads are computed where they are read."""
    program = Program()
    x = program.input(0, "f64")
    scaled = [program.write("mul", x, program.constant(float(k), "f64")) for k in range(2, 12)]
    total = x
    for value in scaled:
        total = program.write("add", program.write("sqrt", total), value)
    assert most_alive(program, program.needed([total], {x}), [total]) > 10
    assert most_alive(program, scheduled(program, [total], {x}), [total]) <= 4


@pytest.mark.parametrize("method", ["rk4", "propagator6"])
def test_a_scheduled_program_is_complete_and_in_order(method: str) -> None:
    model = Multilegged()
    numerics = Numerics(dt=4e-3, method=method)
    chunk = kernel_of(model, CrossingRecorder(model, crossings=3), numerics.resolve(model), None).chunk
    program, wanted = chunk.program, list(chunk.attempt.values())
    fields = {at for at, node in enumerate(program.nodes) if node.op == "input"} | set(chunk.steady.values())
    order = scheduled(program, wanted, fields)
    place = {at: k for k, at in enumerate(order)}
    needed = [
        at for at in program.needed(wanted, fields) if at not in fields and program.nodes[at].op != "constant"
    ]
    assert sorted(order) == needed
    for at in order:
        assert all(place[a] < place[at] for a in program.nodes[at].args if a in place)
    assert most_alive(program, order, wanted) <= most_alive(program, needed, wanted)
