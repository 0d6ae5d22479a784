"""The scalar kernels against the XLA engine: the same rows, whatever the recorder, lanes and devices."""

from __future__ import annotations

import dataclasses
import importlib.util
import os
import re
import subprocess
import sys
import types
from pathlib import Path

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
import pytest

from firing_neuron import Neuron
from gaitsweep.contract import Status
from gaitsweep.engine.kernel import cpu_program, llvm_code
from gaitsweep.engine.kernel.lanes import kernel_of
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.crossings import CrossingRecorder
from gaitsweep.engine.recorders.ramp import RampSchedule
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.engine.recorders.trace import TraceRecorder
from gaitsweep.engine.sweep.engines import EngineError, choose
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from tests.support import environment
from tests.support.multilegged_crossings import wrapped
from tests.support.scalar_programs import native
from tests.support.sweeping import run_rows, same
from toy_model import Toy

LAUNCH = np.linspace(0.1, 4.0, 23)
NUMERICS = Numerics(dt=1e-2)


@pytest.fixture(scope="module", autouse=True)
def kernels(tmp_path_factory: pytest.TempPathFactory):
    """A folder of kernels of its own, so that nothing is left over from another day."""
    before = os.environ.get("GAITSWEEP_CACHE")
    os.environ["GAITSWEEP_CACHE"] = str(tmp_path_factory.mktemp("cache"))
    yield Path(os.environ["GAITSWEEP_CACHE"])
    if before is None:
        del os.environ["GAITSWEEP_CACHE"]
    else:
        os.environ["GAITSWEEP_CACHE"] = before


def both(recorder, starts, **options):
    model = recorder.model
    return [run_rows(model, recorder, starts, engine=name, **options) for name in ("kernel", "xla")]


def agree(kernel, xla, tolerance: float) -> None:
    """Attempts may differ by one trial of an event here and there: the last bits decide."""
    np.testing.assert_array_equal(kernel.status, xla.status)
    np.testing.assert_array_equal(kernel.cycles, xla.cycles)
    np.testing.assert_array_equal(kernel.owner, xla.owner)
    np.testing.assert_allclose(kernel.last, xla.last, rtol=0, atol=tolerance)
    np.testing.assert_allclose(kernel.samples, xla.samples, rtol=0, atol=tolerance)


@pytest.mark.slow
def test_settling_with_kernels_as_with_xla() -> None:
    kernel, xla = both(SettleRecorder(Toy()), {"launch_1": LAUNCH}, numerics=NUMERICS, lanes=4)
    agree(kernel, xla, 1e-12)
    np.testing.assert_array_equal(kernel.labels["gait"], xla.labels["gait"])


def test_a_row_depends_on_itself_alone() -> None:
    """Other lanes, blocks and devices, and the rows in another order: equal to the bit."""
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
def test_rows_that_fail_harm_no_other() -> None:
    """A fall, a start that is no number, and one that diverges, among rows that are well."""
    launch = np.array([1.0, np.nan, 2.0, 1e200, 40.0, 0.5])
    params = {"ceiling": np.array([1000.0, 1000.0, 1000.0, 1e300, 1.0, 1000.0])}
    kernel, xla = both(
        SettleRecorder(Toy(), max_cycles=40), {"launch_1": launch}, params=params, numerics=NUMERICS, lanes=8
    )
    np.testing.assert_array_equal(kernel.status, xla.status)
    assert Status(kernel.status[1]) is Status.not_a_number
    assert {Status(kernel.status[3]), Status(kernel.status[4])} == {Status.diverged, Status.fell}
    well = [0, 2, 5]
    alone = run_rows(
        Toy(),
        SettleRecorder(Toy(), max_cycles=40),
        {"launch_1": launch[well]},
        numerics=NUMERICS,
        engine="kernel",
    )
    np.testing.assert_array_equal(kernel.last[well], alone.last)


@pytest.mark.slow
def test_traces_and_ramps() -> None:
    trace = TraceRecorder(Toy(), duration=5.0, every=0.05, after_cycles=1)
    kernel, xla = both(trace, {"launch_1": LAUNCH[:5]}, lanes=4)
    agree(kernel, xla, 1e-10)
    path = RampSchedule((1.0, 2.0, 1.0), rate=0.02)

    def drive(values, t):
        return Toy().params({**values, "kick": path.at(t)})

    kernel, xla = both(
        CrossingRecorder(Toy(), duration=path.duration),
        {"launch_1": [0.5, 2.0]},
        numerics=NUMERICS,
        drive=drive,
    )
    assert len(kernel.samples) > 40, "more crossings than a buffer holds"
    agree(kernel, xla, 1e-9)


@pytest.mark.slow
def test_a_neuron_that_fires() -> None:
    model = Neuron()
    kernel, xla = both(
        CrossingRecorder(model, crossings=5), {q.name: np.array([0.1]) for q in model.initial_conditions}
    )
    agree(kernel, xla, 1e-10)


@pytest.mark.slow
def test_single_precision() -> None:
    numerics = Numerics(dt=1e-2, precision="float32")
    kernel, xla = both(
        SettleRecorder(Toy(), tolerance=1e-2), {"launch_1": LAUNCH}, numerics=numerics, lanes=8
    )
    np.testing.assert_array_equal(kernel.status, xla.status)
    np.testing.assert_allclose(kernel.last, xla.last, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "dt"), [("rk4", 4e-3), ("propagator6", 32e-3)])
