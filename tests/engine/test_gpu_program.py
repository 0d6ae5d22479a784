"""The program for a card on this machine's processor: its C, and whole sweeps thread by thread."""

from __future__ import annotations

import ctypes
import math
import types
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import card_alone
from gaitsweep.cache_folder import cache_folder
from gaitsweep.dynamics.declarations import parameter, variable
from gaitsweep.dynamics.map_model import MapModel
from gaitsweep.engine import stored_traces
from gaitsweep.engine.kernel import cuda_lanes, lanes, philox
from gaitsweep.engine.kernel.operations import OPERATIONS
from gaitsweep.engine.kernel.program import Kind, Program
from gaitsweep.engine.kernel.source import C, c_function, statements
from gaitsweep.engine.kernel.trace import UnsupportedError, traced_function
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.engine.stored_traces import dependences
from gaitsweep.engine.sweep import engine_choice
from gaitsweep.examples.hopper import Hopper
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.status import Status
from plane_maps import Logistic
from tests.support.host_card import HOST_HEAD, HostCard, compiler, library
from tests.support.multilegged_crossings import wrapped
from tests.support.scalar_programs import executable, traced_with
from tests.support.sweeping import run_rows, same
from toy_model import Toy

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C++ compiler")

NUMERICS = Numerics(dt=1e-2)
LAUNCH = np.linspace(0.1, 4.0, 23)
_CTYPES = {"double": ctypes.c_double, "float": ctypes.c_float, "bool": ctypes.c_bool}
_NUMPY = {"double": np.float64, "float": np.float32, "bool": np.bool_}


class Compiled:
    """A program's nodes as a C function of its inputs, which have the kinds `inputs`."""

    def __init__(self, program: Program, inputs: list[int], outputs: list[int], folder: Path) -> None:
        self.types = [C.types[program.nodes[at].kind] for at in inputs]
        self.results = [C.types[program.nodes[at].kind] for at in outputs]
        given = {at: f"x{k}" for k, at in enumerate(inputs)}
        lines, results = statements(C, program, outputs, given)
        lines += [
            f"out[{k}] = {C.stored(program.nodes[at].kind, result)};"
            for k, (at, result) in enumerate(zip(outputs, results, strict=True))
        ]
        parameters = [f"const {kind} {name}" for kind, name in zip(self.types, given.values(), strict=True)]
        head = f"KERNEL void of({', '.join([*parameters, 'double* out'])})"
        self.code = library(HOST_HEAD + philox.IN_C + c_function(head, lines), folder)

    def __call__(self, *values: Any) -> list[Any]:
        out = np.zeros(len(self.results))
        given = [_CTYPES[kind](value) for kind, value in zip(self.types, values, strict=True)]
        self.code.of(*given, ctypes.c_void_p(out.ctypes.data))
        return [_NUMPY[kind](x) for kind, x in zip(self.results, out, strict=True)]


SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3.7, 1e-310, 1e300, math.inf, -math.inf, math.nan]


@pytest.mark.parametrize("kind", ["f64", "f32", "int", "bool"])
def test_every_operation_in_c_is_that_of_numpy(kind: Kind, tmp_path: Path) -> None:
    """Special values included: comparisons with NaN are false but for !=, functions have C's float forms."""
    names = (
        {"and", "or", "not", "eq", "ne", "select"} if kind == "bool" else {*OPERATIONS} - {"and", "or", "not"}
    )
    names -= {"to_f32", "to_f64", "to_int"} if kind == "int" else set()
    program = Program()
    a, b = program.input(0, kind), program.input(1, kind)
    condition = program.input(2, "bool")
    args = {"select": (condition, a, b), **dict.fromkeys(("add", "sub", "mul", "div", "pow"), (a, b))}
    args |= dict.fromkeys(("lt", "le", "eq", "ne", "and", "or"), (a, b))
    args |= dict.fromkeys(("fma", "fms", "fnma", "philox0", "philox1"), (a, b, a))
    nodes = {name: program.write(name, *args.get(name, (a,))) for name in sorted(names)}
    compiled = Compiled(program, [a, b, condition], list(nodes.values()), tmp_path)
    number = _NUMPY[C.types[kind]]
    values = [True, False] if kind == "bool" else SPECIAL
    with np.errstate(all="ignore"):
        points = [(number(x), number(y), flag) for x in values for y in values for flag in (True, False)]
        for x, y, flag in points:
            typed = {a: x, b: y, condition: np.bool_(flag)}
            for (name, at), mine in zip(nodes.items(), compiled(x, y, flag), strict=True):
                if name == "pow" and x == -math.inf and y == 0.5:
                    continue  # NumPy takes the root, which is no number
                theirs = OPERATIONS[name].evaluate(*(typed[k] for k in program.nodes[at].args))
                # a few units of the last place, for functions of two libraries
                near = 1e-6 if kind == "f32" or name == "to_f32" else 1e-15
                np.testing.assert_allclose(mine, theirs, rtol=near, atol=0, err_msg=f"{name}({x}, {y})")


