"""The order of statements, few values in registers, and fused products and sums: the same numbers."""

from __future__ import annotations

import numpy as np
import pytest

from gaitsweep.engine.kernel import cpu_program
from gaitsweep.engine.kernel import lanes as kernel_lanes
from gaitsweep.engine.kernel.contraction import contracted
from gaitsweep.engine.kernel.lanes import kernel_of
from gaitsweep.engine.kernel.operations import OPERATIONS
from gaitsweep.engine.kernel.program import Program
from gaitsweep.engine.kernel.registers import most_alive, scheduled, steps
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from tests.support.sweeping import run_rows, same

STARTS = {f"psi_{i}": np.random.default_rng(i).uniform(0, 2 * np.pi, 11) for i in (1, 2, 3)}


def random_program(seed: int) -> tuple[Program, list[int], list[int], list[int]]:
    """Sums and products of six inputs; the program, its inputs, its order and what takes their places."""
    random, program = np.random.default_rng(seed), Program()
    inputs = [program.input(k, "f64") for k in range(6)]
    nodes = list(inputs)
    for _ in range(60):
        a, b = random.choice(nodes[-20:], 2)
        nodes.append(program.write(str(random.choice(["add", "sub", "mul"])), int(a), int(b)))
    order = sorted(set(nodes) - set(inputs))
    # among them inputs that change places
    outputs = [*(int(at) for at in random.choice(order, 4, replace=False)), inputs[5], inputs[0]]
    return program, inputs, order, outputs


@pytest.mark.parametrize("registers", [3, 6, None])
@pytest.mark.parametrize("seed", range(8))
def test_slots_are_overwritten_when_they_are_no_longer_needed(seed: int, registers: int | None) -> None:
    program, inputs, order, outputs = random_program(seed)
    start = dict(enumerate(np.random.default_rng(seed).uniform(0.5, 1.5, 6)))
    values = {at: start[k] for k, at in enumerate(inputs)}
    for at in order:
        node = program.nodes[at]
        values[at] = OPERATIONS[node.op].evaluate(*(values[a] for a in node.args))
    memory: dict[object, float] = {**start}
    place: dict[int, object] = {**dict(zip(inputs, range(6), strict=True))}
    hand: dict[int, float] = {}
    overwrites = {at: [inputs[k]] for k, at in enumerate(outputs)}
    for what, at in steps(program, order, inputs, overwrites, registers):
        node = program.nodes[at]
        if what == "load":
            hand[at] = memory[place[at]]
        elif what == "compute":
            hand[at] = OPERATIONS[node.op].evaluate(*(hand[a] for a in node.args))
        else:
            place[at] = outputs.index(at) if what == "write" else ("room", at)
            memory[place[at]] = hand[at]
    assert [memory[k] for k in range(6)] == [values[at] for at in outputs]


def test_fewer_registers_mean_more_loads() -> None:
    program, inputs, order, outputs = random_program(0)
    loads, stores = (
        [
            [what for what, _ in steps(program, order, inputs, {outputs[0]: []}, registers)].count(kind)
            for registers in (None, 8, 4)
        ]
        for kind in ("load", "store")
    )
    assert loads[0] <= len(inputs)
    assert loads[0] < loads[1] < loads[2]
    assert stores[0] == 0 < stores[1] < stores[2]


@pytest.mark.slow
def test_rows_are_the_same_with_few_registers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal to the bit, also alone, with shorter vectors, and beside rows whose events come earlier."""
    model = Multilegged()
    recorder, numerics = CrossingRecorder(model, crossings=2), Numerics(dt=4e-3, method="rk4")
    # what another test has compiled has the machine's own registers and vectors
    monkeypatch.setattr(kernel_lanes, "_compiled", kernel_lanes._compiled.__wrapped__)
    results = []
    for registers, tile, lanes in ((None, cpu_program.TILE, 11), (6, cpu_program.TILE, 1), (28, 2, 11)):
        monkeypatch.setattr(cpu_program, "REGISTERS", registers)
        monkeypatch.setattr(cpu_program, "TILE", tile)
        results.append(run_rows(model, recorder, STARTS, numerics=numerics, lanes=lanes, engine="kernel"))
    same(results[0], results[1])
    same(results[0], results[2])


@pytest.mark.slow
def test_rows_that_wait_alone_are_polled_as_beside_others() -> None:
    """Every attempt of tsit5 may end a row, so that the program has the reason to wait twice."""
    model = Multilegged()
    recorder, numerics = CrossingRecorder(model, crossings=2), Numerics(dt=4e-3, method="tsit5")
    one, other = (
        run_rows(model, recorder, STARTS, numerics=numerics, lanes=lanes, engine="kernel")
        for lanes in (1, 11)
    )
    same(one, other)
    xla = run_rows(model, recorder, STARTS, numerics=numerics, lanes=11, engine="xla")
    np.testing.assert_array_equal(one.status, xla.status)
    np.testing.assert_allclose(one.samples, xla.samples, rtol=0, atol=1e-7)


def test_a_product_in_sums_alone_is_fused_in_all_of_them() -> None:
    """Values written at an event and beside it have the same rounding: each sum is one node."""
    numerics = Numerics(dt=4e-3, method="rk4")
    model = Multilegged()
    chunk = kernel_of(model, CrossingRecorder(model, crossings=2), numerics.resolve(model), None).chunk
    fused = contracted(chunk)
    program = fused.program

    def names(chunk, nodes) -> list[str]:
        return [program.nodes[at].op for at in program.needed(nodes) if not program.steady[at]]

    before, after = names(chunk, chunk.attempt.values()), names(fused, fused.attempt.values())
    fewer = before.count("mul") - after.count("mul")
    assert sum(after.count(op) for op in ("fma", "fms", "fnma")) >= fewer > 50
    assert len(after) == len(before) - fewer
    same_node = [slot for slot, at in chunk.plain.items() if chunk.attempt[slot] == at]
    assert same_node == [slot for slot, at in fused.plain.items() if fused.attempt[slot] == at]


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
