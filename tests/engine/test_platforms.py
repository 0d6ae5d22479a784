"""Devices of a process: without JAX's CPU (JAX_PLATFORMS=cuda), forked, and with all of its cores."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.engine import devices
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.errors import UnsupportedSystem
from tests.support.sweeping import devices_on, run_rows
from toy_model import Toy, launches


class Hidden:
    """JAX's functions that name devices, without a CPU backend as JAX_PLATFORMS=cuda leaves them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.real = jax.local_devices()
        self.asked: list[str | None] = []
        monkeypatch.setattr(jax, "devices", self.devices)
        monkeypatch.setattr(jax, "local_devices", lambda *args, backend=None: self.devices(backend))
        monkeypatch.setattr(type(jax.config), "jax_platforms", property(lambda _: "cuda"), raising=False)

    def devices(self, backend: str | None = None) -> list[Any]:
        self.asked.append(backend)
        if backend == "cpu":
            raise RuntimeError("Unknown backend cpu")
        return self.real


def test_kernels_run_where_jax_may_not_use_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Starts are computed on the device that JAX may use."""
    hidden = Hidden(monkeypatch)
    assert devices.host_device() is hidden.real[0]
    result = run_rows(
        Toy(),
        CrossingRecorder(Toy(), crossings=4),
        {"launch_1": 1.3},
        numerics=Numerics(),
        engine="kernel",
        on="cpu",
    )
    np.testing.assert_allclose(result.samples[:, 2], launches(1.3, 0.5, 0.5, 4), atol=1e-9)
    assert "cpu" not in hidden.asked


def test_starts_are_worked_out_on_the_cpu_where_jax_sees_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last bits of starts do not depend on a card that comes first."""
    asked: list[str | None] = []
    real = jax.local_devices()

    def local_devices(backend: str | None = None) -> list[Any]:
        asked.append(backend)
        return real if backend == "cpu" else ["card"]

    monkeypatch.setattr(jax, "local_devices", local_devices)
    for platforms in (None, "", "cuda,cpu"):
        monkeypatch.setattr(
            type(jax.config), "jax_platforms", property(lambda _, p=platforms: p), raising=False
        )
        assert devices.host_device() is real[0]
    assert set(asked) == {"cpu"}
    assert devices_on("cpu", "kernel")[0].platform == "cpu"


@pytest.fixture
def before_jax(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str, set[str]], None]:
    """Let this process be one that has not imported JAX, with two cards, such platforms and such plugins."""
    cards = [types.SimpleNamespace(name="NVIDIA H200")] * 2
    cuda = types.SimpleNamespace(Device=types.SimpleNamespace(get_all_devices=lambda: cards))
    driver = types.SimpleNamespace(cuDriverGetVersion=lambda: (0, 13000))
    of_jax = [devices.KnownDevice("gpu", "NVIDIA H200", number) for number in range(2)]

    def prepare(requested: str, plugins: set[str]) -> None:
        for name, module in {"cuda": cuda, "cuda.core": cuda, "cuda.bindings": cuda}.items():
            monkeypatch.setitem(sys.modules, name, module)
        monkeypatch.setattr(cuda, "driver", driver, raising=False)
        for name in [name for name in os.environ if name.startswith(devices._SETTINGS)]:
            monkeypatch.delenv(name)
        monkeypatch.setenv("JAX_PLATFORMS", requested)
        monkeypatch.setattr(devices, "_accelerators", lambda: dict.fromkeys(plugins, "1.0"))
        monkeypatch.setattr(devices, "_cards_known", False)
        # each look is one of another process
        monkeypatch.setattr(devices, "_cards_and_driver", devices._cards_and_driver.__wrapped__)
        monkeypatch.setattr(devices, "cache_folder", lambda name: tmp_path)
        monkeypatch.setattr(jax, "local_devices", lambda: of_jax)
        assert devices._known_devices() is None  # once JAX is imported, it is asked
        monkeypatch.delitem(sys.modules, "jax")

    return prepare