def _of_all_kinds(x: Any, y: Any, n: Any, flag: Any) -> Any:
    sides = (jnp.sin(x) + jnp.floor(y), jnp.exp(y) * x.astype(jnp.float32), jnp.where(flag, x, y), n // 3)
    checks = (jnp.isfinite(x), jnp.argmax(jnp.stack([x, x * x])), x.astype(int) + n, jnp.round(y), ~flag)
    constants = (
        x + 0.1,
        y * jnp.float32(0.1),
        jnp.where(flag, jnp.inf, -1e-12),
        jnp.where(flag, y, -jnp.inf),
    )
    return sides, checks, constants, jnp.arctan2(y, y), jnp.sqrt(x), x**-1.5


@pytest.mark.parametrize("x", [0.7, -0.3, 40.0, 0.0, math.nan, math.inf])
def test_a_program_in_c_is_that_in_python(x: float, tmp_path: Path) -> None:
    traced = traced_with(_of_all_kinds, np.float64(0), np.float32(0), np.int64(0), np.bool_(True))
    compiled = Compiled(traced.program, traced.inputs, traced.outputs, tmp_path)
    inputs = np.float64(x), np.float32(x), np.float64(7), np.bool_(x > 0)
    for mine, theirs in zip(compiled(*inputs), executable(traced)(*inputs), strict=True):
        near = 2e-7 if np.asarray(theirs).dtype == np.float32 else 1e-15
        np.testing.assert_allclose(mine, theirs, rtol=near, atol=near)


@pytest.fixture
def on_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """`run_rows` on a card that this machine's processor stands in for."""

    class CudaDevice(HostCard):
        folder = tmp_path

    monkeypatch.setattr(cuda_lanes, "CudaDevice", CudaDevice)
    device = types.SimpleNamespace(platform="gpu")
    monkeypatch.setattr("tests.support.sweeping.devices_on", lambda platform, engine: [device] * 2)
    return partial(run_rows, engine="kernel")


@pytest.mark.slow
def test_sweeps_thread_by_thread(on_card: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Crossings of the toy: lanes, blocks, devices, and a card of little memory change no bit."""
    recorder, starts = CrossingRecorder(Toy(), crossings=12), {"launch_1": LAUNCH}
    one = on_card(Toy(), recorder, starts, numerics=NUMERICS, lanes=7)
    same(one, on_card(Toy(), recorder, starts, numerics=NUMERICS, lanes=3, devices=2, block=5))
    monkeypatch.setattr(cuda_lanes, "_MOST_NUMBERS", 1)
    monkeypatch.setattr(cuda_lanes, "_FEW_LANES", 1)
    same(one, on_card(Toy(), recorder, starts, numerics=NUMERICS, lanes=7))


@pytest.mark.slow
def test_a_group_has_no_more_lanes_than_memory(on_card: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """No bit of a sweep depends on it, and the benchmark of the kernels fills the lanes that there are."""
    recorder, starts = CrossingRecorder(Toy(), crossings=12), {"launch_1": LAUNCH}
    asked = on_card(Toy(), recorder, starts, numerics=NUMERICS, lanes=14)
    monkeypatch.setattr(cuda_lanes, "_FEW_LANES", 2)
    monkeypatch.setattr(cuda_lanes, "_MOST_NUMBERS", 1)
    same(asked, on_card(Toy(), recorder, starts, numerics=NUMERICS, lanes=14))
    monkeypatch.setattr(card_alone, "local_devices", lambda _: [types.SimpleNamespace(platform="gpu")])
    case = card_alone.Case("toy", Toy(), NUMERICS, {"launch_1": (1.0, 2.0)}, polls=1)
    assert card_alone.measure(case, lanes=7).rate > 0.0


def test_a_known_model_is_not_traced_for_a_card(
    on_card: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second process reads its kernels, whose rows vary in one parameter, from the cache."""
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(stored_traces, "cache_folder", cache_folder)
    monkeypatch.setattr(lanes, "kernel_of", lanes.Kernel)  # not kept between runs

    def run() -> Any:
        params, starts = {"omega": np.array([11.0, 12.0, 13.0])}, {"launch_0": np.full(3, 1.3)}
        recorder = CrossingRecorder(Hopper(), crossings=5)
        return on_card(Hopper(), recorder, starts, params=params, numerics=NUMERICS, lanes=4)

    traced = run()
    monkeypatch.setattr(lanes, "chunk_of", lambda *_: pytest.fail("the model is traced again"))
    same(traced, run())


@pytest.mark.slow
def test_rows_that_the_host_opens_are_those_that_the_card_opens(
    on_card: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A card opens rows itself unless the kernel lacks an operation of a start; no bit depends on it."""

    def run() -> Any:
        params = {"kick": np.array([1.0, 1.0, 1.2, 1.0, 1.1])}
        recorder = CrossingRecorder(Toy(), crossings=4)  # whose first sample is the start
        return on_card(Toy(), recorder, {"launch_1": LAUNCH[:5]}, params=params, numerics=NUMERICS, lanes=2)

    opened: list[bool] = []
    lane_kernels = cuda_lanes.gpu_program.lane_kernels

    def noted(*args: Any, **options: Any) -> Any:
        opened.append(options["from_row"])
        return lane_kernels(*args, **options)

    def unsupported(function: Any, shapes: Any) -> Any:
        if len(shapes) == 2:  # parameters and initial conditions
            raise UnsupportedError("an operation")
        return traced_function(function, shapes)

    monkeypatch.setattr(cuda_lanes.gpu_program, "lane_kernels", noted)
    monkeypatch.setattr(lanes.Kernel, "stored", lambda kernel, name, compute, *others: compute())
    by_card = run()
    cuda_lanes._lane_kernels.cache_clear()
    monkeypatch.setattr(lanes, "traced_function", unsupported)
    same(by_card, run())
    assert [*dict.fromkeys(opened)] == [True, False]


def test_a_thread_for_each_lane_that_runs(on_card: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lanes that have ended take no thread, so that the others fill whole warps."""
    launched: list[int] = []

    class CudaDevice(cuda_lanes.CudaDevice):  # the fixture's
        def threads(self, kernel: Any) -> int:
            return 64

        def launch(self, kernel: Any, threads: int, *args: Any) -> None:
            if len(args) == 6:  # those of `run`
                launched.append(threads)
            super().launch(kernel, threads, *args)

    def run() -> Any:
        # rows end one after the other
        params = {"stiffness": np.geomspace(1.0, 64.0, 16)}
        starts, recorder = {"launch_1": np.full(16, 1.3)}, CrossingRecorder(Toy(), crossings=20)
        return on_card(Toy(), recorder, starts, params=params, numerics=NUMERICS, lanes=32)

    of_three = run()
    monkeypatch.setattr(cuda_lanes, "CudaDevice", CudaDevice)
    monkeypatch.setattr(engine_choice, "KERNEL_POLLS_PER_CHUNK", {"gpu": 1})
    same(of_three, run())
    assert max(launched) == 8  # two groups
    assert min(launched) < 8


@pytest.mark.slow
def test_settling_thread_by_thread(on_card: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows settle as on a CPU, whose compiler contracts other sums."""
    options: dict[str, Any] = {"numerics": NUMERICS, "lanes": 16}
    card = on_card(Toy(), SettleRecorder(Toy()), {"launch_1": LAUNCH}, **options)
    monkeypatch.undo()
    cpu = run_rows(Toy(), SettleRecorder(Toy()), {"launch_1": LAUNCH}, engine="kernel", **options)
    np.testing.assert_array_equal(card.status, cpu.status)
    np.testing.assert_array_equal(card.cycles, cpu.cycles)
    np.testing.assert_allclose(card.last, cpu.last, rtol=0, atol=1e-12)


@pytest.mark.slow("xla")
@pytest.mark.parametrize("other", ["kernel", "xla"])
def test_orbits_thread_by_thread(other: str, on_card: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Periods and all crossings of orbits of the logistic map are those of a CPU."""
    model, r = Logistic(), [2.8, 3.2, 3.5, 3.83, 3.74, 3.9]
    run = model, SettleRecorder(model), {"x_0": np.full(6, 0.3)}
    options: dict[str, Any] = {"numerics": Numerics(dt=1.0), "params": {"r": r}}
    card = on_card(*run, **options)
    monkeypatch.undo()
    cpu = run_rows(*run, engine=other, **options)
    periods, orbits = card.numbers["period"], card.numbers["orbit"]
    np.testing.assert_array_equal(periods, [1, 2, 4, 3, 5, 0])
    np.testing.assert_array_equal(periods, cpu.numbers["period"])
    # two observables at all crossings but one
    np.testing.assert_array_equal(np.isfinite(orbits).sum(axis=1), 2 * np.maximum(periods - 1, 0))
    np.testing.assert_allclose(orbits, cpu.numbers["orbit"], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_exponents_thread_by_thread(on_card: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lyapunov exponents and statuses of the logistic map, whose exponent at r = 4 is ln 2, are a CPU's."""

    class Growth(MapModel):
        r = parameter("1", "rate of growth", 4.0)
        x = variable("1", "population", 0.3)

        def image(self, p: Any, s: Any) -> dict[str, Any]:
            return {"x": p.r * s.x * (1.0 - s.x)}

    model, r = Growth(), [2.8, 3.2, 3.83, 3.9, 4.0]
    run = model, SettleRecorder(model, max_cycles=300, exponents=1), {"x_0": np.full(5, 0.3)}
    options: dict[str, Any] = {"params": {"r": r}}
    card = on_card(*run, **options)
    monkeypatch.undo()
    cpu = run_rows(*run, engine="kernel", **options)
    np.testing.assert_array_equal(card.status, cpu.status)
    assert [Status(status).name for status in card.status] == ["settled"] * 3 + ["chaotic"] * 2
    np.testing.assert_allclose(card.numbers["lyapunov_1"][:3], cpu.numbers["lyapunov_1"][:3], rtol=1e-9)
    # of chaotic rows single crossings differ by rounding that grows, their means by less than their errors
    assert card.numbers["lyapunov_1"][4] == pytest.approx(np.log(2.0), rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("contraction", [True, False])
def test_the_chain_thread_by_thread(on_card: Any, contraction: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(3)
    starts = {f"psi_{i}": random.uniform(0, 2 * np.pi, 4) for i in (1, 2, 3)}
    recorder = CrossingRecorder(Multilegged(), crossings=2)
    numerics = Numerics(dt=32e-3, method="propagator6", contraction=contraction)
    card = on_card(Multilegged(), recorder, starts, numerics=numerics, lanes=4)
    monkeypatch.undo()
    cpu = run_rows(Multilegged(), recorder, starts, numerics=numerics, lanes=4, engine="kernel")
    np.testing.assert_array_equal(card.status, cpu.status)
    if contraction:
        # two compilers contract different sums, and rounding grows to some 1e-13 on the way
        assert wrapped(card.samples[:, 2:5] - cpu.samples[:, 2:5]).max() < 1e-10
    else:
        np.testing.assert_array_equal(card.samples, cpu.samples)


@pytest.mark.slow
def test_constants_that_differ_between_rows(on_card: Any) -> None:
    """Only constants that all rows share are in constant memory; results are the same."""
    starts = {"launch_1": np.full(20, 1.3)}
    recorder = CrossingRecorder(Toy(), crossings=6)
    alike, mixed = (
        on_card(
            Toy(),
            recorder,
            starts,
            params={"kick": np.where(np.arange(20) < 19, 1.0, other)},
            numerics=NUMERICS,
            lanes=8,
        )
        for other in (1.0, 1.2)
    )
    width = alike.samples.shape[1]
    np.testing.assert_array_equal(*(r.samples.reshape(20, -1, width)[:19] for r in (alike, mixed)))
    assert np.any(alike.last[19] != mixed.last[19])


@pytest.mark.slow
def test_sweeps_that_vary_the_same_constants_share_a_kernel(
    on_card: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They share it whether or not their rows have equal values; results equal those of own kernels."""
    running: dict[frozenset[str], set[str]] = {}

    class CudaDevice(cuda_lanes.CudaDevice):  # the fixture's
        def module(self, source: str, *, contraction: bool = True) -> Any:
            if "KERNEL void run" in source:
                running[varied].add(source)
            return super().module(source, contraction=contraction)

    monkeypatch.setattr(cuda_lanes, "CudaDevice", CudaDevice)
    recorder, starts = CrossingRecorder(Toy(), crossings=4), {"launch_1": np.full(8, 1.3)}
    results = {}
    for varied in (frozenset[str](), frozenset({"kick"})):
        running[varied] = set()
        for other in (1.0, 1.2):
            kicks = np.array([1.0, other, other, 1.0] * 2)
            options: dict[str, Any] = {"params": {"kick": kicks}, "numerics": NUMERICS, "lanes": 4}
            results[varied, other] = on_card(Toy(), recorder, starts, varied=varied, **options)
    assert [len(sources) for sources in running.values()] == [2, 1]
    for other in (1.0, 1.2):
        same(*(results[varied, other] for varied in running))


def test_constants_that_depend_on_varied_parameters() -> None:
    """Through a function that is compiled by itself too."""

    @jax.jit
    def inner(x: Any) -> Any:
        return 2 * x

    def constants(values: Any, starts: Any) -> Any:
        return {"a": inner(values["x"]), "b": values["y"] * 3, "c": jnp.ones(()), "d": starts["x"] + 1}

    shape = jax.ShapeDtypeStruct((), jnp.float64)
    result = dependences(constants, {"x": shape, "y": shape}, {"x": shape})
    assert ["y" in names for names in result] == [False, True, False, False]
    assert ["x" in names for names in result] == [True, False, False, True]
