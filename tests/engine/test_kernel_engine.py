"""The scalar kernels against the XLA engine: the same rows, whatever the recorder, lanes and devices."""

from __future__ import annotations

import dataclasses
import importlib.util
import re
import subprocess
import sys
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
import pytest

from firing_neuron import Neuron
from gaitsweep.engine.kernel import cpu_program, llvm_code
from gaitsweep.engine.kernel.lanes import kernel_of
from gaitsweep.engine.kernel.operations import OPERATIONS
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.parameter_schedules import RampSchedule
from gaitsweep.engine.recorders.recorder import Recorder
from gaitsweep.engine.recorders.recordings import CrossingRecorder, TraceRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.engine.sweep.engine_choice import EngineError, choose
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.status import Status
from tests.support import environment
from tests.support.multilegged_crossings import wrapped
from tests.support.scalar_programs import native
from tests.support.sweeping import run_rows, same
from toy_model import Toy

LAUNCH = np.linspace(0.1, 4.0, 23)
NUMERICS = Numerics(dt=1e-2)


@pytest.fixture(scope="module", autouse=True)
def empty_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """An empty cache of compiled kernels, so that these tests compile theirs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GAITSWEEP_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


def with_both_engines(recorder: Recorder, starts: Mapping[str, Any], **options: Any) -> list[RowOutcome]:
    return [run_rows(recorder.model, recorder, starts, engine=name, **options) for name in ("kernel", "xla")]


def assert_agree(kernel: RowOutcome, xla: RowOutcome, tolerance: float) -> None:
    """Compare all but the attempts: the last bits decide how many trials locate an event."""
    np.testing.assert_array_equal(kernel.status, xla.status)
    np.testing.assert_array_equal(kernel.cycles, xla.cycles)
    np.testing.assert_array_equal(kernel.owner, xla.owner)
    np.testing.assert_allclose(kernel.last, xla.last, rtol=0, atol=tolerance)
    np.testing.assert_allclose(kernel.samples, xla.samples, rtol=0, atol=tolerance)


@pytest.mark.slow
def test_settling_with_kernels_as_with_xla() -> None:
    kernel, xla = with_both_engines(SettleRecorder(Toy()), {"launch_1": LAUNCH}, numerics=NUMERICS, lanes=4)
    assert_agree(kernel, xla, 1e-12)
    np.testing.assert_array_equal(kernel.labels["gait"], xla.labels["gait"])


def test_rows_are_independent_of_lanes_blocks_devices_and_order() -> None:
    """Results are equal to the last bit."""
    options = {"numerics": NUMERICS, "engine": "kernel"}
    one = run_rows(Toy(), SettleRecorder(Toy()), {"launch_1": LAUNCH}, lanes=4, **options)
    same(
        one,
        run_rows(Toy(), SettleRecorder(Toy()), {"launch_1": LAUNCH}, lanes=40, devices=2, block=5, **options),
    )
    order = np.random.default_rng(0).permutation(LAUNCH.size)
    other = run_rows(Toy(), SettleRecorder(Toy()), {"launch_1": LAUNCH[order]}, lanes=17, **options)
    np.testing.assert_array_equal(one.t_end[order], other.t_end)
    np.testing.assert_array_equal(one.last[order], other.last)


@pytest.mark.slow("xla")
@pytest.mark.parametrize("engine", ["kernel", "xla"])
def test_fewer_rows_than_devices(engine: str) -> None:
    options = {"numerics": NUMERICS, "engine": engine, "lanes": 4}
    one, two = (
        run_rows(Toy(), CrossingRecorder(Toy(), crossings=3), {"launch_1": LAUNCH[:1]}, devices=n, **options)
        for n in (1, 2)
    )
    same(one, two)


@pytest.mark.slow
def test_failed_rows_do_not_change_others() -> None:
    """Rows that fall, start at NaN or diverge run beside rows that settle."""
    launch = np.array([1.0, np.nan, 2.0, 1e200, 40.0, 0.5])
    params = {"ceiling": np.array([1000.0, 1000.0, 1000.0, 1e300, 1.0, 1000.0])}
    kernel, xla = with_both_engines(
        SettleRecorder(Toy(), max_cycles=40), {"launch_1": launch}, params=params, numerics=NUMERICS, lanes=8
    )
    np.testing.assert_array_equal(kernel.status, xla.status)
    assert Status(kernel.status[1]) is Status.not_a_number
    assert {Status(kernel.status[3]), Status(kernel.status[4])} == {Status.diverged, Status.fell}
    sound = [0, 2, 5]
    alone = run_rows(
        Toy(),
        SettleRecorder(Toy(), max_cycles=40),
        {"launch_1": launch[sound]},
        numerics=NUMERICS,
        engine="kernel",
    )
    np.testing.assert_array_equal(kernel.last[sound], alone.last)


@pytest.mark.slow
def test_traces_and_ramps() -> None:
    trace = TraceRecorder(Toy(), duration=5.0, every=0.05, after_cycles=1)
    kernel, xla = with_both_engines(trace, {"launch_1": LAUNCH[:5]}, lanes=4)
    assert_agree(kernel, xla, 1e-10)
    path = RampSchedule((1.0, 2.0, 1.0), rate=0.02)

    def drive(values, t):
        return Toy().params({**values, "kick": path.at(t)})

    kernel, xla = with_both_engines(
        CrossingRecorder(Toy(), duration=path.duration),
        {"launch_1": [0.5, 2.0]},
        numerics=NUMERICS,
        drive=drive,
    )
    assert len(kernel.samples) > 40, "more crossings than a buffer holds"
    assert_agree(kernel, xla, 1e-9)


@pytest.mark.slow
def test_a_neuron_that_fires() -> None:
    model = Neuron()
    kernel, xla = with_both_engines(
        CrossingRecorder(model, crossings=5), {q.name: np.array([0.1]) for q in model.initial_conditions}
    )
    assert_agree(kernel, xla, 1e-10)


@pytest.mark.slow
def test_single_precision() -> None:
    numerics = Numerics(dt=1e-2, precision="float32")
    kernel, xla = with_both_engines(
        SettleRecorder(Toy(), tolerance=1e-2), {"launch_1": LAUNCH}, numerics=numerics, lanes=8
    )
    np.testing.assert_array_equal(kernel.status, xla.status)
    np.testing.assert_allclose(kernel.last, xla.last, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "dt"), [("rk4", 4e-3), ("propagator6", 32e-3)])
def test_the_chain_with_kernels_as_with_xla(method: str, dt: float) -> None:
    """The tolerance is the documented 1e-9 over ten crossings; rounding errors alone grow to about 1e-11."""
    random = np.random.default_rng(3)
    starts = {f"psi_{i}": random.uniform(0, 2 * np.pi, 12) for i in (1, 2, 3)}
    kernel, xla = with_both_engines(
        CrossingRecorder(Multilegged(), crossings=10),
        starts,
        numerics=Numerics(dt=dt, method=method),
        devices=2,
    )
    np.testing.assert_array_equal(kernel.status, xla.status)
    assert wrapped(kernel.samples[:, 2:5] - xla.samples[:, 2:5]).max() < 1e-9


def test_lanes_run_in_vector_registers() -> None:
    """LLVM vectorises the loop over lanes, so that nearly all arithmetic of an attempt is packed."""
    if not llvm.get_host_cpu_features().get("avx2"):
        pytest.skip("this processor has no AVX2")
    recorder = CrossingRecorder(Multilegged(), crossings=10)
    kernel = kernel_of(Multilegged(), recorder, Numerics(dt=4e-3, method="rk4").resolve(Multilegged()), None)
    module = cpu_program.Tile(kernel.chunk, cpu_program.TILE, contraction=True).module()
    assembly = llvm_code._target_machine().emit_assembly(llvm_code._optimised(module))
    packed = len(re.findall(r"\tv(?:f[n]?m\w+|add|sub|mul)pd\t.*[yz]mm", assembly))
    single = len(re.findall(r"\tv(?:f[n]?m\w+|add|sub|mul|div)sd\t", assembly))
    assert packed > 300
    assert single < packed / 20
    # the stack, to which registers are spilled, is aligned to cache lines
    assert re.search(rf"\tandq\t\$-{8 * cpu_program.TILE}, %rsp", assembly)


@pytest.mark.slow
def test_a_second_process_loads_the_compiled_kernel(tmp_path: Path) -> None:
    script = (
        "import numpy as np\n"
        "from gaitsweep.engine.kernel import llvm_code\n"
        "compiled, compile_ = [], llvm_code.machine_code\n"
        "llvm_code.machine_code = lambda module, **o: compiled.append(1) or compile_(module, **o)\n"
        "from tests.support.sweeping import run_rows\n"
        "from toy_model import Toy\n"
        "from gaitsweep.engine.recorders.settle import SettleRecorder\n"
        "run_rows(Toy(), SettleRecorder(Toy(), max_cycles=33), {'launch_1': np.ones(3)}, engine='kernel')\n"
        "print(len(compiled))\n"
    )
    compiled = [
        subprocess.run(
            [sys.executable, "-c", script],
            env=environment(JAX_ENABLE_X64="1", GAITSWEEP_CACHE=str(tmp_path)),
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for _ in range(2)
    ]
    assert compiled == ["3\n", "0\n"]  # three kernels: they open rows, advance them and label their gaits


@dataclasses.dataclass(frozen=True)
class Factorising(Toy):
    """A model whose flow has a Cholesky factorisation, which kernels do not support."""

    def flow(self, params, state):
        rates = super().flow(params, state)
        size = jnp.linalg.cholesky(jnp.eye(2) * params.mass)[0, 0]
        return {**rates, "speed": rates["speed"] * size}


def test_a_gpu_without_its_packages_uses_xla() -> None:
    if importlib.util.find_spec("cuda") is not None:
        pytest.skip("NVIDIA's packages are installed")
    card = types.SimpleNamespace(platform="gpu")
    engine, reason = choose("auto", card, Toy(), SettleRecorder(Toy()), NUMERICS.resolve(Toy()), None)
    assert (engine, reason) == ("xla", "the package cuda-core is not installed")


def test_models_that_kernels_do_not_support_use_xla() -> None:
    device = jax.local_devices()[0]
    model = Factorising()
    engine, note = choose("auto", device, model, SettleRecorder(model), NUMERICS.resolve(model), None)
    assert engine == "xla"
    assert note is not None
    assert "cholesky" in note
    assert "test_kernel_engine.py" in note
    with pytest.raises(EngineError, match=r"engine\.name is kernel, but .*cholesky"):
        choose("kernel", device, model, SettleRecorder(model), NUMERICS.resolve(model), None)
    assert choose("auto", device, Toy(), SettleRecorder(Toy()), NUMERICS.resolve(Toy()), None) == (
        "kernel",
        None,
    )


@pytest.mark.skipif(not llvm.get_host_cpu_features().get("fma"), reason="this processor has no multiply-add")
@pytest.mark.parametrize(("difference", "expected"), [("fma(a, a, -c)", 2.0**-60), ("a * a - c", 0.0)])
def test_only_a_fused_difference_keeps_the_last_bit(difference: str, expected: float) -> None:
    """The square of 1 + 2^-30 has a term 2^-60, which rounding of the product removes."""
    a = 1.0 + 2.0**-30
    values = np.array([a, a * a, 0.0])
    native(f"def one(s):\n    a = s[0]\n    c = s[1]\n    s[2] = {difference}")(values)
    assert values[2] == expected


@pytest.mark.skipif(not llvm.get_host_cpu_features().get("fma"), reason="this processor has no multiply-add")
def test_fused_sums_of_constants_are_those_of_the_compiled_program() -> None:
    """Also the signs of their zeros, and 2^-60, which rounding of the product removes."""
    a = 1.0 + 2.0**-30
    of_numbers = [(-0.0, 1.0, -0.0), (-0.0, 1.0, 0.0), (1.5, 2.0, -3.0), (a, a, -a * a), (np.inf, 1.0, 0.0)]
    compiled = native("def one(s):\n    s[3] = fma(s[0], s[1], s[2])")
    for numbers in of_numbers:
        values = np.array([*numbers, 0.0])
        compiled(values)
        constant = OPERATIONS["fma"].evaluate(*values[:3])
        assert (constant, np.signbit(constant)) == (values[3], np.signbit(values[3])), numbers


def test_contraction_can_be_turned_off() -> None:
    model = Toy()
    chunk = kernel_of(model, CrossingRecorder(model, crossings=3), NUMERICS.resolve(model), None).chunk
    contracted, separate = (
        cpu_program.Tile(chunk, 16, contraction=contracts).source for contracts in (True, False)
    )
    assert ("fma(" in contracted) is cpu_program.FUSES
    assert "fma(" not in separate


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("y += x", r"line `y \+= x"),
        ("y = [x]", r"expression `\[x\]"),
        ("y = x > 1.0", "expression `x > 1.0"),
        ("y = x % 2.0", "expression `x % 2.0"),
        ("y = z", "expression `z"),
        # operators by the kind of their operands
        ("y = s[4 / 2]", "expression `4 / 2"),
        ("y = s[1 ** 2]", r"expression `1 \*\* 2"),
        ("y = s[-1]", "expression `-1"),
        ("y = -(x < 1.0)", r"expression `-\(x < 1.0\)"),
        ("y = not x", "expression `not x"),
        ("y = x & x", "expression `x & x"),
        ("y = 2 * x", r"expression `2 \* x"),
        ("y = x + float32(x)", r"expression `x \+ float32\(x\)"),
        ("y = 1 < 2", "expression `1 < 2"),
        ("y = 1.0 if x else 2.0", "expression `1.0 if x else 2.0"),
        ("y = 1.0 if x < 2.0 else True", "expression `1.0 if x < 2.0 else True"),
        ("s[1] = 1", r"line `s\[1\] = 1"),
        ("s[1] = x < 1.0", r"line `s\[1\] = x < 1.0"),
        # elements of other than the array, and places that are no whole numbers
        ("z[1] = 1.0", "expression `z"),
        ("x[1] = 1.0", r"expression `x\[1\]"),
        ("y = s[0][1]", r"expression `s\[0\]\[1\]"),
        ("y = s[x]", r"expression `s\[x\]"),
        ("y = s[0:1]", "expression `0:1"),
        # functions and their arguments
        ("y = elsewhere(x)", r"expression `elsewhere\(x\)"),
        ("y = math.log()", r"expression `math.log\(\)"),
        ("y = math.log(x=1.0)", r"expression `math.log\(x=1.0\)"),
        ("y = fma(x, x)", r"expression `fma\(x, x\)"),
        ("y = fma(x, x, float32(x))", r"expression `fma\(x, x, float32\(x\)\)"),
        ("y = abs(1)", r"expression `abs\(1\)"),
        # branches, after which names that they assign have no value
        ("if any(x): pass", r"expression `any\(x\)"),
        ("if any(x < 1.0): x = 2.0\n    s[0] = x", "expression `x"),
        ("if any(x < 1.0): pass\n    else: y = 2.0\n    s[0] = y", "expression `y"),
        ("if any(x < 1.0):\n        if any(x < 0.0): x = 2.0\n    s[0] = x", "expression `x"),
    ],
)
def test_unsupported_source_is_named(line: str, named: str) -> None:
    with pytest.raises(ValueError, match=rf"The {named}.*` of a kernel is not lowered\. Allowed: "):
        native(f"def one(s):\n    x = s[0]\n    {line}\n")