@pytest.mark.parametrize(
    ("requested", "plugins", "platform"),
    [
        ("", set(), "cpu"),
        ("cpu", {"xla_cuda13"}, "cpu"),
        ("cpu,cuda", {"xla_cuda13"}, None),
        ("cpu,typo", set(), None),
        ("cuda", set(), None),
        ("tpu", {"libtpu"}, None),
    ],
)
def test_devices_before_jax_is_imported(
    requested: str, plugins: set[str], platform: str | None, before_jax: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """JAX is asked where its choice between several platforms is open, or a setting may change it."""
    before_jax(requested, plugins)
    cores = [("cpu", "cpu", number) for number in range(devices.usable_cores())]
    assert devices._known_devices() == (cores if platform else None)
    monkeypatch.setenv("XLA_FLAGS", "--xla_force_host_platform_device_count=1")
    assert devices._known_devices() is None


@pytest.mark.parametrize("requested", ["", "cuda,cpu"])
def test_cards_that_jax_has_found_before(
    requested: str, before_jax: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A plugin may fail to start, so JAX is asked once for each driver."""
    before_jax(requested, {"xla_cuda13"})
    assert devices._known_devices() is None
    devices.refuse_missing_platform()  # each job is read with it, before its devices are looked up
    found = devices.local_devices()
    assert devices._known_devices() == found
    monkeypatch.setattr(sys.modules["cuda.bindings"].driver, "cuDriverGetVersion", lambda: (0, 14000))
    assert devices._known_devices() is None


def test_a_fork_of_a_process_with_cards_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """CUDA does not survive it."""
    monkeypatch.setattr(devices, "_computed_before", False)
    monkeypatch.setattr(devices, "_cards_known", True)
    devices._note_fork()
    with pytest.raises(UnsupportedSystem, match="fork of one that has computed with JAX or a GPU"):
        devices.refuse_fork()


def test_devices_without_jax_are_those_of_jax() -> None:
    code = (
        "import sys; from gaitsweep.lazy_imports import lazy_packages\n"
        "with lazy_packages(): from gaitsweep.engine.devices import local_devices, of_jax\n"
        "known = local_devices(); assert 'jax' not in sys.modules; import jax\n"
        "assert [of_jax(device) for device in known] == jax.local_devices() == local_devices()\n"
        "assert [d.device_kind for d in known] == [d.device_kind for d in jax.local_devices()]\n"
    )
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "XLA_"))}
    subprocess.run([sys.executable, "-c", code], env={**clean, "JAX_PLATFORMS": "cpu"}, check=True)


def test_a_device_that_jax_lacks_is_refused() -> None:
    with pytest.raises(UnsupportedSystem, match=r"JAX does not find device 0 \(NVIDIA H200\)"):
        devices.of_jax(devices.KnownDevice("gpu", "NVIDIA H200", 0))


def _in_a_fork(call: Callable[[], object]) -> str:
    """The error of a call in a fork of this process; one that waits is ended after 20 s."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(20)
        try:
            call()
            message = "nothing"
        except BaseException as error:
            message = f"{type(error).__name__}: {error}"
        os.write(writer, message.encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        message = pipe.read()
    os.waitpid(child, 0)
    return message


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*fork:RuntimeWarning", "ignore:.*fork:DeprecationWarning")
def test_a_fork_refuses_to_compute() -> None:
    jnp.zeros(1).block_until_ready()
    mapping = gs.return_map(Toy())
    for call in (
        lambda: gs.sweep(Toy(), launch_1=[1.0], run=gs.FixedTime(duration=0.1), verify=0),
        lambda: gs.simulate(Toy(), duration=1.0),
        lambda: gs.return_map(Toy()),
        lambda: mapping(np.ones(len(mapping.coordinates))),
        lambda: mapping.settled({"launch_1": 1.0}),
    ):
        message = _in_a_fork(call)
        assert message.startswith("UnsupportedSystem"), message
        assert all(word in message for word in ("spawn", "client=", "all cores"))
    assert _in_a_fork(lambda: gs.Settle(max_cycles=3)) == "nothing"


@pytest.mark.slow
def test_reading_a_job_leaves_every_core_to_its_run(tmp_path: Any) -> None:
    """JAX counts its devices at its first computation, which is that of a job's steps."""
    (tmp_path / "job.yaml").write_text(
        "name: cores\nmodel: multilegged\nstart: {psi_1: 1, psi_2: 2, psi_3: 3}\nrun: {kind: settle}\n"
    )
    code = (
        "import os; from gaitsweep.job import load_job; "
        "from gaitsweep.engine.devices import local_devices; "
        "load_job('job.yaml'); print(len(local_devices()) == len(os.sched_getaffinity(0)))"
    )
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "True"


@pytest.mark.parametrize(("default", "platform"), [(None, "gpu"), ("cpu", "cpu")])
def test_what_is_on_no_device_is_on_the_default_device(
    default: str | None, platform: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A command makes the CPU the default device of a machine with a GPU."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    with jax.default_device(default):
        assert devices.default_platform() == platform
    with jax.default_device(jax.devices("cpu")[0]):
        assert devices.default_platform() == "cpu"
