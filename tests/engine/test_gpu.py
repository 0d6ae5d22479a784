"""The engines on a CUDA device against the reference: `JAX_PLATFORMS=cuda pytest -m gpu`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gaitsweep.engine.kernel import gpu_program
from gaitsweep.engine.kernel.cuda_device import CudaDevice, DeviceArray, unavailable
from gaitsweep.engine.kernel.lanes import kernel_of
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.examples.compass_walker import CompassWalker
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from gaitsweep.papers.fukuoka2015.planar_quadruped import PlanarQuadruped
from tests.support.multilegged_crossings import reference, simulated, wrapped
from tests.support.sweeping import run_rows, same

pytestmark = pytest.mark.gpu


def test_packages_of_kernels_are_installed() -> None:
    """`auto` would use XLA in all of these tests without these packages."""
    assert unavailable() is None


def test_a_large_kernel_has_all_registers_that_a_thread_may_have() -> None:
    """255 of them leave room for two blocks; the compiler's own choice was 32, and a tenth of the speed."""
    model = PlanarQuadruped()
    numerics = Numerics(method="semi_implicit").resolve(model)
    kernel = kernel_of(model, CrossingRecorder(model, crossings=10), numerics, None)
    card = CudaDevice(0)
    source = gpu_program.run_kernel(kernel.chunk, range(kernel.chunk.first_of_carry), kernel.title).source
    threads = card.threads(card.module(source).get_kernel("run"))
    assert threads == 2 * gpu_program.THREADS * card.use().properties.multiprocessor_count


def test_crossings_on_a_card_agree_with_solve_ivp() -> None:
    """The same bound as on a CPU: 95 % of random starts within 1e-6 rad over ten crossings."""
    _, table = reference("base")
    exact = table[["psi_1", "psi_2", "psi_3"]].to_numpy().reshape(len(set(table["start"])), -1, 3)
    _, psi, _ = simulated({}, exact[:, 0], exact.shape[1] - 1, devices=1)
    worst = wrapped(psi - exact).max(axis=(1, 2))
    assert np.mean(worst < 1e-6) >= 0.95


@pytest.mark.parametrize(("method", "dt"), [("rk4", 4e-3), ("propagator6", 32e-3)])
def test_kernels_on_a_card_agree_with_solve_ivp(method: str, dt: float) -> None:
    """One thread a trajectory, rows refilled and kept on the way: the bound of the XLA engine."""
    _, table = reference("base")
    exact = table[["psi_1", "psi_2", "psi_3"]].to_numpy().reshape(len(set(table["start"])), -1, 3)
    starts = {f"psi_{i + 1}": exact[:, 0, i] for i in range(3)}
    numerics = Numerics(dt=dt, method=method)
    recorder = CrossingRecorder(Multilegged(), crossings=exact.shape[1] - 1)
    result = run_rows(Multilegged(), recorder, starts, numerics=numerics, lanes=64, engine="kernel")
    psi = result.samples.reshape(len(exact), exact.shape[1], -1)[:, :, 2:5]
    assert np.mean(wrapped(psi - exact).max(axis=(1, 2)) < 1e-6) >= 0.95


def test_settling_on_a_card() -> None:
    """Gaits and cycles of settling of kernels and XLA, over rows that outnumber the lanes."""
    random = np.random.default_rng(8)
    starts = {f"psi_{i}": random.uniform(0, 2 * np.pi, 48) for i in (1, 2, 3)}
    numerics = Numerics(dt=32e-3, method="propagator6")
    recorder = SettleRecorder(Multilegged())
    kernel, xla = (
        run_rows(Multilegged(), recorder, starts, numerics=numerics, lanes=lanes, engine=engine)
        for engine, lanes in (("kernel", 32), ("xla", 48))
    )
    np.testing.assert_array_equal(kernel.status, xla.status)
    assert np.mean(kernel.labels["gait"] == xla.labels["gait"]) >= 0.95


@pytest.mark.parametrize("method", ["taylor", "rodas5p"])
def test_a_walker_by_other_methods_on_a_card_as_by_tsit5(method: str) -> None:
    """Twenty steps of each row, whose differences the walk keeps small."""
    model, starts = CompassWalker(), {"stance_rate_0": np.linspace(1.08, 1.1, 100)}
    recorder = CrossingRecorder(model, crossings=20)
    other, tsit5 = (
        run_rows(
            model, recorder, starts, numerics=Numerics(method=name, rtol=1e-12, atol=1e-12), engine="kernel"
        )
        for name in (method, "tsit5")
    )
    np.testing.assert_array_equal(other.status, tsit5.status)
    np.testing.assert_allclose(other.samples, tsit5.samples, rtol=0.0, atol=1e-9)


def test_rows_are_independent_of_which_constants_others_share() -> None:
    """Constants that all rows share reach the threads in another way than others."""
    starts = {f"psi_{i}": np.full(40, 0.7 * i) for i in (1, 2, 3)}
    recorder = CrossingRecorder(Multilegged(), crossings=12)
    alike, mixed = (
        run_rows(
            Multilegged(),
            recorder,
            starts,
            params={"beta": np.where(np.arange(40) < 39, 0.8, other), "kappa": 100.0},
            numerics=Numerics(dt=4e-3),
            lanes=16,
            engine="kernel",
        )
        for other in (0.8, 0.75)
    )
    width = alike.samples.shape[1]
    one, other = (result.samples.reshape(40, -1, width)[:39] for result in (alike, mixed))
    np.testing.assert_array_equal(one, other)
    assert np.any(alike.last[39] != mixed.last[39])


def test_the_quadruped_on_a_card_as_on_a_cpu() -> None:
    """Fixed steps, products of small matrices, inverse trigonometry: the first landings to 1e-9.

    A kernel of a CPU needs no CPU device of JAX.
    """
    model = WaistQuadruped()
    starts, params = {"delta_13": np.array([2.2, 3.0])}, {"T_grow": 0.4, "T_hold": 0.7}
    numerics = Numerics(dt=2e-4, method="semi_implicit")
    recorder = CrossingRecorder(model, crossings=5)
    on = {
        platform: run_rows(
            model, recorder, starts, params=params, numerics=numerics, engine="kernel", on=platform
        )
        for platform in ("gpu", "cpu")
    }
    np.testing.assert_allclose(on["gpu"].samples, on["cpu"].samples, atol=1e-9)


@pytest.mark.parametrize("contraction", [True, False])
def test_rows_do_not_depend_on_lanes(contraction: bool) -> None:
    """Lanes that are refilled, blocks, and buffers that are emptied at other times: equal to the bit."""
    random = np.random.default_rng(5)
    starts = {f"psi_{i}": random.uniform(0, 2 * np.pi, 90) for i in (1, 2, 3)}
    recorder = CrossingRecorder(Multilegged(), crossings=8)
    numerics = Numerics(dt=32e-3, method="propagator6", contraction=contraction)
    one, two = (
        run_rows(
            Multilegged(), recorder, starts, numerics=numerics, lanes=lanes, block=block, engine="kernel"
        )
        for lanes, block in ((17, 20), (90, 90))
    )
    same(one, two)


def test_a_compiled_kernel_is_loaded_from_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path))
    source = 'extern "C" __global__ void one(double* x) { x[0] = 1.0; }'
    card = CudaDevice(0)
    card.module(source)
    (file,) = (tmp_path / "kernels").glob("*.cubin")
    written = file.stat().st_mtime_ns
    x = DeviceArray(card, (1,))
    card.launch(card.module(source).get_kernel("one"), 1, x)
    assert x.from_card(1)[0] == 1.0
    assert file.stat().st_mtime_ns == written