def test_the_chain_with_kernels_as_with_xla(method: str, dt: float) -> None:
    """1e-9 over ten crossings is what is promised; rounding alone grows to some 1e-11 on the way."""
    random = np.random.default_rng(3)
    starts = {f"psi_{i}": random.uniform(0, 2 * np.pi, 12) for i in (1, 2, 3)}
    kernel, xla = both(
        CrossingRecorder(Multilegged(), crossings=10),
        starts,
        numerics=Numerics(dt=dt, method=method),
        devices=2,
    )
    np.testing.assert_array_equal(kernel.status, xla.status)
    assert wrapped(kernel.samples[:, 2:5] - xla.samples[:, 2:5]).max() < 1e-9


def test_lanes_run_in_vector_registers() -> None:
    """The chain's attempt is nearly all packed arithmetic: LLVM turned the loop over lanes into vectors."""
    if not llvm.get_host_cpu_features().get("avx2"):
        pytest.skip("this processor has no AVX2")
    recorder = CrossingRecorder(Multilegged(), crossings=10)
    kernel = kernel_of(Multilegged(), recorder, Numerics(dt=4e-3, method="rk4").resolve(Multilegged()), None)
    assembly = llvm_code.assembly(cpu_program.Tile(kernel.chunk, cpu_program.TILE, True).module())
    packed = len(re.findall(r"\tv(?:f[n]?m\w+|add|sub|mul)pd\t.*[yz]mm", assembly))
    single = len(re.findall(r"\tv(?:f[n]?m\w+|add|sub|mul|div)sd\t", assembly))
    assert packed > 300
    assert single < packed / 20
    # what is spilled lies in one cache line
    assert re.search(rf"\tandq\t\$-{8 * cpu_program.TILE}, %rsp", assembly)


@pytest.mark.slow
def test_a_second_process_finds_the_kernel(kernels: Path) -> None:
    """Compiled once for the machine: the second process loads what the first has left."""
    script = (
        "import numpy as np\n"
        "from gaitsweep.engine.kernel import llvm_code\n"
        "compiled, compile_ = [], llvm_code.machine_code\n"
        "llvm_code.machine_code = lambda module: compiled.append(1) or compile_(module)\n"
        "from tests.support.sweeping import run_rows\n"
        "from toy_model import Toy\n"
        "from gaitsweep.engine.recorders.settle import SettleRecorder\n"
        "run_rows(Toy(), SettleRecorder(Toy(), max_cycles=33), {'launch_1': np.ones(3)}, engine='kernel')\n"
        "print(len(compiled))\n"
    )
    compiled = [
        subprocess.run(
            [sys.executable, "-c", script],
            env=environment(JAX_ENABLE_X64="1"),
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for _ in range(2)
    ]
    assert compiled == ["2\n", "0\n"]  # one opens rows, the other advances them


@dataclasses.dataclass(frozen=True)
class Sampling(Toy):
    """A model whose flow factorises a matrix, which no scalar kernel does."""

    def flow(self, params, state):
        rates = super().flow(params, state)
        size = jnp.linalg.cholesky(jnp.eye(2) * params.mass)[0, 0]
        return {**rates, "speed": rates["speed"] * size}


def test_a_card_without_its_packages_runs_on_xla() -> None:
    """The reason is one sentence, as for a model that kernels cannot express."""
    if importlib.util.find_spec("cuda") is not None:
        pytest.skip("NVIDIA's packages are installed")
    card = types.SimpleNamespace(platform="gpu")
    engine, note = choose("auto", card, Toy(), SettleRecorder(Toy()), NUMERICS.resolve(Toy()), None)
    assert (engine, note) == ("xla", "engine: xla, because the package cuda-core is not installed.")


def test_what_a_kernel_cannot_express_runs_on_xla() -> None:
    device = jax.local_devices()[0]
    model = Sampling()
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


@pytest.mark.skipif(not llvm.get_host_cpu_features().get("fma"), reason="no multiply-add here")
def test_contraction_can_be_turned_off() -> None:
    """The square of 1 + 2^-30 has a last bit that only a fused difference sees."""
    a = 1.0 + 2.0**-30
    results = []
    for line in ("fma(a, a, -c)", "a * a - c"):
        values = np.array([a, a * a, 0.0])
        native(f"def one(s):\n    a = s[0]\n    c = s[1]\n    s[2] = {line}")(values)
        results.append(values[2])
    assert results == [2.0**-60, 0.0]
    model = Toy()
    chunk = kernel_of(model, CrossingRecorder(model, crossings=3), NUMERICS.resolve(model), None).chunk
    fused, apart = (cpu_program.Tile(chunk, 16, each).source for each in (True, False))
    assert ("fma(" in fused) is cpu_program.FUSES
    assert "fma(" not in apart


@pytest.mark.parametrize(("line", "found"), [("y += x", r"line `y \+= x"), ("y = [x]", r"expression `\[x\]")])
def test_what_is_not_lowered_is_named(line: str, found: str) -> None:
    with pytest.raises(ValueError, match=rf"The {found}.*` of a kernel is not lowered\. Allowed: "):
        native(f"def one(s):\n    x = s[0]\n    {line}\n")
